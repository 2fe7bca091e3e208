"""Colours with a fixed meaning, in recordings, plots and reports.

One hue has one meaning everywhere.

Two shades per meaning: ``BRIGHT`` for points and boxes on the dark background of 3D views and maps,
``FIRM`` for curves and bars on a page that may be white or black. Orange always is a ghost (a
dynamic point that was kept), yellow a hole (a static point that was removed), blue a dynamic point
that was removed, grey a static point that was kept, pink a removed point without ground truth.
"""

from __future__ import annotations

import contextlib
import zlib
from functools import cache
from typing import cast

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Outcome
from dynaviz.errors import PluginError

Colour = tuple[int, int, int]  # RGB, 0 to 255

BACKGROUND: Colour = (18, 20, 26)  # of 3D views and maps, in every theme
# text in 3D views: its plate is dark grey in the dark theme, otherwise mid-grey
LABEL: Colour = (
    255,
    255,
    255,
)
NEUTRAL: Colour = (135, 135, 140)  # marks without a meaning of their own, on white and on black

BRIGHT: dict[Outcome, Colour] = {
    Outcome.STATIC_KEPT: (118, 118, 126),
    Outcome.DYNAMIC_REMOVED: (86, 170, 240),
    Outcome.FALSE_POSITIVE: (255, 240, 130),
    Outcome.FALSE_NEGATIVE: (255, 125, 0),
    Outcome.UNLABELLED_KEPT: (58, 58, 66),
    Outcome.UNLABELLED_REMOVED: (255, 175, 210),
}
# of runs without ground truth, in which no point is labelled
UNSCORED: dict[Outcome, Colour] = {**BRIGHT, Outcome.UNLABELLED_KEPT: BRIGHT[Outcome.STATIC_KEPT]}
FIRM: dict[Outcome, Colour] = {
    Outcome.STATIC_KEPT: NEUTRAL,
    Outcome.DYNAMIC_REMOVED: (30, 125, 205),
    Outcome.FALSE_POSITIVE: (172, 153, 40),
    Outcome.FALSE_NEGATIVE: (198, 77, 0),
    Outcome.UNLABELLED_KEPT: NEUTRAL,
    Outcome.UNLABELLED_REMOVED: (170, 95, 150),
}
WORDS: dict[Outcome, str] = {
    Outcome.STATIC_KEPT: "grey",
    Outcome.DYNAMIC_REMOVED: "blue",
    Outcome.FALSE_POSITIVE: "yellow",
    Outcome.FALSE_NEGATIVE: "orange",
    Outcome.UNLABELLED_KEPT: "dark grey",
    Outcome.UNLABELLED_REMOVED: "pink",
}
SCORES: dict[str, Colour] = {  # a score has the hue of the errors that lower it
    "SA": FIRM[Outcome.FALSE_POSITIVE],
    "DA": FIRM[Outcome.FALSE_NEGATIVE],
    "AA": NEUTRAL,
    "HA": (150, 105, 205),
}
OTHERS: tuple[Colour, ...] = (
    (0, 140, 140), (140, 95, 50), (60, 150, 60), (90, 125, 155), (150, 105, 205), (190, 100, 120),
    (10, 122, 191),
    (125, 125, 60),
)  # fmt: skip


# classes of rays
HIT = 1
CROSSED = 2
GRAZED = 3
RAYS: dict[int, Colour] = {HIT: (60, 205, 140), CROSSED: (180, 80, 255), GRAZED: (120, 40, 140)}
SPANS: dict[str, Colour] = {  # states of an object over time
    "moving": (235, 235, 235),
    "standing": (135, 135, 140),
    "hit": RAYS[HIT],
    "through": RAYS[CROSSED],
    "hidden": (95, 95, 100),
    "partly": (255, 205, 160),  # pale orange
}
STATE: Colour = (0, 175, 155)  # of a state without values or classes
CLASSES: tuple[
    Colour, ...
] = (  # classes of a method's state, in the order of its legend; but for the first, of no outcome
    (118, 118, 126),
    STATE,
    (225, 80, 180),
    (150, 180, 50),
    (150, 120, 240),
    (170, 110, 70),
    (235, 235, 235),
)


@cache
def method_colour(name: str) -> Colour:
    """The colour of a method, the same in every figure, on white and on black.

    Args:
        name: of the method, as on the command line. If it is not installed or names no colour, the
            checksum of its name picks one of ``OTHERS``; two such methods may share it, so give
            them different markers.
    """
    handle = next((each for each in registry.handles("methods") if each.name == name), None)
    with contextlib.suppress(PluginError):
        if handle is not None and (colour := handle.load().info.colour):
            return cast(Colour, colour)
    return OTHERS[zlib.crc32(name.encode()) % len(OTHERS)]


def span_colours(ghost: bool) -> dict[str, Colour]:
    """The colours of states over time.

    ``kept`` and ``removed`` as for points of an object (``ghost``) or a place.
    """
    kept, removed = (
        (Outcome.FALSE_NEGATIVE, Outcome.DYNAMIC_REMOVED)
        if ghost
        else (Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE)
    )
    return {**SPANS, "kept": BRIGHT[kept], "removed": BRIGHT[removed]}


def shade(colour: Colour, name: str) -> Colour:
    """A darker or lighter shade of a colour, by the checksum of a name.

    For curves of the same meaning.
    """
    factor = (0.72, 0.9, 1.1, 1.3)[zlib.crc32(name.encode()) % 4]
    red, green, blue = (min(255, round(factor * part)) for part in colour)
    return red, green, blue


def web(colour: Colour) -> str:
    """A colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
