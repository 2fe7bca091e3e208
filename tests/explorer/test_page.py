"""The page of the explorer in Chromium: real clicks, keys and addresses.

Without a graphics card the viewer draws in software, so these tests have a command of their own:
``make browser``.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz import colours
from dynaviz.arrays import F64
from dynaviz.explorer.cards import Card, cards
from dynaviz.explorer.run import ExploredRun
from dynaviz.explorer.server import Explorer
from dynaviz.scores.result import Result
from dynaviz.spatial import geometry
from dynaviz.views.read.focus import ASIDE, CLOSEST
from dynaviz.views.read.reader import RunRecording

pytestmark = pytest.mark.skipif(
    "DYNAVIZ_BROWSER" not in os.environ, reason="draws in Chromium without a GPU; run: make browser"
)

MOST = 120_000  # ms; drawing in software on a busy machine
SMALL = {"width": 1000, "height": 480}  # pixels; fewer are drawn faster
# of the layout of a case: pixels of bars, and the part of its first view
TITLE, TIME_PANEL, SHARE = (
    28,
    29,
    0.6,
)
FIELD_OF_VIEW = 55.0  # degrees: vertical, of the viewer's eye
STATE = "() => JSON.stringify(explorer.current())"


class Page:
    """A page of the explorer that records its requests.

    Args:
        browser: Chromium.
        explorer: the server.
    """

    def __init__(self, browser: Any, explorer: Explorer):
        self.url, self.requests = explorer.url, list[str]()
        self.tab = browser.new_page(viewport=SMALL)
        self.tab.set_default_timeout(MOST)
        self.tab.route("**/*", self._allow)
        self.errors: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))

    def _allow(self, route: Any) -> None:
        self.requests.append(route.request.url)
        if route.request.url.startswith((self.url, "data:", "blob:")):
            route.continue_()
        else:
            route.abort()

    def open_without_viewer(self) -> None:
        """Open the page where the viewer cannot be loaded, for what needs none of its pictures."""
        self.tab.route("**/re_viewer_bg.wasm", lambda route: route.abort())
        self.tab.goto(self.url)
        self.tab.wait_for_selector("body[data-ready]")

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

    def draw(self, pictures: int = 3) -> None:
        """Wait until the page was drawn several times."""
        drawn = "async n => { for (; n; n--) await new Promise(requestAnimationFrame) }"
        self.tab.evaluate(drawn, pictures)

    def changed(self, before: bytes) -> bool:
        """Whether the viewer draws something else within some pictures."""
        for _ in range(20):
            self.draw(2)
            if self.tab.locator("#viewers").screenshot() != before:
                return True
        return False


@pytest.fixture(scope="module")
def page(
    browser: Any, runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Page]:
    run = shutil.copytree(runs["fine"], tmp_path_factory.mktemp("page") / "fine")  # to correct
    with dv.explore(run) as explorer:
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
    page.draw()
    before = page.tab.locator("#viewers").screenshot()
    page.tab.click(f"#card-a-{number}")
    page.wait(f"document.body.dataset.layout === 'case-{number}'")
    page.wait(f"explorer.viewers.a.time === {cases[number - 1].worst_frame}")
    assert page.changed(before)
    assert page.tab.get_attribute(f"#card-a-{number}", "aria-current") == "true"


def test_the_answers_to_a_hundred_clicked_points_are_those_stored(
    page: Page, runs: dict[str, Path]
) -> None:
    with np.load(runs["fine"] / "labels.npz") as file:
        starts = np.concatenate([[0], np.cumsum(file["points"])])
        reasons = file["reason_names"][file["reasons"]]
    drawn = [points for points in RunRecording(runs["fine"] / "run.rrd").drawn() if len(points.xyz)]
    chosen = [
        (points, k)
        for points in drawn
        for k in range(0, len(points.xyz), max(1, len(points.xyz) // 30))
    ][:100]
    clicks = [
        {
            "frame": points.frame,
            "entity_path": "/world/scan",
            "instance_id": k,
            "position": points.xyz[k].tolist(),
        }
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


def on_screen(points: F64, card: Card, width: float, height: float) -> F64:
    """(N, 2) pixels in the viewer at which the first view of a case's layout draws points."""
    middle = (card.low + card.high) / 2
    eye = middle + max(CLOSEST, 1.3 * np.linalg.norm(card.high - card.low)) * ASIDE
    ahead = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    top, bottom = TITLE, SHARE * (height - TIME_PANEL)
    scale = (bottom - top) / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    offset = points - eye
    across, up = (
        scale * (offset @ axis) / (offset @ ahead) for axis in (right, np.cross(right, ahead))
    )
    return np.column_stack([width / 2 + across, (top + bottom) / 2 - up])


