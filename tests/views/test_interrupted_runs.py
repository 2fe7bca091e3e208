"""Files and messages of a run that is killed, interrupted, or runs out of disk space."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.guessing_method import guess_run, record, run_into
from helpers.killed_runs import FRAMES
from helpers.resource_limits import files_end_at
from helpers.worlds import InMemory, room
from rerun.chunk import RrdReader

from dynaviz.contracts.scan import Scan, outcomes
from dynaviz.engine.loop import execute
from dynaviz.errors import DataError
from dynaviz.io.atomic import sha256
from dynaviz.io.lock import NAME
from dynaviz.scores.result import Result
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.read.repair import repaired, salvage
from dynaviz.views.record.recorder import Recorder

Command = Callable[..., tuple[int, str, str]]
UNWRITTEN = 1  # frames that may be lost by a kill: the one that is written in the background
HELPERS = Path(__file__).parents[1] / "helpers"
FINAL = {
    "run.rrd",
    "result.json",
    "labels.npz",
    "static_map.pcd",
    "dynamic_points.pcd",
    "config.toml",
}


def check_answers(recording: RunRecording, scans: list[Any]) -> None:
    """Answers are the method's, frame by frame from the first."""
    for frame, answers in enumerate(recording.answers()):
        scan = scans[frame]
        dynamic = (scan.points[:, 2] < 1.0) & (scan.points[:, 1] > 2.2)
        assert answers.frame == frame
        np.testing.assert_array_equal(answers.outcome, outcomes(scan.labels, dynamic))
    assert [drawn.frame for drawn in recording.drawn()][:frame] == list(
        range(frame)
    )  # the last may be half drawn


