"""Findings in words."""

from __future__ import annotations

from dataclasses import replace

from dynaviz.diagnosis.finding import Confidence, Finding


def test_a_finding_names_its_first_frames():
    several = Finding("no return", Confidence.CERTAIN, "", "", frames=(3, 4), count=1200)
    assert several.where == "frames 3, 4 and 1,198 more"
    assert replace(several, frames=(3,), count=1).where == "frame 3"
    assert (replace(several, frames=()).where, replace(several, frames=(), file="a.bin").where) == (
        "all frames",
        "",
    )
