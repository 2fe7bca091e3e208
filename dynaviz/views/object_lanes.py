"""Objects over time, as lanes of the viewer's state timeline.

What each did, what rays met, what a method decided.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from dynaviz import colours
from dynaviz.scores.spans import Span
from dynaviz.views import paths

MOST = 8  # objects; more lanes would not fit into the view

Parts = Sequence[tuple[str, Span]]  # states with their spans, in the order of frames


def names(objects: Sequence[str]) -> list[str]:
    """The name of each object as a part of a path: ``van_9``; of several alike, with a number."""
    plain = [re.sub(r"\W+", "_", each).strip("_") for each in objects]  # paths escape spaces
    return [
        f"{name}_{plain[: k + 1].count(name)}" if plain.count(name) > 1 else name
        for k, name in enumerate(plain)
    ]


def lanes(
    name: str, ghost: bool, parts: Mapping[str, Parts]
) -> Iterator[tuple[str, Any, list[int], Any]]:
    """The lanes of an object.

    Of each its path, its style, the frames at which its state changes, and the states.

    Args:
        name: of the object, as in ``names``.
        ghost: whether it is dynamic, which decides the colours.
        parts: by the name of the lane.
    """
    shades = {state: (*colour, 255) for state, colour in colours.span_colours(ghost).items()}
    style = rr.StateConfiguration(values=list(shades), colors=list(shades.values()))
    for lane, states in parts.items():
        changes = {span[1] + 1: "" for _, span in states} | {
            span[0]: state for state, span in states
        }
        if changes:
            columns = rr.StateChange.columns(state=[changes[frame] for frame in sorted(changes)])
            yield f"{paths.OBJECTS}/{name}/{lane}", style, sorted(changes), columns


def view() -> Any:
    """The view of all objects; it is empty on the timeline of cases."""
    return rrb.StateTimelineView(name="objects over time", origin=f"/{paths.OBJECTS}")
