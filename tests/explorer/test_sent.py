"""The page as one file: its stored answers are those of the server."""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import cv2
import numpy as np
import pytest

import dynaviz as dv
from dynaviz.errors import DataError, UsageError
from dynaviz.explorer import sent
from dynaviz.explorer.answers import Explored
from dynaviz.explorer.run import ExploredRun

Command = Callable[..., tuple[int, str, str]]
ADDRESS = re.compile(r"\w+://[\w.-]+")
NAMESPACE = "http://www.w3.org"  # of drawings, which is a name and no address


class SentPage:
    """What a written page contains.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self.text = path.read_text()
        self.answers: dict[str, Any] = json.loads(
            gzip.decompress(base64.b64decode(self._script("answers")))
        )
        self.pictures: dict[str, Any] = json.loads(self._script("pictures"))
        modules = json.loads(self.between('<script type="importmap">'))["imports"]
        self.modules = {
            name: base64.b64decode(address.partition(",")[2]).decode()
            for name, address in modules.items()
        }

    def _script(self, name: str) -> str:
        return self.between(f' id="{name}">')

    def between(self, start: str) -> str:
        return self.text.partition(start)[2].partition("</script>")[0]


@pytest.fixture(scope="module")
def alone(runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> SentPage:
    path = dv.export_page(tmp_path_factory.mktemp("sent") / "page.html", runs["fine"])
    return SentPage(path)


@pytest.fixture(scope="module")
def explored(runs: dict[str, Path]) -> Explored:
    return Explored(ExploredRun(runs["fine"]))


def test_answers_are_those_of_the_server(alone: SentPage, explored: Explored) -> None:
    asked = dict.fromkeys(("runs", "evidence", "point", "why"), 0)
    for question, answer in alone.answers.items():
        name, _, query = question.partition("?")
        if name not in asked:
            continue
        asked[name] += 1
        expected = json.loads(json.dumps(explored.answers[name](dict(parse_qsl(query)))))
        for found in (answer, expected):
            found.pop("seconds", None)  # of a replay, which the page cannot start
            for part in (found, found.get("why") or {}):
                part.pop("what_if", None)  # its sliders have fewer steps
            if "map" in found:
                evidence = found["map"].pop("evidence")
                found["map"]["known"] = {row for row, *_ in evidence} & _rows(alone)
        assert answer == expected, question
    assert all(asked.values()), asked


def _rows(page: SentPage) -> set[int]:
    """The rows of all points that the page explains."""
    queries = (dict(parse_qsl(name.partition("?")[2])) for name in page.answers)
    return {int(query["point"]) for query in queries if "point" in query}


def test_sliders_count_as_the_server_does(alone: SentPage, explored: Explored) -> None:
    checked = 0
    for question, answer in alone.answers.items():
        name, _, query = question.partition("?")
        if name != "judge":
            continue
        for parameter, values in answer["values"].items():
            assert len(values) <= sent.STEPS + 2
            for value, stored in values[:: max(len(values) // 3, 1)]:
                settings = json.dumps({parameter: value})
                found = explored.answers["judge"]({**dict(parse_qsl(query)), "settings": settings})
                assert stored == found
                checked += 1
    assert checked > 10
    dial = alone.answers["dial?run=a"]
    assert dial["values"]
    for parameter, values in dial["values"].items():
        value, stored = values[len(values) // 2]
        settings = json.dumps({parameter: value})
        found = explored.answers["dial"]({"run": "a", "settings": settings})
        same = {key: found[key] for key in stored}
        assert stored == json.loads(json.dumps(same))


def test_each_position_of_a_slider_has_an_answer(alone: SentPage) -> None:
    dial = alone.answers["dial?run=a"]
    for slider in dial["given"]["parameters"]:
        known = np.array([value for value, _ in dial["values"][slider["name"]]])
        positions = np.arange(slider["low"], slider["high"] + slider["step"] / 2, slider["step"])
        assert np.abs(known[:, None] - positions).min(0).max() < 1e-5


def test_each_case_has_a_picture_of_its_worst_frame(alone: SentPage) -> None:
    cases = alone.answers["runs?"]["a"]["cases"]
    assert len(alone.pictures) == len(cases) > 0
    for case in cases:
        frames = dict(alone.pictures[f"a a {case['number']}"])
        assert case["worst"] in frames
        assert len(frames) <= sent.FRAMES + 1
        for frame, content in frames.items():
            data = np.frombuffer(base64.b64decode(content), np.uint8)
            size = cv2.imdecode(data, cv2.IMREAD_COLOR).shape[1::-1]
            assert size == (sent.LARGE if frame == case["worst"] else sent.SMALL)


def test_no_part_of_it_is_elsewhere(alone: SentPage) -> None:
    parts = [alone.text.partition("<script")[0], *alone.modules.values()]
    found = {address for part in parts for address in ADDRESS.findall(part)}
    assert {address for address in found if not address.startswith(NAMESPACE)} == set()
    imported = {name for part in parts[1:] for name in re.findall(r"from '(.+?)'", part)}
    assert imported | {"main.js"} == alone.modules.keys()
    assert not re.search(r'(?:src|href)="(?!data:)', alone.text.partition("<script")[0])


def test_of_two_runs_each_has_a_picture_of_each_case(runs: dict[str, Path], tmp_path: Path) -> None:
    page = SentPage(dv.export_page(tmp_path / "two.html", runs["fine"], runs["coarse"]))
    facts = page.answers["runs?"]
    expected = {
        f"{shown} {owner} {case['number']}"
        for owner in facts
        for case in facts[owner]["cases"]
        for shown in "ab"
    }
    assert page.pictures.keys() == expected


def test_a_run_without_truth_can_be_sent(runs: dict[str, Path], tmp_path: Path) -> None:
    page = SentPage(dv.export_page(tmp_path / "unknown.html", runs["unknown"]))
    assert page.answers["dial?run=a"] == {"given": {}, "values": {}}
    assert page.answers["runs?"]["a"]["cases"]


def test_the_command_writes_it(run_command: Command, runs: dict[str, Path], tmp_path: Path) -> None:
    page = tmp_path / "deep/page.html"
    code, shown, err = run_command("explore", runs["fine"], "--export", page)
    assert code == 0, err
    assert f"Written to {page}" in shown
    assert SentPage(page).answers["runs?"]["a"]["method"] == "octomap"


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (["--export", "page.pdf"], "ends in .html"),
        (["--export", "page.html", "--port", "8000"], "--port: not with --export"),
        (["--export", "page.html", "--case", "1"], "--case: not with --export"),
    ],
)
def test_what_does_not_fit_is_refused(
    run_command: Command,
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    more: list[str],
    problem: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run_command("explore", runs["fine"], *more)
    assert code == 2
    assert problem in err
    assert not list(tmp_path.iterdir())


def test_runs_without_points_and_blocked_files_are_errors(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    with pytest.raises(DataError, match="scores alone"):
        dv.export_page(tmp_path / "page.html", runs["scores"])
    with pytest.raises(UsageError, match=r"ends in \.html"):
        dv.export_page(tmp_path / "page", runs["fine"])
    (tmp_path / "file").touch()
    with pytest.raises(DataError):
        dv.export_page(tmp_path / "file/page.html", runs["unknown"])
