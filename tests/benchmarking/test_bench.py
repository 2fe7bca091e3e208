"""Benches: which cells run, what happens to those that fail or die, and how sequences
are combined.
"""

from __future__ import annotations

import io
import json
import os
import shlex
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.toy_method import InProcessExecutor, has_ended, waiting_process, write_room
from rich.console import Console

from dynaviz import api
from dynaviz.benchmarking.bench import bench
from dynaviz.benchmarking.cells import difference
from dynaviz.benchmarking.leaderboard import Leaderboard
from dynaviz.cli import main
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError
from dynaviz.io.pcd import write_pcd
from dynaviz.runs import execution
from dynaviz.scores.collect import combined
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Runtime, Sections, SequenceInfo
from dynaviz.sources.summary import SequenceSummary, summarize
from dynaviz.synthetic.simulate import write as writing

MAIN = [sys.executable, "-c", "from dynaviz.cli import main; main()"]
NONE = {"methods": ["toy"], "record": "none"}


def shown(board: Leaderboard) -> str:
    console = Console(width=150, file=io.StringIO())
    console.print(board)
    return console.file.getvalue()


def states(board: Leaderboard) -> dict[str, str]:
    return {
        row.cell.path.as_posix(): "failed" if row.error else "kept" if row.kept else "ran"
        for row in board.rows
    }


@pytest.fixture(scope="module")
def mixed(
    toy: None, rooms: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Leaderboard, Path]:
    """A real bench with two workers: cells that succeed, one that fails, and one that is killed."""
    out = tmp_path_factory.mktemp("mixed")
    table = {
        "methods": ["beautymap", "toy"],
        "sequences": [str(rooms[0])],
        "record": "scores",
        "workers": 2,
    }
    return bench({**table, "grid": {"toy": {"act": ["raise", "die"]}}}, out), out


def test_a_failed_or_killed_cell_is_a_row_and_the_others_continue(
    mixed: tuple[Leaderboard, Path],
) -> None:
    board, out = mixed
    assert list(states(board).values()) == ["ran", "ran", "failed", "failed"]
    errors = {row.cell.parameter_set.variant: row.error for row in board.failed}
    assert errors["act=raise"] == "ValueError: this method cannot"
    assert "SIGKILL" in errors["act=die"]
    facts = json.loads((out / "one/toy-act=raise/error.json").read_text())
    assert facts == {
        "method": "toy",
        "sequence": "one",
        "variant": "act=raise",
        "error": errors["act=raise"],
    }
    assert "Traceback" in (out / "one/toy-act=raise/error.log").read_text()
    text = shown(board)
    assert "toy-act=raise" in text
    assert "this method cannot" in text


def test_the_spread_over_seeds_follows_from_the_runs(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    table = {"methods": ["octomap_gf"], "record": "none", "sequences": [str(rooms[0])]}
    board = bench({**table, "seeds": [0, 1, 2]}, tmp_path)
    assert {row.cell.parameter_set.seed: row.result.seed for row in board.rows} == {
        0: 0,
        1: 1,
        2: 2,
    }
    (spread,) = board.spreads
    known = [row.result.metrics["SA"] for row in board.rows]
    assert (spread.sequence, spread.method, spread.variant, spread.seeds) == (
        "one", "octomap_gf", "", 3,
    )  # fmt: skip
    assert spread.mean["SA"] == pytest.approx(np.mean(known))
    assert spread.deviation["SA"] == pytest.approx(np.std(known, ddof=1))
    assert "Mean ± standard deviation over the seeds 0, 1, 2" in shown(board)
    assert bench(table, tmp_path / "one").spreads == []


@pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="elsewhere, each cell has its own process"
)
def test_cells_share_a_process_but_not_its_peak_memory(
    toy: None, rooms: list[Path], tmp_path: Path
) -> None:
    gates = [tmp_path / "first", tmp_path / "last"]
    for gate in gates:
        gate.touch()
    acts = [f"wait:{gates[0]}", "hold", f"wait:{gates[1]}"]
    table = {**NONE, "sequences": [str(rooms[0])], "workers": 1, "grid": {"toy": {"act": acts}}}
    _, first, holding, last = bench(table, tmp_path / "out").results
    assert waiting_process(gates[0]) == waiting_process(gates[1])
    peaks = [result.runtime.peak_rss_mb or 0.0 for result in (first, holding, last)]
    assert peaks[1] > 150 + max(peaks[0], peaks[2])  # of the 200 MB that one cell holds


