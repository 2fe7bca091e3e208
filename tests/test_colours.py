"""Colours differ to every eye, and are visible on every background."""

from __future__ import annotations

import pytest
from helpers.colour_vision import EYES, contrast, smallest_difference

from dynaviz import colours
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Outcome

WHITE, BLACK = (255, 255, 255), (16, 18, 20)
SCORED = (
    Outcome.STATIC_KEPT,
    Outcome.DYNAMIC_REMOVED,
    Outcome.FALSE_POSITIVE,
    Outcome.FALSE_NEGATIVE,
)
WRONG = (Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE)


@pytest.mark.parametrize("eye", EYES)
def test_outcomes_differ_and_errors_stand_out(eye: str) -> None:
    assert smallest_difference([colours.BRIGHT[o] for o in SCORED], eye) > 30
    assert min(contrast(colours.BRIGHT[o], colours.BACKGROUND, eye) for o in SCORED) > 4
    kept = colours.BRIGHT[Outcome.STATIC_KEPT]
    assert all(
        contrast(colours.BRIGHT[o], colours.BACKGROUND, eye)
        > 1.3 * contrast(kept, colours.BACKGROUND, eye)
        for o in WRONG
    )


@pytest.mark.parametrize("eye", EYES)
def test_unlabelled_points_are_dimmer_than_kept_ones(eye: str) -> None:
    kept = colours.BRIGHT[Outcome.STATIC_KEPT]
    unlabelled = colours.BRIGHT[Outcome.UNLABELLED_KEPT]
    dim = contrast(unlabelled, colours.BACKGROUND, eye)
    assert 1.5 < dim < contrast(kept, colours.BACKGROUND, eye) / 2
    assert smallest_difference([kept, unlabelled], eye) > 20
    assert colours.UNSCORED[Outcome.UNLABELLED_KEPT] == kept


@pytest.mark.parametrize("eye", EYES)
def test_classes_of_states_differ_from_outcomes_and_from_each_other(eye: str) -> None:
    own = colours.CLASSES[1:]  # the first is that of static points, in both
    outcomes = [colours.BRIGHT[outcome] for outcome in (*SCORED, Outcome.UNLABELLED_REMOVED)]
    assert min(smallest_difference([a, b], eye) for a in own for b in outcomes) > 10
    assert smallest_difference(own, eye) > 10


@pytest.mark.parametrize("eye", EYES)
def test_rays_differ_from_each_other_and_from_all_points(eye: str) -> None:
    points, rays = colours.BRIGHT.values(), colours.RAYS.values()
    assert min(smallest_difference([ray, point], eye) for ray in rays for point in points) > 15
    assert smallest_difference(rays, eye) > 15
    assert min(contrast(ray, colours.BACKGROUND, eye) for ray in rays) > 1.8


@pytest.mark.parametrize("eye", EYES)
def test_curves_and_bars_are_visible_on_white_and_on_black(eye: str) -> None:
    drawn = [*colours.FIRM.values(), *colours.SCORES.values(), colours.NEUTRAL]
    assert min(contrast(colour, page, eye) for colour in drawn for page in (WHITE, BLACK)) > 2.7
    assert smallest_difference([colours.SCORES[score] for score in ("SA", "DA", "AA")], eye) > 11


def own_colours() -> dict[str, colours.Colour]:
    """The colours that the methods of dynaviz name."""
    return {
        handle.name: handle.load().info.colour
        for handle in registry.handles("methods")
        if handle.distribution == "dynaviz"
    }


@pytest.mark.parametrize("eye", EYES)
def test_methods_differ(eye: str) -> None:
    own = own_colours().values()
    assert smallest_difference(own, eye) > 20
    every = [*own, *colours.OTHERS]
    assert min(contrast(colour, page, eye) for colour in every for page in (WHITE, BLACK)) > 1.9


def test_each_method_has_a_colour_for_good() -> None:
    named = own_colours()
    assert {name: colours.method_colour(name) for name in named} == named
    assert colours.method_colour("erasor") == (195, 0, 0)
    assert colours.method_colour("mine") == colours.method_colour("mine") in colours.OTHERS
    shades = {colours.shade((100, 200, 50), name) for name in "abcdefgh"}
    assert shades == {(72, 144, 36), (90, 180, 45), (110, 220, 55), (130, 255, 65)}
    assert colours.web((195, 0, 10)) == "#c3000a"