def test_a_click_with_the_mouse_explains_a_point(page: Page, runs: dict[str, Path]) -> None:
    run = ExploredRun(runs["fine"])
    card = max(
        cards(run), key=lambda card: np.sum(run.wrong.frame[card.rows] == card.case.worst_frame)
    )
    frame = card.case.worst_frame
    rows = card.rows[run.wrong.frame[card.rows] == frame]
    rows = rows[run.wrong.point[rows] != card.point]  # that one is behind a mark
    page.tab.click(f"#card-a-{card.number}")
    page.wait(
        f"explorer.viewers.a.time === {frame} && document.body.dataset.layout === "
        f"'case-{card.number}'"
    )
    box = page.tab.locator("#viewers canvas").bounding_box()
    places = on_screen(run.wrong.xyz[rows].astype(float), card, box["width"], box["height"])

    def click(places: list[list[float]], points: set[int]) -> None:
        """Click until one of some points is chosen."""
        for x, y in places:
            page.tab.mouse.move(box["x"] + x, box["y"] + y)
            page.draw(4)  # the viewer finds what is under the mouse after it was drawn
            page.tab.mouse.click(box["x"] + x, box["y"] + y)
            page.draw(4)
            if page.state.get("point") in points:
                return

    wrong = set(run.wrong.point[rows].tolist())
    click(places[:8].tolist(), wrong)
    at, point = page.state.get("at"), page.state.get("point")
    assert at == frame, "no click met a point of the case"
    assert page.tab.get_attribute(".reason", "data-reason") == run.point(at, point)["reason"]
    assert f"Point {point:,} of frame {at}" in page.tab.inner_text("#point")
    page.tab.wait_for_selector(
        "#point .ledger .strip"
    )  # the replay of the tiny run follows by itself
    page.tab.keyboard.down("Control")  # the viewer then selects both points
    click(places[::-1][:8].tolist(), wrong - {point})
    page.tab.keyboard.up("Control")
    assert page.state.get("point") in wrong - {point}


def test_keys(page: Page, cases: Any) -> None:
    page.tab.click("#card-a-1")
    page.wait("document.body.dataset.layout === 'case-1'")
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


def test_of_several_layouts_the_last_one_counts(page: Page) -> None:
    page.tab.click("#card-a-1")
    page.wait("document.body.dataset.layout === 'case-1'")
    late, held = "**/api/layout?*layout=map*", []
    page.tab.route(late, lambda route: held.append(route))
    with page.tab.expect_request(late):
        page.tab.keyboard.press("m")
    page.tab.keyboard.press("f")
    page.wait("document.body.dataset.layout === 'frame-1'")
    with page.tab.expect_response(late):
        held[0].continue_()
    page.draw()
    assert page.tab.evaluate("document.body.dataset.layout") == "frame-1"
    page.tab.unroute(late)


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


def test_a_correction_changes_the_scores(page: Page, cases: Any) -> None:
    number = next(k for k, case in enumerate(cases, 1) if case.kind == "false_negative")
    page.tab.click(f"#card-a-{number}")
    page.tab.click(".correction button >> text='It is static'")
    page.wait(
        "/^AA .* -> .* with 1 decision/.test(document.getElementById('corrected').textContent)"
    )
    page.tab.click(".correction button >> text='Undo'")
    page.wait("document.getElementById('corrected').textContent === ''")


