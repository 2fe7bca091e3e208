"""Estimated poses are checked: those of a drive that collapses do not hold, and another odometry
is tried.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from helpers.pose_files import scans_to
from helpers.street import drive

from dynaviz.contracts import registry
from dynaviz.io.poses import read_poses
from dynaviz.sources.odometry.estimate import PosesDoNotHold
from dynaviz.sources.odometry.estimated import SECOND, estimate_poses
from dynaviz.sources.odometry.verify import check_poses, restart_frames
from dynaviz.sources.options import SequenceOptions
from dynaviz.spatial import geometry

FRAMES = 14
TRUTH = np.array([sweep.T for sweep in drive(frames=FRAMES)])
COLLAPSED = 0.06  # of its way that is left: 1.8 of 29 m


def shortened(share: float) -> np.ndarray:
    """(N, 4, 4): poses of a drive whose way is a share of the true one."""
    poses = TRUTH.copy()
    poses[:, :3, 3] = TRUTH[0, :3, 3] + share * (TRUTH[:, :3, 3] - TRUTH[0, :3, 3])
    return poses


def points(row: int) -> np.ndarray:
    return drive(frames=FRAMES)[row].points.astype(np.float64)


def again(poses: np.ndarray) -> np.ndarray:
    """What a second start finds that sees the same."""
    first, end = restart_frames(FRAMES)
    return np.array([geometry.inverse(poses[first]) @ T for T in poses[first:end]])


@pytest.mark.parametrize(
    ("share", "second", "holds"),
    [
        pytest.param(1.0, 1.0, True, id="right"),
        pytest.param(COLLAPSED, 1.0, False, id="collapsed"),
        pytest.param(COLLAPSED, COLLAPSED, False, id="collapsed twice"),
    ],
)
def test_poses_of_a_drive_that_collapses_do_not_hold(
    share: float, second: float, holds: bool
) -> None:
    found = check_poses(shortened(share), points, lambda: again(shortened(second)))
    assert found.holds == holds, found


class Recalled:
    """An odometry that recalls a pose for each sweep, by its points."""

    reference: ClassVar[float] = 0.0
    package: ClassVar[str] = "numpy"
    share: ClassVar[float] = 1.0

    def __init__(self, reach: float) -> None:
        self.first: np.ndarray | None = None

    def register(self, points: np.ndarray, times: np.ndarray | None) -> np.ndarray:
        known = [sweep.points[:5] for sweep in drive(frames=FRAMES)]
        (row,) = [k for k in range(FRAMES) if np.allclose(known[k], points[:5], atol=1e-4)]
        T = shortened(self.share)[row]
        if self.first is None:
            self.first = geometry.inverse(T)
        return self.first @ T


class Collapsing(Recalled):
    """One that finds a part of the way."""

    share = COLLAPSED


@pytest.mark.parametrize("other", [Recalled, Collapsing])
def test_another_odometry_is_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: type[Recalled]
) -> None:
    kinds = {"small-gicp": Collapsing, SECOND: other}
    monkeypatch.setattr(registry, "load", lambda group, name: kinds[name])
    scans_to(tmp_path / "scans", [f"{k:06d}" for k in range(FRAMES)], drive(frames=FRAMES))
    source = str(tmp_path / "scans")

    def estimated() -> Path:
        return estimate_poses(source, "small-gicp", tmp_path / "out", SequenceOptions()).file

    if other is Collapsing:
        with pytest.raises(PosesDoNotHold, match=f"neither do those of {SECOND}") as raised:
            estimated()
        assert "small-gicp estimated do not hold" in str(raised.value)
        assert not list((tmp_path / "out").glob("*.csv"))
        return
    found = read_poses(estimated())
    assert f"poses_{SECOND}" in found.path.name
    own = [geometry.inverse(TRUTH[0]) @ T for T in TRUTH]
    np.testing.assert_allclose(found.poses, own, atol=1e-6)
