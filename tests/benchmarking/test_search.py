"""Parameter search: its result, resuming it, and that it never reads held-out sequences."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.toy_method import InProcessExecutor, write_room

from dynaviz.benchmarking import source as sources
from dynaviz.benchmarking.bench import bench
from dynaviz.contracts import params, registry
from dynaviz.errors import DynavizError, UsageError
from dynaviz.scores.collect import combined

pytest.importorskip("optuna", reason="needs optuna: pip install optuna")


def spec(kind: str = "bayes", trials: int = 6, **ranges: str) -> dict[str, object]:
    return {"kind": kind, "trials": trials, "ranges": {"toy": ranges or {"height": "0.1:2.0"}}}


def table(rooms: list[Path], **more: object) -> dict[str, object]:
    return {
        "methods": ["toy"],
        "record": "none",
        "sequences": [str(room) for room in rooms],
        **more,
    }


def tried(out: Path) -> list[str]:
    return sorted(path.parent.name for path in out.glob("one/*/result.json"))


@pytest.mark.parametrize("kind", [pytest.param("random", marks=pytest.mark.slow), "bayes"])
def test_the_best_trial_is_found_and_its_file_can_be_used(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path, kind: str
) -> None:
    board = bench(table(rooms, search=spec(kind, 9)), tmp_path)
    (found,) = board.searches
    every = [*board.rows, *board.trials]
    assert len({row.folder for row in every}) == len(every) == 20
    assert {row.cell.parameter_set.variant for row in board.rows} == {"", found.best.variant}
    by_variant = {
        variant: combined(
            [
                row.result
                for row in every
                if row.result and row.cell.parameter_set.variant == variant
            ]
        )
        for variant in {row.cell.parameter_set.variant for row in every}
    }
    assert len(by_variant) == 10
    assert found.aa == max(total.metrics["AA"] for total in by_variant.values())
    assert by_variant[found.best.variant].metrics["AA"] == found.aa
    assert found.aa > found.default_aa == by_variant[""].metrics["AA"]
    assert 0.8 < found.best.parameters["height"] < 1.4  # the box is 1 m high
    resolved = params.resolve(registry.load("methods", "toy"), config=found.preset)
    assert resolved.params.height == found.best.parameters["height"]
    comment = found.preset.read_text()
    for fact in (
        f"AA {found.aa:.2f} %",
        "9 trials",
        "one, two",
        "seed 0",
        "height = 0.1:2.0",
        f"{found.default_aa:.2f}",
    ):
        assert fact in comment


def test_a_best_set_that_is_also_in_the_grid_counts_once(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    grid = {"toy": {"height": [1.0]}}
    both = bench(table(rooms, grid=grid, search=spec(trials=1, height="1.0:1.0")), tmp_path)
    assert both.searches[0].best.variant == "height=1.0"
    alone = bench(table(rooms, grid=grid), tmp_path)
    assert [row.folder for row in both.rows] == [row.folder for row in alone.rows]
    assert [total.counts for total in both.totals()] == [total.counts for total in alone.totals()]
    held = bench(
        table(rooms, grid=grid, search=spec(trials=1, height="1.0:1.0"), holdout=["two"]), tmp_path
    )
    assert len({row.folder for row in held.rows}) == len(held.rows) == 4


def test_a_search_resumes(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    whole = bench(table(rooms[:1], search=spec(trials=12)), tmp_path / "whole")
    bench(table(rooms[:1], search=spec(trials=5)), tmp_path / "parts")
    first = tried(tmp_path / "parts")
    rest = bench(table(rooms[:1], search=spec(trials=12)), tmp_path / "parts")
    assert len(in_process.ran) == 13 - len(first)
    assert tried(tmp_path / "parts") == tried(tmp_path / "whole")
    assert rest.searches[0].best == whole.searches[0].best


def test_integers_stay_integers_and_ranges_may_be_logarithmic(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    board = bench(
        table(rooms[:1], search=spec("random", 5, steps="log:1:50", height="log:0.1:2")), tmp_path
    )
    steps = [row.cell.parameter_set.parameters["steps"] for row in board.trials]
    assert all(isinstance(step, int) and 1 <= step <= 50 for step in steps)
    heights = [row.cell.parameter_set.parameters["height"] for row in board.trials]
    assert all(height == float(f"{height:.4g}") for height in heights)


def test_the_search_never_opens_held_out_sequences(
    in_process: type[InProcessExecutor],
    rooms: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: list[tuple[str, int]] = []
    real = sources.open_source

    def spy(path: str, *options: object):
        opened.append((Path(path).name, len(in_process.ran)))
        return real(path, *options)

    monkeypatch.setattr(sources, "open_source", spy)
    board = bench(table(rooms[:1], holdout=[str(rooms[1])], search=spec(trials=4)), tmp_path / "a")
    assert min(ran for name, ran in opened if name == "two") == 5, (
        "before the defaults and all trials had run"
    )
    assert min(ran for name, ran in opened if name == "one") == 0
    assert in_process.ran[5:] == ["two/toy", f"two/toy-{board.searches[0].best.variant}"]
    assert {row.cell.source.name for row in board.trials} == {"one"}


def test_held_out_sequences_do_not_affect_the_search(
    in_process: type[InProcessExecutor], rooms: list[Path], tmp_path: Path
) -> None:
    bad = write_room(tmp_path / "two", frames=2, rays=300)
    for path in (bad / "pcd").iterdir():
        path.write_bytes(path.read_bytes()[:-9])
    presets = []
    for held in (rooms[1], bad):
        board = bench(
            table([rooms[0], held], holdout=["two"], search=spec(trials=3)),
            tmp_path / "out" / held.parent.name,
        )
        presets.append(board.searches[0].preset.read_bytes())
    assert presets[0] == presets[1]
    assert [row.cell.source.name for row in board.failed] == ["two", "two"]


def test_a_search_without_ground_truth_is_an_error(
    in_process: type[InProcessExecutor], tmp_path: Path
) -> None:
    blind = write_room(tmp_path / "blind", frames=1, rays=100)
    (blind / "gt_cloud.pcd").unlink()
    with pytest.raises(DynavizError, match="AA is undefined for every parameter set"):
        bench(table([blind], search=spec(trials=2)), tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("hight", "0.1:1", "Did you mean 'height'"),
        ("act", "0:1", "is not a number"),
        ("height", "1", "write LOW:HIGH"),
        ("height", "2:1", "write LOW:HIGH"),
        ("height", "log:0:1", "above 0"),
        ("steps", "1.5:2", "integers"),
        ("height", "0.1:9", "give at most 3"),
    ],
)
def test_an_invalid_range_is_reported_before_anything_runs(
    in_process: type[InProcessExecutor],
    rooms: list[Path],
    tmp_path: Path,
    name: str,
    text: str,
    expected: str,
) -> None:
    with pytest.raises(UsageError, match=expected):
        bench(table(rooms, search=spec(**{name: text})), tmp_path / "out")
    assert not (tmp_path / "out").exists()
