"""MOE, PandaSet and SUSTechPOINTS: layouts, labels, and files that do not fit."""

from __future__ import annotations

import gzip
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from helpers.labelled_files import (
    pickled,
    sustech_box,
    write_moe,
    write_pandaset,
    write_sustech,
)

from dynaviz.errors import DataError, NoPoses
from dynaviz.io.pickled_table import read_pickled_table
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.moe import MoeSequence
from dynaviz.sources.datasets.pandaset import PandaSetSequence
from dynaviz.sources.datasets.sustechpoints import SustechPointsSequence


def test_moe_has_a_label_for_each_point(tmp_path: Path) -> None:
    sequence = open_sequence(str(write_moe(tmp_path)))
    assert isinstance(sequence.reader, MoeSequence)
    assert (sequence.name, len(sequence), sequence.has_labels) == ("moe_00", 3, True)
    assert [scan.labels.tolist() for scan in sequence] == [[1, 0, 0, 0]] * 2 + [[255] * 4]
    scan = sequence[1]
    names = [scan.class_names[number] for number in scan.classes.tolist()]
    assert names == ["moving, class 3", "moveable, standing", "not moveable", "not moveable"]
    np.testing.assert_allclose(scan.points[0], (11, 0, 2), atol=1e-6)
    np.testing.assert_allclose(scan.T_world_sensor[:3, 3], (1, 0, 2))
    assert sequence.facts["labels"] == "of a simulator, exact"


def test_moe_is_found_from_related_folders(tmp_path: Path) -> None:
    root = write_moe(tmp_path)
    for path in (root, root.parent, root / "pcd"):
        assert open_sequence(str(path)).name == "moe_00"


def test_sequences_of_the_competition_of_moe_have_no_labels(tmp_path: Path) -> None:
    root = write_moe(tmp_path)
    for file in (root / "label").iterdir():
        file.unlink()
    sequence = open_sequence(str(root))
    assert not sequence.has_labels
    assert sequence[0].labels is None


@pytest.mark.parametrize(
    ("line", "problem"),
    [("1 2 3", "line 2: 1 2 3 is not a label"), ("1 1", "cannot be read"), (None, "3 lines for 4")],
)
def test_labels_of_moe_that_do_not_fit(tmp_path: Path, line: str | None, problem: str) -> None:
    root = write_moe(tmp_path)
    lines = (root / "label/000000.txt").read_text().splitlines()
    lines[1:2] = [] if line is None else [line]
    (root / "label/000000.txt").write_text("\n".join(lines))
    with pytest.raises(DataError, match=problem):
        open_sequence(str(root))[0]


@pytest.mark.parametrize("suffix", [".pkl.gz", ".pkl"])
def test_pandaset_has_boxes_of_both_lidars_and_classes(tmp_path: Path, suffix: str) -> None:
    sequence = open_sequence(str(write_pandaset(tmp_path, suffix)))
    assert isinstance(sequence.reader, PandaSetSequence)
    assert (sequence.name, sequence.sensor.name) == ("pandaset_002", "pandar64")
    first, second, last = sequence
    # The object ahead, the parked one, beside the first (unlabelled), and a reflection.
    assert first.labels.tolist() == [1, 0, 255, 255] * 2
    assert second.labels.tolist() == [1, 0, 255, 0] * 2
    assert last.labels.tolist() == [255] * 8
    assert [first.class_names[number] for number in first.classes[:4]] == [
        "car",
        "cones",
        "road",
        "reflection",
    ]
    assert second.classes.tolist() == [13, 37, 0, 0] * 2
    # Two boxes with siblings are one object.
    assert second.instances.tolist() == [1, 2, 0, 0] * 2
    assert sequence.facts["objects with boxes"] == "2, of which 1 move"
    np.testing.assert_allclose(first.points[0], (-10, 0, 0), atol=1e-5)
    assert sequence.attributes(0)["intensity"].tolist() == list(range(8))


def test_rays_of_pandaset_start_at_their_lidar_when_it_measured(tmp_path: Path) -> None:
    sequence = open_sequence(str(write_pandaset(tmp_path)))
    scan = sequence[1]
    # The car drives 10 m/s along -x and looks along -x; times are relative to the sweep.
    middles = (np.floor(scan.times / 0.01 + 1e-4) + 0.5) * 0.01
    expected = np.stack([-1 - 10 * middles, np.zeros(8), np.zeros(8)], axis=1)
    # of the PandarGT, with both horizontal axes turned
    expected[4:] += (0.000451117754, 0.605646431446, -0.301525235176)
    np.testing.assert_allclose(scan.origins, expected, atol=1e-3)


def test_a_box_of_one_lidar_does_not_hold_for_points_of_the_other(tmp_path: Path) -> None:
    root = write_pandaset(tmp_path)
    reader = open_sequence(str(root)).reader
    boxes = reader.boxes[0]
    assert [seen.lidar for seen in boxes] == [0, 1, -1]
    moved = np.array([(-10.75, 0, 0), (-10.75, 0, 0)])
    labels = reader._truth(1, np.repeat(moved, 4, axis=0), np.repeat([0, 1], 4)).labels
    assert labels.tolist() == [1] * 4 + [255] * 4


def test_pickles_call_nothing(tmp_path: Path) -> None:
    marker = tmp_path / "executed"

    class Harmful:
        def __reduce__(self) -> object:
            return Path.touch, (marker,)

    (tmp_path / "harmful.pkl").write_bytes(pickle.dumps(Harmful()))
    with pytest.raises(DataError, match="not a pickled table of pandas"):
        read_pickled_table(tmp_path / "harmful.pkl")
    content = pickled({"x": [1.0]}).replace(b"pandas.core.internals.managers", b"os")
    (tmp_path / "named.pkl").write_bytes(content)
    with pytest.raises(DataError):
        read_pickled_table(tmp_path / "named.pkl")
    assert not marker.exists()


