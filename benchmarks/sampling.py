"""How much of the movers each method finds with fewer scans, and with fewer rings, on labelled
drives.

    python benchmarks/sampling.py [--poses small-gicp] SEQUENCE [METHOD ...]

Runs each method on every n-th scan of a drive, and on every n-th ring of its scans, and adds the
results to sampling.json beside the method, from which ``dynaviz doctor`` says which methods the
data suit. Rows that are there are not measured again.
"""

from __future__ import annotations

import argparse
import inspect
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.at_sensor import AtSensor
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.diagnosis.sampling import looks
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.lidar import beams

# every n-th scan, with all rings; every n-th ring, of all scans
STRIDES = (1, 2, 5, 10)
RINGS = (2, 4)


def every_ring(scan: Scan, sensor: Sensor, step: int) -> Scan:
    """Every n-th ring of a scan; points belong to the ring with the nearest elevation."""
    if step == 1:
        return scan
    assert scan.labels is not None
    x, y, z = geometry.apply(
        geometry.inverse(scan.T_world_sensor), scan.points.astype(np.float64)
    ).T
    ring = np.abs(np.degrees(np.arctan2(z, np.hypot(x, y)))[:, None] - beams(sensor)).argmin(1)
    kept = ring % step == 0
    return Scan(scan.index, scan.points[kept], scan.T_world_sensor, labels=scan.labels[kept])


def with_every_ring(sensor: Sensor, step: int) -> Sensor:
    """The sensor that measures every n-th ring."""
    if step == 1:
        return sensor
    kept = beams(sensor)[::step].tolist()
    return replace(sensor, rings=len(kept), elevation=(kept[0], kept[-1]), elevations=tuple(kept))


def rates(name: str, scans: list[Scan], sensor: Sensor) -> tuple[float, float]:
    """SA and DA of a method, in percent."""
    kind = registry.load("methods", name)
    near = AtSensor(sensor)
    seen = [near.hidden(scan)[0] for scan in scans]
    raw_map = np.concatenate([scan.points for scan in seen])
    method = kind(kind.Params())
    method.begin(
        Context(Extent.of(*seen), sensor, raw_map=raw_map if kind.info.needs_map else None)
    )
    for scan in seen:
        method.observe(scan)
    removed = np.concatenate([method.label(scan).dynamic for scan in seen])
    truth = np.concatenate([scan.labels for scan in scans])
    static = truth == Label.STATIC
    dynamic = truth == Label.DYNAMIC
    return 100 * float((~removed[static]).mean()), 100 * float(removed[dynamic].mean())


def table_of(name: str) -> Path:
    """The table in the folder of a method."""
    return Path(inspect.getfile(registry.load("methods", name))).with_name("sampling.json")


def main() -> None:
    """Measure what is missing."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sequence", metavar="SEQUENCE")
    parser.add_argument("methods", nargs="*", metavar="METHOD")
    parser.add_argument("--poses")
    options = parser.parse_args()
    drive = dv.open(options.sequence, poses=options.poses)
    read = (drive[position] for position in range(len(drive)))
    scans = [
        Scan(scan.index, scan.points, scan.T_world_sensor, labels=scan.labels) for scan in read
    ]
    for stride, step in [*((stride, 1) for stride in STRIDES), *((1, step) for step in RINGS)]:
        chosen = [every_ring(scan, drive.sensor, step) for scan in scans[::stride]]
        sensor = with_every_ring(drive.sensor, step)
        seen = looks([scan.position for scan in chosen])
        for name in options.methods or [handle.name for handle in registry.handles("methods")]:
            row = {"method": name, "drive": drive.name, "looks": seen, "rings": sensor.rings or 0}
            table = table_of(name)
            rows = json.loads(table.read_text()) if table.exists() else []
            if any(row.items() <= known.items() for known in rows):
                continue
            SA, DA = rates(name, chosen, sensor)
            rows.append({**row, "SA": round(SA, 2), "DA": round(DA, 2)})
            print(rows[-1], flush=True)
            lines = ",\n".join(
                json.dumps(each)
                for each in sorted(rows, key=lambda row: (row["method"], row["drive"]))
            )
            table.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
