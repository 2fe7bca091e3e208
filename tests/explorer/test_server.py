"""What the server of the explorer answers, to whom, and what it refuses."""

from __future__ import annotations

import json
import math
import shutil
import socket
import struct
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import cv2
import numpy as np
import pytest

import dynaviz as dv
from dynaviz import colours
from dynaviz.arrays import U8
from dynaviz.contracts.scan import ERRORS, ErrorKind
from dynaviz.errors import DataError, UsageError
from dynaviz.explain.case_evidence import evidence_of
from dynaviz.explain.strip import strip
from dynaviz.explorer.cards import MAP_MARGIN, cards, surroundings
from dynaviz.explorer.run import ExploredRun
from dynaviz.explorer.server import Explorer
from dynaviz.scores.result import Result
from dynaviz.views.read.reader import RunRecording


@pytest.fixture(scope="module")
def explorer(runs: dict[str, Path]) -> Iterator[Explorer]:
    with dv.explore(runs["fine"], runs["coarse"]) as server:
        yield server


def get(url: str, **headers: str) -> tuple[int, bytes]:
    """Status and content of an address."""
    try:
        with urllib.request.urlopen(
            urllib.request.Request(url, headers=headers), timeout=30
        ) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def ask(explorer: Explorer, name: str, **query: Any) -> Any:
    """The JSON answer to a question of the page."""
    status, content = get(f"{explorer.url}api/{name}?{urlencode(query)}")
    assert status == 200, content
    return json.loads(content)


def test_nothing_is_served_without_the_token(explorer: Explorer) -> None:
    parts = urlsplit(explorer.url)
    home, token = f"http://{parts.netloc}", parts.path.strip("/")
    assert len(token) >= 32
    assert get(explorer.url)[0] == 200
    for path in (
        "/",
        "/main.js",
        "/a.rrd",
        "/api/runs",
        f"/{token[:-1]}/",
        f"/{token}x/api/runs",
        "/x/api/runs",
    ):
        assert get(home + path)[0] == 404, path


def test_each_server_has_its_own_token(runs: dict[str, Path], explorer: Explorer) -> None:
    with dv.explore(runs["fine"]) as other:
        assert urlsplit(other.url).path != urlsplit(explorer.url).path
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(other.url, timeout=5)


UNLISTED = (
    "labels.npz", "result.json", "run.rrd", "c.rrd", "server.py", "viewer/", "viewer/widget.py",
    "api/", "api/secret",
    "../server.py", "%2e%2e/server.py", "viewer/..%2f__init__.py", "/etc/passwd", "page/main.js",
)  # fmt: skip


@pytest.mark.parametrize("name", UNLISTED)
def test_files_that_are_not_listed_are_not_found(explorer: Explorer, name: str) -> None:
    assert get(explorer.url + name)[0] == 404


def messages(content: bytes) -> list[int]:
    """The kinds of the messages of a recording, up to its end of kind 0."""
    kinds, at = [], 12
    while at < len(content) and (not kinds or kinds[-1]):
        kind, size = struct.unpack_from("<QQ", content, at)
        kinds.append(kind)
        at += 16 + size
    return kinds


def test_recordings_are_served_with_a_passive_layout(
    explorer: Explorer, runs: dict[str, Path]
) -> None:
    for letter, run in (("a", "fine"), ("b", "coarse")):
        status, served = get(f"{explorer.url}{letter}.rrd")
        stored = (runs[run] / "run.rrd").read_bytes()
        # the last command: make this layout active
        active, passive = (
            b"\x10\x01\x18\x01",
            b"\x10\x00\x18\x01",
        )
        place = stored.rindex(active)
        assert status == 200
        assert served.startswith(stored[:place] + passive)
        *kinds, end = messages(stored)
        found = messages(served)
        assert end == 0
        assert end not in found  # it refers to positions in the file
        assert found == kinds


