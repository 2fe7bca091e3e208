"""All kept points of an object with a number are one case."""

from __future__ import annotations

from collections import Counter

import numpy as np
from helpers.failure_cases import labelled, section
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.contracts.scan import Label

FAR = 30.0  # metres between objects, and between visits of one
Visits = list[tuple[int, int, int]]  # number of the object, frame, points


@settings(deadline=None, max_examples=30)
@given(
    st.lists(
        st.tuples(st.integers(1, 130), st.integers(0, 59), st.integers(1, 4)),
        min_size=1, max_size=60, unique_by=lambda visit: visit[:2],
    )
)  # fmt: skip
def test_kept_points_of_an_object_are_one_case_however_long_it_is_away(visits: Visits) -> None:
    frames = []
    for frame in range(60):
        here = [visit for visit in visits if visit[1] == frame]
        points = [
            (FAR * number + 0.1 * k, FAR * frame, 0.0)
            for number, _, count in here
            for k in range(count)
        ]
        numbers = np.repeat([number for number, *_ in here], [count for *_, count in here])
        fields = {"instances": numbers.astype(np.int32), "classes": numbers.astype(np.int32) * 0}
        frames.append(labelled(frame, points, Label.DYNAMIC, False, **fields))
    cases = section(*frames)["cases"]
    totals: Counter[int] = Counter()
    for number, _, count in visits:
        totals[number] += count
    found = {case["instance"]: case for case in cases}
    assert len(found) == len(cases) == min(len(totals), 100)
    for number, case in found.items():
        assert case["points"] == totals[number]
        of = [frame for other, frame, _ in visits if other == number]
        assert (case["first_frame"], case["last_frame"]) == (min(of), max(of))
        assert case["frames"] == len(of)
