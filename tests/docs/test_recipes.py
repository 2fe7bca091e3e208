"""Each recipe works on files in the layout that the program writes."""

from __future__ import annotations

import re
import shlex
import subprocess
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


def poses(path: Path, rows: list[np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, [T[:3].ravel() for T in rows], fmt="%.9f")


def binary(folder: Path, names: list[str], scans: list[Scan], columns: int = 4) -> None:
    """Points with intensity, and with ring and time of six columns."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, scan in zip(names, scans, strict=True):
        rows = np.zeros((len(scan), columns), "<f4")
        rows[:, :3] = own(scan)
        rows[:, 3] = 1.0
        rows[:, 4:] = np.linspace(0, 0.1, len(scan))[:, None]
        rows.tofile(folder / f"{name}.bin")


def hba(scans: list[Scan]) -> None:
    Path("session/pcd").mkdir(parents=True)
    for k, scan in enumerate(scans):
        cloud(Path(f"session/pcd/{k}.pcd"), own(scan))
    rows = [
        [*scan.position, *geometry.quaternion(scan.T_world_sensor[:3, :3])] for scan in scans
    ]  # w first
    np.savetxt("session/pose.json", rows, fmt="%.6f")


def rko_lio(scans: list[Scan]) -> None:
    folder = Path("results/drive_0")
    (folder / "deskewed_scans").mkdir(parents=True)
    tum(folder / "drive_tum_0.txt", scans)
    for k, scan in enumerate(scans):
        xyz = own(scan).astype("<f8")
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\n"
        fields = "".join(f"property double {axis}\n" for axis in "xyz")
        content = f"{head}{fields}end_header\n".encode() + xyz.tobytes()
        (folder / f"deskewed_scans/{START + k * 10**8}.ply").write_bytes(content)


def hdmapping(scans: list[Scan]) -> None:
    """Parts of four scans, each in the frame of its first pose, with times in nanoseconds."""
    laspy = pytest.importorskip("laspy")
    Path("session").mkdir()
    parts = [scans[k : k + 4] for k in range(0, len(scans), 4)]
    registered = [f"{len(parts)}"]
    for number, part in enumerate(parts):
        first = part[0].T_world_sensor
        header = laspy.LasHeader(point_format=1, version="1.2")
        header.scales = [1e-4] * 3
        las = laspy.LasData(header)
        points = np.concatenate([scan.points for scan in part]).astype(np.float64)
        las.x, las.y, las.z = geometry.apply(geometry.inverse(first), points).T
        starts = [START + (4 * number + k) * 10**8 for k in range(len(part))]
        las.gps_time = np.concatenate(
            [t + np.linspace(0, 0.99e8, len(scan)) for t, scan in zip(starts, part, strict=True)]
        )
        las.write(f"session/scan_lio_{number}.laz")
        titles = [f"pose{row}{column}" for row in range(3) for column in range(4)]
        rows = [" ".join(["timestamp_nanoseconds", *titles, "timestampUnix_nanoseconds"])]
        for k, scan in enumerate(part):
            local = geometry.inverse(first) @ scan.T_world_sensor
            moments = (starts[k], starts[k] + 99_000_000)  # the hall is measured from one place
            for t in moments:
                numbers = " ".join(f"{x:.12f}" for x in local[:3].ravel())
                rows.append(f"{t:.20g} {numbers} {t:.20g}")
        Path(f"session/trajectory_lio_{number}.csv").write_text("\n".join(rows) + "\n")
        registered.append(f"/data/session/scan_lio_{number}.laz")
        registered += [" ".join(f"{x:.9g}" for x in row) for row in first]
    Path("session/poses.reg").write_text("\n".join(registered) + "\n")


def lidar_slam_ros2(scans: list[Scan]) -> None:
    with BagWriter(Path("slam"), "sqlite3") as writer:
        for k, scan in enumerate(scans):
            fields = columns(own(scan), intensity=np.ones(len(scan), "f4"))
            writer.cloud(k * SWEEP, fields, topic="/velodyne_points")
            writer.pose(k * SWEEP, scan.T_world_sensor, topic="/current_pose")


def hdl_graph_slam(scans: list[Scan]) -> None:
    for k, scan in enumerate(scans):
        folder = Path(f"dump/{k:06d}")
        folder.mkdir(parents=True)
        cloud(folder / "cloud.pcd", own(scan))
        T = "\n".join(" ".join(f"{x:9.6f}" for x in row) for row in scan.T_world_sensor)
        other = T.replace("1", "2")
        stamp = f"stamp {START // 10**9 + k} 5"
        text = f"{stamp}\nestimate\n{T}\nodom \n{other}\naccum_distance {k}\nid {k + 1}\n"
        (folder / "data").write_text(text)
    Path("dump/graph.g2o").write_text("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n")


def kitti_360(scans: list[Scan]) -> None:
    lidar = np.eye(4)  # on the IMU
    lidar[:3, :3] = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    lidar[:3, 3] = 0.8, 0.3, -0.8
    camera = np.array([[0.0, 0, 1, 1.6], [-1, 0, 0, 0.3], [0, -1, 0, -0.7], [0, 0, 0, 1]])
    to_lidar = geometry.inverse(lidar) @ camera
    folder = Path("calibration")
    poses(folder / "calib_cam_to_velo.txt", [to_lidar])
    numbers = " ".join(f"{x:.9f}" for x in camera[:3].ravel())
    (folder / "calib_cam_to_pose.txt").write_text(f"image_00: {numbers}\nimage_01: {numbers}\n")
    names = [f"{k:010d}" for k in range(len(scans))]
    binary(Path("data_3d_raw/drive/velodyne_points/data"), names, scans)
    unit = [scan.T_world_sensor @ geometry.inverse(lidar) for scan in scans]
    rows = [f"{k} " + " ".join(f"{x:.9f}" for x in T[:3].ravel()) for k, T in enumerate(unit)]
    Path("data_poses/drive").mkdir(parents=True)
    Path("data_poses/drive/poses.txt").write_text("\n".join(rows) + "\n")


def boreas(scans: list[Scan]) -> None:
    times = [START // 1000 + k * 100_000 for k in range(len(scans))]
    folder = Path("boreas-2021-01-26-11-22")
    binary(folder / "lidar", [str(t) for t in times], scans, 6)
    titles = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading"
    lines = [f"{titles},angvel_z,angvel_y,angvel_x"]
    for t, scan in zip(times, scans, strict=True):
        angles = Rotation.from_matrix(scan.T_world_sensor[:3, :3].T).as_euler("xyz")
        numbers = *scan.position, 0.0, 0.0, 0.0, *angles, 0.0, 0.0, 0.0
        lines.append(f"{t}," + ",".join(f"{x:.9f}" for x in numbers))
    (folder / "applanix").mkdir()
    (folder / "applanix/lidar_poses.csv").write_text("\n".join(lines) + "\n")


def cloud_compare(scans: list[Scan]) -> None:
    poses(Path("survey/poses.txt"), [scan.T_world_sensor for scan in scans])
    Path("survey/scans").mkdir()
    for k, scan in enumerate(scans):
        rows = np.column_stack([own(scan), np.full(len(scan), 0.5)])
        np.savetxt(
            f"survey/scans/{k:03d}.txt", rows, "%.8f", header="//X Y Z Intensity", comments=""
        )


def point_labeler(scans: list[Scan]) -> None:
    names = [f"{k:06d}" for k in range(len(scans))]
    binary(Path("labelled/velodyne"), names, scans)
    poses(Path("labelled/poses.txt"), [scan.T_world_sensor for scan in scans])
    numbers = " ".join(f"{x:g}" for x in np.eye(4)[:3].ravel())
    Path("labelled/calib.txt").write_text("".join(f"{k}: {numbers}\n" for k in ("P0", "Tr")))
    Path("labelled/labels").mkdir()
    for name, scan in zip(names, scans, strict=True):
        assert scan.labels is not None
        moving = scan.labels == Label.DYNAMIC
        np.where(moving, 252, 50).astype("<u4").tofile(f"labelled/labels/{name}.label")


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
    "LIO-SAM, SC-LIO-SAM and SC-A-LOAM": lio_sam,
    "HBA": hba,
    "RKO-LIO": rko_lio,
    "HDMapping and MANDEYE": hdmapping,
    "lidar_slam_ros2": lidar_slam_ros2,
    "hdl_graph_slam and interactive_slam": hdl_graph_slam,
    "KITTI-360": kitti_360,
    "Boreas": boreas,
    "CloudCompare": cloud_compare,
    "point_labeler": point_labeler,
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
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", SECTIONS[recipe], re.M | re.S)
    for code in (text for language, text in blocks if language == "python"):
        exec(code, {})
    lines = [line for language, text in blocks if language == "sh" for line in text.splitlines()]
    for line in lines:  # what collects the files
        if line.startswith(("mkdir ", "for ")):
            subprocess.run(["bash", "-c", line], check=True)
    commands = [line for line in lines if line.startswith("dynaviz clean ")]
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