def test_a_point_says_corrected_after_its_case_was_corrected(page: Page, cases: Any) -> None:
    number = next(k for k, case in enumerate(cases, 1) if case.kind == "false_negative")
    page.tab.click(f"#card-a-{number}")
    page.tab.wait_for_selector("#point .given.wrong")
    page.tab.click(".correction button >> text='It is static'")
    page.tab.wait_for_selector("#point .truth >> text=static, corrected")
    assert not page.tab.locator("#point .given.wrong").count()
    assert "corrected: static" in page.tab.inner_text(f"#card-a-{number}")
    page.tab.click(".correction button >> text='Undo'")
    page.tab.wait_for_selector("#point .given.wrong")


def test_the_evidence_of_a_case_is_there_at_once_and_its_strip_is_linked(page: Page) -> None:
    page.tab.click("#card-a-1")
    page.wait("document.body.dataset.layout === 'case-1'")
    strip = page.tab.wait_for_selector("#case .strip")
    page.tab.wait_for_selector("#point .strip")
    asked = [url for url in page.requests if "/api/why?" in url]
    assert not any("exact" in url for url in asked[-2:])  # no replay
    strip.scroll_into_view_if_needed()
    box = strip.bounding_box()
    page.tab.mouse.move(box["x"] + box["width"] * 0.4, box["y"] + box["height"] / 2)
    page.tab.wait_for_selector("#case .ledger figcaption >> text=/^Frame \\d+: /")
    frame = int(page.tab.inner_text("#case .ledger figcaption").split()[1].rstrip(":"))
    page.draw(10)
    assert any(f"lit={frame}" in url for url in page.requests)  # its rays light up
    page.tab.mouse.click(box["x"] + box["width"] * 0.4, box["y"] + box["height"] / 2)
    page.wait(f"explorer.viewers.a.time === {frame}")


def test_sliders_judge_the_stored_points_again(page: Page, cases: Any) -> None:
    page.tab.click("#card-a-1")
    page.tab.click("#case .sliders summary")
    set_to = """([name, value]) => {
        const input = document.querySelector(`#case .sliders input[name=${name}]`)
        input.value = value
        input.dispatchEvent(new Event('input'))
    }"""

    def result() -> str:
        page.wait("!document.body.hasAttribute('data-busy')")
        return str(page.tab.text_content("#case .result"))

    points = page.tab.evaluate(
        "async () => (await (await fetch('api/evidence?run=a&case=1')).json()).strip.points"
    )
    highest = page.tab.evaluate("document.querySelector('#case input[name=prob_miss]').max")
    assert float(highest) < 0.5  # beyond it, a miss would count as a hit
    page.tab.evaluate(set_to, ["prob_miss", 0.49])  # a crossing then counts next to nothing
    never = result()
    assert never.startswith(f"0 of {points} points would be removed")
    removed = cases[0].kind == "false_positive"
    assert f"; {points if removed else 0} are." in never
    assert "The case would cost" in never
    page.tab.evaluate(set_to, ["prob_miss", 0.4])  # as it is
    assert result() == ""


