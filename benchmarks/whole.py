"""Where a whole command spends its time.

A table of its steps, from the start of the process to its end.

Then the time of commands on finished runs, and of a benchmark of the methods.

    python benchmarks/whole.py                       140 frames of a simulated street, HDL-64E;
        octomap and seethrough
    python benchmarks/whole.py SEQ [METHOD ...]

Each command runs in a process of its own, after a run on two frames that compiles. Steps exclude
the steps that they call. Processor time is that of all threads: work in the background counts in
the step during which it happens.
"""

from __future__ import annotations

import functools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

LAUNCHED = (
    "WHOLE_LAUNCHED"  # environment variable: when the process was launched, seconds since the epoch
)


class Steps:
    """Elapsed and processor seconds by step of the main thread.

    Time belongs to the innermost step.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
        self._open = ["start and imports"]
        self._elapsed = time.time() - float(os.environ[LAUNCHED])
        self._processor = time.process_time()
        self._add(self._elapsed, self._processor)
        self._last = time.perf_counter()

    def _add(self, elapsed: float, processor: float) -> None:
        found = self.seconds[self._open[-1]]
        found[0] += elapsed
        found[1] += processor

    def _switch(self) -> None:
        now = time.perf_counter()
        processor = time.process_time()
        self._add(now - self._last, processor - self._processor)
        self._last = now
        self._processor = processor

    def timed(self, name: str, call: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call as a step."""
        self._switch()
        self._open.append(name)
        try:
            return call(*args, **kwargs)
        finally:
            self._switch()
            self._open.pop()

    def wrap(self, owner: Any, method: str, name: str) -> None:
        """Replace a function or method by one that is timed."""
        call = getattr(owner, method)

        @functools.wraps(call)
        def timed(*args: Any, **kwargs: Any) -> Any:
            return self.timed(name, call, *args, **kwargs)

        setattr(owner, method, timed)


def _stream(
    steps: Steps, stream: Callable[..., Iterator[Any]], name: str
) -> Callable[..., Iterator[Any]]:
    def timed(*args: Any, **kwargs: Any) -> Iterator[Any]:
        scans = stream(*args, **kwargs)
        while (scan := steps.timed(name, next, scans, None)) is not None:
            yield scan

    return timed


def child(command: str, method: str, source: str, out: str, frames: str | None = None) -> None:
    """Run a command in this process, and print the seconds of its steps as JSON."""
    import dynaviz.cli  # noqa: F401
    from dynaviz.contracts import registry
    from dynaviz.engine import cleaned_map, loop, outputs
    from dynaviz.runs.execution import Surveyed
    from dynaviz.sources import pose_noise, summary

    steps = Steps()
    steps.wrap(loop, "_warm_up", "loading kernels, first scan")
    steps.wrap(Surveyed, "of", "survey: extent, digest; checks of poses")
    for each in ("add", "result"):
        steps.wrap(pose_noise.PoseNoiseMeter, each, "survey: noise of poses")
    summary.stream = _stream(steps, summary.stream, "waiting for scans: survey")  # type: ignore[assignment]
    loop.stream = _stream(steps, loop.stream, "waiting for scans: observe and label")  # type: ignore[assignment]
    clock = loop.Clock.timed

    def timed(self: Any, frame: int, call: Any, scan: Any) -> Any:
        return steps.timed(f"method: {call.__name__}", clock, self, frame, call, scan)

    loop.Clock.timed = timed  # type: ignore[method-assign]
    steps.wrap(loop.Updates, "update", "metrics: each scan")
    for name, metric in registry.loadable("metrics").items():
        for each in ("finish", "figures"):
            steps.wrap(metric, each, f"metrics: {name}, at the end")
    for each in ("labelled", "__exit__"):
        steps.wrap(outputs.MapFiles, each, "maps")
        steps.wrap(outputs.LabelsFile, each, "labels")
    if command != "none":
        from dynaviz.views.background import Background
        from dynaviz.views.record.recorder import Recorder

        for each in ("begin", "observing", "observed", "labelled", "finish", "__exit__"):
            steps.wrap(Recorder, each, f"recording: {each.strip('_')}")
        steps.wrap(Recorder, "_repeat", "recording: evidence of the cases")
        steps.wrap(Background, "wait", "recording: waiting for states")
    if command == "clean":
        steps.wrap(cleaned_map, "write_maps", "maps")
    steps.timed("the rest", _run, command, method, source, out, frames)
    print(json.dumps(steps.seconds))


