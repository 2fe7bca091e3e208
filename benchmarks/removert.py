"""Seconds a frame of Removert, step by step, and their ratio to the same comparison in plain numpy.

    python benchmarks/removert.py                      a street of 120 000 points a frame, made here
    python benchmarks/removert.py FOLDER               the pcd/*.pcd of a folder in the benchmark's layout
    python benchmarks/removert.py FOLDER --frames 30

Everything is measured in one process, after a first round that compiles. numpy runs on the first frames only, against
the whole map.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from octomap import read, street, timed

from dynaviz import kernels
from dynaviz.method import Context
from dynaviz.params import resolve
from dynaviz.scan import Scan
from dynaviz.sensors import load_sensor
from dynaviz.survey import Extent
from dynaviz_methods.range_images import image_views, slices
from dynaviz_methods.removert import Removert, RemovertParams
from dynaviz_methods.tiles import thinned

SENSOR = load_sensor("hdl64e")
VARIANTS = {
    "default": RemovertParams(),
    "revert": RemovertParams(revert_resolutions=(2.09,)),
    "port": resolve(Removert, preset="port").params,
}
PLAIN_FRAMES = 3


def run(params: RemovertParams, scans: list[Scan], raw_map: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Seconds to begin, seconds of each frame to observe and to label, all labels, and processor seconds a frame."""
    method = Removert(params)
    start = time.perf_counter()
    method.begin(Context(Extent.of(scans[0]), SENSOR, raw_map=raw_map))
    begun, busy = time.perf_counter() - start, time.process_time()
    observed, labelled, labels = [], [], []
    observe = timed(method.observe, observed)
    label = timed(method.label, labelled)
    for scan in scans:
        observe(scan)
    for scan in scans:
        labels.append(label(scan))
    busy = (time.process_time() - busy) / len(scans)
    return begun, np.array([observed, labelled]), np.concatenate(labels), busy


def plain(scans: list[Scan], points: np.ndarray) -> tuple[float, np.ndarray]:
    """Seconds a frame in numpy, and which of the map's points scans look past."""
    params = VARIANTS["default"]
    views = image_views(params.resolutions, SENSOR.elevation or (), SENSOR.azimuth)

    def project(xyz: np.ndarray, scan: Scan, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = ((xyz - scan.position) @ scan.T_world_sensor[:3, :3]).T
        row = np.round(view[2] - np.arctan2(z, np.hypot(x, y)) * view[3])
        column = np.minimum(np.round(view[4] + np.arctan2(y, x) * view[5]), view[1] - 1)
        inside = (row >= 0) & (row <= view[0])
        pixel = np.where(inside, np.minimum(row, view[0] - 1) * view[1] + column, -1).astype(int)
        return pixel, np.sqrt(x * x + y * y + z * z)

    past, start = np.zeros(len(points), bool), time.perf_counter()
    for scan in scans:
        for view, pixels in zip(views, slices(views), strict=True):
            image = np.zeros(pixels.stop - pixels.start + 1)  # the last pixel takes what is out of view
            pixel, ranges = project(scan.points, scan, view)
            farthest_first = np.argsort(-ranges)
            image[pixel[farthest_first]] = ranges[farthest_first]
            image[-1] = 0
            pixel, ranges = project(points, scan, view)
            past |= ranges < image[pixel] * (1 - params.threshold)
    return (time.perf_counter() - start) / len(scans), past


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    scans = read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames or 60)
    raw_map = np.concatenate([scan.points for scan in scans])
    points, _ = thinned(raw_map, 0.05)
    print(f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; {kernels.set_threads(None)} threads")
    print(f"raw map {len(raw_map) / 1e6:.1f} M points, map of 0.05 m cells {len(points) / 1e6:.1f} M")

    for params in VARIANTS.values():  # compile
        run(params, scans[:1], scans[0].points)
    profile: defaultdict[str, list[float]] = defaultdict(list)
    for name in ("nearest", "judge"):
        call = getattr(kernels.range_image, name)
        setattr(kernels.range_image, name, timed(call, profile[name]))
    for name, params in VARIANTS.items():
        for spent in profile.values():
            spent.clear()
        begun, (observed, labelled), labels, _ = run(params, scans, raw_map)
        print(f"\n{name}: {observed.mean() + labelled.mean():.4f} s a frame, fastest {(observed + labelled).min():.4f}")
        print(f"  before the first frame {begun:.2f} s; observe {observed.mean():.4f}, label {labelled.mean():.4f}")
        for step, spent in profile.items():
            if spent:
                print(f"  {step:8} {1000 * sum(spent) / len(scans):7.2f} ms")
        kernels.set_threads(1)
        _, (alone, _), same, busy = run(params, scans, raw_map)
        kernels.set_threads(None)
        slower, equal = alone.mean() / observed.mean(), (same == labels).all()
        print(f"  on one thread {slower:.2f} times as long, {busy:.4f} s of its core's time; same labels: {equal}")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"  peak memory so far {peak:.0f} MB, all scans and the raw map included")

    few = scans[:PLAIN_FRAMES]
    seconds, expected = plain(few, points)
    method = Removert(VARIANTS["default"])
    method.begin(Context(Extent.of(few[0]), SENSOR, raw_map=raw_map))
    start = time.perf_counter()
    for scan in few:
        method.observe(scan)
    ours = (time.perf_counter() - start) / len(few)
    same = (method._past[:-1] > 0) == expected
    print(f"\nnumpy: {seconds:.3f} s a frame; removert on the same: {ours:.4f} s, {seconds / ours:.1f} times faster")
    print(f"same answer: {100 * same.mean():.5f} % of map points")

    sided = run(RemovertParams(scan_neighbours=2), few, np.concatenate([scan.points for scan in few]))[1]
    print(f"with the step on the scan's side, {len(few)} frames: label {sided[1].mean():.3f} s a frame")


if __name__ == "__main__":
    main()