def test_the_dial_moves_the_scores_and_orders_the_cards(page: Page, cases: Any) -> None:
    page.tab.click("#dial summary")
    before = page.tab.text_content("#cards .head")
    page.tab.evaluate("""() => {
        const input = document.querySelector('#dial input[name=prob_miss]')
        input.value = 0.49
        input.dispatchEvent(new Event('input'))
    }""")
    page.tab.wait_for_selector("#cards .would")
    text = str(page.tab.text_content("#dial .result"))
    assert text.startswith("prob_miss 0.49: SA ")
    assert f" of {page.tab.locator('#cards .would').count()} listed cases repaired" in text
    expected = page.tab.evaluate(
        "async () => (await (await fetch('api/dial?run=a&settings={\"prob_miss\":0.49}')).json())"
    )
    costs = expected["cases"]
    order = page.tab.evaluate(
        "[...document.querySelectorAll('.card')].map(card => card.id.split('-')[2])"
    )
    known = [costs[number] for number in order if number in costs]
    assert known == sorted(known, reverse=True)
    worse = [n for n, cost in costs.items() if cost > cases[int(n) - 1].cost]
    assert page.tab.locator("#cards .would.worse").count() == len(worse)
    page.tab.evaluate("""() => {
        const input = document.querySelector('#dial input[name=prob_miss]')
        input.value = 0.4
        input.dispatchEvent(new Event('input'))
    }""")
    page.wait("!document.querySelector('#cards .would')")
    assert page.tab.text_content("#cards .head") == before


def test_the_case_over_time_moves_the_cursor(page: Page, cases: Any) -> None:
    number = next(k for k, case in enumerate(cases, 1) if case.kind == "false_negative")
    page.tab.click(f"#card-a-{number}")
    page.tab.wait_for_selector(
        "#case .time rect.hit, #case .time rect.through"
    )  # with the evidence
    drawn = page.tab.locator(
        "#case .time rect:is(.kept, .partly, .removed) title"
    ).all_text_contents()
    expected = [
        f"answer: {state}, frame{f' {first}' if first == last else f's {first} to {last}'}"
        for state in ("kept", "partly", "removed") for first,
        last in cases[number - 1].spans.get(state, ())
    ]  # fmt: skip
    assert drawn == expected
    page.tab.click(
        "#case .time",
        position={"x": 0.9 * page.tab.locator("#case .time").bounding_box()["width"], "y": 5},
    )
    page.wait("explorer.viewers.a.time > 3")
    assert page.tab.evaluate(
        "Number(document.body.style.getPropertyValue('--frame')) === explorer.viewers.a.time"
    )


def test_the_viewer_is_ready_when_it_shows_points(page: Page) -> None:
    png = page.tab.locator("#viewers").screenshot()
    shown = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    assert (np.abs(shown.astype(int) - colours.BACKGROUND).max(2) < 4).mean() > 0.1
    assert not page.tab.locator(".preview").count()


def test_no_request_left_the_machine(page: Page) -> None:
    assert any(url.endswith("re_viewer_bg.wasm") for url in page.requests)
    assert not [url for url in page.requests if not url.startswith((page.url, "data:", "blob:"))]
    assert not page.errors


@pytest.mark.slow
def test_an_address_restores_two_runs_and_a_point(browser: Any, runs: dict[str, Path]) -> None:
    with dv.explore(runs["fine"], runs["coarse"]) as explorer:
        page = Page(browser, explorer)
        page.open("?case=2&layout=map&frame=3&at=2&point=7&sort=size&search=kept")
        page.wait("explorer.viewers.a.time === 3 && explorer.viewers.b.time === 3")
        state = page.state
        assert {
            name: state[name]
            for name in ("case", "layout", "frame", "at", "point", "sort", "search")
        } == {
            "case": 2,
            "layout": "map",
            "frame": 3,
            "at": 2,
            "point": 7,
            "sort": "size",
            "search": "kept",
        }
        assert page.tab.input_value("input[name=search]") == "kept"
        assert "Point 7 of frame 2" in page.tab.inner_text("#point")
        assert page.tab.locator("#point .answer").count() == 2  # the same click asks both
        merged = page.tab.evaluate(
            "explorer.cards().filter(card => card.others.b).map(card => card.others.b.number)"
        )
        assert merged
        assert len(merged) == len(set(merged))
        shown = page.tab.evaluate(
            "explorer.cards().filter(card => card.of === 'b').map(card => card.number)"
        )
        assert not set(shown) & set(merged)  # one card for a place that both get wrong
        page.tab.fill("input[name=search]", "")
        for choice in ("a", "b", "ab"):
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