def _run(command: str, method: str, source: str, out: str, frames: str | None) -> None:
    from dynaviz import api, cleaning

    if command == "clean":
        cleaning.clean(source, Path(out) / "clean.laz", method=method, frames=frames)
    else:
        api.run(method, source, out=Path(out), record=command, frames=frames)


def profile(command: str, method: str, source: str, frames: str = "") -> dict[str, list[float]]:
    """Elapsed and processor seconds by step of a command in a fresh process."""
    with tempfile.TemporaryDirectory() as out:
        run = subprocess.run(
            [
                sys.executable,
                __file__,
                "--child",
                command,
                method,
                source,
                out,
                *filter(None, [frames]),
            ],
            env={**os.environ, LAUNCHED: str(time.time())},
            stdout=subprocess.PIPE,
            check=True,
        )
    steps: dict[str, list[float]] = json.loads(run.stdout.splitlines()[-1])
    return steps


def others(source: str, folder: Path, methods: Sequence[str]) -> None:
    """Print elapsed and processor seconds of commands on finished runs of two methods, and of a
    benchmark.
    """
    first, second = (str(folder / method) for method in methods[:2])
    for method in methods[:2]:
        _command("run", method, source, "-o", str(folder / method))
    print("\n| command | elapsed / processor seconds |\n|---|---|")
    for words in (
        ("--help",),
        ("info", first, "--failures"),
        ("compare", first, second, "-o", str(folder / "compare.rrd")),
        ("report", first, "-o", str(folder / "report.html")),
        (
            "bench",
            *(word for method in methods for word in ("-m", method)),
            "-s",
            source,
            "-o",
            str(folder / "bench"),
        ),
    ):
        print(
            "| `{}` | {:.2f} / {:.2f} |".format(
                " ".join(w for w in words if "/" not in w), *_command(*words)
            )
        )


def _command(*words: str) -> tuple[float, float]:
    """Elapsed and processor seconds of a command in a process of its own."""
    begin = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "dynaviz", *words], stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - begin, processor


def main(source: str | None = None, *methods: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        if source is None:
            from dynaviz.synthetic.simulate import simulate

            source = str(Path(folder) / "street")
            simulate("street_hdl64", Path(source), frames=140)
        methods = methods or ("octomap", "seethrough")
        for method in methods:
            columns = {}
            for command in ("none", "errors", "full", "clean"):
                profile(command, method, source, "0:2")
                columns[command] = profile(command, method, source)
            print(
                f"\n{method}, elapsed / processor seconds\n\n| step | " + " | ".join(columns) + " |"
            )
            print("|---" * (1 + len(columns)) + "|")
            for step in dict.fromkeys(step for column in columns.values() for step in column):
                cells = [
                    "{:.2f} / {:.2f}".format(*column[step]) if step in column else ""
                    for column in columns.values()
                ]
                print(f"| {step} | " + " | ".join(cells) + " |")
            totals = [
                "{:.1f} / {:.1f}".format(*map(sum, zip(*each.values(), strict=True)))
                for each in columns.values()
            ]
            print("| all | " + " | ".join(totals) + " |", flush=True)
        if len(methods) > 1:
            others(source, Path(folder), methods)


if __name__ == "__main__":
    child(*sys.argv[2:]) if sys.argv[1:2] == ["--child"] else main(*sys.argv[1:])
