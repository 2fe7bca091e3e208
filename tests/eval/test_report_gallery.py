"""The gallery of a report.

Which cases it shows, from where, and that the page holds together in a browser.
"""

from __future__ import annotations

import gzip
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import measured, needs_chromium
from helpers.html_pages import Page
from helpers.made_results import REMOVALS, case, result, thing, without_truth

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Outcome
from dynaviz.reports.reporting import StudyOverview
from dynaviz.scores.sections import Sections
from dynaviz_eval.report import birdseye
from dynaviz_eval.report.gallery import crop, gallery
from dynaviz_eval.report.spots import ALIKE, MOST, Spot, shared_cases
from dynaviz_eval.report.tables import tables

PREVIOUS = Path(__file__).resolve().parents[1] / "data/previous"
GHOST, HOLE = "false_negative", "false_positive"


def failing(method, *cases):
    return result(method, sections={"failures": {"cases": list(cases)}})


def shared(study, *results):
    return shared_cases(tables(study(*results)).boards[0])


def box(x, size=1.0):
    return (x, 0.0, 0.0), (x + size, size, size)


def test_cases_of_several_methods_at_one_place_are_one_row(study):
    car = {"class": 252, "instance": 7}
    cases = shared(
        study,
        failing(
            "a",
            case(GHOST, 5.0, *box(0), **car),
            case(GHOST, 1.0, *box(50), **car),
            case(HOLE, 3.0, *box(0, 4)),
        ),
        failing(
            "b",
            case(GHOST, 2.0, *box(90), cause="standing too long", **car),
            case(HOLE, 2.0, *box(0.5, 3)),
        ),
        failing("c", case(HOLE, 1.0, *box(30))),
    )
    assert [(c.heading, {label: len(spots) for label, spots in c.by.items()}) for c in cases] == [
        ("Ghost: car 7", {"a": 2, "b": 1}),  # one object, wherever it was
        ("Hole: car", {"a": 1, "b": 1}),  # overlapping boxes
        ("Hole: car", {"c": 1}),
    ]
    assert (cases[0].spot("a").size, cases[0].spot("b").cause, cases[0].spot("c")) == (
        "5.00",
        "standing too long",
        None,
    )
    assert [c.number for c in cases] == [1, 2, 3]


