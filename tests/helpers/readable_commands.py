"""The commands that read files, with small examples of their input."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.figure import Figure
from typer import Exit

from dynaviz.benchmarking import bench, tune
from dynaviz.cli import main
from dynaviz.explorer import server
from dynaviz.explorer.answers import Explored
from dynaviz.views import viewer
from dynaviz.views.read import shot
from dynaviz_eval.report import figures
from helpers.damage import remove
from helpers.guessing_method import record_with_metrics
from helpers.readable_files import Subject, baseline, config, scored, tiny_benchmark
from helpers.toy_method import InProcessExecutor, write_room
from helpers.worlds import room

_PROGRESS = re.compile(r"(?!dynaviz:).* [\d,]+/[\d,]+ [a-z]|\[\d+/\d+|compiling kernels")

ONE_CYCLIST = "cars=0&trucks=0&cyclists=1&persons=0&parks=0"
TUNE = (
    *("tune", f"implant:@room?{ONE_CYCLIST}"),
    *("-m", "octomap", "-o", ">tuned", "--trials", "1", "--seeds", "1", "--holdout", "1"),
    *("--range", "resolution=0.2:0.4"),
)


def command(*words: str) -> Callable[[Path], bool]:
    """Run a command on an example in this process; returns whether it did its work.

    It must exit with 0, 1 or 3, or with 2 and one line that says why. Only progress and warnings
    may come before it.

    Args:
        words: its arguments; ``@NAME`` is a file of the example, and ``>NAME`` an output, which is
            removed before.
    """

    def read(folder: Path) -> bool:
        for word in words:
            if word[0] == ">":
                remove(folder / word[1:])
        argv = [
            "dynaviz",
            *(word.replace("@", f"{folder}/").replace(">", f"{folder}/") for word in words),
        ]
        out, err, code = io.StringIO(), io.StringIO(), 0
        with (
            patch.object(sys, "argv", argv),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            try:
                main()
            except SystemExit as end:
                code = int(end.code or 0)
        lines = [line for line in err.getvalue().splitlines() if not _PROGRESS.match(line)]
        errors = [line for line in lines if not line.startswith("dynaviz: warning:")]
        assert code in (0, 1, 2, 3), f"exit code {code}: {err.getvalue()}"
        assert code != 2 or len(errors) == 1, err.getvalue()
        assert all(line.startswith("dynaviz:") and line.isprintable() for line in lines), (
            err.getvalue()
        )
        return code != 2

    return read


class AnsweredExplorer:
    """In place of the explorer's server.

    Answers in this process what its page asks about the run and a case.
    """

    url = ""

    def __init__(self, explored: Explored, port: int = 0) -> None:
        json.dumps(runs := explored.answers["runs"]({}), allow_nan=False)
        for letter, facts in runs.items():
            for name in ("layout", "drawing") if facts["cases"] else ():
                explored.contents[name][0]({"run": letter, "case": "1"})
            point = {"run": letter, "frame": "0", "point": "0"}
            json.dumps(explored.answers["point"](point), allow_nan=False)
            explored.contents["marks"][0](point)
        explored.close()

    def __enter__(self) -> AnsweredExplorer:
        return self

    def __exit__(self, *error: Any) -> None:
        pass

    def wait(self) -> None:
        """Nothing is served."""


@contextlib.contextmanager
def in_this_process() -> Iterator[None]:
    """Benches run their cells in this process, nothing is served, and figures are drawn once, when
    they are saved.
    """
    with (
        patch.object(bench, "LocalExecutor", InProcessExecutor),
        patch.object(tune, "default_panel", lambda without: ("octomap",)),
        patch.object(server, "Explorer", AnsweredExplorer),
        patch.object(Figure, "draw_without_rendering", lambda figure: None),
        patch.object(viewer, "open_window", lambda *files: None),
        patch.object(shot, "_window", lambda source, size, view: nullcontext()),
        patch.object(shot, "_picture", lambda client, view: lambda: b""),
        patch.object(shot, "_go_to", lambda client, timeline, value: None),
        patch.object(
            shot, "_at_frames", lambda client, frames, picture, report: [b""] * len(frames)
        ),
    ):
        yield


@contextlib.contextmanager
def undrawn() -> Iterator[None]:
    """Figures are composed, but not drawn."""
    with patch.object(figures, "svg", lambda figure, name, title: "<svg/>"):
        yield


@contextlib.contextmanager
def without_search() -> Iterator[None]:
    """Tuning ends with success once everything is read and written that the search needs."""
    with patch.object(tune, "bench", side_effect=Exit):
        yield


def subject(
    make: Callable[[Path], object],
    target: str,
    *commands: tuple[str, ...],
    shortened: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> Subject:
    """Commands that read the same files; each runs even if one before it refuses them."""

    def make_in(folder: Path) -> Path:
        make(folder)
        return folder

    def read(folder: Path) -> bool:
        with in_this_process(), shortened():
            did = [command(*words)(folder) for words in commands]
        return all(did)

    return Subject(make_in, read, target)


def recordings(folder: Path) -> None:
    for name in ("run.rrd", "other.rrd"):
        record_with_metrics(room(3, 100), folder / name)


def runs(folder: Path) -> None:
    baseline(folder)


def map_of_demo(folder: Path) -> None:
    tiny_benchmark(folder)
    np.save(
        folder / "map.npy",
        np.concatenate([scan.points[scan.labels == 0] for scan in room(2, 30).scans]),
    )


def labels_of_demo(folder: Path) -> None:
    tiny_benchmark(folder)
    command("run", "octomap", "@demo", "-o", ">out", "--record", "none")(folder)


def recorded_demo(folder: Path) -> None:
    tiny_benchmark(folder)
    command("run", "octomap", "@demo", "-o", ">out")(folder)


def board(folder: Path) -> None:
    labels_of_demo(folder)
    command("report", "@out", "--format", "board", "-o", "@board")(folder)
    (folder / "board/index.html").unlink()  # is only written


def corrected_demo(folder: Path) -> None:
    labels_of_demo(folder)
    digest = json.loads((folder / "out/result.json").read_text())["sequence"]["digest"]
    box = {"frame": 0, "low": [-5, -5, -5], "high": [5, 5, 5]}
    made = {
        "sequence": digest,
        "corrections": [{"case": 1, "what": "car", "truth": "static", "boxes": [box]}],
    }
    (folder / "out/corrections.json").write_text(json.dumps(made))


def implants(folder: Path) -> None:
    write_room(folder / "room", frames=4, rays=500)
    command("simulate", f"implant:@room?panel=none&{ONE_CYCLIST}", ">implants")(folder)
    (folder / "implants/implants.toml").rename(folder / "implants.toml")
    remove(folder / "implants")


def plan(folder: Path) -> None:
    tiny_benchmark(folder)
    (folder / "bench.toml").write_text(
        'methods = ["octomap"]\nrecord = "none"\n[[sequences]]\npath = "demo"\nname = '
        '"there"\nframes = "0:9"\n'
        "[grid]\noctomap = { resolution = [0.1, 0.2] }\n"
    )


def plan_and_runs(folder: Path) -> None:
    plan(folder)
    with in_this_process():
        command("bench", "@bench.toml", "-o", "@bench")(folder)


def configured_demo(folder: Path) -> None:
    tiny_benchmark(folder)
    config(folder)


COMMANDS = {
    "dynaviz info RECORDING": subject(recordings, "run.rrd", ("info", "@run.rrd")),
    "dynaviz info RECORDING --failures": subject(
        recordings, "run.rrd", ("info", "@run.rrd", "--failures")
    ),
    "dynaviz compare": subject(
        recordings, "run.rrd", ("compare", "@run.rrd", "@other.rrd", "-o", ">both.rrd")
    ),
    "dynaviz view": subject(recordings, "run.rrd", ("view", "@run.rrd")),
    "dynaviz view -o": subject(recordings, "run.rrd", ("view", "@run.rrd", "-o", ">picture.png")),
    "dynaviz explore": subject(
        recordings, "run.rrd", ("explore", "@run.rrd", "@other.rrd", "--no-browser")
    ),
    "dynaviz why": subject(
        recorded_demo,
        "**/*",
        *(
            ("why", run, "--frame", "1", "--point", "9", "--json", ">why.json")
            for run in ("@out", "@out/run.rrd")
        ),
    ),
    "dynaviz report --format board": subject(
        board, "**/*", ("report", "@out", "--format", "board", "-o", "@board")
    ),
    "dynaviz score RUN": subject(
        corrected_demo, "out/corrections.json", ("score", "@out", "--sequence", "@demo")
    ),
    "dynaviz info RESULT": subject(scored, "out/result.json", ("info", "@out/result.json")),
    "dynaviz info RESULT --failures": subject(
        scored, "out/result.json", ("info", "@out/result.json", "--failures")
    ),
    "dynaviz report": subject(
        scored, "out/result.json", *(("report", "@out", "--format", kind) for kind in ("md", "csv"))
    ),
    "dynaviz report (HTML)": subject(
        scored, "out/result.json", ("report", "@out", "--format", "html"), shortened=undrawn
    ),
    "dynaviz report (HTML, drawn)": subject(
        scored, "out/result.json", ("report", "@out", "--format", "html")
    ),
    "dynaviz check": subject(
        runs,
        "out/*.json",
        ("check", "@out/result.json", "--min", "AA=50", "--baseline", "@out/baseline.json"),
    ),
    "dynaviz info SEQ": subject(tiny_benchmark, "**/*", ("info", "@demo")),
    "dynaviz doctor": subject(tiny_benchmark, "**/*", ("doctor", "@demo")),
    "dynaviz convert": subject(tiny_benchmark, "**/*", ("convert", "@demo", ">converted")),
    "dynaviz run": subject(
        configured_demo,
        "**/*",
        ("run", "octomap", "@demo", "-o", ">out", "--record", "none", "--config", "@config.toml"),
    ),
    "dynaviz clean": subject(
        tiny_benchmark, "**/*", ("clean", "@demo", "-m", "octomap", "-o", ">map.pcd")
    ),
    "dynaviz live": subject(
        tiny_benchmark,
        "**/*",
        ("live", "@demo", "-m", "octomap", "--rate", "0", "--reach", "10", "-o", ">live"),
    ),
    "dynaviz score": subject(
        map_of_demo, "**/*", ("score", "@map.npy", "@demo", "-o", ">out", "--record", "none")
    ),
    "dynaviz convert --labels": subject(
        labels_of_demo, "**/*", ("convert", "@out", ">labels", "--labels", "--sequence", "@demo")
    ),
    "dynaviz list": subject(config, "*", ("list", "octomap", "--config", "@config.toml")),
    "dynaviz bench": subject(plan, "**/*", ("bench", "@bench.toml", "-o", ">bench")),
    "dynaviz bench --resume": subject(
        plan_and_runs, "bench/**/*", ("bench", "@bench.toml", "-o", "@bench")
    ),
    "dynaviz simulate": subject(
        implants, "**/*", ("simulate", "implant:@room?panel=none&scene=@implants.toml", ">new")
    ),
    "dynaviz tune": subject(implants, "room/**/*", TUNE, shortened=without_search),
    "dynaviz tune (with the search)": subject(implants, "room/**/*", TUNE),
}
