"""The template of a package with a method, a data set and a metric, installed for real."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from helpers.installed_packages import Python, python_with
from helpers.marks import compiled_only

from dynaviz.testing import crossing

TEMPLATE = Path(__file__).resolve().parents[2] / "examples/template"
FRAMES = 5
MAIN = "from dynaviz.cli import main; main()"


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Python:
    """Call Python with the template installed in addition to everything else."""
    return python_with(TEMPLATE, tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kit's crossing as the template's text files."""
    folder = tmp_path_factory.mktemp("text") / "crossing"
    folder.mkdir()
    scans = crossing(FRAMES)
    for scan in scans:
        np.savetxt(
            folder / f"{scan.index:06d}.xyzl",
            np.column_stack([scan.points, scan.labels]),
            fmt="%.9g",
        )
    np.savetxt(folder / "origins.txt", [scan.position for scan in scans])
    return folder


@pytest.mark.slow
def test_it_runs_and_is_scored_as_any_other(python: Python, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = python(
        "-c", MAIN, "run", "seldom", folder, "-o", out, "--record", "scores", "--set", "min_scans=2"
    )
    assert not done.returncode, done.stderr
    result = json.loads((out / "result.json").read_text())
    scans = crossing(FRAMES)
    assert result["sequence"]["points"] == sum(map(len, scans))

    # the same by hand
    seen, ghosts = defaultdict(set), set()
    for scan in scans:
        for voxel in map(tuple, np.floor(scan.points / np.float32(0.5)).astype(int)):
            seen[voxel].add(scan.index)
    counts = dict.fromkeys(("static_kept", "static_removed", "dynamic_removed", "dynamic_kept"), 0)
    for scan in scans:
        voxels = np.floor(scan.points / np.float32(0.5)).astype(int)
        for voxel, point, label in zip(map(tuple, voxels), scan.points, scan.labels, strict=True):
            removed = len(seen[voxel]) < 2
            counts[f"{'dynamic' if label else 'static'}_{'removed' if removed else 'kept'}"] += 1
            if label and not removed:
                ghosts.add(tuple(np.floor(point.astype(float) / 0.2).astype(int)))
    assert {name: result["counts"][name] for name in counts} == counts
    assert min(counts.values()) > 0
    assert result["ghost_volume"]["ghosts_m3"] == pytest.approx(len(ghosts) * 0.2**3, abs=1e-3)
    assert result["reasons"]["false_negative"]["often_seen"] == counts["dynamic_kept"]


KERNELS = """
import numpy as np
from dynaviz import colours, kernels
from dynaviz.contracts import plugin_code, registry

counts = kernels.load("dynaviz_template.kernels").counts
state = np.full(16, -1), np.zeros(16, np.int64), 0
for most in (4, 20):  # the second time, the table grows
    state = counts.add(np.arange(most), *state)
table, scans, used = state
assert counts.look_up(np.array([3, 19, 20]), table, scans).tolist() == [2, 1, 0]
assert (used, len(table)) == (20, 128)
assert colours.method_colour("seldom") == (0, 140, 140)
assert "long_drive" in registry.preset_files()
print(sum(counts.add.stats.cache_misses.values()), plugin_code.plugin("methods", "seldom").sha256)
"""


def counted(python: Python) -> list[str]:
    """The number of kernels that a process compiles, and the digest of the method."""
    done = python("-c", KERNELS)
    assert not done.returncode, done.stderr
    return done.stdout.split()


@pytest.mark.slow
@compiled_only
def test_its_kernels_are_compiled_once_and_count_as_its_code(
    python: Python,
) -> None:
    file = python("-c", "import dynaviz_template.kernels as k; print(k.__path__[0], end='')").stdout
    kernel = Path(file) / "counts.py"
    source = kernel.read_text()
    try:
        _, digest = counted(python)  # an earlier run of the tests may have compiled them
        assert counted(python) == ["0", digest]  # from disk
        kernel.write_text(f"{source}# {time.time_ns()}\n")  # sources that nobody compiled yet
        again, other = counted(python)
        assert int(again) > 0
        assert other != digest
    finally:
        kernel.write_text(source)


@pytest.mark.slow
def test_damaged_data_are_told_in_a_line(python: Python, folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "000000.xyzl").write_text("1 2 3 0\n1 2 three 0\n")
    (broken / "origins.txt").write_text("0 0 1\n")
    done = python("-c", MAIN, "info", broken)
    assert done.returncode == 2
    assert "000000.xyzl" in done.stderr
    assert "row 1" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_its_own_test_passes(python: Python) -> None:
    done = python(
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:dash",
        TEMPLATE / "test_template.py",
    )
    assert not done.returncode, done.stdout
    assert "1 passed" in done.stdout