def test_it_listens_on_this_machine_alone_and_under_no_other_name(explorer: Explorer) -> None:
    address = urlsplit(explorer.url)
    assert address.hostname == "127.0.0.1"
    with (
        socket.socket() as elsewhere
    ):  # all of 127.0.0.0/8 leads to this machine, but only one address is bound
        assert elsewhere.connect_ex(("127.0.0.2", address.port)) != 0
    assert get(explorer.url, Host="example.org")[0] == 400


def test_the_page_allows_no_other_machine(explorer: Explorer) -> None:
    with urllib.request.urlopen(explorer.url, timeout=30) as answer:
        policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    assert "http" not in policy


def test_the_cases_are_those_of_the_result(explorer: Explorer, runs: dict[str, Path]) -> None:
    found = ask(explorer, "runs")
    assert [found[letter]["method"] for letter in "ab"] == ["octomap", "octomap"]
    result = Result.load(runs["fine"] / "result.json")
    cards = found["a"]["cases"]
    assert [(card["cost"], card["worst"], card["sentence"]) for card in cards] == [
        (case.cost, case.worst_frame, case.sentence) for case in result.failures
    ]
    for kind in ("ghost", "hole"):  # each wrong point is of one case
        of_kind = [card for card in cards if card["kind"] == kind]
        points = sum(card["points"] for card in of_kind)
        assert sum(sum(card["spark"]) for card in of_kind) >= points
        assert all(sum(card["spark"]) >= 0.8 * card["points"] for card in of_kind)
    assert all(card["wrong"] in ([], ["b"]) for card in cards)


def test_a_case_is_of_both_runs_if_both_are_wrong_at_most_of_its_points(
    explorer: Explorer, runs: dict[str, Path]
) -> None:
    fine, coarse = (RunRecording(runs[name] / "run.rrd") for name in ("fine", "coarse"))
    others = {answers.frame: answers for answers in coarse.answers()}
    drawn = list(fine.drawn())
    found = set()
    for card in ask(explorer, "runs")["a"]["cases"]:
        ghost = card["kind"] == "ghost"
        kind: ErrorKind = "false_negative" if ghost else "false_positive"
        wrong = []
        for points in drawn[card["first"] : card["last"] + 1]:
            rows = np.flatnonzero(points.outcome == ERRORS[kind])
            frames = np.full(len(rows), points.frame)
            owners = fine.case_points.owners(kind, frames, points.xyz[rows])
            mine = points.point[rows[owners == card["number"]]]
            answers = others[points.frame]
            wrong += (answers.dynamic[mine] != (answers.truth[mine] == 1)).tolist()
        assert card["wrong"] == (["b"] if np.mean(wrong) >= 0.5 else []), card["title"]
        found.add(len(card["wrong"]))
    assert found == {0, 1}


def test_up_to_nine_runs_are_compared(runs: dict[str, Path]) -> None:
    with dv.explore(runs["fine"], runs["coarse"], runs["fine"]) as server:
        found = ask(server, "runs")
        assert list(found) == ["a", "b", "c"]
        for card in found["a"]["cases"]:
            assert card["same"]["c"] == card["number"]  # the same run twice
            assert "c" in card["wrong"]
        assert list(ask(server, "point", frame=2, point=7)["runs"]) == ["a", "b", "c"]
    with pytest.raises(UsageError, match="10 runs: give at most 9"):
        dv.explore(*[runs["fine"]] * 10)


def stored(run: Path) -> Callable[[int, int], tuple[bool, str]]:
    """Label and reason of a point in ``labels.npz``."""
    with np.load(run / "labels.npz") as file:
        starts = np.concatenate([[0], np.cumsum(file["points"])])
        dynamic = np.unpackbits(file["dynamic"], count=int(starts[-1]))
        reasons, names = file["reasons"], file["reason_names"]
    return lambda frame, point: (
        bool(dynamic[starts[frame] + point]),
        str(names[reasons[starts[frame] + point]]),
    )