def test_ghosts_and_holes_are_both_shown(study):
    ghosts = [case(GHOST, 50.0 - k, *box(5 * k), cause=f"cause {k}") for k in range(9)]
    holes = [case(HOLE, 0.5 - k / 100, *box(5 * k), cause=f"cause {k}") for k in range(9)]
    kinds = [c.worst.kind for c in shared(study, failing("a", *ghosts, *holes))]
    assert kinds == [GHOST] * (MOST // 2) + [HOLE] * (MOST // 2)


def test_a_long_road_does_not_fill_the_list(study):
    road = [case(HOLE, 9.0 - k, *box(20 * k), what="road") for k in range(MOST)]
    others = [case(HOLE, 0.5, *box(-20 * k - 20), what=f"thing {k}") for k in range(MOST)]
    shown = [c.worst.what for c in shared(study, failing("a", *road, *others))]
    assert len(shown) == MOST
    assert shown.count("road") == ALIKE


def test_the_gallery_varies_what_the_objects_did(study):
    """Not only the causes, which differ by method."""
    parked = [
        case(GHOST, 9.0 - k, *box(20 * k), behaviour="stood still until the end")
        for k in range(MOST)
    ]
    passed = [case(GHOST, 0.5, *box(-20 * k - 20), behaviour="passed by") for k in range(2)]
    shown = shared(study, failing("a", *parked, *passed))
    assert [c.worst.behaviour for c in shown].count("passed by") == 2
    assert shown[0].title == "Ghost: car, stood still until the end"


def spot(kind: str, low: tuple[float, ...], high: tuple[float, ...]) -> Spot:
    return Spot("a", kind, "car", "", "", 1.0, "1.00", "DA lost", low, high, (None, None))


def scene(size: tuple[float, float, float], outcome: Outcome) -> StudyOverview:
    """Wrong points on the surface of a box at the origin, on a floor, below a roof."""
    random = np.random.default_rng(0)
    wrong = random.uniform(0, size, (4000, 3))
    floor, roof = (
        np.c_[random.uniform(-20, 20, (20_000, 2)), np.full(20_000, z)] for z in (-0.3, 20.0)
    )
    points = np.concatenate([wrong, floor, roof]).astype(np.float32)
    outcomes = np.repeat(np.array([outcome, Outcome.STATIC_KEPT], np.uint8), [len(wrong), 40_000])
    return StudyOverview(points, outcomes)


@pytest.mark.parametrize(
    ("size", "kind", "outcome", "index", "where"),
    [
        ((9.0, 3.0, 0.2), HOLE, Outcome.FALSE_POSITIVE, birdseye.HOLE, "from above"),
        ((8.0, 0.4, 4.0), HOLE, Outcome.FALSE_POSITIVE, birdseye.HOLE, "from the side"),
        ((0.6, 0.6, 1.8), GHOST, Outcome.FALSE_NEGATIVE, birdseye.GHOST, "from the side"),
        ((4.0, 2.0, 1.5), GHOST, Outcome.FALSE_NEGATIVE, birdseye.GHOST, "from above"),
    ],
    ids=["ground", "wall", "pedestrian", "car"],
)
def test_a_case_is_seen_from_where_it_is_largest(size, kind, outcome, index, where):
    overview = scene(size, outcome)
    view, seen_from = crop(spot(kind, (0, 0, 0), size), overview)
    assert seen_from == where
    image = view.draw(overview)
    rows, columns = np.nonzero(image == index)
    assert np.ptp(columns) * view.pixel == pytest.approx(max(size[:2]), abs=0.6)
    assert np.ptp(rows) * view.pixel == pytest.approx(
        size[2] if "side" in where else size[1], abs=0.6
    )
    assert abs(columns.mean() - image.shape[1] / 2) < 8  # in the middle, despite the roof above
    assert abs(rows.mean() - image.shape[0] / 2) < 8


def test_all_pictures_of_a_row_show_the_same_crop(study):
    size = (4.0, 2.0, 1.5)
    wrong = scene(size, Outcome.FALSE_NEGATIVE)
    right = scene(size, Outcome.DYNAMIC_REMOVED)
    cases = shared(study, failing("a", case(GHOST, 5.0, (0, 0, 0), size)), failing("b"))
    (row,) = gallery(cases, ["a", "b", "without a recording"], {"a": wrong, "b": right})
    assert [picture.title for picture in row.pictures] == ["before", "truth", "a", "b"]
    assert [picture.caption for picture in row.pictures[2:]] == [
        "5.00 DA lost: nothing behind",
        "no case here",
    ]
    assert len({(picture.width, picture.height) for picture in row.pictures}) == 1
    before, truth, a, b = (picture.webp for picture in row.pictures)
    assert truth == b  # a method that removed it is as good as the truth
    assert len({before, truth, a}) == 3
    assert not gallery(cases, ["a"], {})


@pytest.fixture(scope="module")
def previous(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results and recordings of an earlier version."""
    folder = tmp_path_factory.mktemp("previous")
    for name in ("fine", "coarse"):
        (folder / name).mkdir()
        shutil.copy(PREVIOUS / name / "result.json", folder / name)
        (folder / name / "run.rrd").write_bytes(
            gzip.decompress((PREVIOUS / name / "run.rrd.gz").read_bytes())
        )
    return folder


@pytest.fixture(scope="module")
def previous_page(previous: Path) -> Path:
    dv.report(previous, out=previous / "page.html")
    return previous / "page.html"


def test_earlier_results_have_a_gallery(previous, previous_page):
    page = Page(previous_page.read_text())
    cases = [image for image in page.images if not (image["alt"] or "").startswith("Bird's-eye")]
    assert len(cases) % 3 == 0  # before, truth, and the best run
    assert len(cases) >= 3
    assert "grazing rays" in dv.report(previous, format="md")
    assert "Costliest cases" in dv.report(previous, format="md")


def test_objects_over_time_have_a_lane_for_each_method(study):
    spans = {"moving": [[0, 9]], "kept": [[0, 4]], "removed": [[5, 9]]}
    kept = failing("a", case(GHOST, 5.0, *box(0), instance=7, spans=spans))
    page = registry.load("reports", "html")(study(kept, failing("b")))
    lanes = page[page.index('aria-label="car 7 over time"') :].partition("</div>")[0]
    assert re.findall(r"<title>(.*?)</title>", lanes) == [
        "object: moving, frames 0 to 9",
        "a: kept, frames 0 to 4",
        "a: removed, frames 5 to 9",
        "b: removed, frames 0 to 9",  # it has no case on the object
    ]
    assert re.findall(r'<rect x="(\d+)" width="(\d+)"', lanes) == [
        ("0", "10"),
        ("0", "5"),
        ("5", "5"),
        ("0", "10"),
    ]


def test_pictures_and_fields_name_the_command_that_explores_their_run(previous, previous_page):
    text = previous_page.read_text()
    runs = json.loads(re.search(r"const runs = (\{.*?\}), shown", text)[1])
    assert runs
    for label, (run,) in runs.items():
        assert (previous / run["recording"]).is_file()
        assert run["command"].startswith("dynaviz explore ")
        assert f'data-run="{label}"' in text or f">{label}<" in text
    assert re.search(r'data-run="[^"]+" data-case="\d+"', text)


def test_a_case_without_a_place_is_left_out(study):
    bad = case(GHOST, 5.0, (0.0, 1.0), (2.0,), reasons={}, cause=None)
    assert Sections.of({"failures": {"cases": [bad]}}).failures
    given = study(failing("a", bad, case(HOLE, 1.0, *box(0), reasons={}, cause=None)))
    assert [c.worst.kind for c in tables(given).by_board[0].cases] == [HOLE]
    for format in ("html", "md", "csv"):
        assert "a" in registry.load("reports", format)(given)


@needs_chromium
def test_nothing_is_cut_off_on_a_phone_or_a_large_screen(study, previous_page, tmp_path):
    names = ["octomap_with_a_long_name", *"bcdefghi"]
    runs = [
        result(
            name,
            "hall" if k % 2 else "the_long_name_of_another_sequence",
            numbers=(900 + k, 100 - k, 80, 20),
            sections={"breakdown": {"object": [thing(3, 10 * k, 90)]}},
        )
        for k, name in enumerate(names)
    ]
    many = tmp_path / "many.html"
    many.write_text(registry.load("reports", "html")(study(*runs, without_truth("a", REMOVALS))))
    for width in (390, 3840):
        assert measured(many, width)["cut"] == []
    found = measured(previous_page, 390)
    assert found["cut"] == []
    assert found["images"]
    assert all(found["images"])  # decoded
