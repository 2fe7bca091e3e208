"""The page of the explorer as one file, for people without dynaviz.

The same page, with the answers that its server would give and pictures in place of the viewer.
"""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dynaviz.arrays import Bool
from dynaviz.errors import UsageError
from dynaviz.explain.judging import Parameter, numbers_of, of_ledgers
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.rays import evenly
from dynaviz.explorer import cards
from dynaviz.explorer.answers import Explored
from dynaviz.explorer.run import ExploredRun
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.views.read.still import spread

PAGE = Path(__file__).with_name("page")
REPLACED = {"server.js": "embedded.js", "viewer.js": "still.js"}
IMPORT = re.compile(r"from '\./([\w.]+)'")  # of a script by another
POLICY = (  # the browser itself refuses all requests
    "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; "
    "img-src data:; base-uri 'none'; form-action 'none'"
)
VIEWERS = 2  # runs with pictures, as the page has viewers of the first two
FRAMES = 6  # with a picture, of each case
LARGE = (640, 400)  # pixels: the picture of the worst frame ...
SMALL = (320, 200)  # ... and of the others
OF_TWO = (480, 300)  # of several runs there is only the worst frame
POINTS = 8  # of a case that are explained
STEPS = 20  # of a slider


def write_page(
    path: str | os.PathLike[str], explored: Explored, progress: Progress = silent
) -> Path:
    """Write the page of a run, or of several runs on the same points, as one HTML file.

    It asks no server and opens offline. It has the cases, what was stored on them, the ledgers of
    up to ``POINTS`` of the points of each, pictures of up to ``FRAMES`` frames, and the answers for
    ``STEPS`` values of each parameter that can be turned.

    Args:
        path: of the file, which ends in ``.html``.
        explored: the runs.
        progress: called with ``export``, the number of finished cases, and their number.

    Raises:
        UsageError: if the name does not end in ``.html``.
        DataError: if the file cannot be written.
    """
    path = checked(path)
    answers = StoredAnswers(explored)
    total = sum(len(of) for of in explored.cards.values())
    done = 0
    for letter in explored.runs:
        answers.add_run(letter)
        for card in explored.cards[letter]:
            answers.add_case(letter, card)
            done += 1
            progress("export", done, total)
    write_atomic(path, page(answers.answers, answers.pictures).encode())
    return path


def checked(path: str | os.PathLike[str]) -> Path:
    """The path of a page.

    Raises:
        UsageError: if its name does not end in ``.html``.
    """
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--export {path}: is a page. Give a name that ends in .html")
    return path


def page(answers: Mapping[str, Any], pictures: Mapping[str, Any]) -> str:
    """The HTML of the page.

    Args:
        answers: by question, as the page writes it.
        pictures: by run, owner and number of the case, its frames with the content of a picture.
    """
    modules = {name: _module(script) for name, script in _scripts().items()}
    packed = base64.b64encode(gzip.compress(_json(answers).encode(), 9, mtime=0)).decode()
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<style>\n{(PAGE / 'style.css').read_text()}</style>"
    )
    body = (
        f'<script type="application/json" id="pictures">{_json(pictures)}</script>\n'
        f'<script type="text/plain" id="answers">{packed}</script>\n'
        f'<script type="importmap">{_json({"imports": modules})}</script>\n'
        '<script type="module">import "main.js"</script>'
    )
    html = (PAGE / "index.html").read_text()
    for old, new in (
        ('<link rel="stylesheet" href="viewer/widget.css">\n', ""),
        (' href="review.html"', ""),
        ('<link rel="stylesheet" href="style.css">', head),
        ('<script type="module" src="main.js"></script>', body),
    ):
        assert old in html
        html = html.replace(old, new)
    return html


def _scripts() -> dict[str, str]:
    """The scripts of the page by name: the first one, and all that are imported."""
    found: dict[str, str] = {}
    waiting = ["main.js"]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name] = (PAGE / REPLACED.get(name, name)).read_text()
            waiting += IMPORT.findall(found[name])
    return found


def _module(script: str) -> str:
    """A module of the page as an address, which imports others by their names alone."""
    script = IMPORT.sub(r"from '\1'", script)
    return "data:text/javascript;charset=utf-8;base64," + base64.b64encode(script.encode()).decode()


def _json(content: Any) -> str:
    return json.dumps(content, separators=(",", ":"))


