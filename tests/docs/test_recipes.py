"""Each recipe works on files in the layout that the program writes."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.bags import START, BagWriter, columns
from helpers.static_hall import hall
from scipy.spatial.transform import Rotation

from dynaviz.contracts.scan import Label, Scan
from dynaviz.io.fields import read_fields
from dynaviz.io.pcd import write_pcd
from dynaviz.spatial import geometry

PAGE = Path(__file__).resolve().parents[2] / "docs" / "recipes.md"
SECTIONS = dict(
    re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE.read_text(encoding="utf-8"), re.M | re.S)
)
TURN = Rotation.from_euler("z", 0.3).as_matrix()  # of the world, so that poses are not the identity
SWEEP = 0.1  # seconds


def world() -> list[Scan]:
    """The hall in a world that is turned."""
    T = np.eye(4)
    T[:3, :3] = TURN
    return [
        Scan(
            scan.index,
            geometry.transform(T, scan.points),
            geometry.compose(T, scan.T_world_sensor),
            labels=scan.labels,
        )
        for scan in hall()
    ]


def own(scan: Scan) -> np.ndarray:
    """(N, 3) float32: the points in the sensor frame."""
    return geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points)


def seconds(k: int) -> str:
    """The time of a scan, as programs print it."""
    return f"{(START + k * 10**8) / 1e9:.6f}"


def tum(path: Path, scans: list[Scan]) -> None:
    """Time, position, quaternion; a space at the end of each line, as FAST-LIVO2 has."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        for k, scan in enumerate(scans):
            numbers = *scan.position, *Rotation.from_matrix(scan.T_world_sensor[:3, :3]).as_quat()
            file.write(f"{seconds(k)} {' '.join(f'{number:.6f}' for number in numbers)} \n")


def bag(path: Path, scans: list[Scan], kind: str = "ros1") -> None:
    """A drive without poses: points with their times, as a Velodyne driver publishes them."""
    with BagWriter(path, kind) as writer:
        for k, scan in enumerate(scans):
            writer.cloud(
                k * SWEEP,
                columns(own(scan), intensity=np.ones(len(scan), "f4")),
                topic="/velodyne_points",
            )


