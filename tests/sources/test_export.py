"""Labels of a run as SemanticKITTI label files."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.errors import DataError
from dynaviz.reviews.objects import box_around, numbered
from dynaviz.reviews.regions import BoxRegion
from dynaviz.runs import export
from dynaviz.runs.export import export_labels
from dynaviz.sources.datasets.convert import convert


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence and its run; the frames do not fill sequence bytes of the packed labels."""
    path = tmp_path_factory.mktemp("run")
    convert(room(frames=4, rays=1003), path / "room")
    dv.run("octomap", path / "room", out=path / "run", record="none", threads=1)
    return path


def test_each_frame_has_a_file_with_a_label_per_point(folder: Path, tmp_path: Path) -> None:
    counted = export_labels(folder / "run", tmp_path / "labels")
    with np.load(folder / "run/labels.npz") as z:  # all frames unpacked at once
        removed_points = np.unpackbits(z["dynamic"])[: z["points"].sum()]
    files = sorted((tmp_path / "labels").glob("*.label"))
    assert [file.name for file in files] == [f"{index:06d}.label" for index in (10, 11, 12, 13)]
    labels = np.concatenate([np.fromfile(file, "<u4") for file in files])
    np.testing.assert_array_equal(labels & 0xFFFF, np.where(removed_points, 251, 9))
    np.testing.assert_array_equal(labels >> 16 > 0, removed_points)
    assert 0 < removed_points.sum() < len(removed_points)
    assert removed_points.sum() in counted
    assert all(file.stat().st_size == 4 * 1003 for file in files)


def test_the_files_are_read_as_labels_of_the_sweeps(folder: Path, tmp_path: Path) -> None:
    """In the folder of a SemanticKITTI sequence, they are read as its ground truth."""
    run, data = folder / "run", tmp_path / "sequences/08"
    sequence = dv.open(folder / "room")
    (data / "velodyne").mkdir(parents=True)
    for scan in sequence:
        local = np.column_stack(
            [scan.points - scan.position.astype(np.float32), np.zeros(len(scan), np.float32)]
        )
        local.astype("<f4").tofile(data / f"velodyne/{scan.index:06d}.bin")
    pose = "1 0 0 0 0 1 0 0 0 0 1 0"
    (data / "calib.txt").write_text(f"Tr: {pose}\n")
    (data / "poses.txt").write_text(f"{pose}\n" * 14)
    export_labels(run, data / "labels", sequence)
    with np.load(run / "labels.npz") as z:
        removed_points = np.unpackbits(z["dynamic"])[: z["points"].sum()]
    np.testing.assert_array_equal(
        np.concatenate([scan.labels for scan in dv.open(data)]), removed_points
    )


def test_labels_of_a_different_sequence_are_refused(folder: Path, tmp_path: Path) -> None:
    sequence, part = dv.open(folder / "room"), dv.open(folder / "room", frames="0:2")
    with pytest.raises(DataError, match="is from a different sequence"):
        export_labels(folder / "run", tmp_path / "out", part)
    with pytest.raises(DataError, match=r"room: contains no result\.json"):
        export_labels(folder / "room", tmp_path / "out", sequence)
    with pytest.raises(DataError, match=r"absent: cannot be read"):
        export_labels(tmp_path / "absent", tmp_path / "out", sequence)
    with pytest.raises(DataError, match="already exists"):
        export_labels(folder / "run", folder / "run", sequence)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("boxed", "lasted"), [(1, 1), (2, 2), (10, 3)])
