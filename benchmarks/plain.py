"""Speed of the methods compared with plain implementations of the same steps, and whether the
results agree.

    python benchmarks/plain.py                      on a generated street
    python benchmarks/plain.py --folder FOLDER      on pcd/*.pcd of a folder in the benchmark's
        layout
    python benchmarks/plain.py --methods dufomap    some methods

OctoMap is compared with a single-threaded numba loop that walks a dense grid in double precision;
Removert, ERASOR and Dynablox with numpy; DUFOMap with the public implementation, if it is installed
(pip install dufomap). All run in one process on the same few frames, after a first round that
compiles. The fastest of three rounds is used.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from scenes import SENSOR, read, street

from dynaviz import kernels
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Scan
from dynaviz_methods.dufomap.method import DufoMap
from dynaviz_methods.dynablox.method import Dynablox, DynabloxParams
from dynaviz_methods.erasor.method import Erasor, ErasorParams
from dynaviz_methods.octomap.method import OctoMap
from dynaviz_methods.removert.method import Removert
from dynaviz_methods.shared.range_images import image_views, slices
from dynaviz_methods.shared.tiles import thinned
from methods import run

ROUNDS = 3
FRAMES = 6
Answer = tuple[float, np.ndarray]  # seconds per frame, and the result


def fastest(call: Callable[[], Answer]) -> Answer:
    """The fastest of some rounds."""
    return min((call() for _ in range(ROUNDS)), key=lambda answer: answer[0])


def ours(running: Any, scans: list[Scan], raw_map: np.ndarray | None = None) -> Answer:
    """Seconds per frame without ``begin``, and all labels."""
    _, observe, label, labels = run(
        running, scans, Context(Extent.of(*scans), SENSOR, raw_map=raw_map)
    )
    return observe + label, labels


def octomap(scans: list[Scan]) -> tuple[str, Answer, Answer]:
    """OctoMap and the walk through a dense grid."""
    plain = fastest(lambda: dense_octomap(scans, 0.1))
    return "a plain walk", plain, fastest(lambda: ours(OctoMap(OctoMap.Params()), scans))


@njit(cache=True)
def plain_walk(
    points, origin, per_metre, low, shape, stamps, stamp, odds, miss, hit, least, most, touched
):
    """Visit every voxel of every ray in a dense grid, then update.

    Bit 1 of a stamp is free, bit 2 is occupied.
    """
    n = 0
    for p in range(len(points)):
        o, d, k, goal, step, t, dt = np.empty((7, 3))
        for a in range(3):
            o[a] = origin[a] * per_metre
            d[a] = points[p, a] * per_metre - o[a]
            k[a] = math.floor(o[a])
            goal[a] = math.floor(points[p, a] * per_metre)
            step[a] = 1.0 if d[a] > 0 else -1.0
            t[a] = (k[a] + (d[a] > 0) - o[a]) / d[a] if k[a] != goal[a] else np.inf
            dt[a] = 1.0 / abs(d[a]) if d[a] != 0.0 else np.inf
        while True:
            v = (int(k[0] - low[0]) * shape[1] + int(k[1] - low[1])) * shape[2] + int(k[2] - low[2])
            end = k[0] == goal[0] and k[1] == goal[1] and k[2] == goal[2]
            if stamps[v] >> 2 != stamp:
                stamps[v] = stamp << 2
                touched[n] = v
                n += 1
            stamps[v] |= 2 if end else 1
            if end:
                break
            a = 0 if t[0] < t[1] and t[0] < t[2] else (1 if t[1] < t[2] else 2)
            k[a] += step[a]
            t[a] = t[a] + dt[a] if k[a] != goal[a] else np.inf
    for i in range(n):
        v = touched[i]
        if stamps[v] & 1:
            odds[v] = max(odds[v] + miss, least)
        if stamps[v] & 2:
            odds[v] = min(odds[v] + hit, most)


def dense_octomap(
    scans: list[Scan], resolution: float, clock: Callable[[], float] = time.perf_counter
) -> Answer:
    """Seconds per frame, and the labels."""
    per_metre = 1.0 / resolution
    extent = Extent.of(*scans)
    low = np.floor(extent.low * per_metre).astype(np.int64) - 1
    shape = np.floor(extent.high * per_metre).astype(np.int64) + 2 - low
    size = int(np.prod(shape))
    stamps = np.zeros(size, np.uint16)
    odds = np.zeros(size, np.float32)
    touched = np.empty(size, np.int64)
    logits = [np.float32(math.log(p / (1 - p))) for p in (0.4, 0.7, 0.12, 0.97)]
    seconds = []
    for stamp, scan in enumerate(scans, 1):
        start = clock()
        plain_walk(
            scan.points, scan.position, per_metre, low, shape, stamps, stamp, odds, *logits, touched
        )
        seconds.append(clock() - start)
    keys = (
        np.floor(scan.points.astype(np.float64) * per_metre).astype(np.int64) - low
        for scan in scans
    )
    return float(np.mean(seconds)), np.concatenate(
        [odds[np.ravel_multi_index(k.T, shape)] < 0 for k in keys]
    )


def removert(scans: list[Scan]) -> tuple[str, Answer, Answer]:
    """Removert's comparison of scans and map, and the same in numpy."""
    raw_map = np.concatenate([scan.points for scan in scans])
    points, _ = thinned(raw_map, 0.05)

    def method_result() -> Answer:
        method = Removert(Removert.Params())
        observe = run(method, scans, Context(Extent.of(scans[0]), SENSOR, raw_map=raw_map))[1]
        return observe, method._past[:-1] > 0

    return "numpy", fastest(lambda: numpy_removert(scans, points)), fastest(method_result)


