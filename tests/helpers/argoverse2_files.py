"""Write small Argoverse 2 logs with pyarrow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

START = 315_966_265_259_836_000  # nanoseconds, on the clock of the data set
UP, DOWN = (1.35, 0.0, 1.64), (1.35, 0.0, 1.53)  # metres: positions of the lidars on the car
STEP = 100_000_000  # nanoseconds between sweeps
SPEED = 10.0  # metres per second, along the city's y axis
POINTS = [
    (10, 0, 1.0),  # in the car that drives ahead
    (10, 0, 0.3),  # ground below the car
    (10, 1.125, 1.0),  # in the border around the car
    (20, 5, 1.0),  # in the parked car
    (-10, 5, 1.0),  # in no box
]
_CITY = np.array([5000.0, 2000.0, 60.0])

Columns = dict[str, Any]


def write_table(path: Path, columns: Columns) -> None:
    """Write a Feather table."""
    import pyarrow as pa
    from pyarrow import feather

    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pa.table(columns), path, compression="lz4")


def transform_columns(positions: Any, quaternion: Any) -> Columns:
    """Columns of transforms: positions (N, 3), and one quaternion w x y z for all."""
    positions = np.asarray(positions, float).reshape(-1, 3)
    n = len(positions)
    rotation = {
        name: np.full(n, value)
        for name, value in zip(("qw", "qx", "qy", "qz"), quaternion, strict=True)
    }
    return rotation | {
        name: positions[:, axis] for axis, name in enumerate(("tx_m", "ty_m", "tz_m"))
    }


def write_sweep(log: Path, stamp: int, points: Any, lasers: Any, offsets: Any) -> None:
    """Write a sweep of points (N, 3) in the ego frame, with laser numbers and time offsets in
    nanoseconds.
    """
    xyz = np.asarray(points, np.float16).reshape(-1, 3)
    columns = {axis: xyz[:, k] for k, axis in enumerate("xyz")} | {
        "intensity": np.zeros(len(xyz), np.uint8)
    }
    columns |= {
        "laser_number": np.array(lasers, np.uint8),
        "offset_ns": np.array(offsets, np.int32),
    }
    write_table(log / f"sensors/lidar/{stamp}.feather", columns)


def _write_boxes(log: Path, rows: list[tuple[int, str, str, Any]]) -> None:
    """Write boxes of 4 x 2 x 1.5 m, given stamp, track, category and centre in the ego frame."""
    stamps, tracks, categories, centres = zip(*rows, strict=True)
    size = {
        name: np.full(len(rows), value)
        for name, value in (("length_m", 4.0), ("width_m", 2.0), ("height_m", 1.5))
    }
    columns = {
        "timestamp_ns": np.array(stamps),
        "track_uuid": list(tracks),
        "category": list(categories),
    }
    transforms = transform_columns(centres, (1, 0, 0, 0))
    write_table(
        log / "annotations.feather",
        columns | size | transforms | {"num_interior_pts": [1] * len(rows)},
    )


def write_log(folder: Path) -> Path:
    """Three sweeps of a car that drives and looks along the city's y axis.

    The last sweep has no boxes.

    Returns:
        The folder of the log.
    """
    log = folder / "sensor/val/0a1b2c3d-log"
    stamps = START + np.arange(-5, 45) * 10_000_000
    along = (stamps - START) * 1e-9 * SPEED
    quarter_turn = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    positions = _CITY + np.outer(along, (0, 1, 0))
    write_table(
        log / "city_SE3_egovehicle.feather",
        {"timestamp_ns": stamps} | transform_columns(positions, quarter_turn),
    )
    sensors = {"sensor_name": ["ring_front_center", "up_lidar", "down_lidar"]}
    mounts = transform_columns([(9, 9, 9), UP, DOWN], (1, 0, 0, 0))
    write_table(log / "calibration/egovehicle_SE3_sensor.feather", sensors | mounts)
    for k in range(3):
        write_sweep(
            log,
            START + k * STEP,
            POINTS,
            [0, 31, 32, 63, 0],
            [0, 99_000_000, 0, 99_000_000, 5_000_000],
        )
    boxes = []
    for k in range(2):
        stamp, parked = START + k * STEP, (20 - k * 0.1 * SPEED, 5, 1.0)
        boxes += [
            (stamp, "track-a", "REGULAR_VEHICLE", (10, 0, 1.0)),
            (stamp, "track-b", "BUS", parked),
        ]
    _write_boxes(log, boxes)
    return log