@pytest.mark.slow
def test_twenty_kills_at_random_moments(tmp_path: Path) -> None:
    moments = random.Random(4)
    steps = [moments.randint(0, 3 * FRAMES) for _ in range(8)] + [
        moments.randint(2 * FRAMES, 3 * FRAMES) for _ in range(12)
    ]
    orders = "".join(
        f"{tmp_path / str(i)} {n} {moments.uniform(0, 0.01)}\n" for i, n in enumerate(steps)
    )
    environment = {**os.environ, "PYTHONPATH": str(HELPERS.parent)}
    done = subprocess.run(
        [sys.executable, HELPERS / "killed_runs.py"],
        input=orders,
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    scans, salvaged = room(FRAMES, 1000).scans, []
    for i, line in enumerate(done.stdout.splitlines()):
        run, folder = json.loads(line), tmp_path / str(i)
        assert run["status"] in (0, -signal.SIGKILL), done.stderr
        names = {path.name for path in folder.iterdir()}
        if "result.json" in names:  # the last file of a run
            assert names - {NAME} == FINAL  # killed before it removed its lock
            assert Result.load(folder / "result.json").recording_sha256 == sha256(
                folder / "run.rrd"
            )
        if "run.rrd" in names:
            assert RunRecording(folder / "run.rrd").complete
            continue
        part = folder / ".run.rrd.part"
        before = part.read_bytes() if part.exists() else b""
        found = salvage(part, folder / "saved.rrd") if before else None
        if run["frames"] > UNWRITTEN:
            assert found
            assert run["frames"] - UNWRITTEN <= found.answered <= found.frames == FRAMES
            check_answers(RunRecording(folder / "saved.rrd"), scans)
            assert part.read_bytes() == before
        salvaged.append(found.answered if found else 0)
    assert len(done.stdout.splitlines()) == 20
    assert len(set(salvaged)) >= 5, salvaged  # killed at many different frames


def test_an_error_leaves_a_part_that_opens(little_room: InMemory, tmp_path: Path) -> None:
    class Torn(InMemory):
        reads = 0

        def __getitem__(self, position: int) -> Scan:
            self.reads += 1
            if self.reads == 4 + 2 * len(self):
                raise RuntimeError("torn")
            return super().__getitem__(position)

    with pytest.raises(RuntimeError, match="torn"):
        record(Torn(little_room.scans), tmp_path / "run.rrd")
    assert [p.name for p in tmp_path.iterdir()] == [".run.rrd.part"]
    recording = RunRecording(tmp_path / ".run.rrd.part")
    assert not recording.complete
    assert recording.result is None
    assert len(list(recording.answers())) == 2


KILLED = """
import os, signal, sys
sys.path[:0] = {folders!r}
from helpers.worlds import room
from helpers.guessing_method import guess_run
from dynaviz.engine.loop import Listener, execute
from dynaviz.views.record.recorder import Recorder

class Killer(Listener):
    def labelled(self, labelled, curves):
        if labelled.frame == 3:
            os.kill(os.getpid(), signal.SIGKILL)

with Recorder({path!r}) as recorder:
    execute(guess_run(room(6, 500)), [recorder, Killer()], recorder)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_killed_run_leaves_every_frame_but_the_last(tmp_path: Path) -> None:
    here = Path(__file__).parent
    code = KILLED.format(folders=[str(here.parent), str(here)], path=str(tmp_path / "run.rrd"))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert os.listdir(tmp_path) == [".run.rrd.part"]
    part = tmp_path / ".run.rrd.part"
    with pytest.raises(DataError, match=r"is incomplete.*dynaviz info"):
        RunRecording(part)
    frames: set[Any] = set()
    for chunk in RrdReader(part).stream().filter(content="/answers"):
        frames |= set(chunk.to_record_batch()["frame"].to_pylist())
    assert {0, 1, 2} <= frames <= {0, 1, 2, 3}


INTERRUPTED = """
import os, signal, sys
sys.path[:0] = {folders!r}
from dynaviz.runs import execution
from dynaviz.sources import opening
from dynaviz.cli import main
from helpers.guessing_method import run_into
from helpers.worlds import room

class Signals:
    def __init__(self, number): self.number = number
    def __call__(self, phase, done, total):
        if (phase, done) == ("label", 4):
            os.kill(os.getpid(), self.number)

def one(*arguments, out, **options):
    run_into(out, room(6, 500), progress=Signals({number}))

opening.open_source = lambda *a, **k: room(6, 500)
execution.run_method = one
sys.argv = ["dynaviz", "run", "octomap", "somewhere", "-o", {out!r}]
main()
"""


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, 130, "interrupted"),
        pytest.param(signal.SIGTERM, 143, "terminated", marks=pytest.mark.slow),
    ],
)
def test_a_signal_leaves_a_file_that_opens(
    tmp_path: Path, number: int, code: int, word: str
) -> None:
    script = INTERRUPTED.format(
        folders=[str(HELPERS.parent)], number=int(number), out=str(tmp_path / "out")
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    part = tmp_path / "out/.run.rrd.part"
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert (
        done.stderr.strip()
        == f"dynaviz: {word}. Salvage what was recorded with: dynaviz info {part}."
    )
    assert [path.name for path in part.parent.iterdir()] == [".run.rrd.part"]
    recording = RunRecording(part)
    assert len(list(recording.answers())) == 4
    assert not recording.complete
    frames, _ = recording.curve(
        "scores/wrong_points/false_positives"
    )  # complete, though fewer than ten
    assert frames.tolist() == [0, 1, 2, 3]
    with pytest.warns(
        UserWarning, match=r"did not finish\. Saved 4 of 6 frames in .*run-repaired\.rrd"
    ):
        assert len(list(RunRecording(repaired(part)).answers())) == 4


@pytest.mark.parametrize("missing", [2_000, 110_000, 150_000, 190_000])
def test_on_a_full_disk_an_incomplete_recording_keeps_its_part_name(
    tmp_path: Path, missing: int
) -> None:
    sequence = room(6, 500)
    size = record(sequence, tmp_path / "whole.rrd", "scores").stat().st_size
    (tmp_path / "run.rrd").write_bytes(b"of an earlier run")
    with (
        pytest.raises(DataError, match=r"run\.rrd: cannot be written \(File too large\)") as caught,
        files_end_at(size - missing),
    ):
        record(sequence, tmp_path / "run.rrd", "scores")
    assert caught.value.__notes__ == [
        f"Salvage what was recorded with: dynaviz info {tmp_path / '.run.rrd.part'}"
    ]
    assert (tmp_path / "run.rrd").read_bytes() == b"of an earlier run"
    found = salvage(tmp_path / ".run.rrd.part", tmp_path / "saved.rrd")
    assert found.answered <= found.observed <= found.frames
    if missing == 2_000:  # only the index at the end
        assert found.answered == found.frames
        assert RunRecording(tmp_path / "saved.rrd").complete


@pytest.mark.parametrize("limit", [0, 2_000, 40_000])
def test_on_a_full_disk_no_file_gets_its_final_name(tmp_path: Path, limit: int) -> None:
    with pytest.raises(DataError, match="cannot be written"), files_end_at(limit):
        run_into(tmp_path / "out", room(6, 500))
    assert {path.name for path in (tmp_path / "out").iterdir()} <= {".run.rrd.part"}


def test_unwritable_paths(tmp_path: Path) -> None:
    whole = record(room(3, 200), tmp_path / "run.rrd", "scores")
    (tmp_path / "file").touch()
    for out in (tmp_path / "file/run.rrd", Path("/proc/dynaviz/run.rrd")):
        with pytest.raises(DataError, match="cannot be written"), Recorder(out) as recorder:
            execute(guess_run(room(2, 100)), [recorder], recorder)
        with pytest.raises(DataError, match="cannot be written"):
            run_into(out, room(2, 100), recorded=False)
        with pytest.raises(DataError, match="cannot be written"):
            salvage(whole, out)
