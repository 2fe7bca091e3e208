"""Causes and behaviours of failure cases, recounted from scans and labels in another way."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.recount import look_at, recounted, scans_of
from helpers.recount_behaviour import recounted_behaviours

import dynaviz as dv

HOLD = 0.97  # of the causes
METHODS = (
    "octomap", "octomap_g", "octomap_gf", "seethrough", "dufomap", "erasor", "removert",
    "beautymap", "dynablox", "hmm_mos", "freedom",
)  # fmt: skip
REAL = {
    "KITTI 0011": "kitti_tracking/training/velodyne/0011",
    "KITTI 0012": "unified/kitti_tracking_0012",
    "SemanticKITTI": "semantickitti/sequences/08",
    "nuScenes": "nuscenes",
    "Argoverse 2": "argoverse2",
}


def check(sequence: str, methods: tuple[str, ...], folder: Path, least: int) -> None:
    """Run methods on a sequence and recount their causes and behaviours."""
    for method in methods:
        dv.run(method, sequence, out=folder / method, record="none")
    runs = [folder / method for method in methods]
    scans = scans_of(sequence)
    cases = look_at(runs, scans)
    causes = recounted(cases)
    behaviours = recounted_behaviours(cases, scans)
    false = [str(each) for each in (*causes, *behaviours) if not each.holds]
    assert min(len(causes), len(behaviours)) >= least
    assert len(false) <= (1 - HOLD) * (len(causes) + len(behaviours)), "\n".join(false)


def test_causes_and_behaviours_hold_at_other_points(tmp_path: Path) -> None:
    check("simulate:street_vlp16?frames=15", ("octomap", "dufomap"), tmp_path, 40)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["demo", "hall_vlp16_real?frames=40"])
def test_both_hold_for_all_methods(scene: str, tmp_path: Path) -> None:
    check(f"simulate:{scene}", METHODS, tmp_path, 300)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*poses drift")  # of KITTI 0011
@pytest.mark.parametrize("name", REAL)
def test_both_hold_on_real_drives(name: str, real_data: Path, tmp_path: Path) -> None:
    check(str(real_data / REAL[name]), METHODS, tmp_path, 300)
