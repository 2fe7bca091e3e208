"""Write the seconds of each suite and of the slowest hundred tests to ``seconds.csv``.

pytest -n 2 -m "not slow" --junitxml=build/junit.xml
python tests/seconds.py build/junit.xml
"""

import collections
import csv
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

rows, suites = [], collections.defaultdict[str, list[float]](list)
for case in ET.parse(sys.argv[1]).iter("testcase"):
    place = [part for part in case.get("classname", "").split(".")[1:] if not part[0].isupper()]
    rows.append((float(case.get("time", 0)), "/".join(place) + ".py", case.get("name")))
    suites[place[0] if len(place) > 1 else "others"].append(rows[-1][0])
with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
    write = csv.writer(file, lineterminator="\n").writerow
    write(("seconds", "tests", "suite or test"))
    for name, seconds in sorted(suites.items(), key=lambda each: -sum(each[1])):
        write((f"{sum(seconds):.1f}", len(seconds), name))
    for seconds, path, name in sorted(rows, reverse=True)[:100]:
        write((f"{seconds:.1f}", 1, f"{path}::{name}"))
