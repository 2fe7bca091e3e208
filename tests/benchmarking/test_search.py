"""Searching parameters: what is found, that it is found again, and that nothing held out is looked at."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.toy_method import Here, write_room

from dynaviz import params, registry
from dynaviz.benchmarking import source as sources
from dynaviz.benchmarking.bench import bench
from dynaviz.errors import DynavizError, UsageError
from dynaviz.results.collect import combined

pytest.importorskip("optuna", reason="needs optuna: pip install 'dynaviz[tune]'")


def wish(kind: str = "bayes", trials: int = 6, **ranges: str) -> dict[str, object]:
    return {"kind": kind, "trials": trials, "ranges": {"toy": ranges or {"height": "0.1:2.0"}}}


def table(rooms: list[Path], **more: object) -> dict[str, object]:
    return {"methods": ["toy"], "record": "none", "sequences": [str(room) for room in rooms], **more}


def tried(out: Path) -> list[str]:
    return sorted(path.parent.name for path in out.glob("one/*/result.json"))


@pytest.mark.parametrize("kind", ["random", "bayes"])
def test_the_best_of_the_trials_is_found_and_can_be_fed_back(
    here: type[Here], rooms: list[Path], tmp_path: Path, kind: str
) -> None:
    board = bench(table(rooms, search=wish(kind, 9)), tmp_path)
    (found,) = board.found
    every = [*board.rows, *board.trials]
    assert len({row.folder for row in every}) == len(every) == 20
    assert {row.cell.what.variant for row in board.rows} == {"", found.best.variant}
    by_variant = {
        variant: combined([row.result for row in every if row.result and row.cell.what.variant == variant])
        for variant in {row.cell.what.variant for row in every}
    }
    assert len(by_variant) == 10
    assert found.aa == max(total.metrics["AA"] for total in by_variant.values())
    assert by_variant[found.best.variant].metrics["AA"] == found.aa
    assert found.aa > found.default_aa == by_variant[""].metrics["AA"]
    assert 0.8 < found.best.parameters["height"] < 1.4  # the box is 1 m high
    resolved = params.resolve(registry.load("methods", "toy"), config=found.preset)
    assert resolved.params.height == found.best.parameters["height"]
    remark = found.preset.read_text()
    for fact in (
        f"AA {found.aa:.2f} %",
        "9 trials",
        "one, two",
        "seed 0",
        "height = 0.1:2.0",
        f"{found.default_aa:.2f}",
    ):
        assert fact in remark


def test_a_best_set_that_a_grid_has_too_counts_once(here: type[Here], rooms: list[Path], tmp_path: Path) -> None:
    grid = {"toy": {"height": [1.0]}}
    both = bench(table(rooms, grid=grid, search=wish(trials=1, height="1.0:1.0")), tmp_path)
    assert both.found[0].best.variant == "height=1.0"
    alone = bench(table(rooms, grid=grid), tmp_path)
    assert [row.folder for row in both.rows] == [row.folder for row in alone.rows]
    assert [total.counts for total in both.totals()] == [total.counts for total in alone.totals()]
    held = bench(table(rooms, grid=grid, search=wish(trials=1, height="1.0:1.0"), holdout=["two"]), tmp_path)
    assert len({row.folder for row in held.rows}) == len(held.rows) == 4


def test_a_search_goes_on_where_it_was_left(here: type[Here], rooms: list[Path], tmp_path: Path) -> None:
    whole = bench(table(rooms[:1], search=wish(trials=12)), tmp_path / "whole")
    bench(table(rooms[:1], search=wish(trials=5)), tmp_path / "parts")
    first = tried(tmp_path / "parts")
    rest = bench(table(rooms[:1], search=wish(trials=12)), tmp_path / "parts")
    assert len(here.ran) == 13 - len(first)
    assert tried(tmp_path / "parts") == tried(tmp_path / "whole")
    assert rest.found[0].best == whole.found[0].best


def test_whole_numbers_stay_whole_and_may_be_logarithmic(here: type[Here], rooms: list[Path], tmp_path: Path) -> None:
    board = bench(table(rooms[:1], search=wish("random", 5, steps="log:1:50", height="log:0.1:2")), tmp_path)
    steps = [row.cell.what.parameters["steps"] for row in board.trials]
    assert all(isinstance(step, int) and 1 <= step <= 50 for step in steps)
    heights = [row.cell.what.parameters["height"] for row in board.trials]
    assert all(height == float(f"{height:.4g}") for height in heights)


def test_the_search_never_opens_what_is_held_out(
    here: type[Here], rooms: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[tuple[str, int]] = []
    real = sources.api.open

    def spy(path: str, **how: object):
        opened.append((Path(path).name, len(here.ran)))
        return real(path, **how)

    monkeypatch.setattr(sources.api, "open", spy)
    board = bench(table(rooms[:1], holdout=[str(rooms[1])], search=wish(trials=4)), tmp_path / "a")
    assert min(ran for name, ran in opened if name == "two") == 5, "before the defaults and all trials had run"
    assert min(ran for name, ran in opened if name == "one") == 0
    assert here.ran[5:] == ["two/toy", f"two/toy-{board.found[0].best.variant}"]
    assert {row.cell.source.name for row in board.trials} == {"one"}


def test_what_is_held_out_changes_nothing(here: type[Here], rooms: list[Path], tmp_path: Path) -> None:
    bad = write_room(tmp_path / "two", frames=2, rays=300)
    for path in (bad / "pcd").iterdir():
        path.write_bytes(path.read_bytes()[:-9])
    presets = []
    for held in (rooms[1], bad):
        board = bench(
            table([rooms[0], held], holdout=["two"], search=wish(trials=3)), tmp_path / "out" / held.parent.name
        )
        presets.append(board.found[0].preset.read_bytes())
    assert presets[0] == presets[1]
    assert [row.cell.source.name for row in board.failed] == ["two", "two"]


def test_without_truth_there_is_nothing_to_search(here: type[Here], tmp_path: Path) -> None:
    blind = write_room(tmp_path / "blind", frames=1, rays=100)
    (blind / "gt_cloud.pcd").unlink()
    with pytest.raises(DynavizError, match="no set of parameters has an AA"):
        bench(table([blind], search=wish(trials=2)), tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("hight", "0.1:1", "Did you mean 'height'"),
        ("act", "0:1", "is no number"),
        ("height", "1", "write LOW:HIGH"),
        ("height", "2:1", "write LOW:HIGH"),
        ("height", "log:0:1", "above 0"),
        ("steps", "1.5:2", "whole numbers"),
        ("height", "0.1:9", "give at most 3"),
    ],
)
def test_a_range_that_is_none_is_told_before_anything_runs(
    here: type[Here], rooms: list[Path], tmp_path: Path, name: str, text: str, says: str
) -> None:
    with pytest.raises(UsageError, match=says):
        bench(table(rooms, search=wish(**{name: text})), tmp_path / "out")
    assert not (tmp_path / "out").exists()