def test_a_rectangle_shows_the_evidence_of_the_points_inside(
    browser: Any, runs: dict[str, Path]
) -> None:
    with dv.explore(runs["fine"]) as explorer:
        page = Page(browser, explorer)
        page.open_without_viewer()
        pane = page.tab.wait_for_selector("#case .map .pane")
        pane.scroll_into_view_if_needed()
        caption, strip = "#case figure:has(.map) figcaption", "#case .ledger .strip"
        box = page.tab.locator("#case .map .pane >> nth=0").locator(".ground").bounding_box()
        evidence = page.tab.evaluate(
            "async () => (await (await fetch('api/evidence?run=a&case=1')).json()).map"
        )
        along = 0 if evidence["size"][0] >= evidence["size"][1] else 1
        half = evidence["size"][along] / 2
        inside = [row for row, *at in evidence["evidence"] if at[along] <= half]
        assert len(inside) < len(evidence["evidence"])
        page.tab.mouse.move(box["x"] + 1, box["y"] + 1)
        page.tab.mouse.down()
        page.tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] - 1, steps=3)
        page.tab.mouse.up()
        assert len(inside) > 1
        page.wait(
            f"document.querySelector('{strip}').ariaLabel.includes('median of {len(inside)} "
            "points')"
        )
        count = sum(at[along] <= half for at in evidence["points"])
        assert page.tab.inner_text(caption).startswith(
            f"{count} of {len(evidence['points'])} points: "
        )
        asked = next(url for url in reversed(page.requests) if "/api/evidence?" in url)
        assert sorted(map(int, parse_qs(urlsplit(asked).query)["points"][0].split(","))) == sorted(
            inside
        )
        page.tab.locator("#case .map .pane >> nth=0").focus()
        page.tab.keyboard.press("Escape")
        page.wait(
            f"document.querySelector('{strip}').ariaLabel.includes('median of "
            f"{len(evidence['evidence'])} points')"
        )
        page.tab.keyboard.press("ArrowRight")  # a rectangle in the middle
        page.wait(
            "document.querySelector('#case .map .chosen').getAttribute('visibility') === 'visible'"
        )
        width = page.tab.get_attribute("#case .map .chosen", "width")
        page.tab.keyboard.press("Shift+ArrowRight")
        assert float(page.tab.get_attribute("#case .map .chosen", "width")) > float(width)
        page.tab.keyboard.press("Escape")
        page.tab.close()


def test_of_three_runs_an_object_has_one_card_with_a_bar_for_each(
    browser: Any, runs: dict[str, Path]
) -> None:
    with dv.explore(runs["fine"], runs["coarse"], runs["fine"]) as explorer:
        page = Page(browser, explorer)
        page.open_without_viewer()
        page.tab.wait_for_selector("#point .answer[data-run=c]")
        cases = len(Result.load(runs["fine"] / "result.json").failures)
        assert page.tab.evaluate("explorer.cards().filter(card => card.others.c).length") >= cases
        assert page.tab.locator("#card-a-1 .cost-of").all_inner_texts()[0][0] == "A"
        assert page.tab.locator(".cost-of").count() == 3 * page.tab.locator(".card").count()
        assert not page.tab.evaluate("explorer.cards().some(card => card.of === 'c')")
        page.tab.close()


def test_without_ground_truth_the_page_opens_at_the_first_case_of_the_recording(
    browser: Any, runs: dict[str, Path]
) -> None:
    with dv.explore(runs["unknown"]) as explorer:
        page = Page(browser, explorer)
        page.open_without_viewer()
        shown = [
            int(card.get_attribute("id").split("-")[-1]) for card in page.tab.locator(".card").all()
        ]
        assert shown == list(
            range(1, len(Result.load(runs["unknown"] / "result.json").clusters) + 1)
        )
        page.wait("document.querySelector('#card-a-1').ariaCurrent === 'true'")
        page.tab.close()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.slow
