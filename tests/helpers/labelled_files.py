"""Write small data sets of MOE, PandaSet and SUSTechPOINTS."""

from __future__ import annotations

import gzip
import io
import json
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.io.pcd import write_pcd

FRAMES = 3
START = 1_557_540_000.0  # seconds
HALF_TURN = (0.0, 0.0, 0.0, 1.0)  # w x y z: the sensor looks backwards


def sensor_points(k: int) -> np.ndarray[Any, Any]:
    """(4, 3) points in the sensor frame, which moves 1 m forward per frame.

    In an object that drives ahead, in a parked one, next to the first one, and far from all.
    """
    return np.array([(10, 0, 0), (20 - k, 5, 0), (10, 1.15, 0), (5, -20, 0)], np.float32)


def write_moe(folder: Path) -> Path:
    """MOE: three scans; the last one has no labels.

    Returns:
        The folder of the sequence.
    """
    root = folder / "MOE-Dataset/00"
    for name in ("pcd", "label"):
        (root / name).mkdir(parents=True)
    for k in range(FRAMES):
        fields = dict(zip("xyz", sensor_points(k).T, strict=True))
        write_pcd(root / f"pcd/{k:06d}.pcd", fields, np.eye(4))
        if k < FRAMES - 1:
            lines = ["1 1 3", "1 0 -1", "0 0 -1", "0 0 -1"]
            (root / f"label/{k:06d}.txt").write_text("\n".join(lines) + "\n")
    rows = [f"1 0 0 {k} 0 1 0 0 0 0 1 2" for k in range(FRAMES)]
    (root / "gt_poses.txt").write_text("\n".join(rows) + "\n")
    return root


class _Call:
    """Pickled as the call of a function of another package, which need not be installed."""

    def __init__(self, name: str, args: tuple[Any, ...] = (), state: Any = None) -> None:
        self.name = name
        self.args = args
        self.state = state


class _New(_Call):
    """Pickled as an object of a class of another package."""


class _Name(_Call):
    """Pickled as a name of another package."""


class _Writer(pickle._Pickler):  # type: ignore[misc]  # in Python, so that names can be written
    """Writes names of packages that are not imported."""

    def save(self, obj: Any, save_persistent_id: bool = True) -> None:
        if isinstance(obj, _Name):
            module, _, name = obj.name.rpartition(".")
            super().save(module)
            super().save(name)
            self.write(pickle.STACK_GLOBAL)
        elif isinstance(obj, _Call):
            self.save(_Name(obj.name))
            super().save(obj.args)
            self.write(pickle.NEWOBJ if isinstance(obj, _New) else pickle.REDUCE)
            if obj.state is not None:
                super().save(obj.state)
                self.write(pickle.BUILD)
        else:
            super().save(obj, save_persistent_id)


def _array(values: np.ndarray[Any, Any]) -> _Call:
    """An array as NumPy 1 pickled it."""
    code = values.dtype.str[1:] if values.dtype != object else "O8"
    order = "|" if values.dtype.itemsize == 1 or values.dtype == object else "<"
    state = (3, order, None, None, None, -1, -1, 63 if code == "O8" else 0)
    dtype = _Call("numpy.dtype", (code, False, True), state)
    content = values.ravel().tolist() if code == "O8" else values.tobytes()
    empty = (_Name("numpy.ndarray"), (0,), b"b")
    state = (1, values.shape, dtype, False, content)
    return _Call("numpy.core.multiarray._reconstruct", empty, state)


def _index(kind: str, facts: dict[str, Any]) -> _Call:
    name = _Name(f"pandas.core.indexes.{kind}")
    return _Call("pandas.core.indexes.base._new_Index", (name, {**facts, "name": None}))