def numpy_removert(scans: list[Scan], points: np.ndarray) -> Answer:
    """Seconds per frame in numpy, and which map points the scans see through."""
    params = Removert.Params()
    views = image_views(params.resolutions, SENSOR.elevation or (), SENSOR.azimuth)

    def project(xyz: np.ndarray, scan: Scan, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = ((xyz - scan.position) @ scan.T_world_sensor[:3, :3]).T
        row = np.round(view[2] - np.arctan2(z, np.hypot(x, y)) * view[3])
        column = np.minimum(np.round(view[4] + np.arctan2(y, x) * view[5]), view[1] - 1)
        inside = (row >= 0) & (row <= view[0])
        pixel = np.where(inside, np.minimum(row, view[0] - 1) * view[1] + column, -1).astype(int)
        return pixel, np.sqrt(x * x + y * y + z * z)

    past = np.zeros(len(points), bool)
    start = time.perf_counter()
    for scan in scans:
        for view, pixels in zip(views, slices(views), strict=True):
            # the last pixel is for points out of view
            image = np.zeros(pixels.stop - pixels.start + 1)
            pixel, ranges = project(scan.points, scan, view)
            farthest_first = np.argsort(-ranges)
            image[pixel[farthest_first]] = ranges[farthest_first]
            image[-1] = 0
            pixel, ranges = project(points, scan, view)
            past |= ranges < image[pixel] * (1 - params.threshold)
    return (time.perf_counter() - start) / len(scans), past


def erasor(scans: list[Scan]) -> tuple[str, Answer, Answer]:
    """ERASOR on every scan, with a map of all scans, and the same in numpy."""
    params = dataclasses.replace(Erasor.Params(), removal_interval=1)
    raw_map = np.concatenate([s.points for s in scans])
    plain = fastest(lambda: numpy_erasor(params, scans, raw_map))
    return "numpy", plain, fastest(lambda: ours(Erasor(params), scans, raw_map))


def numpy_erasor(params: ErasorParams, scans: list[Scan], raw_map: np.ndarray) -> Answer:
    """Seconds per scan in numpy, without downsampling the map; and which raw points are removed."""
    points, voxels = thinned(raw_map, params.map_voxel)
    points = points.astype(float)
    n = params.rings * params.sectors
    alive = np.ones(len(points), bool)
    start = time.perf_counter()

    def bins(xyz: np.ndarray) -> np.ndarray:
        reach = np.hypot(xyz[:, 0], xyz[:, 1])
        ring = (reach * params.rings / params.max_range).astype(int)
        sector = (np.arctan2(xyz[:, 1], xyz[:, 0]) / (2 * np.pi) % 1 * params.sectors).astype(int)
        inside = (
            (reach < params.max_range)
            & (xyz[:, 2] > params.min_height)
            & (xyz[:, 2] < params.max_height)
        )
        return np.where(inside, ring * params.sectors + sector, n)

    def heights(z: np.ndarray, b: np.ndarray) -> np.ndarray:
        low = np.full(n + 1, np.inf)
        high = np.full(n + 1, -np.inf)
        np.minimum.at(low, b, z)
        np.maximum.at(high, b, z)
        return np.where(high >= low, high - low, np.nan)[:n]

    for scan in scans:
        foot = scan.position - (0, 0, SENSOR.height)
        query = thinned(scan.points, params.query_voxel)[0] - foot
        here = points - foot
        of_scan = bins(query)
        of_map = np.where(alive, bins(here), n)
        low = heights(query[:, 2], of_scan)
        high = heights(here[:, 2], of_map)
        with np.errstate(invalid="ignore"):
            flagged = (low / high < params.scan_ratio) & (high > params.min_difference)
        flagged &= np.bincount(of_scan, minlength=n + 1)[:n] >= params.min_points
        chosen = np.flatnonzero(np.append(flagged, False)[of_map])
        chosen = chosen[np.argsort(of_map[chosen], kind="stable")]
        for rows in np.split(chosen, np.flatnonzero(np.diff(of_map[chosen])) + 1):
            alive[rows[~ground(params, here[rows])]] = False
    return (time.perf_counter() - start) / len(scans), ~alive[voxels]


def ground(params: ErasorParams, points: np.ndarray) -> np.ndarray:
    """R-GPF with LAPACK: (N,) bool, ground points."""
    lowest = np.sort(points[:, 2])[params.ground_skip :][: params.ground_lowest]
    chosen = points[:, 2] < (lowest.mean() if len(lowest) else 0) + params.ground_seed
    for _ in range(params.ground_iterations):
        if not chosen.any():
            break
        centre = points[chosen].mean(0)
        centred = points[chosen] - centre
        normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        chosen = (points - centre) @ normal * (-1 if normal[2] < 0 else 1) < params.ground_distance
    return chosen


def dynablox(scans: list[Scan]) -> tuple[str, Answer, Answer]:
    """All of Dynablox, and only its distances in numpy."""
    params = Dynablox.Params()
    method = Dynablox(params)
    ours(method, scans)
    space = method._map
    plain = fastest(lambda: numpy_distances(params, space, scans))
    first = (space._first[np.flatnonzero(space._inner)][:, None] + np.arange(512)).ravel()
    same = np.abs(space._distance[first] - plain[1]) < 1e-4
    seconds, _ = fastest(lambda: ours(Dynablox(params), scans))
    return "numpy, only the distances,", (plain[0], same), (seconds, np.ones(len(same), bool))


def numpy_distances(p: DynabloxParams, space: Any, scans: list[Scan]) -> Answer:
    """Seconds per frame in numpy for the distances of all voxels that can contain points, and the
    distances.
    """
    blocks = np.flatnonzero(space._inner)
    voxels = (512 * blocks[:, None] + np.arange(512)).ravel()
    centres = (space.grid.keys(voxels) + 0.5) * p.resolution
    distance = np.zeros(len(voxels), np.float32)
    weight = np.zeros(len(voxels), np.float32)
    rows, columns, top, per_row, per_column = space._view.numbers
    start = time.perf_counter()

    def pixels(xyz: np.ndarray, scan: Scan) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = ((xyz - scan.position) @ scan.T_world_sensor[:3, :3]).T
        row = np.floor((top - np.arctan2(z, np.hypot(x, y))) * per_row + 0.5)
        column = np.floor((np.arctan2(y, x) + np.pi) * per_column + 0.5) % columns
        inside = (row >= 0) & (row < rows)
        return np.where(inside, row * columns + column, rows * columns).astype(int), np.sqrt(
            x * x + y * y + z * z
        )

    for scan in scans:
        image = np.full(int(rows * columns) + 1, np.inf)
        at, ranges = pixels(scan.points, scan)
        np.minimum.at(image, at, np.where(ranges < p.min_range, np.inf, ranges))
        image[-1] = np.inf
        at, ranges = pixels(centres, scan)
        behind = image[at] - ranges
        seen = np.flatnonzero(np.isfinite(behind) & (behind >= -p.truncation))
        total = distance[seen] * weight[seen] + np.minimum(behind[seen], p.truncation)
        weight[seen] += 1
        distance[seen] = total / weight[seen]
    return (time.perf_counter() - start) / len(scans), distance


def dufomap(scans: list[Scan]) -> tuple[str, Answer, Answer]:
    """DUFOMap and the public implementation."""
    params = DufoMap.Params(max_range=50.0)
    plain = fastest(lambda: public_dufomap(scans, kernels.set_threads(None)))
    return "the public implementation", plain, fastest(lambda: ours(DufoMap(params), scans))


def public_dufomap(
    scans: list[Scan], threads: int, clock: Callable[[], float] = time.perf_counter
) -> Answer:
    """Seconds per frame of the public implementation with the range limits of its example, and its
    labels.
    """
    program = importlib.import_module("dufomap").dufomap(0.1, 0.2, 1, threads)
    near = [
        np.linalg.norm(scan.points - scan.position.astype(np.float32), axis=1) for scan in scans
    ]
    chosen = [scan.points[(r > 0.2) & (r < 50)] for scan, r in zip(scans, near, strict=True)]
    start = clock()
    for scan, points in zip(scans, chosen, strict=True):
        program.run(points, scan.T_world_sensor, False)
    labels = [program.segment(scan.points, scan.T_world_sensor, False) for scan in scans]
    return (clock() - start) / len(scans), np.concatenate(labels) > 0


COMPARED = {call.__name__: call for call in (octomap, removert, erasor, dynablox, dufomap)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="*", default=list(COMPARED), choices=COMPARED)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--frames", type=int, default=FRAMES)
    arguments = parser.parse_args()
    scans = (
        read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames)
    )
    print(
        f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; "
        f"{kernels.set_threads(None)} threads"
    )
    for name in arguments.methods:
        try:
            COMPARED[name](scans[:2])  # compile
        except ImportError as error:
            print(f"{name}: {error}")
            continue
        reference, (plain, expected), (seconds, answer) = COMPARED[name](scans)
        same = 100 * np.mean(expected == answer[: len(expected)])
        print(
            f"{name:9} {1000 * seconds:8.1f} ms per frame; {reference} {1000 * plain:.1f} ms",
            end="",
            flush=True,
        )
        print(f", {plain / seconds:.1f} times as long; {same:.4f} % identical", flush=True)


if __name__ == "__main__":
    main()
