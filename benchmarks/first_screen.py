"""When the first screen of a recording arrives: ``python benchmarks/first_screen.py RUN.rrd ...``.

    python benchmarks/first_screen.py run.rrd                     at 4, 12 and 50 MB/s
    python benchmarks/first_screen.py run.rrd --rate 2            at 2 MB/s

Serves each recording over HTTP at a limited rate, and prints how many of its bytes come before the
first frame (layout, properties, texts, cases, curves, map), and how long after the first byte they
have arrived. The viewer draws what has arrived.
"""

from __future__ import annotations

import argparse
import contextlib
import threading
import time
import urllib.request
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

from dynaviz.views import paths
from dynaviz.views.read.chunks import chunks_in

RATES = (4.0, 12.0, 50.0)  # MB/s
SLICE = 1 << 15  # bytes that are sent at once


def before_frames(path: Path) -> tuple[int, int]:
    """Bytes before the first points of a frame, and up to the last chunk of the cases."""
    of_frames = [f"/{paths.SCAN}", f"/{paths.ANSWERS}"]
    found = list(chunks_in(path))
    first = min(at for at, _, entity, on in found if entity in of_frames and paths.FRAME in on)
    cases = [end for _, end, _, on in found if paths.CASE in on]
    return first, max(cases, default=0)


def arrival(path: Path, rate: float, size: int) -> float:
    """Seconds between the first byte and a number of bytes of a file, served at so many MB/s."""

    class Throttled(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            begin = time.perf_counter()
            sent = 0
            # the client leaves when it has what it waits for
            with path.open("rb") as file, contextlib.suppress(ConnectionError):
                while part := file.read(SLICE):
                    self.wfile.write(part)
                    sent += len(part)
                    ahead = sent / (1e6 * rate) - (time.perf_counter() - begin)
                    time.sleep(max(ahead, 0.0))

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Throttled)
    threading.Thread(target=server.handle_request, daemon=True).start()
    with urllib.request.urlopen(f"http://127.0.0.1:{server.server_port}/") as answer:
        answer.read(1)
        begin = time.perf_counter()
        left = size - 1
        while left > 0:
            left -= len(answer.read(min(SLICE, left)))
        seconds = time.perf_counter() - begin
    server.server_close()
    return seconds


def main() -> None:
    """Print a line for each recording and rate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--rate", nargs="+", type=float, default=RATES, help="MB/s")
    given = parser.parse_args()
    for path in given.recordings:
        first, cases = before_frames(path)
        size = path.stat().st_size
        print(f"{path}: {size / 1e6:.1f} MB, cases within {cases / 1e6:.2f} MB, "
              f"frames after {first / 1e6:.2f} MB")  # fmt: skip
        for rate in given.rate:
            seconds = arrival(path, rate, min(max(cases, 1), size))
            every = arrival(path, rate, first)
            print(f"  at {rate:g} MB/s: cases after {seconds:.2f} s, frames begin at {every:.2f} s")


if __name__ == "__main__":
    main()
