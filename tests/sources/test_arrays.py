"""Arrays from Python: mistakes name the scan and the field, and say what to give in the words of
the reader.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import at

import dynaviz as dv
from dynaviz.errors import DataError, UsageError, addressed, on_command_line
from dynaviz.online import live
from dynaviz.testing.world import SENSOR

POINTS = np.random.default_rng(0).uniform(-9, 9, (400, 3))
GOOD = at(1.0, 2.0, 0.5, 0.4)


def pose(change: Callable[[np.ndarray], None]) -> np.ndarray:
    T = GOOD.copy()
    change(T)
    return T


def nan(T: np.ndarray) -> None:
    T[0, 3] = np.nan


def scaled(T: np.ndarray) -> None:
    T[:3, :3] *= 1.1


def mirrored(T: np.ndarray) -> None:
    T[:3, 1] *= -1


def sheared(T: np.ndarray) -> None:
    T[0, 1] += 0.4


MISTAKES: dict[str, tuple[tuple[Any, Any], str]] = {
    "(3, N)": (
        (POINTS.T, GOOD),
        r"scan 2, points: \(3, 400\) of float64\. Give \(N, 3 or more\).*: points\.T",
    ),
    "(N, 2)": ((POINTS[:, :2], GOOD), r"scan 2, points: \(400, 2\) of float64"),
    "text": ((POINTS.astype("U8"), GOOD), r"scan 2, points: \(400, 3\) of <U8"),
    "one row": ((POINTS[0], GOOD), r"scan 2, points: \(3,\) of float64"),
    "NaN pose": ((POINTS, pose(nan)), "scan 2, pose: has NaN or infinite numbers"),
    "scaled": (
        (POINTS, pose(scaled)),
        r"scan 2, pose: the rotation is scaled by 1\.1\. Give T_world_sensor",
    ),
    "mirrored": ((POINTS, pose(mirrored)), "scan 2, pose: the matrix mirrors"),
    "sheared": ((POINTS, pose(sheared)), "scan 2, pose: the matrix is not a rotation"),
    "transposed": (
        (POINTS, GOOD.T),
        r"scan 2, pose: the last row is 1 2 0\.5 1\. The matrix may be transposed: pose\.T",
    ),
    "(3, 4)": ((POINTS, GOOD[:3]), r"scan 2, pose: \(3, 4\)\. Give T_world_sensor: \(4, 4\)"),
    "words": ((POINTS, "here"), "scan 2, pose: str is not a matrix"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_mistakes_name_the_scan_and_the_field(kind: str) -> None:
    scan, message = MISTAKES[kind]
    with pytest.raises(UsageError, match=message):
        dv.open([(POINTS, GOOD), (POINTS, GOOD), scan])
    session = live("octomap", sensor=SENSOR)
    session.update(POINTS, GOOD)
    session.update(POINTS, GOOD)
    with pytest.raises(UsageError, match=message):
        session.update(*scan)


def test_points_may_be_nan_and_poses_nearly_rigid() -> None:
    points = np.vstack([POINTS, np.full((5, 3), np.nan)]).astype(np.float32)
    rounded = GOOD.round(3)
    sequence = dv.open([(points, rounded), (points[:0], GOOD)])
    assert [len(sequence[k]) for k in range(2)] == [405, 0]


@pytest.mark.parametrize(
    ("typed", "argument"),
    [
        (
            "Estimate them with --poses small-gicp, or give --poses FILE: KITTI",
            'poses="small-gicp", or give poses=FILE: K',
        ),
        ("Read them with files:PATH --points-in sensor, or", 'files:PATH points_in="sensor", or'),
        ("--frames 0:3: selects none. Use --stride N", 'frames="0:3": selects none. Use stride=N'),
        ("Let methods ignore them: --set min_range=0.6 (dufomap)", '{"min_range": 0.6} (dufomap)'),
        ("leave out --extrinsic, or add --no-deskew", "leave out extrinsic, or add deskew=False"),
        ("give the file with --poses and the other", "give the file with poses and the other"),
        ("--voxel-size 0.5 or --tiles autoware", 'voxel_size=0.5 or tiles="autoware"'),
        ("--serve for a browser", "--serve for a browser"),
    ],
)
def test_options_are_arguments_in_python(typed: str, argument: str) -> None:
    assert addressed(typed).endswith(argument) or argument in addressed(typed)
    with on_command_line():
        assert addressed(typed) == typed


def test_the_command_line_and_python_name_options_in_their_own_way(
    tmp_path: Path, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    (tmp_path / "scans").mkdir()
    for k in range(2):
        np.save(tmp_path / f"scans/{k:06d}.npy", POINTS.astype(np.float32))
    with pytest.raises(
        DataError, match=r"Estimate them with poses=.small-gicp., or give poses=FILE"
    ):
        dv.open(tmp_path / "scans")
    _, _, err = run_command("run", "octomap", tmp_path / "scans", "-o", tmp_path / "out")
    assert "Estimate them with --poses small-gicp, or give --poses FILE" in err
