"""The table of results on real drives follows from its file, and the file from the data."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.benchmarking.gain import DRAWS

ROOT = Path(__file__).resolve().parents[2]
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
    scores = page[page.index("## Scores") :].split(f"| `{cell['drive']}` |")[
        1
    ]  # a drive is named in its first row
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
    methods = {cell["method"] for cell in STORED["cells"]}
    for drive in STORED["drives"]:
        for poses in ("given", "small-gicp"):
            cells = [
                c
                for c in STORED["cells"]
                if (c["drive"], c["poses"]) == (drive["name"], poses) and not c["set"]
            ]
            assert sorted(cell["method"] for cell in cells) == sorted(methods)
            assert {len(cell["removed"]) for cell in cells} == {len(drive["movers"])}


@pytest.mark.slow
def test_a_cell_follows_from_the_data(real_data: Path) -> None:
    result = dv.run(METHOD, dv.open(real_data / "nuscenes"), record="none", maps=False)
    assert [result.counts["static_kept"], result.counts["static_removed"]] == CELL["static"]
    assert result.counts["dynamic_removed"] == sum(CELL["removed"])
