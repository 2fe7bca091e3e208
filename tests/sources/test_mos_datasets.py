"""HeLiMOS and DOALS: layouts, splits, labels by stamp, and files that do not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bags import START, BagWriter, at, columns
from helpers.mos_files import write_doals, write_helimos

from dynaviz.errors import DataError
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.doals import DoalsSequence
from dynaviz.sources.datasets.helimos import SENSORS, HelimosSequence


@pytest.mark.parametrize("lidar", SENSORS)
def test_each_lidar_of_helimos_is_a_sequence(tmp_path: Path, lidar: str) -> None:
    root = write_helimos(tmp_path, list(SENSORS))
    sequence = open_sequence(str(root / lidar))
    assert isinstance(sequence.reader, HelimosSequence)
    assert (sequence.name, sequence.sensor.name) == (f"helimos_{lidar.lower()}", SENSORS[lidar])
    assert [sequence[k].labels.tolist() for k in range(4)] == [[0, 1, 255, 255]] * 3 + [[255] * 4]
    np.testing.assert_allclose(sequence[1].T_world_sensor[:3, 3], (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(sequence[1].points[0], (11, 0, 0), atol=1e-6)


def test_splits_of_helimos_select_labels_but_not_frames(tmp_path: Path) -> None:
    root = write_helimos(tmp_path, ["Ouster"])
    for split, frame in (("train", 0), ("val", 1), ("test", 2)):
        sequence = open_sequence(f"helimos_{split}:{root}")
        assert (len(sequence), sequence.name) == (4, f"helimos_ouster_{split}")
        known = [k for k in range(4) if (sequence[k].labels != 255).any()]
        assert known == [frame]


def test_helimos_is_found_from_related_folders(tmp_path: Path) -> None:
    root = write_helimos(tmp_path, ["Avia"])
    for path in (root, root.parent, root / "Avia/velodyne"):
        assert open_sequence(str(path)).name == "helimos_avia"
    write_helimos(tmp_path, ["Aeva", "Avia"])
    with pytest.raises(DataError, match="several lidars: Aeva, Avia"):
        open_sequence(str(root))


def test_files_missing_from_helimos_are_reported(tmp_path: Path) -> None:
    root = write_helimos(tmp_path, ["Ouster"])
    (root / "val.txt").write_text("first\n")
    with pytest.raises(DataError, match=r"val\.txt: contains something other than frame numbers"):
        open_sequence(f"helimos_val:{root}")[0]
    (root / "Ouster/poses.txt").unlink()
    with pytest.raises(
        DataError, match=r"poses\.txt: does not exist\. HeLiMOS's toolbox writes it"
    ):
        open_sequence(f"helimos:{root}")


def test_labels_of_doals_belong_to_scans_by_stamp(tmp_path: Path) -> None:
    folder = write_doals(tmp_path)
    sequence = open_sequence(str(folder))
    assert isinstance(sequence.reader, DoalsSequence)
    assert (sequence.name, sequence.sensor.name, sequence.has_labels) == (
        "doals_hauptgebaeude_1",
        "os1_64",
        True,
    )
    labels = [sequence[k].labels for k in range(len(sequence))]
    assert [labels[k].tolist() for k in (1, 3)] == [[0, 1, 1, 0, 0], [0, 0, 0, 0, 1]]
    assert all((labels[k] == 255).all() for k in (0, 2, 4))
    assert sequence.facts["labelled scans"] == "2"


def test_a_bag_of_doals(tmp_path: Path) -> None:
    folder = tmp_path / "station/sequence_2"
    folder.mkdir(parents=True)
    points = np.arange(12.0).reshape(4, 3) * [
        [0],
        [1],
        [1],
        [1],
    ]  # the first one is at the origin: no return
    with BagWriter(folder / "2020-02-20-17-35-27") as bag:
        for k in range(3):
            for topic in ("/os1_cloud_node/points", "/camera/points"):
                bag.cloud(k / 10, columns(points), topic=topic, frame="os1_lidar")
            bag.odometry(k / 10, at(k), child="os1_lidar", world="map")
    (folder / "indices.csv").write_text(f"{START + 100_000_000},2\n")
    for path in (folder, bag.path):
        sequence = open_sequence(str(path))
        assert sequence.name == "doals_station_2"
        assert [sequence[k].labels.tolist() for k in range(3)] == [
            [255] * 4,
            [255, 0, 1, 0],
            [255] * 4,
        ]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (f"{START},99\n", "point 99 of the scan at"),
        ("17,0\n", "none of its stamps is the stamp of a scan"),
        ("stamp,0\n", "line 1: contains something other than integers"),
        ("\n", "contains no labels"),
    ],
)
def test_labels_that_do_not_fit_are_reported(tmp_path: Path, content: str, problem: str) -> None:
    folder = write_doals(tmp_path)
    (folder / "indices.csv").write_text(content)
    with pytest.raises(DataError, match=rf"indices\.csv.*{problem}"):
        open_sequence(str(folder))[0]
