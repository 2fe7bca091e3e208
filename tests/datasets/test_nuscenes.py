"""nuScenes: tables written with json, keyframes and the sweeps between them, and scenes to choose from."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaviz.datasets import open_sequence
from dynaviz.datasets.nuscenes import NuScenesSequence
from dynaviz.errors import DataError

START = 1_532_402_927_600_000  # microseconds
GLOBAL = np.array([400.0, 1100.0, 0.0])
NO_TURN = [1.0, 0.0, 0.0, 0.0]
RIGHT = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]  # the lidar's y axis points forward
SWEEPS = 13  # every 0.1 s; a keyframe every 0.5 s, from the second sweep on
KEYS = (1, 6, 11)


def lidar(points: Any) -> np.ndarray[Any, Any]:
    """Points in the car's frame as the lidar sees them, with intensity and ring."""
    x, y, z = (np.asarray(points, float) - (1.0, 0.0, 1.8)).T
    return np.column_stack([-y, x, z, np.zeros(len(x)), np.zeros(len(x))]).astype("<f4")


def points(k: int) -> list[Any]:
    """Points of a sweep in the frame of the car, which drives 1 m ahead in each."""
    return [
        (20, 0, 0.5),  # in the car that drives ahead as fast
        (30 - k, 5, 0.5),  # in the parked car
        (10, -3, 0.5),  # in a car that only the first keyframes know
        (0, 0, 1.5),  # on the recording car's own roof
        (12, 8, 0.5),  # in no box
    ]


def write(root: Path, version: str, name: str, table: str, rows: list[Any]) -> None:
    path = root / version / f"{table}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    old = json.loads(path.read_text()) if path.exists() else []
    path.write_text(json.dumps([*old, *rows], indent=0))


def scene(root: Path, name: str = "scene-0061", version: str = "v1.0-mini", annotated: bool = True) -> None:
    def add(table: str, *rows: Any) -> None:
        write(root, version, name, table, list(rows))

    add("scene", {"token": f"token-{name}", "name": name, "log_token": "log"})
    if not (root / version / "sensor.json").exists():
        sensors = [{"token": f"s-{channel}", "channel": channel} for channel in ("CAM_FRONT", "LIDAR_TOP")]
        add("sensor", *sensors)
        add("category", {"token": "c-car", "name": "vehicle.car"}, {"token": "c-bus", "name": "vehicle.bus.rigid"})
    for channel, turn in (("CAM_FRONT", NO_TURN), ("LIDAR_TOP", RIGHT)):
        row = {"token": f"k-{channel}-{name}", "sensor_token": f"s-{channel}"}
        add("calibrated_sensor", row | {"translation": [1.0, 0.0, 1.8], "rotation": turn})
    for k in range(SWEEPS):
        key = next((key for key in KEYS if key >= k), KEYS[-1])
        for channel in ("CAM_FRONT", "LIDAR_TOP"):
            file = f"{'samples' if k in KEYS else 'sweeps'}/{channel}/{name}__{k}.pcd.bin"
            pose = {
                "token": f"p-{channel}-{name}-{k}",
                "translation": list(GLOBAL + np.array([k, 0, 0])),
                "rotation": NO_TURN,
            }
            row = {"token": f"d-{channel}-{name}-{k}", "sample_token": f"{name}-{key}", "ego_pose_token": pose["token"]}
            row |= {"calibrated_sensor_token": f"k-{channel}-{name}", "filename": file, "is_key_frame": k in KEYS}
            add("ego_pose", pose)
            add("sample_data", row | {"timestamp": START + k * 100_000})
            (root / file).parent.mkdir(parents=True, exist_ok=True)
            lidar(points(k)).tofile(root / file)
    rows = []
    for key in KEYS:
        add("sample", {"token": f"{name}-{key}", "scene_token": f"token-{name}", "timestamp": START + key * 100_000})
        drawn = {"ahead": (20 + key, 0, 0.75), "parked": (30, 5, 0.75)}
        if key < KEYS[-1]:
            drawn["lost"] = (10 + key, -3, 0.75)
        for who, place in drawn.items():
            row = {
                "token": f"a-{who}-{name}-{key}",
                "sample_token": f"{name}-{key}",
                "instance_token": f"i-{who}-{name}",
            }
            row |= {"translation": list(GLOBAL + place), "rotation": NO_TURN, "size": [2.0, 4.0, 1.5]}  # width first
            rows.append(row)
    add("sample_annotation", *(rows if annotated else []))
    kinds = {"ahead": "c-car", "parked": "c-bus", "lost": "c-car"}
    add("instance", *({"token": f"i-{who}-{name}", "category_token": kind} for who, kind in kinds.items()))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = tmp_path / "nuscenes"
    scene(root)
    return root


def test_keyframes_and_sweeps_are_in_the_order_of_time(root: Path) -> None:
    sequence = open_sequence(str(root))
    assert isinstance(sequence, NuScenesSequence)
    assert (sequence.name, sequence.sensor.name, len(sequence)) == ("nuscenes_scene-0061", "hdl32e", SWEEPS)
    assert [sequence[k].index for k in range(SWEEPS)] == list(range(SWEEPS))
    assert sequence[2].stamp_ns == (START + 200_000) * 1000
    assert sequence.facts == {"keyframes": "3", "objects with boxes": "3, of which 2 move"}