@pytest.mark.parametrize("made", ["cleaned", "arrays"])
def test_runs_of_clean_and_of_arrays_explain_a_point(
    browser: Any, made: str, tmp_path: Path
) -> None:
    scans = room(4, 700).scans
    local = [
        geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points) for scan in scans
    ]
    arrays = [(xyz, scan.T_world_sensor) for xyz, scan in zip(local, scans, strict=True)]
    if made == "arrays":
        run: Any = dv.run("octomap", arrays, record=tmp_path / "alone.rrd")
    else:
        folder = tmp_path / "scans"
        folder.mkdir()
        for scan, xyz in zip(scans, local, strict=True):
            np.save(folder / f"{scan.index:06d}.npy", xyz)
        poses = np.array([scan.T_world_sensor for scan in scans])[:, :3].reshape(-1, 12)
        np.savetxt(folder / "poses.txt", poses, fmt="%.17g")
        run = dv.clean(folder, tmp_path / "map.pcd", method="octomap").folder
    with dv.explore(run) as explorer:
        page = Page(browser, explorer)
        page.open("?frame=1&at=1&point=7")
        page.tab.wait_for_selector("#point .ledger figure")
        assert "Point 7 of frame 1" in page.tab.inner_text("#point")
        assert not page.errors
        page.tab.close()


def test_a_review_is_done_by_keys(browser: Any, runs: dict[str, Path], tmp_path: Path) -> None:
    run = shutil.copytree(runs["fine"], tmp_path / "fine")
    with dv.explore(run) as explorer:
        page = Page(browser, explorer)
        page.tab.goto(explorer.url + "review.html")
        page.tab.wait_for_selector("body[data-ready=review]")
        idle = "!document.body.hasAttribute('data-busy')"
        first = page.tab.inner_text("#question")
        page.tab.keyboard.press("r")
        page.wait("document.querySelectorAll('.card .verdict').length === 1")
        page.wait(f"{idle} && document.getElementById('question').textContent !== {first!r}")
        assert "by 1 decision" in page.tab.inner_text("#balance")
        page.tab.keyboard.press("k")
        page.wait("document.querySelectorAll('.card .verdict').length === 2")
        page.tab.keyboard.press("u")
        page.wait("document.querySelectorAll('.card .verdict').length === 1")
        page.wait(idle)
        box = page.tab.locator("#views canvas").first.bounding_box()
        assert box is not None
        page.tab.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.2 * box["height"])
        page.tab.mouse.down()
        page.tab.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.8 * box["height"])
        page.tab.mouse.up()
        assert "at all times" in page.tab.inner_text("#tool")
        page.tab.keyboard.press("f")
        assert "from frame" in page.tab.inner_text("#tool")
        page.tab.keyboard.press("k")
        page.wait("/by 2 decisions/.test(document.getElementById('balance').textContent)")
        page.tab.keyboard.press("w")
        page.wait("/^Written to/.test(document.getElementById('tool').textContent)")
        assert (run / "reviewed.pcd").is_file()
        page.tab.goto(explorer.url + "review.html")  # it goes on where it was left
        page.tab.wait_for_selector("body[data-ready=review]")
        assert page.tab.locator(".card .verdict").count() == 1
        assert page.tab.locator(".card[aria-current] .verdict").count() == 0
        assert not page.errors
        page.tab.close()


class SentTab:
    """A page that was sent as a file, opened where no request is answered.

    Args:
        browser: Chromium.
        path: the file.
    """

    def __init__(self, browser: Any, path: Path) -> None:
        self.context = browser.new_context(viewport={"width": 1400, "height": 900}, offline=True)
        self.tab = self.context.new_page()
        self.tab.set_default_timeout(MOST)
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("console", lambda message: self._hear(message))
        self.tab.goto(path.as_uri())
        self.tab.wait_for_selector("body[data-ready=viewer]")

    def _hear(self, message: Any) -> None:
        if message.type == "error":
            self.errors.append(message.text)

    @property
    def left(self) -> list[str]:
        """Requests for anything but the file itself."""
        return [url for url in self.requests[1:] if not url.startswith(("data:", "blob:"))]

    def wait(self, condition: str) -> None:
        self.tab.wait_for_function(f"() => {condition}")


