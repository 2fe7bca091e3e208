"""JUnit XML of checked results, which CI systems show next to a build."""

from __future__ import annotations

from itertools import groupby
from xml.etree import ElementTree as xml

from dynaviz.scores.regression import CheckedValue, CheckOutcome, RegressionCheck


def junit_xml(checked: RegressionCheck) -> bytes:
    """A test suite with a test case for each checked value of each run; values for information are not in it."""
    root = xml.Element("testsuites", name="dynaviz check")
    values = [each for each in checked.values if each.outcome is not CheckOutcome.INFO]
    for run, of_run in groupby(sorted(values, key=lambda each: each.run), key=lambda each: each.run):
        rows = list(of_run)
        failed = sum(each.outcome is CheckOutcome.FAILED for each in rows)
        suite = xml.SubElement(root, "testsuite", name=run, tests=f"{len(rows)}", failures=f"{failed}")
        for each in rows:
            case = xml.SubElement(suite, "testcase", classname=run, name=each.name)
            text = _sentence(each)
            if each.outcome is CheckOutcome.FAILED:
                xml.SubElement(case, "failure", message=text).text = text
            else:
                xml.SubElement(case, "system-out").text = text
    xml.indent(root)
    document: bytes = xml.tostring(root, encoding="utf-8", xml_declaration=True)
    return document


def _sentence(checked: CheckedValue) -> str:
    """The value, its limit and the remark."""
    numbers = [] if checked.value is None else [f"{checked.name} {checked.value:.2f} %"]
    numbers += [] if checked.limit is None else [f"at least {checked.limit:.2f} % is required"]
    counts = [f"{name} {count:,}" for name, (count, _) in checked.counts.items()]
    return "; ".join([*numbers, *([checked.remark] if checked.remark else []), *counts]) or "passed"
