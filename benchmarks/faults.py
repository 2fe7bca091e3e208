"""Whether doctor and quick check name the faults of poses, frames and units alike, and whether
their advice helps.

    python benchmarks/faults.py [PART ...]

Two scenes of the simulator, a street as it is and a hall with motion during the sweep and jitter of
the poses, are written as files with one fault each: every order of quaternions, inverted poses,
axes of a camera, other units, and points in the other frame. Each fault is diagnosed by ``dynaviz
doctor`` and by the quick check of ``clean`` and ``run``; then the advice of the first finding is
followed, and the sequence is diagnosed again. With PART, only faults whose name contains it. Prints
a table, and how many faults are named, named alike, and without a finding at the end.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.diagnosis import Confidence, Finding, doctor, quick_check
from dynaviz.spatial import geometry

STREET = "simulate:street_vlp16", 0.0  # and degrees by which its world is turned
HALL = "simulate:hall_vlp16?sweep_s=0.1&jitter_m=0.03&jitter_deg=0.1", 50.0
STRIDES = {STREET: 4, HALL: 6}
FRAMES = 12
AXES = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # T_lidar_camera


@dataclass(frozen=True)
class Files:
    """The files of a sequence.

    Points in the frame that ``points_in`` states, and a pose for each scan.

    Attributes:
        points: (N, 3) float64 for each scan.
        poses: (4, 4) float64 each.
        points_in: the option with which they are read.
    """

    points: list[F64]
    poses: list[F64]
    points_in: str = "sensor"

    def posed(self, change: Callable[[F64], F64]) -> Files:
        """With other poses."""
        return replace(self, poses=[change(T) for T in self.poses])

    def scaled(self, points: float = 1.0, positions: float = 1.0) -> Files:
        """In other units."""
        poses = [
            geometry.pose(T[:3, 3] * positions, geometry.quaternion(T[:3, :3])) for T in self.poses
        ]
        return replace(self, points=[xyz * points for xyz in self.points], poses=poses)

    def open(self, folder: Path) -> dv.Sequence:
        """Write the files and open them."""
        for number, xyz in enumerate(self.points):
            np.save(folder / f"{number:06d}.npy", xyz.astype(np.float32))
        np.savetxt(folder / "poses.txt", [T[:3].ravel() for T in self.poses])
        return dv.open(f"files:{folder}", points_in=self.points_in)


@cache
def correct(scene: tuple[str, float], points_in: str) -> Files:
    """The scene without a fault."""
    path, degrees = scene
    stride = STRIDES[scene]
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    scans = list(dv.open(path, frames=f"4:{4 + FRAMES * stride}", stride=stride))
    sensors = [geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points) for scan in scans]
    poses = [turn @ scan.T_world_sensor for scan in scans]
    if points_in == "world":
        sensors = [geometry.apply(T, xyz) for T, xyz in zip(poses, sensors, strict=True)]
    return Files(sensors, poses, points_in)


def reordered(T: F64, order: tuple[int, ...]) -> F64:
    """The pose with its quaternion x y z w in another order."""
    return geometry.pose(
        T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat()[list(order)][[3, 0, 1, 2]]
    )


POSES: dict[str, tuple[str, Callable[[F64], F64]]] = {
    "inverted": ("poses inverted", np.linalg.inv),
    "camera": ("poses of a camera", lambda T: np.linalg.inv(AXES) @ T @ AXES),
    "camera's axes": ("poses of a camera", lambda T: T @ AXES),
}
ORDERS = {
    "quaternion " + " ".join("xyzw"[k] for k in order): (
        "quaternion order",
        partial(reordered, order=order),
    )
    for order in permutations(range(4))
    if order != (0, 1, 2, 3)
}
USUAL = {name: ORDERS[name] for name in ("quaternion w x y z", "quaternion y z w x")}
UNITS = {"millimetres": 1000.0, "centimetres": 100.0}


def cases() -> Iterator[tuple[str, str, Files]]:
    """Name, expected finding and files of each fault."""
    for scene in (STREET, HALL):
        where = scene[0].split(":")[1].split("_")[0]
        own = correct(scene, "sensor")
        world = correct(scene, "world")
        for k, (name, (finding, change)) in enumerate(ORDERS.items()):
            if name == "quaternion y x z w":
                continue  # hardly turns a sensor that turns about z
            if k % 2 == (scene is HALL) or name in USUAL:
                yield f"{where}: {name}", finding, own.posed(change)
        for name, (finding, change) in {**POSES, **USUAL}.items():
            if name not in USUAL:
                yield f"{where}: {name}", finding, own.posed(change)
            yield f"{where}: {name}, points in the world", finding, world.posed(change)
        yield (
            f"{where}: world points read as the sensor's",
            "points in world frame",
            replace(world, points_in="sensor"),
        )
        yield (
            f"{where}: sensor points read as the world's",
            "points in sensor frame",
            replace(own, points_in="world"),
        )
        for unit, factor in UNITS.items():
            yield f"{where}: points in {unit}", unit, own.scaled(points=factor)
            yield f"{where}: positions in {unit}", unit, own.scaled(positions=factor)
            yield f"{where}: everything in {unit}", unit, world.scaled(factor, factor)


def followed(files: Files, finding: Finding) -> Files:
    """The files after the advice of a finding was followed, as its text states it."""
    fix = finding.fix
    if "--points-in" in finding.option:
        return replace(files, points_in=finding.option.split()[1])
    if finding.name == "poses inverted":
        return files.posed(np.linalg.inv)
    if finding.name == "poses of a camera":
        return files.posed(lambda T: (AXES @ T if "both sides" in fix else T) @ np.linalg.inv(AXES))
    if found := re.search(r"hold (q[wxyz] q[wxyz] q[wxyz] q[wxyz])", fix):
        names = found[1].split()
        order = tuple(names.index(name) for name in ("qx", "qy", "qz", "qw"))
        return files.posed(partial(reordered, order=order))
    if found := re.search(r"divide (.*) by (\d+)", fix):
        factor = 1 / float(found[2])
        return files.scaled(
            factor if "points" in found[1] else 1.0, factor if "positions" in found[1] else 1.0
        )
    if found := re.search(r"R = (\[.*\]), write", fix):
        turn = np.eye(4)
        turn[:3, :3] = json.loads(found[1])
        turned = files.posed(lambda T: turn @ T)
        return (
            turned
            if files.points_in == "sensor"
            else replace(turned, points=[geometry.apply(turn, xyz) for xyz in files.points])
        )
    return files


def likely(sequence: dv.Sequence) -> list[Finding]:
    """The findings of the doctor on poses, frames and units that are certain or likely."""
    return [
        finding for finding in doctor(sequence).of_poses if finding.confidence <= Confidence.LIKELY
    ]


def main() -> int:
    """Print a row for each fault."""
    parts = sys.argv[1:]
    rows = []
    print(
        "| fault | named | by the quick check | after following the advice | doctor s | quick s |"
    )
    print("|---|---|---|---|---|---|")
    for name, expected, files in cases():
        if parts and not any(part in name for part in parts):
            continue
        with tempfile.TemporaryDirectory() as folder:
            sequence = files.open(Path(folder))
            start = time.process_time()
            found = likely(sequence)
            middle = time.process_time()
            quick = [each.name for each in quick_check(sequence)]
            end = time.process_time()
            after = likely(followed(files, found[0]).open(Path(folder))) if found else []
        named = [each.name for each in found]
        rows.append(
            (named == [expected], named == quick and bool(named), bool(named) and not after)
        )
        left = ", ".join(each.name for each in after)
        words = f"{', '.join(named) or '-'} | {', '.join(quick) or '-'} | {left or '-'}"
        print(f"| {name} | {words} | {middle - start:.1f} | {end - middle:.1f} |", flush=True)
    right, alike, clean = (sum(column) for column in zip(*rows, strict=True))
    print(
        f"\n{len(rows)} faults: {right} named rightly, {alike} alike by both, {clean} without a "
        "finding at the end"
    )
    return int(min(right, alike, clean) < len(rows))


if __name__ == "__main__":
    sys.exit(main())