def test_clicks_give_the_stored_label_and_reason_of_each_run(
    explorer: Explorer, runs: dict[str, Path]
) -> None:
    known = {letter: stored(runs[name]) for letter, name in (("a", "fine"), ("b", "coarse"))}
    drawn = list(RunRecording(runs["fine"] / "run.rrd").drawn())
    random, asked = np.random.default_rng(0), 0
    for points in drawn:
        for instance in random.choice(
            len(points.xyz), min(9, len(points.xyz)), replace=False
        ).tolist():
            x, y, z = map(float, points.xyz[instance])
            place = {
                "run": "a",
                "entity": "/world/scan",
                "frame": points.frame,
                "x": x,
                "y": y,
                "z": z,
            }
            found = ask(explorer, "click", **place, instance=instance)
            assert (found["frame"], found["point"]) == (points.frame, points.point[instance])
            for letter, point in found["runs"].items():
                assert (point["removed"], point["reason"]) == known[letter](
                    found["frame"], found["point"]
                )
            asked += 1
    assert asked >= 40


def test_a_click_on_the_map_finds_the_wrong_point_in_its_frame(explorer: Explorer) -> None:
    card = ask(explorer, "runs")["a"]["cases"][0]
    point = ask(explorer, "point", frame=card["worst"], point=card["point"])
    x, y, z = point["runs"]["a"]["position"]
    place = {"run": "a", "entity": "/world/map/wrong", "x": x, "y": y, "z": z}
    assert (
        ask(explorer, "click", **place, frame=card["worst"], instance=0)["point"] == card["point"]
    )
    found = ask(explorer, "click", **place, frame=card["last"] + 40)
    assert found["runs"]["a"]["outcome"].startswith("false")
    assert get(f"{explorer.url}api/click?run=a&entity=world/map&frame=0&x=900&y=0&z=0")[0] == 400


@pytest.fixture
def mailed(runs: dict[str, Path], tmp_path: Path) -> Iterator[Explorer]:
    """The recording alone, far from its sequence."""
    (tmp_path / "run.rrd").write_bytes((runs["fine"] / "run.rrd").read_bytes())
    with dv.explore(tmp_path / "run.rrd") as server:
        yield server


def test_the_evidence_on_a_case_needs_no_sequence(mailed: Explorer, runs: dict[str, Path]) -> None:
    card = ask(mailed, "runs")["a"]["cases"][0]
    query = {"run": "a", "frame": card["worst"], "point": card["point"]}
    answer = ask(mailed, "why", **query)
    assert answer["metres"] == 0
    expected = json.loads(json.dumps(dv.why(runs["fine"], card["worst"], card["point"]).to_dict()))
    assert {name: answer["why"][name] for name in expected} == expected
    assert answer["why"]["ledger"]["entries"]
    rays, none = (
        len(get(f"{mailed.url}api/marks?{urlencode(asked)}")[1]) for asked in (query, {"run": "a"})
    )
    assert rays > none
    evidence = ask(mailed, "evidence", run="a", case=1)
    assert evidence["strip"]["points"] > 1
    assert [p["name"] for p in evidence["what_if"]["parameters"]] == [
        "prob_miss",
        "prob_hit",
        "clamp_min",
        "clamp_max",
    ]


def test_a_point_without_stored_evidence_has_that_of_one_beside_it(runs: dict[str, Path]) -> None:
    run, asked = ExploredRun(runs["coarse"]), 0
    ledgers = [
        ledger for case in range(1, len(run.result.failures) + 1) for ledger in run.ledgers(case)
    ]
    for frame in {ledger.frame for ledger in ledgers}:
        drawn = run.drawn(frame)
        assert drawn is not None
        for row in drawn.point.tolist():
            point = run.point(frame, row)
            alike = {
                ledger.point: math.dist(ledger.position, point["position"])
                for ledger in ledgers
                if (ledger.frame, ledger.removed, ledger.reason.name)
                == (frame, point["removed"], point["reason"])
            }
            found = run.stored(frame, row)
            if min(alike.values(), default=math.inf) > 0.5:
                assert found is None
            else:
                assert found is not None
                assert found[1] == alike[found[0].point] == min(alike.values())
                asked += row not in alike
    assert asked


