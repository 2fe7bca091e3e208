"""nuScenes: keyframes and the sweeps between them, selection of scenes, and invalid tables."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.nuscenes_files import (
    START,
    SWEEPS,
    ego_points,
    lidar_sweep,
    write_nuscenes,
    write_scene,
)

from dynaviz.errors import DataError
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.nuscenes import NuScenesSequence


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_nuscenes(tmp_path)


def test_keyframes_and_sweeps_are_in_order_of_time(root: Path) -> None:
    sequence = open_sequence(str(root))
    assert isinstance(sequence.reader, NuScenesSequence)
    assert (sequence.name, sequence.sensor.name, len(sequence)) == (
        "nuscenes_scene-0061",
        "hdl32e",
        SWEEPS,
    )
    assert [sequence[k].index for k in range(SWEEPS)] == list(range(SWEEPS))
    assert sequence[2].stamp_ns == (START + 200_000) * 1000
    assert sequence.facts == {"keyframes": "3", "objects with boxes": "3, of which 2 move"}


def test_the_world_frame_has_the_axes_of_the_map_and_starts_at_the_sensor(root: Path) -> None:
    sequence = open_sequence(str(root))
    for k in (0, 7):
        scan = sequence[k]
        np.testing.assert_allclose(scan.position, [k, 0, 0], atol=1e-9)
        np.testing.assert_allclose(
            scan.points, np.add(ego_points(k), (k - 1.0, 0, -1.8)), atol=1e-5
        )
        np.testing.assert_allclose(scan.T_world_sensor[:3, 1], [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("k", "labels"),
    [
        (0, [255, 255, 255, 255, 255]),  # before the first keyframe
        (1, [1, 0, 1, 255, 0]),
        (4, [1, 0, 1, 255, 0]),  # between two keyframes
        (6, [1, 0, 1, 255, 0]),
        (8, [1, 0, 255, 255, 0]),  # the next keyframe lacks a car, so its box is extrapolated
        (11, [1, 0, 0, 255, 0]),
        (12, [255, 255, 255, 255, 255]),  # after the last keyframe
    ],
)
def test_boxes_become_labels(root: Path, k: int, labels: list[int]) -> None:
    assert open_sequence(str(root))[k].labels.tolist() == labels  # type: ignore[union-attr]


def test_classes_and_instances(root: Path) -> None:
    scan = open_sequence(str(root))[4]
    names = [scan.class_names[kind] for kind in scan.classes.tolist()]  # type: ignore[union-attr]
    assert names == ["vehicle.car", "vehicle.bus.rigid", "vehicle.car", "none", "none"]
    # ahead, lost, parked
    assert scan.instances.tolist() == [1, 3, 2, 0, 0]  # type: ignore[union-attr]


def test_boxes_rotate_the_short_way_between_keyframes(root: Path) -> None:
    path = root / "v1.0-mini/sample_annotation.json"
    rows = json.loads(path.read_text())
    half = np.radians(10) / 2
    for row in rows:
        if "ahead" in row["token"] and row["sample_token"].endswith("-6"):
            row["rotation"] = [
                -np.cos(half),
                0,
                0,
                -np.sin(half),
            ]  # 10 degrees to the left, as the negative quaternion
    path.write_text(json.dumps(rows))
    sequence = open_sequence(str(root))
    assert isinstance(sequence.reader, NuScenesSequence)
    # in the box, which is rotated by 4 degrees in this frame
    corner, frame = (
        np.array([1.95, 0.95, 0.5]),
        3,
    )
    turn = np.radians(4)
    ahead = [
        (20 + np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z)
        for x, y, z in (corner, corner * (1.06, 1, 1), corner * (-1, 1, 1), corner * (-1, 1.13, 1))
    ]
    lidar_sweep(ahead).tofile(root / f"sweeps/LIDAR_TOP/scene-0061__{frame}.pcd.bin")
    assert sequence[frame].labels.tolist() == [1, 255, 1, 255]  # type: ignore[union-attr]


def test_without_boxes_there_are_no_labels(tmp_path: Path) -> None:
    write_scene(tmp_path, annotated=False)
    sequence = open_sequence(str(tmp_path))
    assert not sequence.has_labels
    assert sequence[3].labels is None


def test_without_the_folder_sweeps_there_are_only_keyframes(root: Path) -> None:
    shutil.rmtree(root / "sweeps")
    sequence = open_sequence(str(root))
    assert [sequence[k].labels.tolist()[:2] for k in range(len(sequence))] == [[1, 0]] * 3  # type: ignore[union-attr]
    np.testing.assert_allclose(sequence[2].position, [10, 0, 0], atol=1e-9)


def test_several_scenes_are_reported(root: Path) -> None:
    write_scene(root, "scene-0103")
    with pytest.raises(
        DataError,
        match=r"several scenes: scene-0061, scene-0103\. Choose one, for example "
        r"nuscenes/scene-0061",
    ):
        open_sequence(str(root))
    for path in (f"{root}/scene-0103", f"nuscenes:{root}/v1.0-mini/scene-0103"):
        sequence = open_sequence(path)
        assert (sequence.name, len(sequence)) == ("nuscenes_scene-0103", SWEEPS)
        assert sequence[6].labels.tolist() == [1, 0, 1, 255, 0]  # type: ignore[union-attr]
    with pytest.raises(
        DataError,
        match=r"nuscenes: has no scene scene-7\. Give one of its scenes: scene-0061, scene-0103",
    ):
        open_sequence(f"{root}/scene-7")


@pytest.mark.parametrize("inner", ["", "v1.0-mini", "scene-0061", "v1.0-mini/scene-0061"])
def test_a_scene_is_found_from_related_folders(root: Path, inner: str) -> None:
    write_scene(root, version="v1.0-trainval")  # both contain the same scene
    assert open_sequence(str(root / inner)).name == "nuscenes_scene-0061"


TABLES = (
    "scene",
    "sample",
    "category",
    "sensor",
    "calibrated_sensor",
    "sample_data",
    "ego_pose",
    "sample_annotation",
)


@pytest.mark.parametrize("table", TABLES)
def test_truncated_tables_are_reported(root: Path, table: str) -> None:
    path = root / f"v1.0-mini/{table}.json"
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(DataError, match=rf"{table}\.json, record \d+: not a valid list of records"):
        open_sequence(str(root))


@pytest.mark.parametrize(
    ("table", "key", "value", "problem"),
    [
        (
            "sample_data",
            "timestamp",
            None,
            r"sample_data\.json, record 0: key timestamp is missing",
        ),
        (
            "ego_pose",
            "rotation",
            [0, 0, 0, 0],
            r"ego_pose\.json, token p-.*: no valid translation and rotation",
        ),
        ("ego_pose", "token", "other", r"ego_pose\.json: pose p-.* is missing"),
        (
            "sample_annotation",
            "translation",
            ["a", 2, 3],
            r"sample_annotation\.json, token a-.*: no valid translation",
        ),
        (
            "sample_annotation",
            "size",
            [1, 2],
            r"sample_annotation\.json, token a-.*: no valid size",
        ),
        (
            "sensor",
            "channel",
            "LIDAR_FRONT",
            r"sample_data\.json: has no LIDAR_TOP data for this scene",
        ),
    ],
)
def test_invalid_records_are_reported(
    root: Path, table: str, key: str, value: Any, problem: str
) -> None:
    path = root / f"v1.0-mini/{table}.json"
    rows = json.loads(path.read_text())
    for row in rows:
        if value is None:
            del row[key]
        else:
            row[key] = value
    path.write_text(json.dumps(rows))
    with pytest.raises(DataError, match=problem):
        open_sequence(str(root))


def test_missing_and_truncated_sweeps_are_reported(root: Path) -> None:
    path = root / "sweeps/LIDAR_TOP/scene-0061__3.pcd.bin"
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(
        DataError, match=r"__3\.pcd\.bin, byte 80: ends in the middle of a point: 96 bytes .* 20"
    ):
        open_sequence(str(root))[3]
    path.unlink()
    with pytest.raises(DataError, match=r"__3\.pcd\.bin: does not exist"):
        open_sequence(str(root))
