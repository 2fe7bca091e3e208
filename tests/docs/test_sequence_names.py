"""A sequence has one name on all pages: the one that ``dynaviz info`` prints."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "README.md",
    "benchmarks/README.md",
    *(str(page.relative_to(ROOT)) for page in sorted((ROOT / "docs").rglob("*.md"))),
)
NAMES = [
    drive["name"]
    for file in ("real", "sealed")
    for drive in json.loads((ROOT / f"docs/{file}.json").read_text(encoding="utf-8"))["drives"]
]
FORMATS = ("kitti_tracking", "kitti_raw", "nuscenes", "pandaset", "semantickitti", "argoverse2")
DATA_SETS = ("KITTI tracking", "KITTI raw", "nuScenes", "PandaSet", "SemanticKITTI")


def other_spellings(text: str) -> Iterator[str]:
    """Places that name a sequence of a data set in another way.

    Paths, such as ``velodyne/0012``, are no names. Nor are sequences of a whole data set in a
    sentence about the data set, such as frames of KITTI 00.
    """
    prose = re.sub(r"```.*?```", "", text, flags=re.S)
    for code in re.findall(r"`([^`\n]+)`", prose):
        for known in NAMES:
            if (
                "/" not in code
                and code != known
                and re.sub(r"[^a-z0-9]", "", code.lower())
                == re.sub(r"[^a-z0-9]", "", known.lower())
            ):
                yield code
    plain = re.sub(r"`[^`\n]*`|\]\([^)]*\)", "", prose)
    words = "|".join((*DATA_SETS, *FORMATS, *(each.replace("_", " ") for each in FORMATS)))
    yield from re.findall(rf"(?:{words})[ _](?:scene-|drive )?\d{{2,}}\b", plain)
    for known in NAMES:
        yield from re.findall(rf"(?<![\w/.,-]){known.replace('_', ' ')}", plain)
        if (number := re.fullmatch(r"\D+?(?:_|-)(0\d{3})", known)) is not None:
            yield from re.findall(rf"(?<![\w/.,-]){number[1]}(?![\w-]|[.,]\d)", plain)


@pytest.mark.parametrize("page", PAGES)
def test_sequences_have_one_name(page: str) -> None:
    assert not list(other_spellings((ROOT / page).read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("AA on KITTI tracking 0012 is 98", ["KITTI tracking 0012", "0012"]),
        ("| kitti tracking 0011 |", ["kitti tracking 0011", "kitti tracking 0011", "0011"]),
        ("on `kitti_tracking_0012`; `velodyne/0012`, 0.0012", []),
        ("`nuscenes scene-0916`", ["nuscenes scene-0916"]),
    ],
)
def test_the_check_finds_other_spellings(text: str, found: list[str]) -> None:
    assert sorted(other_spellings(text)) == sorted(found)
