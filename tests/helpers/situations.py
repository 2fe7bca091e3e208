"""Situations that people have, drawn at random from one small street with known truth.

``python -m helpers.situations [-n 3000] [-s 0]``, run in ``tests``, prints how often each kind was
read rightly, named, or not noticed.

A situation is a choice of names, pose file, type and world, which all programs may write, and at
most one fault. It must be read rightly, to 5 cm, or a finding or an error must name the fault.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.diagnosis import quick_check
from dynaviz.errors import DataError, DynavizError
from dynaviz.sources.datasets.pose_matching import parse_extrinsic
from dynaviz.spatial import geometry
from helpers.bags import START
from helpers.pose_files import quaternions
from helpers.street import Sweep, drive, pose

FRAMES = 36
NEAR = 0.05  # metres of error that a right map may have
RIGHT = "right"
NAMED = "named"
CANNOT_TELL = "cannot tell"
ELSE = "another finding"
SILENT = "silent"
UTM = np.array([388_421.0, 5_572_094.0, 120.0])

Poses = list[np.ndarray]
Clouds = list[np.ndarray]


@dataclass
class Files:
    """What is written.

    Attributes:
        clouds: (N, 3) float64 of each scan, as in its file; poses: (4, 4) of each.
        times: nanoseconds of the scans; pose_times: of the poses.
        options: with which the folder is opened.
    """

    clouds: Clouds
    poses: Poses
    times: list[int]
    pose_times: list[int]
    options: dict[str, str] = field(default_factory=dict)


Fault = Callable[[Files, np.random.Generator], None]


# --- names of scans: the text of a time or a number


def _number(width: int) -> Callable[[int, int], str]:
    return lambda k, t: f"{k:0{width}d}"


NAMES: dict[str, Callable[[int, int], str]] = {
    "number": _number(1),
    "six digits": _number(6),
    "ten digits": _number(10),
    "prefix": lambda k, t: f"scan_{k:04d}",
    "ns": lambda k, t: str(t),
    "us": lambda k, t: str(t // 1000),
    "s.ns": lambda k, t: f"{t // 10**9}.{t % 10**9:09d}",
    "s.ns without zeros": lambda k, t: f"{t // 10**9}.{t % 10**9}",
    "s_ns": lambda k, t: f"{t // 10**9}_{t % 10**9:09d}",
    "s_ns without zeros": lambda k, t: f"{t // 10**9}_{t % 10**9}",
    "since boot": lambda k, t: str(t - START + 9_412_345_678),
}
TIMED = ("ns", "us", "s.ns", "s.ns without zeros", "s_ns", "s_ns without zeros")


# --- pose files


def _rows(path: Path, rows: np.ndarray) -> None:
    np.savetxt(path, rows, fmt="%.9f")


def _kitti(folder: Path, files: Files) -> None:
    _rows(folder / "poses.txt", np.array([T[:3].ravel() for T in files.poses]))


def _matrix(folder: Path, files: Files) -> None:
    _rows(folder / "optimized_poses.txt", np.array([T.ravel() for T in files.poses]))


def _tum(order: tuple[int, ...]) -> Callable[[Path, Files], None]:
    def write(folder: Path, files: Files) -> None:
        table = quaternions(files.poses)[:, order]
        lines = [
            f"{t // 10**9}.{t % 10**9:09d} " + " ".join(f"{v:.9f}" for v in row)
            for t, row in zip(files.pose_times, table, strict=True)
        ]
        (folder / "way.tum").write_text("\n".join(lines) + "\n")

    return write


def _seven(order: tuple[int, ...], name: str) -> Callable[[Path, Files], None]:
    return lambda folder, files: _rows(folder / name, quaternions(files.poses)[:, order])


def _indexed(folder: Path, files: Files) -> None:
    rows = [f"{k} " + " ".join(f"{v:.9f}" for v in T[:3].ravel()) for k, T in _enumerate(files)]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")


def _csv(folder: Path, files: Files) -> None:
    lines = ["index,x,y,z,qx,qy,qz,qw"]
    for k, row in enumerate(quaternions(files.poses)):
        lines.append(f"{k}," + ",".join(f"{v:.9f}" for v in row))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")


def _enumerate(files: Files) -> Iterator[tuple[int, np.ndarray]]:
    return enumerate(files.poses)


X_FIRST = (0, 1, 2, 3, 4, 5, 6)
W_FIRST = (0, 1, 2, 6, 3, 4, 5)
POSES: dict[str, Callable[[Path, Files], None]] = {
    "KITTI": _kitti,
    "4x4": _matrix,
    "TUM": _tum(X_FIRST),
    "TUM with w first": _tum(W_FIRST),
    "seven columns": _seven(X_FIRST, "poses.txt"),
    "seven columns with w first": _seven(W_FIRST, "pose.json"),
    "13 columns": _indexed,
    "CSV": _csv,
}
BY_TIME = ("TUM", "TUM with w first")
BY_NUMBER = ("13 columns", "CSV")


# --- scans


def _write(folder: Path, suffix: str, names: list[str], clouds: Clouds, kind: str) -> None:
    from dynaviz.io.pcd import write_pcd

    folder.mkdir()
    for name, xyz in zip(names, clouds, strict=True):
        points = xyz.astype(kind)
        if suffix == ".pcd":
            write_pcd(folder / f"{name}.pcd", dict(zip("xyz", points.T, strict=True)), np.eye(4))
        elif suffix == ".npy":
            np.save(folder / f"{name}.npy", points)
        else:
            rows = np.column_stack([points, np.full(len(points), 0.3)])
            rows.astype("<f4").tofile(folder / f"{name}.bin")


SUFFIXES = (".pcd", ".npy", ".bin")


# --- faults; the words of an error or a finding that name each


def _changed(change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    def apply(files: Files, random: np.random.Generator) -> None:
        files.poses = [change(T) for T in files.poses]

    return apply


def _mount(*mounts: str) -> Fault:
    def apply(files: Files, random: np.random.Generator) -> None:
        T = parse_extrinsic(str(random.choice(mounts)))
        assert T is not None
        files.poses = [each @ geometry.inverse(T) for each in files.poses]

    return apply


def _metres(points: float, positions: float) -> Fault:
    def apply(files: Files, random: np.random.Generator) -> None:
        files.clouds = [xyz * points for xyz in files.clouds]
        files.poses = [np.vstack([_scaled(T, positions), T[3:]]) for T in files.poses]

    return apply


def _scaled(T: np.ndarray, factor: float) -> np.ndarray:
    return np.column_stack([T[:3, :3], T[:3, 3] * factor])


def _late(*seconds: float) -> Fault:
    def apply(files: Files, random: np.random.Generator) -> None:
        late = float(random.choice(seconds))
        moments = np.arange(-3.0 - abs(late), 7.0 + abs(late), 0.05).tolist()
        world = files.poses[0] @ geometry.inverse(drive(frames=FRAMES)[0].T)
        files.poses = [world @ pose(t) for t in moments]
        files.pose_times = [files.times[0] + round((t + late) * 1e9) for t in moments]

    return apply


def _clock(*seconds: float) -> Fault:
    def apply(files: Files, random: np.random.Generator) -> None:
        shift = float(random.choice(seconds))
        files.pose_times = [t + round(shift * 1e9) for t in files.times]

    return apply


def _relative(files: Files, random: np.random.Generator) -> None:
    files.pose_times = [t - files.times[0] + 10**9 for t in files.times]


def _reversed(files: Files, random: np.random.Generator) -> None:
    files.poses = files.poses[::-1]


def _shuffled(files: Files, random: np.random.Generator) -> None:
    blocks = np.arange(FRAMES).reshape(-1, 6)
    files.poses = [files.poses[k] for k in random.permuted(blocks, axis=1).ravel()]


def _another(files: Files, random: np.random.Generator) -> None:
    """Poses of another drive."""
    T = files.poses[0] @ geometry.inverse(drive(frames=FRAMES)[0].T)
    files.poses = [T @ pose(1.5 * k / 10 + 2.0, 3.0) for k in range(FRAMES)]


def _placed(files: Files, random: np.random.Generator) -> None:
    files.clouds = _in_world(files.clouds, files.poses)


def _said_world(files: Files, random: np.random.Generator) -> None:
    files.options["points_in"] = "world"


def _in_world(clouds: Clouds, poses: Poses) -> Clouds:
    return [geometry.apply(T, xyz) for T, xyz in zip(poses, clouds, strict=True)]


def _coarse(files: Files, random: np.random.Generator) -> None:
    """A map far away, in float32."""
    world = np.eye(4)
    world[:3, 3] = UTM
    files.poses = [world @ T for T in files.poses]
    files.clouds = [
        xyz.astype(np.float32).astype(float) for xyz in _in_world(files.clouds, files.poses)
    ]
    files.options["points_in"] = "world"


_OVER = np.diag([1.0, -1.0, -1.0, 1.0])
_NED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # T_lidar_camera


def _camera(T: np.ndarray) -> np.ndarray:
    return geometry.inverse(_CAMERA) @ T @ _CAMERA


@dataclass(frozen=True)
class Kind:
    """A fault.

    Attributes:
        apply: makes it; words: a pattern that names it, in a finding or an error.
        timed: whether it needs times in names and poses.
    """

    apply: Fault
    words: str
    timed: bool = False


FAULTS: dict[str, Kind] = {
    "mount": Kind(
        _mount("0,0,0,0,0,90", "0,0,0,0,0,-90", "0,0,0,0,0,180", "0.4,0,0.2,0,0,45"), "lidar mount"
    ),
    "mount upside down": Kind(
        _mount("0,0,0,180,0,0", "0.3,0,0,180,0,90"), "lidar mount|quaternion order|not z-up"
    ),
    "mount tilted": Kind(
        _mount("0,0,0,0,15,0", "0,0,0,0,-8,0", "0,0,0,10,0,0"), "lidar mount|tilt"
    ),
    "mount turned a little": Kind(_mount("0,0,0,0,0,2", "0,0,0,0,0,-4"), "lidar mount"),
    "lever arm": Kind(_mount("1.5,0.3,0,0,0,0", "-1.2,0,0.5,0,0,0"), "lidar mount"),
    "inverted": Kind(_changed(geometry.inverse), "poses inverted"),
    "camera axes": Kind(_changed(_camera), "poses of a camera"),
    "NED": Kind(_changed(lambda T: _NED @ T @ _OVER), "poses in NED"),
    "upside down world": Kind(_changed(lambda T: _OVER @ T), "not z-up|quaternion order|tilted"),
    "millimetres": Kind(_metres(1000.0, 1000.0), "metres"),
    "points in millimetres": Kind(_metres(1000.0, 1.0), "metres"),
    "points in centimetres": Kind(_metres(100.0, 1.0), "metres"),
    "positions in millimetres": Kind(_metres(1.0, 1000.0), "metres"),
    "late": Kind(_late(0.2, -0.1, 0.5, -0.4), "poses late", timed=True),
    "leap seconds": Kind(_late(18.0, -18.0), "poses late|leap", timed=True),
    "leap seconds apart": Kind(_clock(18.0, -18.0, 37.0), "clock|overlap in time", timed=True),
    "GPS time": Kind(_clock(-315_964_782.0), "clock|overlap in time", timed=True),
    "relative time": Kind(_relative, "clock|overlap in time", timed=True),
    "reversed": Kind(_reversed, "do not fit|out of order|inverted"),
    "shuffled": Kind(_shuffled, "do not fit|out of order"),
    "other drive": Kind(_another, "do not fit|drift"),
    "placed already": Kind(_placed, "points in world frame"),
    "said world": Kind(_said_world, "points in sensor frame"),
    "float32 far away": Kind(_coarse, "steps of"),
}
NOT_KNOWN = re.compile(r"do not fit|cannot tell")


@dataclass(frozen=True)
class Situation:
    """A choice by name.

    Attributes:
        fault: of ``FAULTS``; empty for none.
    """

    seed: int
    names: str
    poses: str
    suffix: str
    kind: str
    world: str
    fault: str

    @classmethod
    def drawn(cls, seed: int) -> Situation:
        """The situation of a seed: every third one has no fault."""
        random = np.random.default_rng(seed)
        faults = ["", *FAULTS]
        fault = "" if seed % 3 == 0 else faults[1 + (seed - seed // 3) % len(FAULTS)]
        names = str(random.choice([*NAMES]))
        poses = str(random.choice([*POSES]))
        if fault and FAULTS[fault].timed:
            names = str(random.choice(TIMED))
            poses = str(random.choice(BY_TIME))
        if poses in BY_NUMBER and names not in ("number", "six digits", "ten digits", "prefix"):
            poses = "KITTI"
        suffix = str(random.choice(SUFFIXES))
        world = str(random.choice(["near", "near", "turned", "far"]))
        if fault in ("float32 far away", "inverted", "millimetres", "positions in millimetres"):
            world = "turned"
        kind = "f8" if suffix == ".npy" and random.random() < 0.5 else "f4"
        return cls(seed, names, poses, suffix, kind, world, fault)

    def __str__(self) -> str:
        parts = [self.names, self.poses, self.suffix, self.kind, self.world]
        return f"{self.seed}: {', '.join(parts)}; fault: {self.fault or 'none'}"

    def write(self, folder: Path) -> Files:
        """Write the files."""
        random = np.random.default_rng((self.seed, 1))
        sweeps = drive(frames=FRAMES)
        world = world_of(self.world, random)
        start = START + 1_234_567 * int(random.integers(0, 700))
        times = [start + k * 100_000_000 for k in range(FRAMES)]
        files = Files(
            [sweep.points.astype(float) for sweep in sweeps],
            [world @ sweep.T for sweep in sweeps],
            times,
            list(times),
        )
        if self.fault:
            FAULTS[self.fault].apply(files, random)
        names = [NAMES[self.names](k, t) for k, t in enumerate(files.times)]
        _write(folder / "scans", self.suffix, names, files.clouds, self.kind)
        POSES[self.poses](folder, files)
        return files

    def outcome(self, check: bool = True) -> tuple[str, str]:
        """What becomes of it, and the words of the finding or error.

        Args:
            check: whether a correct situation must have no finding, which takes a second.
        """
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            files = self.write(Path(folder))
            try:
                sequence = dv.open(folder, **files.options)
                right = _is_right(sequence)
                if right and (self.fault or not check):
                    return RIGHT, ""
                found = quick_check(sequence)
            except DynavizError as error:
                return self._judged(str(error), isinstance(error, DataError))
            if not found:
                return (RIGHT if right else SILENT), ""
            words = "; ".join(map(str, found[:1]))
            return self._judged(words, not right)

    def _judged(self, words: str, wrong: bool) -> tuple[str, str]:
        if self.fault and wrong and re.search(FAULTS[self.fault].words, words):
            return NAMED, words
        return (CANNOT_TELL if wrong and NOT_KNOWN.search(words) else ELSE), words


def world_of(kind: str, random: np.random.Generator) -> np.ndarray:
    """(4, 4): where the street is."""
    T = np.eye(4)
    if kind == "near":
        return T
    T[:3, :3] = Rotation.from_euler("z", random.uniform(-np.pi, np.pi)).as_matrix()
    T[:3, 3] = UTM if kind == "far" else [*random.uniform(-40, 40, 2), random.uniform(-3, 3)]
    return T


@cache
def _truth() -> tuple[Sweep, ...]:
    return drive(frames=FRAMES)


def _is_right(sequence: dv.Sequence) -> bool:
    """Whether all points are where they were, up to one motion of the world that keeps it level."""
    sweeps = _truth()
    if len(sequence) != FRAMES:
        return False
    move = sweeps[0].T @ geometry.inverse(sequence[0].T_world_sensor)
    if move[2, 2] < 0.999:
        return False
    for position in range(0, FRAMES, 5):
        found = geometry.apply(move, sequence[position].points.astype(np.float64))
        if np.linalg.norm(found - sweeps[position].world, axis=1).max() > NEAR:
            return False
    return True


def _outcome(seed: int) -> tuple[Situation, str, str]:
    situation = Situation.drawn(seed)
    kind, words = situation.outcome()
    return situation, kind, words


def main() -> int:
    """Print the matrix of faults and outcomes; the exit code is 1 if a fault was silent."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-n", type=int, default=300, help="number of situations")
    parser.add_argument("-s", type=int, default=0, help="first seed")
    parser.add_argument("-j", type=int, default=2, help="processes")
    parser.add_argument("--fault", choices=["", *FAULTS], help="only situations with this fault")
    parser.add_argument("--show", action="store_true", help="list what is neither right nor named")
    arguments = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # one per process
    matrix: dict[str, Counter[str]] = defaultdict(Counter)
    with ProcessPoolExecutor(arguments.j) as pool:
        drawn = map(Situation.drawn, range(arguments.s, arguments.s + arguments.n))
        wanted = arguments.fault
        seeds = [each.seed for each in drawn if wanted is None or each.fault == wanted]
        for situation, kind, words in pool.map(_outcome, seeds, chunksize=4):
            matrix[situation.fault or "none"][kind] += 1
            if kind in (SILENT, ELSE) or (arguments.show and kind == CANNOT_TELL):
                print(f"{kind}: {situation}: {words[:220]}", flush=True)
    columns = (RIGHT, NAMED, CANNOT_TELL, ELSE, SILENT)
    print(f"{'fault':26}" + "".join(f"{column:>16}" for column in columns))
    for fault in ["none", *FAULTS]:
        row = matrix[fault]
        print(f"{fault:26}" + "".join(f"{row[column] or '':>16}" for column in columns))
    silent = sum(row[SILENT] for row in matrix.values())
    print(f"{sum(row.total() for row in matrix.values())} situations, {silent} silent")
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main())
