"""The law of reading: a map is right to 5 cm, or a finding or an error names what is wrong.

Situations are drawn at random (``helpers.situations``); ``make law`` draws 3,000.
"""

from __future__ import annotations

import pytest
from helpers.situations import CANNOT_TELL, FAULTS, NAMED, RIGHT, SILENT, Situation

SEEDS = {fault: [s for s in range(2000) if Situation.drawn(s).fault == fault] for fault in FAULTS}
QUICK = 10  # one of so many correct situations is checked for findings, too
READ = ("GPS time", "relative time", "leap seconds apart", "points in millimetres", "mount")
MEASURED = [
    fault if fault in READ else pytest.param(fault, marks=pytest.mark.slow) for fault in FAULTS
]


@pytest.mark.parametrize("seed", range(0, 120, 3))
def test_what_programs_write_is_read_rightly(seed: int) -> None:
    situation = Situation.drawn(seed)
    assert situation.fault == ""
    assert situation.outcome(check=seed % QUICK == 0) == (RIGHT, ""), situation


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(1040, id="points of the sensor, said to be in a world far away"),
        pytest.param(1075, id="points that were placed already, in a world far away"),
        pytest.param(1057, id="millimetres, and quaternions with w first"),
        pytest.param(1292, id="points of the sensor, said to be in the world, with w first"),
    ],
)
def test_two_doubts_at_once_are_named(seed: int) -> None:
    situation = Situation.drawn(seed)
    assert situation.outcome()[0] == NAMED, situation


@pytest.mark.parametrize("fault", MEASURED)
def test_a_fault_is_read_rightly_or_named(fault: str) -> None:
    situation = Situation.drawn(SEEDS[fault][0])
    outcome, words = situation.outcome()
    assert outcome in (RIGHT, NAMED, CANNOT_TELL), f"{situation}: {words}"


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_no_fault_is_silent(fault: str) -> None:
    for seed in SEEDS[fault][1:6]:
        situation = Situation.drawn(seed)
        assert situation.outcome()[0] != SILENT, situation
