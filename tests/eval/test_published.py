"""Published numbers are consistent."""

import math

import pytest

from dynaviz.contracts import registry
from dynaviz_eval.published import (
    published,
    published_by_protocol,
    published_runtimes,
    published_sequences,
)

pytestmark = pytest.mark.boundscheck

ROWS = [(sequence, row) for sequence in published_sequences() for row in published(sequence)]


def test_the_sequences_of_the_benchmark_are_known():
    assert published_sequences() == [
        "av2",
        "kitti_00",
        "kitti_01",
        "kitti_02",
        "kitti_05",
        "kitti_07",
        "semindoor",
    ]
    assert published("nowhere") == ()


@pytest.mark.parametrize(
    ("sequence", "row"), ROWS, ids=[f"{s} {r.title}, {r.source.text[:6]}" for s, r in ROWS]
)
def test_AA_and_HA_fit_SA_and_DA(sequence, row):
    rounding = 0.06 if "DOR" in row.source.text else 0.015
    means = math.sqrt(row.SA * row.DA), 2 * row.SA * row.DA / (row.SA + row.DA)
    assert pytest.approx(means, abs=rounding) == (row.AA, row.HA)


def test_a_row_names_its_source():
    row = next(row for row in published("kitti_00") if row.method == "octomap_gf")
    assert (row.SA, row.DA, row.AA) == (93.06, 98.67, 95.83)
    assert "ITSC 2023" in row.source.text
    assert "read in the paper" in str(row.source)


def test_runtimes_of_the_papers_table():
    table = {row.method: row for row in published_runtimes() if row.sequence is None}
    assert (table["erasor"].mean_s, table["erasor"].std_s, table["erasor"].n_parameters) == (
        0.718,
        0.039,
        18,
    )
    assert len(table) == 5


OTHERS = published_by_protocol()


@pytest.mark.parametrize("row", OTHERS, ids=[f"{r.sequence} {r.title}" for r in OTHERS])
def test_a_score_belongs_to_its_protocol(row):
    info = registry.load("protocols", row.protocol).info
    assert row.scores
    assert set(row.scores) <= set(info.scores)
    assert row.source.read in ("paper", "repository", "secondary")
    if {"PR", "RR", "F1"} <= set(row.scores):  # rounded parts
        PR, RR, F1 = (row.scores[name] for name in ("PR", "RR", "F1"))
        assert pytest.approx(2 * PR * RR / (PR + RR), abs=0.09) == F1


def test_scores_under_other_protocols_are_found_by_the_name_of_a_sequence():
    kitti = published_by_protocol("semantickitti_00")
    assert {row.protocol for row in kitti} == {"erasor"}
    best = max(kitti, key=lambda row: row.scores["F1"])
    assert (best.title, best.scores["F1"]) == ("ERASOR2", 98.6)
    assert {row.protocol for row in published_by_protocol("02")} == {"erasor", "freedom"}
    doals = published_by_protocol("doals_station_1")
    assert {row.method: row.scores["IoU"] for row in doals}["hmm_mos"] == 88.7
    assert [row.title for row in doals if row.learned] == ["3DMiniNet"]
    assert published_by_protocol("somewhere else") == ()
