"""Checks of results as JUnit XML, and as Markdown for the summary of a job."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from xml.etree import ElementTree as xml

from dynaviz.scores.regression import CheckedValue, CheckOutcome, RegressionCheck

HEAD = "| run | metric | value [%] | limit [%] | before [%] |\n|---|---|---|---|---|\n"
COST_OF = {"SA": "SA", "DA": "DA"}  # the metric that cases cost; of others, both


def junit_xml(checked: RegressionCheck) -> bytes:
    """A test suite with a test case for each checked value of each run.

    A failure lists the cases that are new or grew. Values for information are not in it.
    """
    root = xml.Element("testsuites", name="dynaviz check")
    values = [each for each in checked.values if each.outcome is not CheckOutcome.INFO]
    for run, of_run in groupby(
        sorted(values, key=lambda each: each.run), key=lambda each: each.run
    ):
        rows = list(of_run)
        failed = sum(each.outcome is CheckOutcome.FAILED for each in rows)
        suite = xml.SubElement(
            root, "testsuite", name=run, tests=f"{len(rows)}", failures=f"{failed}"
        )
        for each in rows:
            case = xml.SubElement(suite, "testcase", classname=run, name=each.name)
            text = _sentence(each)
            if each.outcome is CheckOutcome.FAILED:
                where = "".join(f"\n{line}" for line in _where(checked, each))
                xml.SubElement(case, "failure", message=text).text = text + where
            else:
                xml.SubElement(case, "system-out").text = text
    xml.indent(root)
    document: bytes = xml.tostring(root, encoding="utf-8", xml_declaration=True)
    return document


def markdown(checked: RegressionCheck) -> str:
    """Failed checks as a table, and where each run lost points."""
    failed = checked.failed
    total = sum(each.outcome is not CheckOutcome.INFO for each in checked.values)
    lines = [f"### {len(failed)} of {total} checks failed\n" if failed else "### Checks passed\n"]
    numbers = [each for each in failed if not each.is_text]
    rows = [
        f"| {each.run} | {each.name} | {_cell(each.value)} | {_cell(each.limit)} | "
        f"{_cell(each.before)} |\n"
        for each in numbers
    ]
    if rows:
        lines.append(HEAD + "".join(rows))
    lines += [f"- {each.run}: {each.remark}" for each in failed if each.is_text]
    for run, changes in checked.cases.items():
        lines.append(f"\n**{run}**: cases that are new or cost more\n")
        for change in changes:
            command = "" if change.command is None else f"  \n  `{change.command}`"
            lines.append(f"- {change.text}{command}")
    return "\n".join(lines) + "\n"


def _where(checked: RegressionCheck, failed: CheckedValue) -> Iterator[str]:
    """Cases of a run that lower a metric, and how to look at them."""
    for change in checked.cases.get(failed.run, ()):
        if COST_OF.get(failed.name, change.case.metric) == change.case.metric:
            yield change.text
            if change.command is not None:
                yield f"  {change.command}"


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _sentence(checked: CheckedValue) -> str:
    """The value, its limit and the remark."""
    numbers = [] if checked.value is None else [f"{checked.name} {checked.value:.2f} %"]
    numbers += [] if checked.limit is None else [f"at least {checked.limit:.2f} % is required"]
    numbers += [] if checked.before is None else [f"{checked.before:.2f} % before"]
    counts = [f"{name} {count:,}" for name, (count, _) in checked.counts.items()]
    return "; ".join([*numbers, *([checked.remark] if checked.remark else []), *counts]) or "passed"
