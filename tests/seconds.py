"""Write the seconds of each suite, the faults that it found, and the slowest hundred tests to
``seconds.csv``.

pytest -n 2 -m "not slow" --junitxml=build/junit.xml
python tests/mutants.py dynaviz/io dynaviz/scores ... --sample 6 > build/mutants.txt
python tests/seconds.py build/junit.xml build/mutants.txt
"""

import collections
import csv
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

rows, suites = [], collections.defaultdict[str, list[float]](list)
for case in ET.parse(sys.argv[1]).iter("testcase"):
    place = [part for part in case.get("classname", "").split(".")[1:] if not part[0].isupper()]
    rows.append((float(case.get("time", 0)), "/".join(place) + ".py", case.get("name")))
    suites[place[0] if len(place) > 1 else "others"].append(rows[-1][0])
lines = re.findall(r"(\d+) of (\d+) killed by tests/(\w+)", Path(sys.argv[2]).read_text())
found = {suite: f"{killed} of {tried}" for killed, tried, suite in lines}
with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
    write = csv.writer(file, lineterminator="\n").writerow
    write(("seconds", "tests", "injected faults found", "suite or test"))
    for name, seconds in sorted(suites.items(), key=lambda each: -sum(each[1])):
        write((f"{sum(seconds):.1f}", len(seconds), found.get(name, ""), name))
    for seconds, path, name in sorted(rows, reverse=True)[:100]:
        write((f"{seconds:.1f}", 1, "", f"{path}::{name}"))