def pickled(columns: Mapping[str, Any], protocol: int = 4) -> bytes:
    """A table as pandas 1.0 pickled it, one block for each column."""
    arrays = {
        name: np.asarray(values, object if isinstance(values[0], str) else None)
        for name, values in columns.items()
    }
    rows = len(next(iter(arrays.values())))
    axes = [
        _index("base.Index", {"data": _array(np.array(list(arrays), object))}),
        _index("range.RangeIndex", {"start": 0, "stop": rows, "step": 1}),
    ]
    blocks = [
        {
            "values": _array(values[None]),
            "mgr_locs": _Call("builtins.slice", (number, number + 1, 1)),
        }
        for number, values in enumerate(arrays.values())
    ]
    state = (axes, [], [], {"0.14.1": {"axes": axes, "blocks": blocks}})
    manager = _New("pandas.core.internals.managers.BlockManager", (), state)
    table = {"_data": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}}
    frame = _New("pandas.core.frame.DataFrame", (), table)
    file = io.BytesIO()
    _Writer(file, protocol).dump(frame)
    return file.getvalue()


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """A table, compressed if its name ends in ``.gz``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = pickled(columns)
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)


def write_pandaset(folder: Path, suffix: str = ".pkl.gz") -> Path:
    """PandaSet: three sweeps; both lidars see the object ahead, which has a box for each.

    The car drives along -x of the world, since its sensor looks backwards. Points 0 to 3 are of the
    Pandar64 and, again, 4 to 7 of the PandarGT, which sees the object 0.6 m farther.

    Returns:
        The folder of the sequence.
    """
    root = folder / "pandaset/002"
    for k in range(FRAMES):
        xyz = np.concatenate([sensor_points(k), sensor_points(k) + np.array((0.6, 0, 0))])
        xyz = xyz * (-1, -1, 1) + (100 - k, 50, 0)
        points = dict(zip("xyz", xyz.T, strict=True))
        points["i"] = np.arange(8.0)
        points["t"] = START + 0.1 * k + np.linspace(0.003, 0.085, 8)
        points["d"] = np.repeat([0, 1], 4)
        write_table(root / f"lidar/{k:02d}{suffix}", points)
        boxes = [
            ("a", "Car", (90 - k, 50), 0, "b"),
            ("b", "Car", (89.4 - k, 50), 1, "a"),
            ("c", "Cones", (80, 45), -1, ""),
        ]
        names, labels, places, lidars, siblings = zip(*boxes, strict=True)
        cuboids = {
            "uuid": list(names),
            "label": list(labels),
            "yaw": [np.pi / 2] * 3,
            "position.x": [float(place[0]) for place in places],
            "position.y": [float(place[1]) for place in places],
            "position.z": [0.0] * 3,
            "dimensions.x": [2.0] * 3,
            "dimensions.y": [1.4] * 3,
            "dimensions.z": [1.6] * 3,
            "cuboids.sibling_id": list(siblings),
            "cuboids.sensor_id": list(lidars),
        }
        if k < FRAMES - 1:
            write_table(root / f"annotations/cuboids/{k:02d}{suffix}", cuboids)
        if k == 0:
            classes = {"class": [13, 37, 7, 4] * 2}
            write_table(root / f"annotations/semseg/{k:02d}{suffix}", classes)
    w, x, y, z = HALF_TURN
    poses = [
        {
            "position": {"x": 100.0 - k, "y": 50.0, "z": 0.0},
            "heading": {"w": w, "x": x, "y": y, "z": z},
        }
        for k in range(FRAMES)
    ]
    (root / "lidar/poses.json").write_text(json.dumps(poses))
    (root / "lidar/timestamps.json").write_text(
        json.dumps([START + 0.1 * k for k in range(FRAMES)])
    )
    return root


def sustech_box(kind: str, name: str, x: float, y: float, **more: Any) -> dict[str, Any]:
    """A box of 2 x 2 x 1.6 m around z = 0, as SUSTechPOINTS saves it."""
    psr = {
        "position": {"x": x, "y": y, "z": 0.0},
        "scale": {"x": 2.0, "y": 2.0, "z": 1.6},
        "rotation": {"x": 0.0, "y": 0.0, "z": more.pop("yaw", 0.0)},
    }
    return {"psr": psr, "obj_type": kind, "obj_id": name, **more}


def write_sustech(folder: Path, poses: bool = True, timed: bool = True) -> Path:
    """SUSTechPOINTS: three scans, 0.5 s apart; the last one has no labels.

    Returns:
        The folder of the scene.
    """
    root = folder / "data/example"
    for name in ("lidar", "label", *(("lidar_pose",) if poses else ())):
        (root / name).mkdir(parents=True)
    for k in range(FRAMES):
        stem = f"{START + 0.5 * k:.3f}" if timed else f"{k:06d}"
        fields = dict(zip("xyz", sensor_points(k).T, strict=True))
        fields["intensity"] = np.zeros(4, np.float32)
        write_pcd(root / f"lidar/{stem}.pcd", fields, np.eye(4))
        boxes = [sustech_box("Car", "1", 10, 0), sustech_box("Car", "2", 20 - k, 5)]
        boxes.append(sustech_box("Pedestrian", "", 5, -20))
        content: Any = boxes if k else {"frame": stem, "objs": boxes}
        if k < FRAMES - 1:
            (root / f"label/{stem}.json").write_text(json.dumps(content))
        if poses:
            T = np.eye(4)
            T[0, 3] = k
            pose = {"lidarPose": T.ravel().tolist()}
            (root / f"lidar_pose/{stem}.json").write_text(json.dumps(pose))
    return root
