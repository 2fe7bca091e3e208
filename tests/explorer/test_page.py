"""The page of the explorer in Chromium: real clicks, keys and addresses.

Without a graphics card the viewer draws in software, which takes minutes on a busy machine: set DYNAVIZ_BROWSER=1.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.explorer.server import Explorer
from dynaviz.results.result import Result
from dynaviz.viz.reader import RunRecording

pytestmark = pytest.mark.skipif("DYNAVIZ_BROWSER" not in os.environ, reason="set DYNAVIZ_BROWSER=1 to run in Chromium")

SECONDS = 90_000  # ms; drawing in software on a busy machine
STATE = "() => JSON.stringify(explorer.current())"


class Page:
    """A page of the explorer that records its requests.

    Args:
        browser: Chromium.
        explorer: the server.
    """

    def __init__(self, browser: Any, explorer: Explorer):
        self.url, self.requests = explorer.url, list[str]()
        self.tab = browser.new_page(viewport={"width": 1100, "height": 560})
        self.tab.set_default_timeout(SECONDS)
        self.tab.route("**/*", self._allow)
        self.errors: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))

    def _allow(self, route: Any) -> None:
        self.requests.append(route.request.url)
        if route.request.url.startswith((self.url, "data:", "blob:")):
            route.continue_()
        else:
            route.abort()

    def open(self, query: str = "") -> None:
        """Open an address, and wait for the viewers."""
        self.tab.goto(self.url + query)
        self.tab.wait_for_selector("body[data-ready=viewer]")

    @property
    def state(self) -> dict[str, Any]:
        """What the address restores."""
        found: dict[str, Any] = json.loads(self.tab.evaluate(STATE))
        return found

    def wait(self, condition: str) -> None:
        """Wait for an expression."""
        self.tab.wait_for_function(f"() => {condition}")


@pytest.fixture(scope="module")
def page(browser: Any, runs: dict[str, Path]) -> Iterator[Page]:
    with dv.explore(runs["fine"]) as explorer:
        page = Page(browser, explorer)
        page.open()
        yield page
        page.tab.close()


@pytest.fixture(scope="module")
def cases(runs: dict[str, Path]) -> Any:
    return Result.load(runs["fine"] / "result.json").failures


def test_it_opens_at_the_costliest_case(page: Page, cases: Any) -> None:
    assert page.state["case"] == 1
    page.wait(f"explorer.viewers.a.time === {cases[0].worst_frame}")
    assert page.tab.inner_text("#case .sentence") == cases[0].sentence
    assert page.tab.locator(".card").count() == len(cases)


def test_a_card_moves_the_cursor_and_the_camera(page: Page, cases: Any) -> None:
    number = next(k for k, case in enumerate(cases, 1) if case.worst_frame != cases[0].worst_frame)
    page.tab.click("#card-a-1")
    page.wait("document.body.dataset.layout === 'case-1'")
    page.wait(f"explorer.viewers.a.time === {cases[0].worst_frame}")
    page.tab.wait_for_timeout(1500)
    before = page.tab.locator("#viewers").screenshot()
    page.tab.click(f"#card-a-{number}")
    page.wait(f"document.body.dataset.layout === 'case-{number}'")
    page.wait(f"explorer.viewers.a.time === {cases[number - 1].worst_frame}")
    page.tab.wait_for_timeout(1500)
    assert page.tab.locator("#viewers").screenshot() != before
    assert page.tab.get_attribute(f"#card-a-{number}", "aria-current") == "true"


def test_the_answers_to_a_hundred_clicked_points_are_those_stored(page: Page, runs: dict[str, Path]) -> None:
    with np.load(runs["fine"] / "labels.npz") as file:
        starts = np.concatenate([[0], np.cumsum(file["points"])])
        reasons = file["reason_names"][file["reasons"]]
    drawn = [points for points in RunRecording(runs["fine"] / "run.rrd").drawn() if len(points.xyz)]
    chosen = [(points, k) for points in drawn for k in range(0, len(points.xyz), max(1, len(points.xyz) // 30))][:100]
    clicks = [
        {"frame": points.frame, "entity_path": "/world/scan", "instance_id": k, "position": points.xyz[k].tolist()}
        for points, k in chosen
    ]
    ask = """async clicks => {
        const found = []
        for (const {frame, ...item} of clicks) {
            explorer.viewers.a.time = frame
            await explorer.clicked('a', item)
            const {at, point} = explorer.current()
            found.push([at, point, document.querySelector('.reason').dataset.reason])
        }
        return found
    }"""
    found = page.tab.evaluate(ask, clicks)
    rows = [(points.frame, int(points.point[k])) for points, k in chosen]
    assert len(found) == 100
    assert found == [[frame, point, str(reasons[starts[frame] + point])] for frame, point in rows]


def test_a_click_with_the_mouse_explains_a_point(page: Page, cases: Any) -> None:
    page.tab.click("#card-a-1")
    page.wait(f"explorer.viewers.a.time === {cases[0].worst_frame}")
    page.tab.wait_for_timeout(1500)
    box = page.tab.locator("#viewers").bounding_box()
    for dx, dy in ((0.5, 0.3), (0.5, 0.34), (0.48, 0.28), (0.52, 0.32), (0.46, 0.36), (0.55, 0.4), (0.4, 0.3)):
        x, y = box["x"] + dx * box["width"], box["y"] + dy * box["height"]
        page.tab.mouse.move(x, y)
        page.tab.wait_for_timeout(600)
        page.tab.mouse.click(x, y)
        page.tab.wait_for_timeout(600)
        if "point" in page.state:
            break
    state = page.state
    assert "point" in state, "no click met a point"
    assert f"Point {state['point']:,} of frame {state['at']}" in page.tab.inner_text("#point")
    page.tab.wait_for_selector("#point .ledger table")  # the replay of the tiny run follows by itself


def test_keys(page: Page, cases: Any) -> None:
    page.tab.click("#card-a-1")
    page.tab.keyboard.press("j")
    page.wait("explorer.current().case === 2")
    page.wait(f"explorer.viewers.a.time === {cases[1].worst_frame}")
    page.tab.keyboard.press("k")
    page.wait("explorer.current().case === 1")
    for key, layout in (("f", "frame"), ("m", "map"), ("c", "case")):
        page.tab.keyboard.press(key)
        page.wait(f"document.body.dataset.layout === '{layout}-1'")
    page.tab.keyboard.press("Space")
    page.wait("explorer.viewers.a.playing")
    page.tab.keyboard.press("Space")
    page.wait("!explorer.viewers.a.playing")
    page.tab.keyboard.press("?")
    page.tab.wait_for_selector("#help[open]")
    page.tab.keyboard.press("?")
    page.wait("!document.getElementById('help').open")


def test_filters_sort_and_search(page: Page, cases: Any) -> None:
    kind = "ghost" if cases[0].kind == "false_negative" else "hole"
    page.tab.select_option("select[name=sort]", "size")
    page.tab.fill("input[name=search]", cases[0].what)
    shown = page.tab.locator(".card")
    found = {int(card.get_attribute("id").split("-")[-1]) for card in shown.all()}
    assert found >= {k for k, case in enumerate(cases, 1) if case.what == cases[0].what}
    assert len(found) < len(cases)
    page.tab.fill("input[name=search]", "no such thing")
    assert shown.count() == 0
    page.tab.fill("input[name=search]", "")
    assert page.tab.inner_text(".card >> nth=0").startswith(
        str(1 + max(range(len(cases)), key=lambda k: cases[k].points))
    )
    page.tab.select_option("select[name=sort]", "cost")
    if page.tab.locator("select[name=kind]").count():
        page.tab.select_option("select[name=kind]", kind)
        assert shown.count() == sum(case.kind == cases[0].kind for case in cases)
        page.tab.select_option("select[name=kind]", "")


def test_no_request_left_the_machine(page: Page) -> None:
    assert any(url.endswith("re_viewer_bg.wasm") for url in page.requests)
    assert not [url for url in page.requests if not url.startswith((page.url, "data:", "blob:"))]
    assert not page.errors


def test_an_address_restores_two_runs_and_a_point(browser: Any, runs: dict[str, Path]) -> None:
    with dv.explore(runs["fine"], runs["coarse"]) as explorer:
        page = Page(browser, explorer)
        page.open("?case=2&layout=map&frame=3&at=2&point=7&sort=size&search=kept")
        page.wait("explorer.viewers.a.time === 3 && explorer.viewers.b.time === 3")
        state = page.state
        assert {name: state[name] for name in ("case", "layout", "frame", "at", "point", "sort", "search")} == {
            "case": 2, "layout": "map", "frame": 3, "at": 2, "point": 7, "sort": "size", "search": "kept",
        }  # fmt: skip
        assert page.tab.input_value("input[name=search]") == "kept"
        assert "Point 7 of frame 2" in page.tab.inner_text("#point")
        assert page.tab.locator("#point .answer").count() == 2  # the same click asks both
        page.tab.fill("input[name=search]", "")
        for choice in ("a", "b", "both"):
            if page.tab.locator(f"select[name=by] option[value={choice}]").count():
                page.tab.select_option("select[name=by]", choice)
                assert {c.inner_text() for c in page.tab.locator(".card .by").all()} <= {
                    f"only {choice.upper()} wrong", "both wrong",
                }  # fmt: skip
        page.tab.evaluate("explorer.viewers.a.seek(1)")
        page.wait("explorer.viewers.b.time === 1")  # one cursor
        page.wait("location.search.includes('frame=1')")
        assert not page.errors
        page.tab.close()