def test_tables_of_the_installed_pandas_are_read(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    columns = {"x": [1.5, 2.5], "number": [3, 4], "fine": [True, False]}
    frame = pandas.DataFrame(columns)
    frame["text"] = pandas.Series(["a", "b"], dtype=object)
    frame.columns = pandas.Index(np.array(list(frame.columns), object), dtype=object)
    frame.to_pickle(tmp_path / "new.pkl.gz")
    table = read_pickled_table(tmp_path / "new.pkl.gz")
    assert {name: values.tolist() for name, values in table.items()} == {
        **columns,
        "text": ["a", "b"],
    }
    assert table["x"].dtype == np.float64


def test_a_table_of_an_old_pandas_is_one_to_pandas_too(tmp_path: Path) -> None:
    """The fixture is what pandas reads, so the reader is not tested against itself."""
    pandas = pytest.importorskip("pandas")
    (tmp_path / "old.pkl").write_bytes(pickled({"x": [1.0, 2.0], "label": ["a", "b"]}))
    frame = pandas.read_pickle(tmp_path / "old.pkl")
    assert frame["x"].tolist() == [1.0, 2.0]
    assert frame["label"].tolist() == ["a", "b"]


def test_large_references_in_pickles_are_refused(tmp_path: Path) -> None:
    (tmp_path / "memo.pkl").write_bytes(b"\x80\x04Nr\xff\xff\xff\x7f.")
    with pytest.raises(DataError, match="beyond the end of the file"):
        read_pickled_table(tmp_path / "memo.pkl")


def test_bombs_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynaviz.io.pickled_table.LARGEST", 1 << 20)
    (tmp_path / "bomb.pkl.gz").write_bytes(gzip.compress(bytes(1 << 24)))
    with pytest.raises(DataError, match="larger than 1 MB"):
        read_pickled_table(tmp_path / "bomb.pkl.gz")


def test_sustechpoints_has_boxes_with_ids(tmp_path: Path) -> None:
    sequence = open_sequence(str(write_sustech(tmp_path)))
    assert isinstance(sequence.reader, SustechPointsSequence)
    assert (sequence.name, sequence.has_labels) == ("sustechpoints_example", True)
    # The object ahead, the parked one, beside the first, and in a box without an id.
    assert [scan.labels.tolist() for scan in sequence] == [
        [1, 0, 255, 255],
        [1, 0, 255, 255],
        [255] * 4,
    ]
    scan = sequence[1]
    assert [scan.class_names[number] for number in scan.classes.tolist()] == [
        "car",
        "car",
        "none",
        "pedestrian",
    ]
    np.testing.assert_allclose(scan.points[0], (11, 0, 0), atol=1e-6)
    assert scan.stamp_ns == 1_557_540_000_500_000_000
    facts = sequence.facts
    assert facts["objects with boxes"] == "2, of which 1 move"
    assert facts["poses"] == "lidar_pose/*.json"
    assert facts["boxes without an id"].startswith("2,")


def test_sustechpoints_without_times_judges_by_the_way(tmp_path: Path) -> None:
    sequence = open_sequence(str(write_sustech(tmp_path, timed=False)))
    assert sequence[0].labels.tolist() == [0, 0, 0, 255]  # 1 m, which is not over 1 m
    assert "not times" in sequence.facts["moving objects"]
    pose = sequence.reader.folder / "lidar_pose/000001.json"
    pose.write_text(pose.read_text().replace("1.0, 0.0, 0.0, 1.0", "1.0, 0.0, 0.0, 2.0", 1))
    again = open_sequence(str(sequence.reader.folder))
    assert again[0].labels.tolist()[0] == 1


def test_sustechpoints_without_poses_has_no_labels(tmp_path: Path) -> None:
    root = write_sustech(tmp_path, poses=False)
    with pytest.raises(NoPoses):
        open_sequence(str(root))
    (root / "ego_pose").mkdir()
    with pytest.raises(NoPoses, match=r"poses of the car \(ego_pose\), but not of the lidar"):
        open_sequence(str(root))
    sequence = open_sequence(str(root), poses="none")
    assert not sequence.has_labels
    assert sequence[0].labels is None
    assert sequence.facts["labels"].startswith("none")


def test_turned_boxes_of_sustechpoints(tmp_path: Path) -> None:
    """A long box, turned to lie along y and tilted to follow a ramp."""
    root = write_sustech(tmp_path)
    for k, file in enumerate(sorted((root / "label").iterdir())):
        box = sustech_box("Bus", "1", 10, 1 + k, yaw=np.pi / 2)
        box["psr"]["scale"]["x"] = 12.0
        file.write_text(json.dumps([box]))
    scan = open_sequence(str(root))[0]
    assert scan.labels.tolist() == [1, 0, 1, 0]


def test_damaged_labels_of_sustechpoints_are_reported(tmp_path: Path) -> None:
    root = write_sustech(tmp_path)
    file = next(iter(sorted((root / "label").iterdir())))
    box = sustech_box("Car", "1", 10, 0)
    del box["psr"]["rotation"]
    file.write_text(json.dumps([box]))
    with pytest.raises(DataError, match="box 0: no valid position, scale and rotation"):
        open_sequence(str(root))[0]
