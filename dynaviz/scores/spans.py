"""Spans of frames: when an object moved or stood, when rays met its place, and when a method kept
or removed it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from dynaviz.scores.failure_case import FailureCase

Span = tuple[int, int]  # first and last frame
Spans = Mapping[str, tuple[Span, ...]]  # by state, one of those in ``LANES``

# States by lane; frames without a state are unseen. An object is ``kept`` if more than half of its
# points are, ``partly`` if some are, ``removed`` if none is; a place of static points is
# ``removed`` where some of them are.
LANES: dict[str, tuple[str, ...]] = {
    "truth": ("moving", "standing"),
    "looks": ("hit", "through", "hidden"),
    "answer": ("kept", "partly", "removed"),
}

MOST = 4  # spans of a lane in words


def spans_of(frames: Iterable[int]) -> tuple[Span, ...]:
    """The spans of ascending frames without gaps."""
    found: list[Span] = []
    for frame in frames:
        if found and frame == found[-1][1] + 1:
            found[-1] = found[-1][0], frame
        else:
            found.append((frame, frame))
    return tuple(found)


def lane(spans: Spans, name: str) -> list[tuple[str, Span]]:
    """The states of a lane with their spans, in the order of frames."""
    found = [(state, span) for state in LANES[name] for span in spans.get(state, ())]
    return sorted(
        ((state, (first, last)) for state, (first, last) in found), key=lambda part: part[1]
    )


def shared_objects(
    runs: Mapping[str, Sequence[FailureCase]],
) -> list[tuple[str, dict[str, list[tuple[str, Span]]]]]:
    """The objects that runs kept, the costliest first.

    What each is, its own states, and by run what it decided.

    A run without a case on an object removed it. Objects without a number cannot be told apart
    between runs, and are left out.
    """
    found: dict[tuple[int | None, int], dict[str, FailureCase]] = {}
    for run, cases in runs.items():
        for case in cases:
            if case.instance and case.spans:
                found.setdefault((case.class_, case.instance), {}).setdefault(run, case)
    objects = []
    for of in sorted(found.values(), key=lambda of: -max(case.cost for case in of.values())):
        first = next(iter(of.values()))
        truth = lane(first.spans, "truth")
        gone = [("removed", span) for _, span in truth]
        answers = {run: lane(of[run].spans, "answer") if run in of else gone for run in runs}
        objects.append((f"{first.what} {first.instance}", {"object": truth, **answers}))
    return objects


def in_words(spans: Spans) -> str:
    """When an object moved, and when it was kept, such as ``moves 0-19, stands 20-60.

    Kept 0-26, removed 27-60``.
    """
    verbs = {"moving": "moves", "standing": "stands", "partly": "partly kept"}
    lanes = [
        [f"{verbs.get(state, state)} {_span(span)}" for state, span in lane(spans, name)]
        for name in LANES
    ]
    return "; ".join(
        ", ".join(parts[:MOST]) + ", ..." * (len(parts) > MOST) for parts in lanes if parts
    )


def _span(span: Span) -> str:
    return str(span[0]) if span[0] == span[1] else f"{span[0]}-{span[1]}"
