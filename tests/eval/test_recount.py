"""The causes of failure cases, recounted from scans and labels without the product's own looks."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.recount import Drive, recounted

import dynaviz as dv

HOLD = 0.97  # of the causes
METHODS = (
    "octomap", "octomap_g", "octomap_gf", "seethrough", "dufomap", "erasor", "removert",
    "beautymap", "dynablox", "hmm_mos", "freedom",
)  # fmt: skip
REAL = {
    "KITTI 0011": "kitti_tracking/training/velodyne/0011",
    "KITTI 0012": "unified/kitti_tracking_0012",
    "nuScenes": "nuscenes",
}


def check(sequence: str, methods: tuple[str, ...], folder: Path, least: int) -> None:
    """Run methods on a sequence and recount their causes."""
    drive = Drive(sequence)
    every = []
    for method in methods:
        dv.run(method, sequence, out=folder / method, record="none")
        every += [(method, case) for case in recounted(folder / method, drive)]
    false = [
        f"{method} {case.number} {case.what}: {case.stated!r}, recounted {case.found!r}"
        for method, case in every
        if not case.holds
    ]
    assert len(every) >= least
    assert len(false) <= (1 - HOLD) * len(every), "\n".join(false)


def test_causes_hold_when_other_points_are_looked_at(tmp_path: Path) -> None:
    check("simulate:street_vlp16?frames=15", ("octomap", "dufomap"), tmp_path, 40)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["street_hdl64?frames=50", "hall_vlp16_real?frames=40"])
def test_causes_of_all_methods_hold(scene: str, tmp_path: Path) -> None:
    check(f"simulate:{scene}", METHODS, tmp_path, 300)


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_causes_on_real_drives_hold(name: str, real_data: Path, tmp_path: Path) -> None:
    check(str(real_data / REAL[name]), METHODS, tmp_path, 300)
