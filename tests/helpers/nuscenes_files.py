"""Write small nuScenes data sets with json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

START = 1_532_402_927_600_000  # microseconds
SWEEPS = 13  # every 0.1 s; a keyframe every 0.5 s, from the second sweep on
_KEYFRAMES = (1, 6, 11)
_GLOBAL = np.array([400.0, 1100.0, 0.0])
_IDENTITY = [1.0, 0.0, 0.0, 0.0]
_QUARTER_TURN = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]  # the lidar's y axis points forward


def lidar_sweep(points: Any) -> np.ndarray[Any, Any]:
    """Rows of a lidar file for points (N, 3) in the ego frame."""
    x, y, z = (np.asarray(points, float) - (1.0, 0.0, 1.8)).T
    return np.column_stack([-y, x, z, np.zeros(len(x)), np.zeros(len(x))]).astype("<f4")


def ego_points(k: int) -> list[Any]:
    """Points of sweep ``k`` in the ego frame; the car drives 1 m forward per sweep."""
    return [
        (20, 0, 0.5),  # in the car that drives ahead at the same speed
        (30 - k, 5, 0.5),  # in the parked car
        (10, -3, 0.5),  # in a car that only the first two keyframes have
        (0, 0, 1.5),  # on the roof of the recording car
        (12, 8, 0.5),  # in no box
    ]


def write_scene(
    root: Path, name: str = "scene-0061", version: str = "v1.0-mini", annotated: bool = True
) -> None:
    """Add a scene to a data set."""

    def add(table: str, *rows: Any) -> None:
        path = root / version / f"{table}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        existing = json.loads(path.read_text()) if path.exists() else []
        path.write_text(json.dumps([*existing, *rows], indent=0))

    add("scene", {"token": f"token-{name}", "name": name, "log_token": "log"})
    if not (root / version / "sensor.json").exists():
        sensors = [
            {"token": f"s-{channel}", "channel": channel} for channel in ("CAM_FRONT", "LIDAR_TOP")
        ]
        add("sensor", *sensors)
        add(
            "category",
            {"token": "c-car", "name": "vehicle.car"},
            {"token": "c-bus", "name": "vehicle.bus.rigid"},
        )
    for channel, rotation in (("CAM_FRONT", _IDENTITY), ("LIDAR_TOP", _QUARTER_TURN)):
        row = {"token": f"k-{channel}-{name}", "sensor_token": f"s-{channel}"}
        add("calibrated_sensor", row | {"translation": [1.0, 0.0, 1.8], "rotation": rotation})
    for k in range(SWEEPS):
        keyframe = next((keyframe for keyframe in _KEYFRAMES if keyframe >= k), _KEYFRAMES[-1])
        for channel in ("CAM_FRONT", "LIDAR_TOP"):
            file = f"{'samples' if k in _KEYFRAMES else 'sweeps'}/{channel}/{name}__{k}.pcd.bin"
            pose = {
                "token": f"p-{channel}-{name}-{k}",
                "translation": list(_GLOBAL + np.array([k, 0, 0])),
                "rotation": _IDENTITY,
            }
            row = {
                "token": f"d-{channel}-{name}-{k}",
                "sample_token": f"{name}-{keyframe}",
                "ego_pose_token": pose["token"],
                "calibrated_sensor_token": f"k-{channel}-{name}",
                "filename": file,
                "is_key_frame": k in _KEYFRAMES,
            }
            add("ego_pose", pose)
            add("sample_data", row | {"timestamp": START + k * 100_000})
            (root / file).parent.mkdir(parents=True, exist_ok=True)
            lidar_sweep(ego_points(k)).tofile(root / file)
    annotations = []
    for keyframe in _KEYFRAMES:
        sample = f"{name}-{keyframe}"
        add(
            "sample",
            {
                "token": sample,
                "scene_token": f"token-{name}",
                "timestamp": START + keyframe * 100_000,
            },
        )
        centres = {"ahead": (20 + keyframe, 0, 0.75), "parked": (30, 5, 0.75)}
        if keyframe < _KEYFRAMES[-1]:
            centres["lost"] = (10 + keyframe, -3, 0.75)
        for instance, centre in centres.items():
            row = {
                "token": f"a-{instance}-{name}-{keyframe}",
                "sample_token": sample,
                "instance_token": f"i-{instance}-{name}",
            }
            row |= {
                "translation": list(_GLOBAL + centre),
                "rotation": _IDENTITY,
                "size": [2.0, 4.0, 1.5],
            }  # width first
            annotations.append(row)
    add("sample_annotation", *(annotations if annotated else []))
    categories = {"ahead": "c-car", "parked": "c-bus", "lost": "c-car"}
    add(
        "instance",
        *(
            {"token": f"i-{instance}-{name}", "category_token": token}
            for instance, token in categories.items()
        ),
    )


def write_nuscenes(folder: Path) -> Path:
    """A data set with one scene.

    Returns:
        Its folder.
    """
    root = folder / "nuscenes"
    write_scene(root)
    return root
