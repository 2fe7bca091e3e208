"""Refined poses: known errors vanish, exact poses stay, and the result states what happened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.io.pcd import write_pcd
from dynaviz.io.poses import read_poses
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.refine import refine
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.poses import transforms
from dynaviz.testing import InMemory
from dynaviz.testing.world import crossing, moved

FRAMES = 8
TRUE = crossing(FRAMES)
FAR = np.array([512_000.0, 5_403_000.0, 0.0])


def disturbed(shift: float, turn: float) -> list[Scan]:
    """Scans placed by poses with independent errors, standard deviations in metres and degrees."""
    random = np.random.default_rng(3)
    errors = transforms(
        random.normal(0, shift, (FRAMES, 3)), np.radians(random.normal(0, turn, (FRAMES, 3)))
    )
    found = []
    for scan, error in zip(TRUE, errors, strict=True):
        T = geometry.compose(
            geometry.compose(scan.T_world_sensor, error), geometry.inverse(scan.T_world_sensor)
        )
        found.append(moved(scan, T))
    return found


def spread(sequence: dv.Sequence) -> float:
    """Metres: root mean square distance of points from where exact poses place them, after the best
    common motion.
    """
    found, true = (
        np.concatenate([s[k].points.astype(np.float64) for k in range(FRAMES)])
        for s in (sequence, TRUE)
    )
    a, b = found - found.mean(0), true - true.mean(0)
    turn, *_ = Rotation.align_vectors(b[::50], a[::50])
    return float(np.sqrt(((turn.apply(a) - b) ** 2).sum(1).mean()))


@pytest.fixture(scope="module")
def given() -> Drive:
    return Drive.of(InMemory(disturbed(0.04, 0.2)))


@pytest.fixture(scope="module")
def refined(given: Drive) -> Drive:
    return refine(given)


def test_errors_of_single_frames_vanish(given: Drive, refined: Drive) -> None:
    assert spread(refined) < 0.3 * spread(given)
    found = refined.refinement
    assert found.before is not None
    assert found.after is not None
    assert found.after.translation_m < 0.3 * found.before.translation_m
    assert found.frames == FRAMES


def test_the_refinement_states_how_far_poses_moved(given: Drive, refined: Drive) -> None:
    before, after = (
        np.array([drive[k].position for k in range(FRAMES)]) for drive in (given, refined)
    )
    moved = np.linalg.norm(after - before, axis=1)
    assert refined.refinement.median_m == pytest.approx(np.median(moved), abs=1e-5)
    assert refined.refinement.max_m == pytest.approx(moved.max(), abs=1e-5)
    assert 0.05 < refined.refinement.median_deg <= refined.refinement.max_deg < 1.0
    assert refined[2].labels is not None
    np.testing.assert_array_equal(refined[2].position, refined.poses[-1].T_world_sensor[2, :3, 3])


def test_exact_poses_stay() -> None:
    found = refine(Drive.of(InMemory(TRUE))).refinement
    assert found.max_m < 0.01
    assert found.max_deg < 0.05


def test_scans_that_do_not_match_keep_their_poses() -> None:
    empty = [
        Scan(k, np.zeros((0, 3), np.float32), T)
        for k, T in enumerate(np.tile(np.eye(4), (5, 1, 1)))
    ]
    found = refine(Drive.of(InMemory(empty)))
    np.testing.assert_array_equal(found.poses[-1].T_world_sensor, np.tile(np.eye(4), (5, 1, 1)))
    assert (found.refinement.frames, found.refinement.after) == (0, None)


def write(folder: Path, scans: list[Scan], offset: F64) -> Path:
    """A folder of scans in the sensor frame, with poses."""
    folder.mkdir()
    for scan in scans:
        local = geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points)
        write_pcd(folder / f"{scan.index:06d}.pcd", dict(zip("xyz", local.T, strict=True)))
    poses = np.array([scan.T_world_sensor for scan in scans])
    poses[:, :3, 3] += offset
    np.savetxt(folder / "poses.txt", poses[:, :3].reshape(-1, 12), fmt="%.17g")
    return folder


@pytest.mark.slow
def test_poses_are_refined_once_and_kept_in_the_coordinates_of_the_source(tmp_path: Path) -> None:
    scans = write(tmp_path / "scans", disturbed(0.04, 0.2), FAR)
    results = [
        dv.clean(
            scans,
            tmp_path / "map.npz",
            method="octomap",
            refine_poses=True,
            record="none",
            threads=1,
        ).result
        for _ in range(2)
    ]
    first, second = (result.pose_refinement for result in results)
    assert first is not None
    assert second is not None
    assert (first.reused, second.reused, first.max_m) == (False, True, second.max_m)
    assert results[0].sequence == results[1].sequence
    assert results[0].pose_noise == first.after
    assert dv.Result.load(tmp_path / "map_run/result.json").pose_refinement == second
    page = (tmp_path / "map_run/summary.md").read_text()
    assert f"Poses were refined: {second}. They are in" in page
    kept = read_poses(tmp_path / "map_run/poses_refined.csv").poses
    assert np.abs(kept[:, :3, 3] - FAR).max() < 50
    again = dv.open(scans, poses=tmp_path / "map_run/poses_refined.csv")
    np.testing.assert_array_equal(
        again[3].T_world_sensor, results[0].answers.sequence[3].T_world_sensor
    )
    other = dv.run(
        "octomap",
        dv.open(scans, frames="1:"),
        out=tmp_path / "map_run",
        refine_poses=True,
        threads=1,
    )
    assert other.pose_refinement is not None
    assert not other.pose_refinement.reused
