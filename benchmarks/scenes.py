"""Input of the benchmarks.

A generated street of any length with 120 000 points per frame, or scans of a folder.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.io.pcd import read_pcd

SENSOR = load_sensor("hdl64e")
KINDS = ("points", "T_world_sensor", "labels")
# metres after which the street repeats, and scans in that distance
BLOCK = 18.0
SCANS = 24


def arguments_parser(
    description: str | None, frames: int, methods: str = "*"
) -> argparse.ArgumentParser:
    """The arguments of a benchmark of methods.

    Which, with which preset, and on how many frames of which folder.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("methods", nargs=methods)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--frames", type=int, default=frames)
    parser.add_argument("--preset")
    return parser


def street(frames: int, azimuths: int = 1900, step: float = 0.8) -> list[Scan]:
    """A sensor with 64 rings drives ``step`` metres per frame between house fronts, parked boxes
    and 3 moving boxes.
    """
    random = np.random.default_rng(0)
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, azimuths), np.radians(np.linspace(-24.8, 8.0, 64))
    )
    planar = np.cos(elevation)
    direction = np.stack(
        [planar * np.cos(azimuth), planar * np.sin(azimuth), np.sin(elevation)], -1
    ).reshape(-1, 3)
    parked = [(x, y, 0.8) for x in range(-60, 160, 9) for y in (-5.0, 5.5)]
    scans = []
    for index in range(frames):
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = origin = step * index, 0.1 * math.sin(index), 1.73
        driving = [
            (15 + 1.5 * index, -2.0, 0.8),
            (-30 + 2.0 * index, 2.0, 0.8),
            (120 - index, 2.5, 0.8),
        ]
        with np.errstate(divide="ignore"):
            inverse = 1.0 / direction
        reach = np.full(len(direction), 80.0)
        down = direction[:, 2] < 0
        level = direction[:, 1] != 0
        reach[down] = np.minimum(reach[down], -origin[2] * inverse[down, 2])
        front = np.where(direction[:, 1] > 0, 11.0 - origin[1], -9.0 - origin[1]) * inverse[:, 1]
        reach[level] = np.minimum(reach, front)[level]
        moving = np.zeros(len(direction), np.uint8)
        for centre in parked + driving:
            corner = np.array([2.0, 0.9, 0.8])
            near, far = np.sort(
                [(centre + side * corner - origin) * inverse for side in (-1, 1)], 0
            )
            enter = near.max(1)
            first = (enter > 0) & (enter < far.min(1)) & (enter < reach)
            reach = np.where(first, enter, reach)
            moving = np.where(first, centre in driving, moving)
        seen = reach < 80.0
        points = origin + direction[seen] * (reach + random.normal(0, 0.02, len(reach)))[seen, None]
        labels = moving[seen].astype(np.uint8)
        scans.append(Scan(index, points.astype(np.float32), T_world_sensor, labels=labels))
    return scans


@dataclass(frozen=True)
class Drive:
    """A drive of any length in the memory of one block.

    Its scans repeat, each time ``block_length`` metres farther.
    """

    block: list[Scan]
    frames: int
    block_length: float = BLOCK
    name: str = "drive"
    sensor: Sensor = SENSOR
    has_labels: bool = True

    @staticmethod
    def of(points: int, frames: int, folder: Path) -> Drive:
        """A drive with about this many points per frame.

        The block is stored in a file in the folder.
        """
        path = folder / f"block{points}.npz"
        if not path.exists():
            block = street(SCANS, round(points / 120_000 * 1915), BLOCK / SCANS)
            arrays = {
                f"{kind}{scan.index}": getattr(scan, kind) for scan in block for kind in KINDS
            }
            np.savez(path, **arrays)
        with np.load(path) as stored:
            return Drive(
                [
                    Scan(index, **{kind: stored[f"{kind}{index}"] for kind in KINDS})
                    for index in range(SCANS)
                ],
                frames,
            )

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[Scan]:
        return map(self.__getitem__, range(self.frames))

    def __getitem__(self, position: int) -> Scan:
        times, place = divmod(position, len(self.block))
        scan = self.block[place]
        pose = self.block[place].T_world_sensor.copy()
        pose[0, 3] += (shift := times * self.block_length)
        points = scan.points + np.float32([shift, 0, 0])
        return replace(scan, index=position, points=points, T_world_sensor=pose, origins=None)


def read(folder: Path, frames: int | None) -> list[Scan]:
    clouds = (read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))[:frames])
    return [Scan(index, cloud.xyz, cloud.T_world_sensor) for index, cloud in enumerate(clouds)]