def test_boxes_contain_the_points_of_objects_that_are_large_and_last(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, boxed: int, lasted: int
) -> None:
    monkeypatch.setattr(export, "BOXED", boxed)
    monkeypatch.setattr(export, "LASTING", lasted)
    monkeypatch.setattr(export, "MOVED", 0.0)
    export_labels(folder / "run", tmp_path / "labels")
    with (tmp_path / "labels/boxes.csv").open() as file:
        rows = list(csv.DictReader(file))
    frames = Counter[int]()
    for file in (tmp_path / "labels").glob("*.label"):
        numbers = Counter((np.fromfile(file, "<u4") >> 16).tolist())
        frames.update(n for n, points in numbers.items() if n and points >= boxed)
    lasting = {n for n, count in frames.items() if count >= lasted}
    assert bool(lasting) == (boxed < 10)  # three objects of few points
    for scan in dv.open(folder / "room"):
        values = np.fromfile(tmp_path / f"labels/{scan.index:06d}.label", "<u4")
        here = {int(row["instance"]): row for row in rows if int(row["frame"]) == scan.index}
        large = Counter((values >> 16).tolist())
        assert set(here) == {n for n in lasting if large[n] >= boxed}
        for number, row in here.items():
            points = scan.points[values >> 16 == number]
            assert len(points) == int(row["points"])
            yaw = float(row["yaw"])
            apart = points - np.array([float(row[axis]) for axis in "xyz"])
            along = apart[:, 0] * np.cos(yaw) + apart[:, 1] * np.sin(yaw)
            across = apart[:, 1] * np.cos(yaw) - apart[:, 0] * np.sin(yaw)
            for side, name in ((along, "length"), (across, "width"), (apart[:, 2], "height")):
                assert np.abs(side).max() <= float(row[name]) / 2 + 0.005


def test_a_walker_and_a_car_have_one_number_each_and_the_box_of_the_car_turns() -> None:
    random = np.random.default_rng(1)
    car = random.uniform((-2, -1, 0), (2, 1, 1.5), (2000, 3))
    walker = random.uniform((-0.3, -0.3, 0), (0.3, 0.3, 1.8), (300, 3))
    c = np.cos(0.5)
    s = np.sin(0.5)
    turned = car @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    frames = [
        np.concatenate([turned + np.array([k * 0.8, 0, 0]), walker + np.array([0, 8 + 0.1 * k, 0])])
        for k in range(5)
    ]
    for numbers in numbered([frame.astype(np.float32) for frame in frames]):
        assert set(numbers[:2000].tolist()) == {1}
        assert set(numbers[2000:].tolist()) == {2}
    middle, size, yaw = box_around(turned + np.array([5, 6, 7]))
    np.testing.assert_allclose(middle, [5, 6, 7.75], atol=0.1)
    np.testing.assert_allclose(size, [4, 2, 1.5], atol=0.1)
    assert yaw == pytest.approx(0.5, abs=0.03)


def test_decisions_change_the_labels_and_nobody_knows_stays_unlabelled(
    folder: Path, tmp_path: Path
) -> None:
    everything = BoxRegion((-500.0, -500.0, -500.0), (500.0, 500.0, 500.0))
    for verdict, value in (("undecided", 0), ("static", 9), ("dynamic", 251)):
        file = tmp_path / f"{verdict}.json"
        dv.review(folder / "run", review=file).decide(everything, verdict)
        export_labels(folder / "run", tmp_path / verdict, review=file)
        for path in (tmp_path / verdict).glob("*.label"):
            assert set((np.fromfile(path, "<u4") & 0xFFFF).tolist()) == {value}


def test_boxes_are_those_of_objects_that_move(tmp_path: Path) -> None:
    drive = dv.open("simulate:demo?frames=12")
    dv.run("seethrough", drive, out=tmp_path / "run", record="none", threads=1)
    export_labels(tmp_path / "run", tmp_path / "labels")
    with (tmp_path / "labels/boxes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows
    for number in {row["instance"] for row in rows}:
        own = [row for row in rows if row["instance"] == number]
        middles = np.array([[float(row[axis]) for axis in "xyz"] for row in own])
        assert len(own) >= 3
        assert np.linalg.norm(middles[-1] - middles[0]) > 1.99
        assert all(int(row["points"]) >= 10 for row in own)
    moving = []
    for scan in drive:
        numbers = np.fromfile(tmp_path / f"labels/{scan.index:06d}.label", "<u4") >> 16
        here = [int(row["instance"]) for row in rows if int(row["frame"]) == scan.index]
        moving += [np.mean(scan.labels[numbers == number] == 1) > 0.5 for number in here]
    assert np.mean(moving) > 0.95
