"""Seconds a frame of ERASOR, step by step, and their ratio to the same comparison in plain numpy.

    python benchmarks/erasor.py                      141 frames of a street, 120 000 points each, made here
    python benchmarks/erasor.py FOLDER               the pcd/*.pcd of a folder in the benchmark's layout
    python benchmarks/erasor.py FOLDER --frames 30

Everything is measured in one process, after a first round that compiles. numpy runs on the first scans and
looks at the whole map each time.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from octomap import read, street, timed

from dynaviz import kernels
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.sensors import load_sensor
from dynaviz.survey import Extent
from dynaviz_methods.erasor import Erasor, ErasorParams
from dynaviz_methods.tiles import thinned

SENSOR = load_sensor("hdl64e")
STEPS = {
    "thin the scan: number": ("centroids", "number"),
    "thin the scan: means": ("centroids", "means"),
    "bins": ("polar", "locate"),
    "heights": ("polar", "heights"),
    "ground": ("region_ground", "fit"),
}
VARIANTS = {
    "default": ErasorParams(),
    "every point": ErasorParams(map_voxel=0.0, query_voxel=0.0),
    "port": ErasorParams(port=True),
}
PLAIN_SCANS = 3


PROFILE: defaultdict[str, list[float]] = defaultdict(list)


def run(params: ErasorParams, scans: list[Scan], raw_map: np.ndarray) -> tuple[float, np.ndarray, float, np.ndarray]:
    """Seconds to begin, of each frame to observe, of one to label, and all labels."""
    method = Erasor(params)
    start = time.perf_counter()
    method.begin(Context(Extent.of(scans[0]), SENSOR, raw_map=raw_map))
    begun = time.perf_counter() - start
    for spent in PROFILE.values():
        spent.clear()
    observed: list[float] = []
    observe = timed(method.observe, observed)
    for scan in scans:
        observe(scan)
    start = time.perf_counter()
    labels = np.concatenate([method.label(scan) for scan in scans])
    return begun, np.array(observed), (time.perf_counter() - start) / len(scans), labels


def plain(params: ErasorParams, scans: list[Scan], raw_map: np.ndarray) -> tuple[float, np.ndarray]:
    """Seconds a scan in numpy, the map thinned beforehand; and which raw points go."""
    points, voxels = thinned(raw_map, params.map_voxel)
    points, n = points.astype(float), params.rings * params.sectors
    alive, start = np.ones(len(points), bool), time.perf_counter()

    def bins(xyz: np.ndarray) -> np.ndarray:
        reach = np.hypot(xyz[:, 0], xyz[:, 1])
        ring = (reach * params.rings / params.max_range).astype(int)
        sector = (np.arctan2(xyz[:, 1], xyz[:, 0]) / (2 * np.pi) % 1 * params.sectors).astype(int)
        inside = (reach < params.max_range) & (xyz[:, 2] > params.min_height) & (xyz[:, 2] < params.max_height)
        return np.where(inside, ring * params.sectors + sector, n)

    def heights(z: np.ndarray, b: np.ndarray) -> np.ndarray:
        low, high = np.full(n + 1, np.inf), np.full(n + 1, -np.inf)
        np.minimum.at(low, b, z)
        np.maximum.at(high, b, z)
        return np.where(high >= low, high - low, np.nan)[:n]

    for scan in scans:
        foot = scan.position - (0, 0, SENSOR.height)
        query, here = thinned(scan.points, params.query_voxel)[0] - foot, points - foot
        of_scan, of_map = bins(query), np.where(alive, bins(here), n)
        low, high = heights(query[:, 2], of_scan), heights(here[:, 2], of_map)
        with np.errstate(invalid="ignore"):
            flagged = (low / high < params.scan_ratio) & (high > params.min_difference)
        flagged &= np.bincount(of_scan, minlength=n + 1)[:n] >= params.min_points
        chosen = np.flatnonzero(np.append(flagged, False)[of_map])
        chosen = chosen[np.argsort(of_map[chosen], kind="stable")]
        for rows in np.split(chosen, np.flatnonzero(np.diff(of_map[chosen])) + 1):
            alive[rows[~ground(params, here[rows])]] = False
    return (time.perf_counter() - start) / len(scans), ~alive[voxels]


def ground(params: ErasorParams, points: np.ndarray) -> np.ndarray:
    """R-GPF with LAPACK."""
    lowest = np.sort(points[:, 2])[params.ground_skip :][: params.ground_lowest]
    chosen = points[:, 2] < (lowest.mean() if len(lowest) else 0) + params.ground_seed
    for _ in range(params.ground_iterations):
        if not chosen.any():
            break
        centre = points[chosen].mean(0)
        away = points[chosen] - centre
        normal = np.linalg.eigh(away.T @ away)[1][:, 0]
        chosen = (points - centre) @ normal * (-1 if normal[2] < 0 else 1) < params.ground_distance
    return chosen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    scans = read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames or 141)
    raw_map = np.concatenate([scan.points for scan in scans])
    print(f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; {kernels.set_threads(None)} threads")
    print(f"raw map {len(raw_map) / 1e6:.1f} M points, its voxels {len(thinned(raw_map, 0.1)[0]) / 1e6:.2f} M")

    for params in VARIANTS.values():  # compile
        run(params, scans[:4], np.concatenate([scan.points for scan in scans[:4]]))
    for step, (module, name) in STEPS.items():
        setattr(getattr(kernels, module), name, timed(getattr(getattr(kernels, module), name), PROFILE[step]))
    for name, params in VARIANTS.items():
        begun, observed, labelled, labels = run(params, scans, raw_map)
        compared = observed[params.removal_interval - 1 :: params.removal_interval]
        print(f"\n{name}: {observed.mean() + labelled:.4f} s a frame; {100 * labels.mean():.2f} % removed")
        print(f"  before the first frame {begun:.2f} s; observe {observed.mean():.4f}, label {labelled:.4f}")
        print(f"  a scan that is compared {compared.mean():.4f} s, longest {compared.max():.4f}; of that")
        parts = {step: sum(spent) / len(compared) for step, spent in PROFILE.items()}
        for step, mean in (parts | {"the rest, in numpy": compared.mean() - sum(parts.values())}).items():
            print(f"    {step:22} {1000 * mean:7.2f} ms")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"  peak memory so far {peak:.0f} MB, all scans and the raw map included")

    few, params = scans[:PLAIN_SCANS], dataclasses.replace(VARIANTS["default"], removal_interval=1)
    seconds, expected = plain(params, few, raw_map)
    _, observed, _, labels = run(params, few, raw_map)
    ratio = seconds / observed.mean()
    print(f"\nnumpy: {seconds:.3f} s a scan; erasor on the same: {observed.mean():.4f} s, {ratio:.1f} times faster")
    print(f"same label: {100 * (labels == expected[: len(labels)]).mean():.5f} % of their points")


if __name__ == "__main__":
    main()
