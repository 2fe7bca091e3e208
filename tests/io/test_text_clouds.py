"""Point clouds as text and E57: what the columns hold is stated, known, or asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.pose_files import kitti
from helpers.street import drive

import dynaviz as dv
from dynaviz.errors import DataError
from dynaviz.io.fields import read_fields
from dynaviz.spatial import geometry

POINTS = np.random.default_rng(0).uniform(-20, 20, (40, 3)).round(3)
TIMES = np.linspace(0.0, 0.1, len(POINTS))
COLOURS = np.random.default_rng(1).integers(0, 256, (len(POINTS), 3))
NORMALS = np.random.default_rng(2).uniform(-1, 1, (len(POINTS), 3))


def lines(*columns: np.ndarray, separator: str = " ") -> str:
    table = np.column_stack(columns)
    return "\n".join(separator.join(f"{value:g}" for value in row) for row in table) + "\n"


@pytest.mark.parametrize(
    ("suffix", "text", "names"),
    [
        (".xyz", lines(POINTS), ""),
        (".txt", lines(POINTS, TIMES), "intensity"),
        (".asc", lines(POINTS, COLOURS), "red green blue"),
        (".xyz", f"{len(POINTS)}\n" + lines(POINTS, TIMES, COLOURS), "intensity red green blue"),
        (".csv", "x,y,z,time\n" + lines(POINTS, TIMES, separator=","), "time"),
        (".csv", '"X";"Y";"Z";"I"\n' + lines(POINTS, TIMES, separator=";"), "intensity"),
        (".txt", "//X Y Z R G B\n" + lines(POINTS, COLOURS), "red green blue"),
        (".asc", "# x y z nx ny nz\n\n" + lines(POINTS, NORMALS), "nx ny nz"),
        (".csv", "time,y,x,z\n" + lines(TIMES, POINTS[:, [1, 0, 2]], separator=","), "time"),
    ],
)
def test_columns_are_named_or_known(tmp_path: Path, suffix: str, text: str, names: str) -> None:
    path = tmp_path / f"000001{suffix}"
    path.write_text(text)
    fields = read_fields(path)
    assert sorted(fields) == sorted([*"xyz", *names.split()])
    assert np.allclose(np.column_stack([fields[axis] for axis in "xyz"]), POINTS, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (lines(np.arange(len(POINTS)), POINTS), "counts points or is a time"),
        (lines(1.7e9 + TIMES, POINTS), "counts points or is a time"),
        (lines(POINTS, NORMALS), "cannot tell what its columns hold"),
        (lines(POINTS, TIMES, TIMES), "cannot tell what its columns hold"),
        ("x,y,z,time\n" + lines(POINTS, separator=","), "3 numbers per line, but 4 titles"),
        (lines(POINTS) + "1 2\n", "line 41"),
        ("", "contains no points"),
    ],
)
def test_nobody_guesses(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "000001.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=words):
        read_fields(path)


def test_scans_as_text_are_a_drive(tmp_path: Path) -> None:
    sweeps = drive()
    (tmp_path / "scans").mkdir()
    for k, sweep in enumerate(sweeps):
        np.savetxt(tmp_path / f"scans/{k:06d}.txt", sweep.points, fmt="%.6f")
    kitti(tmp_path / "poses.txt", [sweep.T for sweep in sweeps])
    sequence = dv.open(tmp_path)
    assert len(sequence) == len(sweeps)
    assert np.allclose(sequence[3].points, sweeps[3].world, atol=1e-3)


@pytest.mark.parametrize("columns", [1, 2, 7, 8, 12, 16])
def test_pose_files_are_no_scans(tmp_path: Path, columns: int) -> None:
    for k in range(3):
        np.savetxt(tmp_path / f"drive_{k}.txt", np.tile(np.eye(4).ravel()[-columns:], (5, 1)))
    with pytest.raises(DataError):
        dv.open(f"files:{tmp_path}")


def test_scans_as_e57_have_their_poses(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57", reason="E57 files need pye57")
    sweeps = drive()
    for k, sweep in enumerate(sweeps):
        xyz = sweep.points.astype(float)
        data = {f"cartesian{axis}": xyz[:, k] for k, axis in enumerate("XYZ")}
        quaternion = geometry.quaternion(sweep.T[:3, :3])
        with pye57.E57(str(tmp_path / f"{k:03d}.e57"), mode="w") as file:
            file.write_scan_raw(data, rotation=quaternion, translation=sweep.T[:3, 3])
    sequence = dv.open(tmp_path)
    assert sequence.facts["poses"] == "pose of each E57"
    for k, sweep in enumerate(sweeps):
        assert np.allclose(sequence[k].points, sweep.world, atol=2e-3)
    (tmp_path / "000.e57").write_bytes((tmp_path / "000.e57").read_bytes()[:900])
    with pytest.raises(DataError, match="not a valid E57 file"):
        dv.open(tmp_path)