def test_a_sequence_is_read_once_for_its_cells(
    in_process: type[InProcessExecutor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []

    def counted(sequence: Sequence, *rest: object) -> SequenceSummary:
        read.append(sequence.name)
        return summarize(sequence)

    monkeypatch.setattr(execution, "summarize", counted)
    paths = [write_room(tmp_path / name, frames=2, rays=300) for name in ("one", "two")]
    table = {**NONE, "sequences": [*map(str, paths)], "grid": {"toy": {"height": [0.3]}}}
    assert set(states(bench(table, tmp_path / "out")).values()) == {"ran"}
    assert read == ["one", "two"]
    write_room(paths[1], frames=2, rays=300, seed=9)
    bench(table, tmp_path / "out")
    assert in_process.ran == ["two/toy", "two/toy-height=0.3"]
    assert read == ["one", "two", "two"]


def test_a_cell_has_all_files_of_a_run(mixed: tuple[Leaderboard, Path]) -> None:
    board, out = mixed
    files = {path.name for path in (out / "one/toy").iterdir()}
    assert files == {
        "run.rrd",
        "result.json",
        "labels.npz",
        "static_map.pcd",
        "dynamic_points.pcd",
        "config.toml",
    }
    assert not [path for path in (out / "one/toy-act=die").iterdir() if path.name == "result.json"]
    result = Result.load(out / "one/toy/result.json")
    assert (result.variant, result.record) == ("", "scores")
    assert result == board.rows[1].result


def test_the_command_of_a_cell_gives_the_same_labels(
    mixed: tuple[Leaderboard, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = mixed[0].rows[1].result
    assert result
    monkeypatch.setattr(sys, "argv", [*shlex.split(result.command), "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code
    assert Result.load(tmp_path / "result.json").labels_sha256 == result.labels_sha256


def test_labels_do_not_depend_on_the_workers_and_timing_has_all_cores(
    mixed: tuple[Leaderboard, Path], rooms: list[Path], tmp_path: Path
) -> None:
    (timed,) = bench(
        {"methods": ["beautymap"], "sequences": [str(rooms[0])], "timing": True}, tmp_path
    ).results
    shared = mixed[0].results[0]
    assert (timed.method, timed.labels_sha256) == (shared.method, shared.labels_sha256)
    assert timed.counts["dynamic_removed"] + timed.counts["static_removed"] > 0
    assert timed.runtime.threads == os.cpu_count()
    assert shared.runtime.threads == max(1, (os.cpu_count() or 1) // 2)
    assert (timed.record, shared.record) == (None, "scores")
    assert not timed.instrumented


@pytest.mark.parametrize(
    "end", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_an_interrupted_bench_resumes(
    toy: None, rooms: list[Path], tmp_path: Path, end: signal.Signals
) -> None:
    out, gate = tmp_path / "out", tmp_path / "gate"
    typed = [
        "bench",
        "-m",
        "toy",
        "-s",
        rooms[0],
        "-o",
        out,
        "--record",
        "none",
        "--grid",
        f"toy.act=wait:{gate}",
    ]
    begun = subprocess.Popen(
        [*MAIN, *map(str, typed)], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    pid, _ = waiting_process(gate)
    begun.send_signal(end)
    _, err = begun.communicate()
    assert has_ended(pid), "the process of the cell outlived the bench"
    done = sorted(out.glob("one/*/result.json"))
    assert [path.parent.name for path in done] == ["toy"]
    assert not list(out.glob("one/*/error.json")), "a cell that was interrupted has not failed"
    before = [path.stat().st_mtime_ns for path in done]
    if end == signal.SIGINT:
        assert begun.returncode == 130
        assert "Traceback" not in err
        return
    gate.touch()
    table = {**NONE, "sequences": [str(rooms[0])], "grid": {"toy": {"act": [f"wait:{gate}"]}}}
    assert list(states(bench(table, out)).values()) == ["kept", "ran"]
    assert [path.stat().st_mtime_ns for path in done] == before


def test_only_what_changed_runs_again(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    one, two = (
        write_room(tmp_path / "data" / name, frames=2, rays=300, seed=len(name))
        for name in ("one", "three")
    )
    table = {**NONE, "sequences": [str(one), str(two)], "grid": {"toy": {"height": [0.3]}}}
    out = tmp_path / "out"
    assert set(states(bench(table, out)).values()) == {"ran"}
    assert set(states(bench(table, out)).values()) == {"kept"}
    assert in_process.ran == []

    bench({**table, "grid": {"toy": {"height": [0.7]}}}, out)
    assert in_process.ran == ["one/toy-height=0.7", "three/toy-height=0.7"]

    for name, change in {
        "one/toy": lambda text: text[:-20],
        "one/toy-height=0.3": lambda text: text.replace('"seed": 0', '"seed": 1'),
        "three/toy": lambda text: text.replace('"numpy": "', '"numpy": "0.'),
        "three/toy-height=0.3": lambda text: text.replace('"height": 0.3', '"height": 0.4'),
    }.items():
        path = out / name / "result.json"
        before = path.read_text()
        path.write_text(change(before))
        assert path.read_text() != before
        bench(table, out)
        assert in_process.ran == [name]

    write_room(two, frames=2, rays=300, seed=99)
    bench(table, out)
    assert in_process.ran == ["three/toy", "three/toy-height=0.3"]
    bench(table, out, fresh=True)
    assert len(in_process.ran) == 4


def test_a_cell_without_its_recording_runs_again(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    table = {"methods": ["toy"], "sequences": [str(rooms[0])], "record": "scores"}
    bench(table, tmp_path)
    bench(table, tmp_path)
    assert in_process.ran == []
    with (tmp_path / "one/toy/run.rrd").open("ab") as file:
        file.write(b"x")
    bench(table, tmp_path)
    assert in_process.ran == ["one/toy"]
    (tmp_path / "one/toy/run.rrd").unlink()
    bench(table, tmp_path)
    assert in_process.ran == ["one/toy"]
    bench({**table, "record": "none"}, tmp_path)
    assert in_process.ran == ["one/toy"]
    assert not (tmp_path / "one/toy/run.rrd").exists()


def test_totals_add_the_counts_of_sequences(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    few = write_room(tmp_path / "few", frames=1, rays=50)
    board = bench(
        {**NONE, "sequences": [str(rooms[0]), str(few)], "grid": {"toy": {"act": ["raise"]}}},
        tmp_path / "out",
    )
    (total,) = board.totals()  # the variant that fails has none
    kept = removed = 0
    for row in board.rows[::2]:
        with np.load(row.folder / "labels.npz") as z:
            dynamic = np.unpackbits(z["dynamic"])[: z["points"].sum()].astype(bool)
        sequence = api.open(row.cell.source.path)
        truth = np.concatenate([sequence[k].labels for k in range(len(sequence))])
        kept += int((~dynamic & (truth == 0)).sum())
        removed += int((dynamic & (truth == 0)).sum())
    assert (total.counts["static_kept"], total.counts["static_removed"]) == (kept, removed)
    assert total.metrics["SA"] == pytest.approx(100 * kept / (kept + removed))
    means = [result.metrics["SA"] for result in board.results]
    assert total.metrics["SA"] != pytest.approx(sum(means) / 2, abs=1e-3)
    assert total.runtime.frames == 3
    assert total.sequence.points == 1650
    assert "all 2" in shown(board)


def test_runtimes_combine_over_all_frames() -> None:
    frames = [np.array([0.1, 0.3, 0.2]), np.array([1.0, 2.0])]
    parts = [
        Result(
            "m",
            {},
            SequenceInfo(str(k)),
            Sections(counts={"static_kept": 1}),
            Runtime(f.mean(), f.std(), len(f)),
        )
        for k, f in enumerate(frames)
    ]
    total, whole = combined(parts).runtime, np.concatenate(frames)
    assert (total.mean_s, total.std_s, total.frames) == pytest.approx(
        (whole.mean(), whole.std(), 5)
    )


def test_unreadable_data_are_rows_but_a_missing_sequence_is_an_error(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    far = write_room(tmp_path / "far", frames=2, rays=300)
    write_pcd(
        far / "pcd/000011.pcd", dict.fromkeys("xyz", np.full(300, 1e7, np.float32)), np.eye(4)
    )
    with pytest.raises(DataError, match="absent"):
        bench({**NONE, "sequences": [str(rooms[0]), str(tmp_path / "absent")]}, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    board = bench(
        {**NONE, "sequences": [{"path": str(rooms[0]), "frames": "0:1"}, str(far)]},
        tmp_path / "out",
    )
    assert list(states(board).values()) == ["ran", "failed"]
    assert "km from the world's origin" in board.failed[0].error
    assert not board.totals()


def test_scenes_are_simulated_once(
    in_process: type[InProcessExecutor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulated = []

    def simulate(scene: str, out: Path, frames: int, seed: int, progress: object) -> None:
        simulated.append((scene, frames, seed))
        write_room(out, frames=1, rays=99, seed=seed)
        facts = {"preset": scene, "frames": frames, "seed": seed, "generator": writing.VERSION}
        (out / "sequence.toml").write_text(
            "".join(f"{key} = {json.dumps(value)}\n" for key, value in facts.items())
        )

    monkeypatch.setattr(writing, "simulate", simulate)
    table = {**NONE, "sequences": ["simulate:hall_vlp16:1"]}
    assert [[*states(bench(table, tmp_path)).values()] for _ in range(2)] == [["ran"], ["kept"]]
    other = {"simulate": "hall_vlp16", "frames": 1, "seed": 5, "name": "hall_vlp16-1"}
    assert list(states(bench({**table, "sequences": [other]}, tmp_path)).values()) == ["ran"]
    assert simulated == [("hall_vlp16", 1, 0), ("hall_vlp16", 1, 5)]
    (tmp_path / "sequences/hall_vlp16-1/sequence.toml").write_text('name = "mine"')
    board = bench({**table, "sequences": [other]}, tmp_path)
    assert "not a simulated scene" in board.failed[0].error
    assert (tmp_path / "sequences/hall_vlp16-1/pcd").exists(), "the data of a user are kept"


def test_a_timed_runtime_needs_all_cores_and_no_recording(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    row = bench({**NONE, "sequences": [str(rooms[0])]}, tmp_path).rows[0]
    assert row.result
    timed = replace(row.cell, timing=True)
    for runtime, instrumented, expected in (
        (Runtime(threads=os.cpu_count()), False, None),
        (Runtime(threads=999), False, "threads is 999"),
        (Runtime(threads=os.cpu_count()), True, "states recorded"),
    ):
        problem = difference(
            timed, replace(row.result, runtime=runtime, instrumented=instrumented), row.folder
        )
        assert problem is None if expected is None else expected in str(problem)


def test_a_folder_that_cannot_be_created_is_named(rooms: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(
        DataError, match=r"file/bench: cannot be written .* choose another folder with -o"
    ):
        bench({"methods": ["octomap"], "sequences": [str(rooms[0])]}, tmp_path / "file/bench")


def test_a_leaderboard_is_a_data_frame_with_a_row_for_each_cell(
    mixed: tuple[Leaderboard, Path],
) -> None:
    board, _ = mixed
    frame = board.to_pandas()
    assert list(frame["method"]) == [row.cell.parameter_set.method for row in board.rows]
    finished = frame[frame["error"].isna()]
    assert list(finished["SA"]) == [result.metrics["SA"] for result in board.results]
    assert repr(board) == "<Leaderboard of 4 runs, 2 failed>"
