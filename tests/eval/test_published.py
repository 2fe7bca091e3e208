"""Published numbers are consistent."""

import math

import pytest

from dynaviz_eval.published import published, published_runtimes, published_sequences

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
    ("sequence", "row"), ROWS, ids=[f"{s} {r.title}, {r.source[:6]}" for s, r in ROWS]
)
def test_AA_and_HA_fit_SA_and_DA(sequence, row):
    rounding = 0.06 if "DOR" in row.source else 0.015
    means = math.sqrt(row.SA * row.DA), 2 * row.SA * row.DA / (row.SA + row.DA)
    assert pytest.approx(means, abs=rounding) == (row.AA, row.HA)


def test_a_row_names_its_source():
    row = next(row for row in published("kitti_00") if row.method == "octomap_gf")
    assert (row.SA, row.DA, row.AA) == (93.06, 98.67, 95.83)
    assert "ITSC 2023" in row.source


def test_runtimes_of_the_papers_table():
    table = {row.method: row for row in published_runtimes() if row.sequence is None}
    assert (table["erasor"].mean_s, table["erasor"].std_s, table["erasor"].n_parameters) == (
        0.718,
        0.039,
        18,
    )
    assert len(table) == 5
