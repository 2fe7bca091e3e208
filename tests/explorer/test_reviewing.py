"""What the page of a review asks, decides and writes."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.io.fields import coordinates, read_fields
from dynaviz.sources.datasets.convert import convert

if TYPE_CHECKING:
    from dynaviz.explorer.server import Explorer

SECONDS = 60.0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a recording."""
    folder = tmp_path_factory.mktemp("review")
    sequence = room(6, 3000)
    convert(sequence, folder / "room")
    dv.run("octomap", folder / "room", out=folder / "run", record="errors", threads=1)
    return folder / "run"


@pytest.fixture
def explorer(run: Path, tmp_path: Path) -> Iterator[Explorer]:
    with dv.explore(shutil.copytree(run, tmp_path / "run")) as server:
        yield server


def ask(explorer: Explorer, name: str, post: bool = False, **query: Any) -> Any:
    address = Request(
        f"{explorer.url}api/{name}?{urlencode(query)}", method="POST" if post else "GET"
    )
    with urlopen(address, timeout=SECONDS) as answer:
        content = answer.read()
    return json.loads(content) if "json" in answer.headers["content-type"] else content


def overview(explorer: Explorer) -> Any:
    end = time.monotonic() + SECONDS
    while "candidates" not in (found := ask(explorer, "review")):
        assert "error" not in found
        assert time.monotonic() < end
        time.sleep(0.05)
    return found


def points(explorer: Explorer, number: int) -> Any:
    return np.frombuffer(ask(explorer, "review_points", candidate=number), "<f4").reshape(-1, 5)


def test_a_decision_is_counted_and_can_be_taken_back(explorer: Explorer, tmp_path: Path) -> None:
    found = overview(explorer)
    assert 1 <= found["worth"] <= len(found["candidates"])
    first = found["candidates"][0]
    verdict = "dynamic" if first["answered"] == "kept" else "static"
    made = ask(explorer, "decide", post=True, candidate=1, verdict=verdict, reviewer="AB")
    assert [each["key"] for each in made["decisions"]] == [first["key"]]
    assert made["kept"] + made["removed"] == pytest.approx(first["points"], rel=0.05)
    flags = points(explorer, 1)[:, 4].astype(int)
    assert ((flags >> 2 > 0) == (flags & 2 > 0)).all()
    labels = dv.review(tmp_path / "run").labels
    before = dv.review(tmp_path / "run", review=tmp_path / "none.json").labels
    changed = sum(int((a != b).sum()) for a, b in zip(before, labels, strict=True))
    assert changed == made["kept"] + made["removed"]
    undone = ask(explorer, "undo", post=True)
    assert undone["undone"] == first["key"]
    assert (undone["kept"], undone["removed"], undone["decisions"]) == (0, 0, [])


def test_two_pages_add_to_one_file(explorer: Explorer, tmp_path: Path) -> None:
    overview(explorer)
    with dv.explore(tmp_path / "run") as other:
        overview(other)
        ask(explorer, "decide", post=True, candidate=1, verdict="static")
        made = ask(other, "decide", post=True, candidate=1, verdict="undecided")
        assert [each["verdict"] for each in made["decisions"]] == ["static", "undecided"]


def test_a_box_is_decided_from_a_frame_on(explorer: Explorer) -> None:
    overview(explorer)
    place = ask(explorer, "review_place", candidate=1)
    low, high = (",".join(map(str, place[name])) for name in ("low", "high"))
    box = {"candidate": 1, "verdict": "dynamic", "low": low, "high": high}
    every = ask(explorer, "decide", post=True, **box)["decisions"][-1]
    both = ask(explorer, "decide", post=True, **box, first=3)["decisions"]
    seen = points(explorer, 1)
    inside = ((seen[:, :3] >= place["low"]) & (seen[:, :3] <= place["high"])).all(1)
    assert every["points"] == pytest.approx(inside.sum(), abs=3)  # rounded in the answer
    assert both[1]["points"] == pytest.approx((inside & (seen[:, 3] >= 3)).sum(), abs=3)
    assert both[0]["points"] + both[1]["points"] == every["points"]  # the last one holds


def test_what_a_place_shows_is_what_the_scans_have_there(explorer: Explorer) -> None:
    found = overview(explorer)
    for each in found["candidates"][:5]:
        place = ask(explorer, "review_place", candidate=each["number"])
        assert len(place["points"]) == len(place["through"]) == found["frames"]
        assert each["first"] <= place["best"] <= each["last"]
        seen = points(explorer, each["number"])
        chosen = seen[seen[:, 4].astype(int) & 2 > 0]
        counted = np.bincount(chosen[:, 3].astype(int), minlength=found["frames"])
        assert counted.tolist() == place["points"]


def test_the_map_is_written_with_the_decisions(explorer: Explorer, tmp_path: Path) -> None:
    found = overview(explorer)
    made = ask(explorer, "decide", post=True, candidate=1, verdict="dynamic")
    out = tmp_path / "map.npz"
    state = ask(explorer, "write", post=True, out=out)
    end = time.monotonic() + SECONDS
    while "text" not in state:
        assert "error" not in state
        assert time.monotonic() < end
        time.sleep(0.05)
        state = ask(explorer, "written")
    labels = dv.review(tmp_path / "run").labels
    kept = sum(int((~each).sum()) for each in labels)
    assert len(coordinates(read_fields(out))) == kept
    assert f"{kept:,} kept" in state["text"]
    assert made["decisions"]
    assert Path(found["out"]).parent.is_dir()


@pytest.mark.parametrize(
    ("name", "query", "problem"),
    [
        ("decide", {"candidate": 0, "verdict": "static"}, "candidate 0"),
        ("decide", {"candidate": 1, "verdict": "gone"}, "verdict gone"),
        ("decide", {"candidate": 1, "verdict": "static", "low": "1,2", "high": "x"}, "low"),
        ("undo", {}, "no decision to undo"),
        ("write", {"out": "map.xyz123"}, ""),
    ],
)
def test_bad_questions_are_refused(
    explorer: Explorer, name: str, query: dict[str, Any], problem: str
) -> None:
    overview(explorer)
    if name == "write":
        state = ask(explorer, name, post=True, **query)
        while "phase" in state:
            state = ask(explorer, "written")
        assert "map.xyz123" in state["error"]
        return
    with pytest.raises(HTTPError) as refused:
        ask(explorer, name, post=True, **query)
    assert refused.value.code == 400
    assert problem in json.loads(refused.value.read())["error"]


def test_a_damaged_file_is_refused_in_one_line(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "run")
    (tmp_path / "run" / "review.json").write_text("{")
    with dv.explore(tmp_path / "run") as server:
        end = time.monotonic() + SECONDS
        while "error" not in (found := ask(server, "review")):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert "review.json" in found["error"]
        assert "\n" not in found["error"]
    assert (tmp_path / "run" / "review.json").read_text() == "{"