def test_the_evidence_of_chosen_points_is_that_of_their_ledgers(
    mailed: Explorer, runs: dict[str, Path]
) -> None:
    ledgers = RunRecording(runs["fine"] / "run.rrd").ledgers(1)
    drawn = ask(mailed, "evidence", run="a", case=1)["map"]
    assert [row for row, *_ in drawn["evidence"]] == [ledger.point for ledger in ledgers]
    some = ledgers[::2]
    rows = ",".join(str(ledger.point) for ledger in some)
    found = ask(mailed, "evidence", run="a", case=1, points=rows)
    assert found["strip"] == json.loads(json.dumps(strip(some)))
    assert found["text"] == evidence_of(some).text
    assert ask(mailed, "evidence", run="a", case=1, points="999999") == {}


def test_the_map_of_a_case_contains_its_points(runs: dict[str, Path]) -> None:
    run = ExploredRun(runs["fine"])
    explained = [card for card in cards(run) if run.ledgers(card.number)]
    assert len(explained) > 1
    for card in explained[:3]:
        found = surroundings(run, card, run.ledgers(card.number))
        mine = run.wrong.xyz[card.rows[run.wrong.frame[card.rows] == card.case.worst_frame]]
        assert len(found["points"]) == len(mine) > 0
        assert np.allclose(found["points"] + card.low - MAP_MARGIN, mine, atol=0.01)
        assert len(found["around"][card.outcome.name.lower()]) >= len(mine)
        places = np.array([place for _, *place in found["evidence"]])
        assert (
            (places >= MAP_MARGIN - 0.02) & (places <= np.array(found["size"]) - MAP_MARGIN + 0.02)
        ).all()


def test_other_points_are_explained_by_a_replay(explorer: Explorer, runs: dict[str, Path]) -> None:
    query = {"run": "a", "frame": 0, "point": 3}
    if "why" not in ask(explorer, "why", **query):
        assert ask(explorer, "why", **query)["seconds"] > 0
    end = time.monotonic() + 60
    while "why" not in (answer := ask(explorer, "why", **query, exact=1)):
        assert "error" not in answer, answer
        assert time.monotonic() < end
        time.sleep(0.05)
    expected = json.loads(json.dumps(dv.why(runs["fine"], 0, 3).to_dict()))
    assert {name: answer["why"][name] for name in expected} == expected


def test_a_run_with_other_parameters_opens_the_comparison(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    shutil.copytree(runs["fine"], tmp_path / "fine")
    with dv.explore(tmp_path / "fine") as server:
        query = urlencode({"run": "a", "settings": json.dumps({"prob_miss": 0.3})})
        with urllib.request.urlopen(
            urllib.request.Request(f"{server.url}api/run?{query}", method="POST")
        ) as answer:
            state = json.load(answer)
        end = time.monotonic() + 60
        while "phase" in state:
            assert time.monotonic() < end
            time.sleep(0.05)
            state = ask(server, "run")
        with urllib.request.urlopen(f"{state['url']}api/runs", timeout=30) as answer:
            compared = json.load(answer)
    assert [compared[letter]["variant"] for letter in "ab"] == ["", "prob_miss=0.3"]
    assert (
        Result.load(tmp_path / "fine" / "with_prob_miss=0.3" / "result.json").parameters[
            "prob_miss"
        ]
        == 0.3
    )


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ("point?frame=77&point=0", "frame 77: the run has the frames 0 to 5"),
        ("point?frame=0&point=9999", "point 9999: frame 0 has the points 0 to 699"),
        ("point?frame=x&point=0", "frame: give a whole number"),
        ("why?run=c&frame=0&point=0", "run c: choose from a, b"),
        ("layout?case=999", "case 999: the run has the cases 1 to"),
        ("layout?case=1&layout=sky", "layout sky: choose from case, frame, map"),
        ("click?frame=0&x=1&y=2", "z: give a number"),
        ("rescored?run=c", "run c: choose from a, b"),
    ],
)
def test_wrong_questions_get_a_line(explorer: Explorer, question: str, message: str) -> None:
    status, content = get(f"{explorer.url}api/{question}")
    assert status == 400
    assert message in json.loads(content)["error"]