TURN = """([part, name, value]) => {
    const input = document.querySelector(`${part} input[name=${name}]`)
    input.value = value
    input.dispatchEvent(new Event('input'))
}"""


def test_a_page_that_was_sent_works_offline(
    browser: Any, runs: dict[str, Path], cases: Any, tmp_path: Path
) -> None:
    sent = SentTab(browser, dv.export_page(tmp_path / "page.html", runs["fine"]))
    tab = sent.tab
    assert tab.locator(".card").count() == len(cases)
    assert tab.inner_text("#case .sentence") == cases[0].sentence
    tab.wait_for_selector("#case .strip")
    tab.wait_for_selector("#point .strip")
    assert tab.locator("#case .time").count() == 1
    drawn = "[...document.querySelectorAll('img')].filter(image => image.offsetWidth)"
    assert tab.evaluate(f"{drawn}.every(image => image.complete && image.naturalWidth > 1)")
    frames = tab.locator(".frames button")
    frames.last.click()  # a picture of another frame
    last = int(frames.last.get_attribute("data-frame"))
    sent.wait(f"explorer.viewers.a.time === {last}")
    assert tab.evaluate("document.body.style.getPropertyValue('--frame')") == str(last)
    tab.keyboard.press("j")
    sent.wait("document.querySelector('.card[aria-current]').id !== 'card-a-1'")
    tab.click("#card-a-1")
    tab.wait_for_selector("#case .map .evidence")
    before = tab.inner_text("#point h2")
    for place in tab.evaluate(
        "[...document.querySelectorAll('#case .map .pane')].map(pane => {"
        "const { x, y, width, height } = pane.querySelector('.evidence').getBoundingClientRect();"
        "return [[x + 2, y + 2], [x + width - 2, y + height - 2], [x + width - 2, y + 2]] }).flat()"
    ):
        tab.locator("#case .map").scroll_into_view_if_needed()
        tab.mouse.click(*place)
    assert tab.locator("#point .evidence").count() == 1
    assert tab.inner_text("#point h2").startswith("Point ")
    assert before.startswith("Point ")
    tab.click("#dial summary")
    tab.evaluate(TURN, ["#dial", "prob_miss", 0.45])
    tab.wait_for_selector("#cards .would")
    assert "prob_miss" in tab.inner_text("#dial .result")
    tab.evaluate(TURN, ["#dial", "prob_hit", 0.6])  # one at a time: the other returns
    sent.wait("document.querySelector('#dial .result').textContent.startsWith('prob_hit')")
    assert float(tab.evaluate("document.querySelector('#dial input[name=prob_miss]').value")) == 0.4
    tab.click("#case .sliders summary")
    tab.evaluate(TURN, ["#case .sliders", "prob_miss", 0.49])
    sent.wait("document.querySelector('#case .result').textContent.includes('would be removed')")
    assert not tab.locator("button:has-text('Run with this'):visible").count()
    assert not tab.locator("#review:visible").count()
    assert not tab.locator("button:has-text('Picture')").count()
    assert sent.left == []
    assert sent.errors == []
    sent.context.close()


def test_two_runs_that_were_sent_show_the_case_of_each(
    browser: Any, runs: dict[str, Path], tmp_path: Path
) -> None:
    page = dv.export_page(tmp_path / "two.html", runs["fine"], runs["coarse"])
    sent = SentTab(browser, page)
    assert sent.tab.locator(".still .large").count() == 2
    sent.wait("[...document.querySelectorAll('.still .large')].every(image => image.naturalWidth)")
    first, second = (
        image.get_attribute("src") for image in sent.tab.locator(".still .large").all()
    )
    assert first != second
    sent.tab.locator(".card").last.click()
    sent.wait(f"document.querySelector('.still .large').src !== {first!r}")
    assert sent.left == []
    assert sent.errors == []
    sent.context.close()
