"""Write small sequences in the layouts of KITTI tracking, SemanticKITTI, KITTI raw and KITTI
odometry.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

# The camera has x right, y down, z forward; the sensor has x forward, y left, z up.
_CAMERA_FROM_SENSOR = "0 -1 0 {} 0 0 -1 {} 1 0 0 {}"
_DATE = "calib_time: 09-Jan-2012 13:57:47\n"


def write_sweep(path: Path, points: Any) -> None:
    """Write points (N, 3) with intensity 0 as a velodyne file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([np.asarray(points, float), np.zeros(len(points))]).astype("<f4").tofile(path)


def tracking_box(frame: int, track: int, kind: str, ahead: float, left: float = 0.0) -> str:
    """A line of ``label_02``.

    A box of 2 x 2 x 4 m across the road whose bottom is 1.7 m below the camera.
    """
    return f"{frame} {track} {kind} 0 0 0 0 0 9 9 2 2 4 {-left} 1.7 {ahead} 0\n"


def write_tracking(folder: Path) -> Path:
    """KITTI tracking: a car that drives ahead of the parked sensor, in frames 0 and 10.

    The sweeps between are missing.

    Returns:
        The folder ``training``.
    """
    root = folder / "training"
    for name in ("oxts", "calib", "label_02"):
        (root / name).mkdir(parents=True)
    row = " ".join(["49.0", "8.4", "100.0", *["0"] * 27]) + "\n"
    (root / "oxts/0003.txt").write_text(row * 11)
    (root / "calib/0003.txt").write_text(
        "P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
        f"Tr_velo_to_cam: {_CAMERA_FROM_SENSOR.format(0, 0, 0)}\nTr_imu_to_velo: 1 0 0 -1 0 1 0 0 "
        "0 0 1 0\n"
    )
    boxes = [
        tracking_box(0, 0, "Car", 10),
        tracking_box(10, 0, "Car", 20),
        tracking_box(0, 1, "Pedestrian", 30),
        tracking_box(10, 1, "Pedestrian", 30),
    ]
    region = "0 -1 DontCare -1 -1 -10 900 0 1242 375 -1000 -1000 -1000 -10 -1 -1 -1\n"
    (root / "label_02/0003.txt").write_text("".join([*boxes, region]))
    points = [
        (10, 0, -1.0),  # in the moving car
        (10, 0, -1.68),  # ground below the car
        (10, 2.1, -1.0),  # in the border around the car
        (30, 0, -1.0),  # in the box of the standing pedestrian
        (15, 3, -1.0),  # on no object
        (-10, 0, 0.0),  # behind the camera
        (10, -6, 0.0),  # in the unlabelled region
    ]
    for frame in (0, 10):
        write_sweep(root / f"velodyne/0003/{frame:06d}.bin", points)
    return root