@pytest.mark.parametrize(
    "question",
    ["loading", "layout?case=1", "layout?case=1&first=1", "layout?case=1&layout=map", "marks"],
)
def test_layouts_and_marks_are_recordings(explorer: Explorer, question: str) -> None:
    assert get(f"{explorer.url}api/{question}{'&' if '?' in question else '?'}run=b")[1].startswith(
        b"RRF2"
    )


def test_files_are_written_on_request_only(explorer: Explorer, runs: dict[str, Path]) -> None:
    assert get(f"{explorer.url}api/correct?case=1&truth=static")[0] == 404
    assert not (runs["fine"] / "corrections.json").exists()


def pixels(png: bytes) -> U8:
    """(rows, columns, 3) uint8 RGB."""
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)[
        :, :, ::-1
    ]


def test_cases_are_drawn_at_once(explorer: Explorer) -> None:
    small, large = (
        get(f"{explorer.url}api/drawing?case=1{size}")[1] for size in ("", "&width=640&height=400")
    )
    assert pixels(small).shape == (108, 168, 3)
    assert pixels(large).shape == (400, 640, 3)
    facts = ask(explorer, "runs")["a"]["cases"][0]
    colour = colours.BRIGHT[
        ERRORS["false_negative" if facts["kind"] == "ghost" else "false_positive"]
    ]
    rows, columns = np.nonzero((pixels(large) == colour).all(2))
    assert len(rows)
    assert 200 - 40 < np.median(rows) < 200 + 40  # the eye looks at the middle of the case
    assert 320 - 64 < np.median(columns) < 320 + 64


def test_runs_without_ground_truth_have_clusters(runs: dict[str, Path]) -> None:
    with dv.explore(runs["unknown"]) as server:
        (facts,) = ask(server, "runs").values()
        assert not facts["truth"]
        clusters = Result.load(runs["unknown"] / "result.json").clusters
        assert [(card["suspicion"], card["kind"]) for card in facts["cases"]] == [
            (c.suspicion, "removed") for c in clusters
        ]
        assert get(f"{server.url}api/layout?case=1")[0] == 200


def test_runs_that_cannot_be_explored(runs: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(DataError, match="without points to explore"):
        dv.explore(runs["scores"])
    with pytest.raises(DataError, match=r"contains no result\.json and no run\.rrd"):
        dv.explore(tmp_path)
    with pytest.raises(UsageError, match="from a different sequence"):
        dv.explore(runs["fine"], runs["unknown"])


def test_results_are_explored_in_the_folder_of_their_run(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    scans = dv.open(runs["fine"].parent / "room", frames="0:2")
    results = [
        Result.load(runs["fine"] / "result.json"),
        dv.run("octomap", scans, out=tmp_path / "run"),
    ]
    for result, frames in zip(results, (6, 2), strict=True):
        with dv.explore(result) as server:
            assert ask(server, "runs")["a"]["frames"] == frames
    with pytest.raises(UsageError, match="the run was not recorded"):
        dv.explore(dv.run("octomap", scans))


def test_a_notebook_shows_the_page(explorer: Explorer) -> None:
    assert f'<iframe src="{explorer.url}"' in explorer._repr_html_()