def numbered(folder: Path, scans: list[Scan]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for k, scan in enumerate(scans):
        cloud(folder / f"{k:06d}.pcd", own(scan))


def cloud(path: Path, points: np.ndarray) -> None:
    """A cloud as PCL writes it: all of its VIEWPOINTs are the identity."""
    write_pcd(path, {**columns(points), "intensity": np.ones(len(points), np.float32)}, np.eye(4))


def fast_lio(scans: list[Scan]) -> None:
    with BagWriter(Path("fastlio")) as writer:
        for k, scan in enumerate(scans):
            fields = {
                name: np.zeros(len(scan), "f4")
                for name in ("intensity", "normal_x", "normal_y", "normal_z")
            }
            fields |= {"curvature": np.linspace(0, 100, len(scan), dtype="f4")}
            writer.cloud(
                k * SWEEP,
                columns(own(scan), **fields),
                topic="/cloud_registered_body",
                frame="body",
            )
            writer.odometry(
                k * SWEEP, scan.T_world_sensor, topic="/Odometry", world="camera_init", child="body"
            )


def fast_livo2(scans: list[Scan]) -> None:
    tum(Path("Log/pcd/lidar_poses.txt"), scans)
    for k, scan in enumerate(scans):
        cloud(Path(f"Log/pcd/{seconds(k)}.pcd"), own(scan))


def kiss_slam(scans: list[Scan]) -> None:
    pipeline = pytest.importorskip("kiss_icp.pipeline").OdometryPipeline
    numbered(Path("scans"), scans)
    bag(Path("drive"), scans)
    folder, poses = Path("results/latest"), np.array([scan.T_world_sensor for scan in scans])
    folder.mkdir(parents=True)
    for name, times in (
        ("scans", np.arange(len(scans), dtype=float)),
        ("drive", [float(seconds(k)) for k in range(len(scans))]),
    ):
        pipeline.save_poses_kitti_format(f"{folder}/{name}_poses", poses)
        pipeline.save_poses_tum_format(f"{folder}/{name}_poses", poses, times)


def glim(scans: list[Scan]) -> None:
    bag(Path("drive"), scans, "sqlite3")
    for name in ("traj_lidar.txt", "odom_lidar.txt", "traj_imu.txt", "odom_imu.txt"):
        tum(Path("dump") / name, scans)


def lio_sam(scans: list[Scan]) -> None:
    bag(Path("drive"), scans)
    keys = [0, 3, 6, 9]
    angles = [Rotation.from_matrix(scans[k].T_world_sensor[:3, :3]).as_euler("xyz") for k in keys]
    table = np.column_stack([[scans[k].position for k in keys], keys, angles]).astype(np.float32)
    fields = dict(zip(("x", "y", "z", "intensity", "roll", "pitch", "yaw"), table.T, strict=True))
    Path("LOAM").mkdir()
    write_pcd(
        "LOAM/transformations.pcd", {**fields, "time": [float(seconds(k)) for k in keys]}, np.eye(4)
    )
    numbered(Path("SC/Scans"), scans)
    np.savetxt(
        "SC/optimized_poses.txt", [scan.T_world_sensor[:3].ravel() for scan in scans], fmt="%.17g"
    )


def mast(scans: list[Scan]) -> None:
    numbered(Path("mast"), hall(fixed=True))


def survey(scans: list[Scan]) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [1e-4] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.concatenate([scan.points for scan in scans]).T.astype(np.float64)
    las.gps_time = np.concatenate(
        [100.0 + SWEEP * (k + np.linspace(0, 0.99, len(scan))) for k, scan in enumerate(scans)]
    )
    las.write("survey.laz")
    lines = ["time,x,y,z,qx,qy,qz,qw"]
    for k, scan in enumerate([*scans, scans[-1]]):
        numbers = (
            100.0 + SWEEP * k,
            *scan.position,
            *Rotation.from_matrix(scan.T_world_sensor[:3, :3]).as_quat(),
        )
        lines.append(",".join(f"{number:.6f}" for number in numbers))
    Path("trajectory.csv").write_text("\n".join(lines) + "\n")


WRITERS: dict[str, Callable[[list[Scan]], None]] = {
    "FAST-LIO": fast_lio,
    "FAST-LIVO2": fast_livo2,
    "KISS-SLAM and KISS-ICP": kiss_slam,
    "GLIM": glim,
    "LIO-SAM": lio_sam,
    "A fixed sensor": mast,
    "A hand-held scanner": survey,
}


def test_every_recipe_is_tried() -> None:
    assert list(SECTIONS) == list(WRITERS)


@pytest.mark.filterwarnings(
    "ignore:the sensor is unknown", "ignore:.*outside the time span", "ignore:.*the poses drift"
)
@pytest.mark.parametrize(
    "recipe",
    [pytest.param(name, marks=[] if name == "FAST-LIO" else pytest.mark.slow) for name in WRITERS],
)
def test_recipe(
    recipe: str,
    run_command: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    scans = world()
    WRITERS[recipe](scans)
    commands = [line for line in SECTIONS[recipe].splitlines() if line.startswith("dynaviz clean ")]
    assert commands
    moving = sum(int((scan.labels == Label.DYNAMIC).sum()) for scan in scans)
    for command in commands:
        code, out, err = run_command(
            *shlex.split(command)[1:], "--keep-dynamic", "removed.pcd", "--record", "none"
        )
        assert code == 0, f"{command}\n{out}\n{err}"
        kept, removed = (
            len(read_fields(path)["x"]) for path in (shlex.split(command)[-1], "removed.pcd")
        )
        print(command, kept, removed, moving)
        assert 0.5 * moving < removed < 1.2 * moving, command
