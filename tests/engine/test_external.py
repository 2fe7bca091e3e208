"""Scoring what other programs wrote: against brute force, a kd-tree, and the runs that wrote it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from helpers.street import drive
from helpers.worlds import InMemory, room
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import dynaviz as dv
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.io.pcd import read_pcd, write_pcd
from dynaviz.scores.sections import Runtime
from dynaviz.sources.drive import Drive


def save(path: Path, points: np.ndarray) -> Path:
    write_pcd(path, dict(zip("xyz", np.asarray(points, np.float32).T, strict=True)))
    return path


def cloud(sequence: InMemory) -> tuple[np.ndarray, np.ndarray]:
    """All points, and all labels."""
    return tuple(
        np.concatenate([getattr(scan, name) for scan in sequence.scans])
        for name in ("points", "labels")
    )  # type: ignore[return-value]


def counts(removed: np.ndarray, labels: np.ndarray) -> dict[str, int]:
    return {
        "static_kept": int((~removed & (labels == 0)).sum()),
        "static_removed": int((removed & (labels == 0)).sum()),
        "dynamic_removed": int((removed & (labels == 1)).sum()),
        "dynamic_kept": int((~removed & (labels == 1)).sum()),
        "unlabelled": int((labels == 255).sum()),
    }


@settings(
    deadline=None, max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.integers(0, 99), st.sampled_from([0.0, 0.05, 0.3, 2.0]), st.booleans())
def test_every_point_as_by_brute_force(
    tmp_path: Path, seed: int, radius: float, on_lattice: bool
) -> None:
    """In float32, as the public benchmark's export computes.

    On a lattice, many distances are the radius itself.
    """
    random, sequence = np.random.default_rng(seed), room(frames=3, rays=200, seed=seed)
    points, labels = cloud(sequence)
    if on_lattice:
        points = (np.round(points / 0.05) * np.float32(0.05)).astype(np.float32)
        sequence = InMemory(
            [replace(s, points=p) for s, p in zip(sequence.scans, np.split(points, 3), strict=True)]
        )
    kept = points[random.random(len(points)) < 0.5]
    d = points[:, None] - kept[None]
    nearest = np.sqrt(
        (d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]).min(1)
    )
    result = dv.score(save(tmp_path / "map.pcd", kept), sequence, radius=radius)
    assert result.counts == counts(nearest > np.float32(radius), labels)
    assert (result.scoring, result.method, result.parameters) == ("nn", "map", {"radius": radius})


def test_every_point_as_by_a_kd_tree_in_double_precision(
    little_room: InMemory, tmp_path: Path
) -> None:
    points, _ = cloud(little_room)
    kept = points[np.random.default_rng(1).random(len(points)) < 0.2] + np.float32(0.01)
    dv.score(save(tmp_path / "map.pcd", kept), little_room, out=tmp_path / "out", record="none")
    distance, _ = cKDTree(kept.astype(np.float64)).query(points.astype(np.float64))
    with np.load(tmp_path / "out/labels.npz") as z:
        removed = np.unpackbits(z["dynamic"])[: len(points)] > 0
        reasons = z["reason_names"][z["reasons"]]
    assert 0.1 < removed.mean() < 0.9
    assert not (removed != (distance > 0.05))[np.abs(distance - 0.05) > 1e-6].any()
    assert ((reasons == "no_kept_point_within_radius") == removed).all()
    assert ((reasons == "near_kept_point") == ~removed).all()


def test_the_map_of_a_run_is_scored_as_the_run_but_within_the_radius(
    little_room: InMemory, tmp_path: Path
) -> None:
    points, labels = cloud(little_room)
    run = dv.run("octomap", little_room, out=tmp_path / "run", record="none")
    with np.load(tmp_path / "run/labels.npz") as z:
        masked = np.unpackbits(z["dynamic"])[: len(points)] > 0
    path = tmp_path / "run/static_map.pcd"
    distance, _ = cKDTree(read_pcd(path).xyz.astype(np.float64)).query(points.astype(np.float64))
    assert 0 < (masked & (distance <= 0.05)).sum() < masked.sum()
    assert dv.score(path, little_room).counts == counts(masked & (distance > 0.05), labels)
    assert dv.score(path, little_room, radius=1e-6).metrics == run.metrics


def test_labels_of_a_run_are_scored_as_the_run(little_room: InMemory, tmp_path: Path) -> None:
    run = dv.run("octomap", little_room, out=tmp_path, record="none")
    again = dv.score(tmp_path / "labels.npz", little_room, name="again")
    assert (again.method, again.scoring, again.labels_sha256) == (
        "again",
        "mask",
        run.labels_sha256,
    )
    assert again.sequence == run.sequence
    for section in ("counts", "metrics", "error_distance", "breakdown", "voxelwise"):
        assert getattr(again.sections, section) == getattr(run.sections, section)
    assert again.sections.reasons.false_positive == run.sections.reasons.false_positive


def test_labels_of_another_sequence_are_rejected(little_room: InMemory, tmp_path: Path) -> None:
    dv.run("octomap", little_room, out=tmp_path, record="none")
    for other in (Drive.of(little_room).select("1:"), room(seed=1)):
        with pytest.raises(
            DataError, match=r"labels\.npz: is from a different sequence.*the same frames"
        ):
            dv.score(tmp_path / "labels.npz", other, out=tmp_path / "out")
        assert not list((tmp_path / "out").glob("*.*")), "nothing is written"


def test_damaged_labels_are_rejected(little_room: InMemory, tmp_path: Path) -> None:
    path = tmp_path / "labels.npz"
    dv.run("octomap", little_room, out=tmp_path, record="none")
    with np.load(path) as z:
        whole = dict(z)
    content = path.read_bytes()
    for damaged in (b"", b"hello", content[: len(content) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(DataError, match=r"not a valid labels\.npz of a run"):
            dv.score(path, little_room)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(DataError, match=r"not a valid labels\.npz of a run"):
        dv.score(path, little_room)
    np.savez(path, **{**whole, "dynamic": whole["dynamic"][:-1]})
    with pytest.raises(DataError, match="arrays have different lengths"):
        dv.score(path, little_room)
    np.savez(path, **{**whole, "frames": whole["frames"][:-1]})
    with pytest.raises(DataError, match="arrays have different lengths"):
        dv.score(path, little_room)


def test_the_runtime_of_another_program_is_unknown(little_room: InMemory, tmp_path: Path) -> None:
    path = save(tmp_path / "erasor_output.pcd", cloud(little_room)[0])
    result = dv.score(path, little_room, out=tmp_path / "out", record="scores")
    assert result.runtime == Runtime(frames=len(little_room))
    assert not result.instrumented
    assert "n/a" in str(result)
    assert "erasor_output" in str(result)
    assert not (tmp_path / "out/config.toml").exists()
    source = result.sections.source
    assert (source.file, source.sha256) == (
        path.name,
        hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    saved = json.loads((tmp_path / "out/result.json").read_text())
    assert (saved["scoring"], saved["source"]) == ("nn", json.loads(msgspec.json.encode(source)))


def test_the_recording_contains_every_label(little_room: InMemory, tmp_path: Path) -> None:
    from dynaviz.views.read.reader import RunRecording

    points, labels = cloud(little_room)
    path = save(tmp_path / "clean.pcd", points[labels == 0])
    result = dv.score(path, little_room, out=tmp_path / "out", record="errors")
    recording = RunRecording(tmp_path / "out/run.rrd")
    assert recording.result is not None
    assert (recording.result.scoring, recording.result.metrics) == ("nn", result.metrics)
    assert result.metrics["SA"] == 100
    assert result.counts["dynamic_removed"] > 0


def test_points_without_coordinates_are_kept(tmp_path: Path) -> None:
    points = np.array([[1, 0, 0], [np.nan, 0, 0], [5, 0, 0], [0, np.inf, 0]], np.float32)
    scan = Scan(0, points, np.eye(4), labels=np.array([0, 0, 1, 0], np.uint8))
    result = dv.score(save(tmp_path / "map.pcd", points[:1]), InMemory([scan]))
    assert result.counts == counts(np.array([False, False, True, False]), scan.labels)
    assert result.sections.reasons.static_kept == {"not_finite": 2, "near_kept_point": 1}


def test_points_of_the_map_that_are_not_finite_are_ignored(
    little_room: InMemory, tmp_path: Path
) -> None:
    points, _ = cloud(little_room)
    expected = dv.score(save(tmp_path / "map.pcd", points[:900]), little_room)
    save(
        tmp_path / "map.pcd",
        np.concatenate([points[:900], np.full((100, 3), np.nan), [[np.inf, 0, 0]]]),
    )
    with pytest.warns(UserWarning, match=r"map\.pcd: 101 of 1,001 points are not finite"):
        result = dv.score(tmp_path / "map.pcd", little_room)
    assert result.counts == expected.counts
    assert result.sections.source.not_finite == 101


@pytest.mark.parametrize(("scale", "shift"), [(1, 500.0), (1000, 0.0), (1, 5e6), (1e30, 0.0)])
def test_a_map_in_another_frame_raises_a_warning(
    little_room: InMemory, tmp_path: Path, scale: float, shift: float
) -> None:
    points, labels = cloud(little_room)
    path = save(tmp_path / "map.pcd", points.astype(np.float64) * scale + shift)
    with pytest.warns(
        UserWarning, match=r"only 0(\.\d+)? % of the static points .* another frame\. The map spans"
    ):
        result = dv.score(path, little_room)
    assert result.counts["dynamic_kept"] <= 1
    assert len(result.sections.source.remarks) == 1
    assert sum(result.counts.values()) == len(labels)


def street() -> InMemory:
    """A street with truth."""
    scans = [
        Scan(k, s.world.astype(np.float32), s.T, labels=s.dynamic.astype(np.uint8))
        for k, s in enumerate(drive(frames=8, columns=720))
    ]
    return InMemory(scans, "street")


def share_kept(result: dv.Result) -> float:
    """Share of the static points that are kept."""
    kept = result.counts["static_kept"]
    return kept / (kept + result.counts["static_removed"])


def centroids(points: np.ndarray, edge: float) -> np.ndarray:
    """One point for each voxel."""
    _, of = np.unique(np.floor(points / edge).astype(int), axis=0, return_inverse=True)
    sums = [np.bincount(of.ravel(), column) for column in points.T]
    return np.column_stack(sums) / np.bincount(of.ravel())[:, None]


@pytest.mark.parametrize("edge", [0.0, 0.2])
@pytest.mark.parametrize("height", [1.73, -0.5])
def test_a_map_that_is_too_high_or_too_low_is_named(
    tmp_path: Path, edge: float, height: float
) -> None:
    sequence = street()
    points, labels = cloud(sequence)
    kept = points[labels == 0].astype(float)
    path = save(tmp_path / "map.pcd", (centroids(kept, edge) if edge else kept) + [0, 0, height])
    word = "higher" if height > 0 else "lower"
    with pytest.warns(UserWarning, match=rf"is {abs(height):.1f}\d m {word} than the sequence"):
        dv.score(path, sequence)


def test_a_map_that_was_thinned_is_named_with_the_radius_that_it_needs(tmp_path: Path) -> None:
    sequence = street()
    points, labels = cloud(sequence)
    path = save(tmp_path / "map.pcd", centroids(points[labels == 0].astype(float), 0.2))
    with pytest.warns(UserWarning, match="as if it was thinned") as found:
        low = dv.score(path, sequence)
    radius = float(str(found[0].message).split("--radius ")[1].split(",")[0])
    high = dv.score(path, sequence, radius=radius)  # without a warning
    assert share_kept(low) < 0.9
    assert share_kept(high) > 0.98
    save(path, points[labels == 0])
    assert share_kept(dv.score(path, sequence)) == 1


def test_same_on_one_and_many_threads(little_room: InMemory, tmp_path: Path) -> None:
    path = save(tmp_path / "map.pcd", cloud(little_room)[0][::7])
    one, many = (dv.score(path, little_room, threads=threads) for threads in (1, None))
    assert one.labels_sha256 == many.labels_sha256


def test_voxels_are_kept_by_points_of_the_map_itself(little_room: InMemory, tmp_path: Path) -> None:
    """A map of voxel centres loses SA by the radius, but no voxel."""
    points, labels = cloud(little_room)
    voxels = np.unique(np.floor(points[labels == 0].astype(np.float64) * 5), axis=0)
    result = dv.score(save(tmp_path / "map.pcd", (voxels + 0.5) / 5), little_room)
    assert result.metrics["SA"] < 50
    assert (result.sections.voxelwise.PR, result.sections.voxelwise.RR) == (100, 100)
    half = dv.score(
        save(tmp_path / "map.pcd", (voxels[::2] + 0.5) / 5), little_room
    ).sections.voxelwise
    assert (half.static, half.static_kept) == (len(voxels), len(voxels[::2]))


def test_an_empty_map_is_rejected(little_room: InMemory, tmp_path: Path) -> None:
    for points in (np.zeros((0, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(DataError, match=r"map\.pcd: contains no point"):
            dv.score(save(tmp_path / "map.pcd", points), little_room)


@pytest.mark.parametrize("radius", [-0.1, np.inf, np.nan])
def test_an_invalid_radius_is_rejected(
    little_room: InMemory, tmp_path: Path, radius: float
) -> None:
    with pytest.raises(UsageError, match="radius = "):
        dv.score(save(tmp_path / "map.pcd", np.zeros((1, 3))), little_room, radius=radius)


@pytest.mark.parametrize("name", ["", "a/b", "..", "a\n"])
def test_an_invalid_name_is_rejected(little_room: InMemory, tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="name = "):
        dv.score(save(tmp_path / "map.pcd", np.zeros((1, 3))), little_room, name=name)


def test_without_ground_truth_there_is_nothing_to_score(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="room has no ground truth"):
        dv.score(save(tmp_path / "map.pcd", np.zeros((1, 3))), room(labelled=False))


def test_a_score_does_not_overwrite_its_map(little_room: InMemory, tmp_path: Path) -> None:
    dv.run("octomap", little_room, out=tmp_path, record="none")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for name in ("static_map.pcd", "labels.npz"):
        with pytest.raises(UsageError, match="would overwrite"):
            dv.score(tmp_path / name, little_room, out=tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("dynamic", np.zeros(8), r"dynamic is an array \(8,\) of float64"),
        ("reasons", np.zeros((2, 3), np.uint8), r"reasons is an array \(2, 3\) of uint8"),
        ("points", np.full(3, np.nan), r"points is an array \(3,\) of float64"),
        ("points", np.array([-5, 65, 0]), "its arrays have different lengths"),
        ("frames", np.array([0, 1, 99]), "has no labels for frame"),
    ],
)
def test_labels_with_damaged_arrays(
    tmp_path: Path, name: str, value: np.ndarray, problem: str
) -> None:
    sequence = room(3, 20)
    dv.run("octomap", sequence, out=tmp_path, record="none")
    with np.load(tmp_path / "labels.npz") as z:
        arrays = {key: z[key] for key in z.files}
    np.savez(tmp_path / "labels.npz", **{**arrays, name: value})
    with pytest.raises(DataError, match=rf"labels\.npz: .*{problem}"):
        dv.score(tmp_path / "labels.npz", sequence)