def write_semantickitti(folder: Path) -> Path:
    """SemanticKITTI: two sweeps, one metre apart along the sensor's x axis.

    Only the first has labels.

    Returns:
        The folder of the sequence.
    """
    root = folder / "sequences/04"
    for frame in (0, 1):
        points = [(10, 0, 0), (2, 2, 0), (2, 2, 0.5), (2, 2, 0), (0, 2.999, 0), (0, 3, 0)]
        write_sweep(root / f"velodyne/{frame:06d}.bin", points)
    transform = _CAMERA_FROM_SENSOR.format(0.1, -0.2, 0.3)
    (root / "calib.txt").write_text(f"P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: {transform}\n")
    (root / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n")
    (root / "labels").mkdir()
    np.array([40, 252 | 5 << 16, 259, 30, 0, 1], "<u4").tofile(root / "labels/000000.label")
    return root


def write_oxts(path: Path, latitude: float = 49.0, yaw: float = 0.0) -> None:
    """Write the GPS record of a frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        " ".join([str(latitude), "8.4", "100.0", "0", "0", str(yaw), *["0"] * 24]) + "\n"
    )


def _tracklet(kind: str, first: int, poses: list[tuple[float, float, float, float]]) -> str:
    """The XML element of a box of 4 x 2 x 1.5 m with poses (x, y, z, yaw)."""
    items = "".join(
        "<item "
        f"class_id='3'><tx>{x}</tx><ty>{y}</ty><tz>{z}</tz><rz>{yaw}</rz><state>2</state></item>"
        for x, y, z, yaw in poses
    )
    size = "<h>1.5</h><w>2.0</w><l>4.0</l>"
    return (
        "<item "
        f"class_id='1'><objectType>{kind}</objectType>{size}<first_frame>{first}</first_frame>"
        "<poses "
        f"class_id='2'><count>{len(poses)}</count><item_version>2</item_version>{items}</poses></item>"
    )


def _tracklet_file(*items: str) -> str:
    head = (
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
    )
    body = (
        "<tracklets "
        f"class_id='0'><count>{len(items)}</count><item_version>1</item_version>{''.join(items)}</tracklets>"
    )
    return (
        f"{head}<boost_serialization signature='serialization::archive' "
        f"version='9'>{body}</boost_serialization>\n"
    )


def write_raw_drive(folder: Path) -> Path:
    """KITTI raw: frames 0, 1 and 3 of a parked sensor; frame 2 has no sweep.

    Returns:
        The folder of the drive.
    """
    day = folder / "raw/2011_09_26"
    drive = day / "2011_09_26_drive_0009_sync"
    points = [
        (10, 0, -1.0),  # in the moving car
        (10, 0, -1.68),  # ground below the car
        (10, 1.125, -1.0),  # in the border around the car
        (20, 5, -1.0),  # in the parked van
        (15, 3, -1.0),  # on no object
        (-10, 0, 0.0),  # behind the camera
    ]
    for frame in (0, 1, 3):
        write_sweep(drive / f"velodyne_points/data/{frame:010d}.bin", points)
    for frame in range(4):
        write_oxts(drive / f"oxts/data/{frame:010d}.txt")
    (drive / "velodyne_points/timestamps.txt").write_text(
        "".join(f"2011-09-26 13:02:25.{frame}00000001\n" for frame in range(4))
    )
    (day / "calib_imu_to_velo.txt").write_text(_DATE + "R: 1 0 0 0 1 0 0 0 1\nT: -1 0 0\n")
    (day / "calib_velo_to_cam.txt").write_text(
        _DATE + "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\ndelta_f: 0 0\n"
    )
    (day / "calib_cam_to_cam.txt").write_text(
        _DATE + "corner_dist: 9.950000e-02\nR_rect_00: 1 0 0 0 1 0 0 0 1\nS_rect_02: 1.242000e+03 "
        "3.750000e+02\n"
        "P_rect_02: 700 0 600 0 0 700 180 0 0 0 1 0\n"
    )
    moving = [(10 + 3 * frame, 0, -1.7, 0.0) for frame in range(4)]
    parked = [(20, 5, -1.7, np.pi / 2)] * 2
    tracklets = _tracklet_file(_tracklet("Car", 0, moving), _tracklet("Van", 0, parked))
    (drive / "tracklet_labels.xml").write_text(tracklets)
    return drive


def write_odometry(
    folder: Path, frames: range = range(3), number: str = "00", poses: bool = True
) -> Path:
    """KITTI odometry: a camera that moves 1 m forward with each frame.

    Returns:
        The folder of the sequence.
    """
    root = folder / "sequences" / number
    for frame in frames:
        write_sweep(
            root / f"velodyne/{frame:06d}.bin",
            [(10, 0, 0), (49.9, 0, 0), (50.1, 0, 0), (-30, 0, 41)],
        )
    (root / "calib.txt").write_text("Tr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n")
    if poses:
        lines = [f"1 0 0 0 0 1 0 0 0 0 1 {frame}\n" for frame in range(frames.stop)]
        (folder / "poses").mkdir(exist_ok=True)
        (folder / f"poses/{number}.txt").write_text("".join(lines))
    return root
