"""The table of results on real drives follows from its file, and the file from the data."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.scores.movers import DRAWS

ROOT = Path(__file__).resolve().parents[2]
SEALED: dict[str, Any] = json.loads((ROOT / "docs/sealed.json").read_text(encoding="utf-8"))
STORED: dict[str, Any] = json.loads((ROOT / "docs/real.json").read_text(encoding="utf-8"))
DRIVE, METHOD = "nuscenes_scene-0916", "beautymap"
COLUMNS = {
    ("given", False): 1,
    ("small-gicp", False): 2,
    ("given", True): 3,
    ("small-gicp", True): 4,
}  # after the method
CELL = next(
    cell
    for cell in STORED["cells"]
    if (cell["drive"], cell["method"], cell["poses"]) == (DRIVE, METHOD, "given")
)
TUNED = next(cell for cell in STORED["cells"] if cell["set"] and cell["poses"] == "small-gicp")


@pytest.mark.parametrize("cell", [CELL, TUNED], ids=["default", "tuned"])
def test_a_row_follows_from_the_file(cell: dict[str, Any]) -> None:
    page = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    scores = page[page.index("### Scores") :]
    scores = scores.split(f"| `{cell['drive']}` |")[1]  # a drive is named in its first row
    row = next(line for line in scores.splitlines() if f"`{cell['method']}`" in line)
    row = row[row.index(f"`{cell['method']}`") :]
    text = row.split("|")[COLUMNS[cell["poses"], bool(cell["set"])]]
    SA, DA, AA, low, high, found = map(float, re.findall(r"[\d.]+", text))
    kept, removed = cell["static"]
    points = [
        number
        for drive in STORED["drives"]
        if drive["name"] == cell["drive"]
        for _, number in drive["movers"]
    ]
    static, dynamic = kept / (kept + removed), sum(cell["removed"]) / sum(points)
    assert pytest.approx([100 * static, 100 * dynamic], abs=0.05) == [SA, DA]
    assert pytest.approx(100 * (static * dynamic) ** 0.5, abs=0.05) == AA
    assert found == sum(
        part / whole >= 0.5 for part, whole in zip(cell["removed"], points, strict=True)
    )
    rng, drawn = np.random.default_rng(1), []
    for _ in range(DRAWS):
        chosen = rng.integers(len(points), size=len(points)).tolist()
        share = sum(cell["removed"][k] for k in chosen) / sum(points[k] for k in chosen)
        drawn.append(100 * (static * share) ** 0.5)
    assert [low, high] == pytest.approx(np.quantile(drawn, [0.025, 0.975]), abs=2.5)


def test_every_drive_has_every_method_with_both_poses() -> None:
    """Methods of packages in ``examples/`` may lack some."""
    others = {path.name for path in (ROOT / "examples").iterdir()}
    methods = {cell["method"] for cell in STORED["cells"]} - others
    for drive in STORED["drives"]:
        for poses in ("given", "small-gicp"):
            cells = [
                c
                for c in STORED["cells"]
                if (c["drive"], c["poses"]) == (drive["name"], poses) and not c["set"]
            ]
            assert sorted({cell["method"] for cell in cells} - others) == sorted(methods)
            assert {len(cell["removed"]) for cell in cells} == {len(drive["movers"])}


def sealed_rows(page: str, head: str) -> dict[str, list[str]]:
    """The cells of a table of sealed drives, by the text of the first column."""
    text = (ROOT / page).read_text(encoding="utf-8")
    lines = text[text.index(head) :].splitlines()
    rows = lines[2 : next(k for k, line in enumerate(lines) if not line.startswith("|"))]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return {first.strip("`"): rest for first, *rest in cells}


def test_the_sealed_table_follows_from_its_file() -> None:
    """Every cell, the mean rank and the lowest AA."""
    names = [drive["name"] for drive in SEALED["drives"]]
    AA: dict[str, dict[str, float]] = {name: {} for name in names}
    rows = sealed_rows("docs/results.md", "| method | `nuscenes_scene-0523`")
    for cell in SEALED["cells"]:
        kept, lost = cell["static"]
        taken, left = cell["dynamic"]
        SA = 100 * kept / (kept + lost)
        DA = 100 * taken / (taken + left)
        AA[cell["drive"]][cell["method"]] = (SA * DA) ** 0.5
        shown = rows[cell["method"]][names.index(cell["drive"])]
        numbers = [float(each) for each in re.findall(r"[\d.]+", shown)]
        assert numbers[:3] == pytest.approx([SA, DA, (SA * DA) ** 0.5], abs=0.051)
        movers = next(
            drive["movers"] for drive in SEALED["drives"] if drive["name"] == cell["drive"]
        )
        assert len(numbers) == (6 if movers else 3)
        if movers:
            assert numbers[5] == sum(
                2 * removed >= points
                for removed, (_, points) in zip(cell["removed"], movers, strict=True)
            )
    for method, row in rows.items():
        ranks = [
            1 + sum(other > known[method] for other in known.values()) for known in AA.values()
        ]
        assert float(row[-2]) == pytest.approx(sum(ranks) / len(ranks), abs=0.051)
        assert float(row[-1]) == pytest.approx(min(k[method] for k in AA.values()), abs=0.051)
    order = [float(row[-2]) for row in rows.values()]
    assert order == sorted(order)


def test_where_seethrough_is_not_first_is_named() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for drive in SEALED["drives"]:
        scores = {
            cell["method"]: cell["static"][0]
            / sum(cell["static"])
            * cell["dynamic"][0]
            / sum(cell["dynamic"])
            for cell in SEALED["cells"]
            if cell["drive"] == drive["name"]
        }
        named = f"`{drive['name']}` (" in text
        assert named == (max(scores, key=scores.__getitem__) != "seethrough")


def test_the_sealed_counts_are_those_that_were_given(shared: Path) -> None:
    assert json.loads((shared / "data/sealed.json").read_text(encoding="utf-8")) == SEALED


@pytest.mark.slow
def test_a_cell_follows_from_the_data(real_data: Path) -> None:
    result = dv.run(METHOD, dv.open(real_data / "nuscenes"), record="none", maps=False)
    assert [result.counts["static_kept"], result.counts["static_removed"]] == CELL["static"]
    assert result.counts["dynamic_removed"] == sum(CELL["removed"])


def test_the_page_of_seethrough_says_which_drives_had_a_part_and_where_it_is_not_first() -> None:
    rows = sealed_rows("docs/measured/seethrough.md", "| drive | part in choosing |")
    sealed = [drive["name"] for drive in SEALED["drives"]]
    developed = [drive["name"] for drive in STORED["drives"]]
    assert list(rows) == [*sealed, *developed]  # rows of one drive replace each other
    assert all((cells[0] == "none: sealed") == (name in sealed) for name, cells in rows.items())
    page = (ROOT / "docs/measured/seethrough.md").read_text(encoding="utf-8")
    facts = {drive["name"]: drive for drive in (*SEALED["drives"], *STORED["drives"])}
    for file in (SEALED, STORED):
        for name, poses in {(c["drive"], c["poses"]) for c in file["cells"]}:
            shares = {}
            for cell in file["cells"]:
                if (cell["drive"], cell["poses"], bool(cell["set"])) != (name, poses, False):
                    continue
                kept, lost = cell["static"]
                points = sum(number for _, number in facts[name]["movers"])
                gone, left = cell.get(
                    "dynamic", (sum(cell["removed"]), points - sum(cell["removed"]))
                )
                shares[cell["method"]] = kept / (kept + lost) * gone / (gone + left)
            place = 1 + sum(other > shares["seethrough"] for other in shares.values())
            words = "given poses" if poses == "given" else "`small-gicp`"
            line = next(
                line
                for line in page.splitlines()
                if line.startswith(f"| `{name}` |") and f"| {words} |" in line
            )
            assert f"{place} of {len(shares)}" in line, line
            assert (f"**{place} of" in line) == (place > 1)