class StoredAnswers:
    """The answers to what the page can ask without a server.

    Args:
        explored: the runs.

    Attributes:
        answers, pictures: as for ``page``.
    """

    def __init__(self, explored: Explored) -> None:
        self._explored = explored
        self.answers: dict[str, Any] = {}
        self.pictures: dict[str, list[tuple[int, str]]] = {}
        self._keep("runs", {}, explored.answers["runs"]({}))

    def add_run(self, letter: str) -> None:
        """What the page asks about a whole run."""
        explored = self._explored
        if self.answers["runs?"][letter]["corrections"]:
            of_run = {"run": letter}
            self._keep("rescored", of_run, explored.answers["rescored"](of_run))
        dial = explored.runs[letter].dial
        given = explored.answers["dial"]({"run": letter, "settings": "{}"})
        values: dict[str, list[tuple[float, Any]]] = {}
        if dial is not None:
            given = {**given, "parameters": _coarse(given["parameters"])}
            for each in given["parameters"]:
                values[each["name"]] = [
                    (value, self._turned(letter, each["name"], value)) for value in _values(each)
                ]
        self._keep("dial", {"run": letter}, {"given": given, "values": values})

    def _turned(self, letter: str, name: str, value: float) -> dict[str, Any]:
        query = {"run": letter, "settings": json.dumps({name: value})}
        found = self._explored.answers["dial"](query)
        return {key: found[key] for key in ("scores", "cases", "text")}

    def add_case(self, letter: str, card: cards.Card) -> None:
        """What the page asks about a case, and its pictures."""
        run = self._explored.runs[letter]
        ledgers = run.ledgers(card.number)
        query = {"run": letter, "case": str(card.number)}
        evidence = _with_coarse(self._explored.answers["evidence"](query))
        rows = _chosen(ledgers, card.point)
        if evidence:
            known = [each for each in evidence["map"]["evidence"] if each[0] in rows]
            evidence["map"] = {**evidence["map"], "evidence": known}
        self._keep("evidence", query, evidence)
        frame = card.case.worst_frame
        for row in rows:
            self._add_point(letter, frame, row)
        if evidence and evidence["what_if"]:
            self._add_sliders(letter, card, rows, evidence["what_if"]["parameters"])
        for shown in list(self._explored.runs)[:VIEWERS]:
            self.pictures[f"{shown} {letter} {card.number}"] = list(self._drawn(shown, run, card))

    def _add_point(self, owner: str, frame: int, row: int) -> None:
        """Truth, answer, reason and ledger of a point in each run.

        Its sliders are those of the run whose case it is of.
        """
        at = {"frame": str(frame), "point": str(row)}
        self._keep("point", at, self._explored.answers["point"](at))
        for letter in self._explored.runs:
            query = {"run": letter, **at}
            found = self._explored.answers["why"](query)
            if "why" in found:
                document = _with_coarse(found["why"])
                if letter != owner:
                    document["what_if"] = None
                self._keep("why", query, {**found, "why": document})
            else:
                self._keep("why", query, {})

    def _add_sliders(
        self,
        letter: str,
        card: cards.Card,
        rows: Sequence[int],
        parameters: Sequence[Mapping[str, Any]],
    ) -> None:
        """How many points of a case would be removed with each value of a slider, and whether those
        in some rows of their scan would be.
        """
        run = self._explored.runs[letter]
        ledgers = run.ledgers(card.number)
        given = numbers_of(run.result.parameters)
        judged = of_ledgers(ledgers, given)
        turned = [
            (each["name"], value, judged.judge({each["name"]: value}, given))
            for each in parameters
            for value in _values(each)
        ]
        at = {"run": letter, "frame": str(card.case.worst_frame)}
        self._keep_counts({"run": letter, "case": str(card.number)}, turned)
        for k, ledger in enumerate(ledgers):
            if ledger.point in rows:
                alone = [(name, value, removed[k : k + 1]) for name, value, removed in turned]
                self._keep_counts({**at, "point": str(ledger.point)}, alone)

    def _keep_counts(
        self, query: Mapping[str, str], turned: Sequence[tuple[str, float, Bool]]
    ) -> None:
        values: dict[str, list[tuple[float, dict[str, int]]]] = {}
        for name, value, removed in turned:
            values.setdefault(name, []).append((value, {"removed": int(removed.sum())}))
        self._keep("judge", query, {"values": values})

    def _drawn(self, shown: str, owner: ExploredRun, card: cards.Card) -> Iterator[tuple[int, str]]:
        """Frame and picture of some frames of a case."""
        run = self._explored.runs[shown]
        worst = card.case.worst_frame
        several = len(self._explored.runs) > 1
        boxes = {frame: box for frame, *box in cards.boxes(owner, card)}
        frames = [worst] if several else spread(list(boxes) or [worst], worst, FRAMES)
        if worst not in frames:
            frames = sorted([*frames, worst])
        for frame in frames:
            low, high = (np.array(end) for end in boxes.get(frame, (card.low, card.high)))
            size = OF_TWO if several else LARGE if frame == worst else SMALL
            content = cards.picture(run, card, size, (frame, low, high), ".webp")
            yield frame, base64.b64encode(content).decode()

    def _keep(self, name: str, query: Mapping[str, str], answer: Any) -> None:
        question = "&".join(f"{key}={query[key]}" for key in sorted(query))
        self.answers[f"{name}?{question}"] = answer


def _chosen(ledgers: Sequence[PointLedger], middle: int | None) -> list[int]:
    """Rows of the points of a case that are explained."""
    rows = [ledgers[k].point for k in evenly(len(ledgers), POINTS).tolist()]
    if middle is not None and middle not in rows:
        rows = [middle, *rows[: POINTS - 1]]
    return rows


def _with_coarse(answer: Mapping[str, Any]) -> dict[str, Any]:
    """An answer whose sliders have the stored values."""
    what_if = answer.get("what_if")
    if what_if is None:
        return dict(answer)
    return {**answer, "what_if": {**what_if, "parameters": _coarse(what_if["parameters"])}}


def _coarse(parameters: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Sliders with fewer steps."""
    found = []
    for each in parameters:
        steps = round((each["high"] - each["low"]) / each["step"])
        every = max(-(-steps // STEPS), 1)
        step = each["step"] * every
        found.append({**each, "step": step, "high": each["low"] + step * (steps // every)})
    return found


def _values(slider: Mapping[str, Any]) -> list[float]:
    """The values of a slider, and that of the run."""
    parameter = msgspec.convert(slider, Parameter)
    return parameter.values(round((parameter.high - parameter.low) / parameter.step) + 1)