def test_the_world_begins_at_the_sensor_with_the_axes_of_the_map(root: Path) -> None:
    sequence = open_sequence(str(root))
    for k in (0, 7):
        scan = sequence[k]
        np.testing.assert_allclose(scan.position, [k, 0, 0], atol=1e-9)
        np.testing.assert_allclose(scan.points, np.add(points(k), (k - 1.0, 0, -1.8)), atol=1e-5)
        np.testing.assert_allclose(scan.T_world_sensor[:3, 1], [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("k", "labels"),
    [
        (0, [255, 255, 255, 255, 255]),  # before the first keyframe
        (1, [1, 0, 1, 255, 0]),
        (4, [1, 0, 1, 255, 0]),  # between two keyframes
        (6, [1, 0, 1, 255, 0]),
        (8, [1, 0, 255, 255, 0]),  # the next keyframe has lost a car: it may be where it would be now
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
    assert scan.instances.tolist() == [1, 3, 2, 0, 0]  # type: ignore[union-attr]  # ahead, lost, parked


def test_boxes_turn_the_short_way_between_keyframes(root: Path) -> None:
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
            ]  # 10 degrees to the left, written the other way round
    path.write_text(json.dumps(rows))
    sequence = open_sequence(str(root))
    assert isinstance(sequence, NuScenesSequence)
    corner, frame = np.array([1.95, 0.95, 0.5]), 3  # of the box that is turned by 4 degrees there
    turn = np.radians(4)
    ahead = [(20 + np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z)
             for x, y, z in (corner, corner * (1.06, 1, 1), corner * (-1, 1, 1), corner * (-1, 1.13, 1))]  # fmt: skip
    lidar(ahead).tofile(root / f"sweeps/LIDAR_TOP/scene-0061__{frame}.pcd.bin")
    assert sequence[frame].labels.tolist() == [1, 255, 1, 255]  # type: ignore[union-attr]


def test_without_boxes_there_is_no_truth(tmp_path: Path) -> None:
    scene(tmp_path, annotated=False)
    sequence = open_sequence(str(tmp_path))
    assert not sequence.has_labels
    assert sequence[3].labels is None


def test_without_the_folder_of_sweeps_there_are_keyframes(root: Path) -> None:
    shutil.rmtree(root / "sweeps")
    sequence = open_sequence(str(root))
    assert [sequence[k].labels.tolist()[:2] for k in range(len(sequence))] == [[1, 0]] * 3  # type: ignore[union-attr]
    np.testing.assert_allclose(sequence[2].position, [10, 0, 0], atol=1e-9)


def test_one_of_several_scenes_must_be_chosen(root: Path) -> None:
    scene(root, "scene-0103")
    with pytest.raises(DataError, match=r"several scenes: scene-0061, scene-0103\. .* as in nuscenes/scene-0061"):
        open_sequence(str(root))
    for path in (f"{root}/scene-0103", f"nuscenes:{root}/v1.0-mini/scene-0103"):
        sequence = open_sequence(path)
        assert (sequence.name, len(sequence)) == ("nuscenes_scene-0103", SWEEPS)
        assert sequence[6].labels.tolist() == [1, 0, 1, 255, 0]  # type: ignore[union-attr]
    with pytest.raises(DataError, match="nuscenes: has no scene scene-7, but scene-0061, scene-0103"):
        open_sequence(f"{root}/scene-7")


@pytest.mark.parametrize("inner", ["", "v1.0-mini", "scene-0061", "v1.0-mini/scene-0061"])
def test_a_scene_is_found_from_many_places(root: Path, inner: str) -> None:
    scene(root, version="v1.0-trainval")  # both hold the same scene
    assert open_sequence(str(root / inner)).name == "nuscenes_scene-0061"


TABLES = ("scene", "sample", "category", "sensor", "calibrated_sensor", "sample_data", "ego_pose", "sample_annotation")


@pytest.mark.parametrize("table", TABLES)
def test_tables_that_are_cut_are_told(root: Path, table: str) -> None:
    path = root / f"v1.0-mini/{table}.json"
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(DataError, match=rf"{table}\.json, record \d+: is no whole list of records"):
        open_sequence(str(root))


@pytest.mark.parametrize(
    ("table", "key", "value", "problem"),
    [
        ("sample_data", "timestamp", None, r"sample_data\.json, record 0: has no timestamp"),
        ("ego_pose", "rotation", [0, 0, 0, 0], r"ego_pose\.json, token p-.*: has no translation and rotation"),
        ("ego_pose", "token", "other", r"ego_pose\.json: has no pose p-"),
        ("sample_annotation", "translation", ["a", 2, 3], r"sample_annotation\.json, token a-.*: has no translation"),
        ("sample_annotation", "size", [1, 2], r"sample_annotation\.json, token a-.*: has no size"),
        ("sensor", "channel", "LIDAR_FRONT", r"sample_data\.json: has no LIDAR_TOP of this scene"),
    ],
)
def test_damaged_records_are_told(root: Path, table: str, key: str, value: Any, problem: str) -> None:
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


def test_sweeps_that_are_missing_or_cut_are_told(root: Path) -> None:
    path = root / "sweeps/LIDAR_TOP/scene-0061__3.pcd.bin"
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(DataError, match=r"__3\.pcd\.bin, byte 80: ends in the middle of a point: 96 bytes .* 20"):
        open_sequence(str(root))[3]
    path.unlink()
    with pytest.raises(DataError, match=r"__3\.pcd\.bin: is missing"):
        open_sequence(str(root))
