"""Cost of a comparison: seconds and peak memory of ``dynaviz compare``, and of a plain copy of its inputs.

    python benchmarks/comparing.py                 a simulated street, HDL-64E, 141 frames, OctoMap and DUFOMap
    python benchmarks/comparing.py A.rrd B.rrd...  existing recordings

Each round runs in its own process, so its peak memory is that of the comparison. The best of three rounds is used.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from dynaviz import api
from dynaviz.synthetic.simulate import simulate

METHODS = ("octomap", "dufomap")
ROUNDS = 3
CODE = """
import json, sys, time
start = time.perf_counter()
import dynaviz as dv
from dynaviz.engine.loop import peak_rss_mb
comparison = dv.compare(*sys.argv[2:], out=sys.argv[1] or None)
seconds, points = time.perf_counter() - start, comparison.sequence.points
print(json.dumps({"seconds": seconds, "cpu": time.process_time(), "peak_mb": peak_rss_mb(), "points": points}))
"""


def measure(out: str, recordings: list[str]) -> dict[str, float]:
    """The best round of a comparison; an empty ``out`` writes no recording."""
    rounds = [
        json.loads(
            subprocess.run([sys.executable, "-c", CODE, out, *recordings], check=True, capture_output=True).stdout
        )
        for _ in range(ROUNDS)
    ]
    return min(rounds, key=lambda one: one["seconds"])


def main(recordings: list[str]) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if not recordings:
            simulate("street_hdl64", folder / "street", frames=141)
            for method in METHODS:
                api.run(method, api.open(folder / "street"), out=folder / method)
                recordings.append(str(folder / method / "run.rrd"))
        start = time.perf_counter()
        for i, recording in enumerate(recordings):
            shutil.copy(recording, folder / f"{i}.rrd")
        copied = time.perf_counter() - start
        read = sum(Path(recording).stat().st_size for recording in recordings) / 1e6
        print(f"copying {len(recordings)} recordings of {read:.0f} MB: {copied:.2f} s")
        for out in ("", str(folder / "compare.rrd")):
            cost = measure(out, recordings)
            label = f"compared and written ({Path(out).stat().st_size / 1e6:.0f} MB)" if out else "compared"
            print(
                f"{label}: {cost['seconds']:.1f} s, {cost['cpu']:.1f} s of processor time, "
                f"peak {cost['peak_mb']:.0f} MB, {cost['points']:,} points"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
