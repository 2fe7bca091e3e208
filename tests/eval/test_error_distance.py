"""Distances from wrong points to correct ones."""

import errno
import gc
import json
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers.sections import plain

from dynaviz.contracts.scan import Outcome
from dynaviz.errors import DynavizError
from dynaviz_eval.error_distance import EDGES, ErrorDistance, distances, summary
from dynaviz_eval.spool import PointSpool

pytestmark = pytest.mark.boundscheck


def spool_of(clouds):
    spool = PointSpool()
    for frame, points in enumerate(clouds):
        spool.append(frame, np.asarray(points, np.float32).reshape(-1, 3))
    return spool


def clouds(frames, n, seed, spread):
    rng = np.random.default_rng(seed)
    return [rng.normal((3.0 * k, 0, 0), spread, (n, 3)) for k in range(frames)]


def all_pairs(query, reference):
    return np.linalg.norm(np.asarray(query)[:, None] - np.asarray(reference)[None], axis=2).min(1)


def run(info, *labelled):
    metric = ErrorDistance(info)
    for each in labelled:
        assert metric.update(each) == {}
    return plain(metric.finish())["error_distance"], metric.figures()


def test_distances_span_frames(info, make_labelled):
    missed = make_labelled(0, points=np.zeros((1, 3)), labels=[1], dynamic=[False])
    later = make_labelled(1, points=[[0.3, 0.4, 0], [9, 0, 0]], labels=[1, 0], dynamic=[True, True])
    section, histograms = run(info, missed, later)
    found = section["false_negative"]
    assert found["p10"] == found["p50"] == found["p90"] == pytest.approx(0.5, abs=2e-4)
    assert (found["within_0.1"], found["within_0.3"], found["within_1.0"]) == (0, 0, 100)
    assert histograms["false_negative"].counts.tolist() == [found["histogram"], [0] * 40 + [0]]
    assert found["histogram"].index(1) == 10
    assert section["false_positive"] == dict.fromkeys(section["false_positive"]) | {
        "count": 0
    }  # no true negative


@pytest.mark.plain
def test_sections_equal_all_pairs_of_all_frames(info, make_labelled):
    frames = [make_labelled(k) for k in range(3)]
    section, histograms = run(info, *frames)
    points = np.concatenate([f.scan.points for f in frames])
    outcome = np.concatenate([f.outcome for f in frames])
    for kind, wrong, right in (
        ("false_negative", Outcome.FALSE_NEGATIVE, Outcome.DYNAMIC_REMOVED),
        ("false_positive", Outcome.FALSE_POSITIVE, Outcome.STATIC_KEPT),
    ):
        expected = all_pairs(points[outcome == wrong], points[outcome == right])
        found = section[kind]
        assert found["count"] == len(expected)
        assert found["histogram"] == np.histogram(expected, EDGES)[0].tolist()
        assert len(found["histogram"]) == 41
        assert found["p50"] == pytest.approx(
            np.quantile(expected, 0.5, method="inverted_cdf"), abs=2e-4
        )
        for metres in (0.1, 0.3, 1.0):
            assert found[f"within_{metres}"] == pytest.approx(100 * (expected < metres).mean())
        of_frame = np.repeat(range(3), [len(f.scan) for f in frames])[outcome == wrong]
        assert (
            histograms[kind].counts[2].tolist()
            == np.histogram(expected[of_frame == 2], EDGES)[0].tolist()
        )


@pytest.mark.parametrize("block", [20, 333])
def test_slabs_and_blocks_change_nothing(block):
    wrong, right = spool_of(clouds(6, 60, 1, 2.0)), spool_of(clouds(7, 80, 2, 2.0))
    whole = distances(wrong, right, 6, block=10**9)
    cut = distances(wrong, right, 6, block=block)
    assert whole[0].sum() == 360
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(a, b)


def test_memory_depends_on_the_block_not_on_the_run():
    frame = np.random.default_rng(0).uniform(-20, 20, (20_000, 3)).astype(np.float32)
    spool = spool_of([frame] * 40)
    tracemalloc.start()
    try:
        spool.sample(0, 64)
        low, high = np.array([[-10, -np.inf, -np.inf], [10, np.inf, np.inf]])
        assert sum(len(points) for points, _ in spool.blocks(low, high, 20_000)) > 40 * 9000
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * frame.nbytes  # of 40 on disk


def test_distances_beyond_the_limit_are_only_counted(info, make_labelled):
    points = [[0, 0, 0], [1, 0, 0], [500, 0, 0]]
    section, _ = run(
        info, make_labelled(0, points=points, labels=[1, 1, 1], dynamic=[True, False, False])
    )
    found = section["false_negative"]
    assert found["p50"] == pytest.approx(1, abs=2e-4)
    assert found["p90"] is None  # beyond 2 m
    assert found["histogram"][-1] == 1
    assert found["count"] == 2


def test_undefined_without_wrong_or_correct_points(info, make_labelled):
    perfect = make_labelled(0, points=np.zeros((2, 3)), labels=[0, 1], dynamic=[False, True])
    blind = make_labelled(0, points=np.zeros((2, 3)), labels=[0, 1], dynamic=[True, False])
    for labelled in (perfect, blind):
        section, histograms = run(info, labelled)
        assert histograms == {}
        for found in section.values():
            assert {v for k, v in found.items() if k != "count"} == {None}
        json.dumps(section, allow_nan=False)


def test_points_without_coordinates_have_no_distance(info, make_labelled):
    points = [[0, 0, 0], [0.1, 0, 0], [np.nan, 0, 0], [0, np.inf, 0]]
    section, _ = run(
        info, make_labelled(0, points=points, labels=[1] * 4, dynamic=[True, False, False, False])
    )
    assert section["false_negative"]["count"] == 1


def test_percentiles_of_known_distances():
    fine = np.zeros(20_001, np.int64)
    # just under 0.1 m, 0.1 m, just under 1 m, beyond 2 m
    fine[[999, 1000, 9999, 20_000]] = (
        25,
        25,
        40,
        10,
    )
    found = summary(fine)
    assert (found.p10, found.p50, found.p90) == (0.1, 0.1001, 1.0)
    assert (found.within_01, found.within_03, found.within_10) == (25, 50, 90)


def open_files(folder):
    names = []
    for fd in Path("/proc/self/fd").iterdir():
        try:
            names.append(str(fd.readlink()))
        except FileNotFoundError:  # the descriptor of the listing itself
            continue
    return [name for name in names if name.startswith(str(folder))]


@pytest.mark.skipif(
    not Path("/proc/self/fd").exists(), reason="open files are listed under /proc on Linux only"
)
@pytest.mark.parametrize("ending", ["finished", "deleted"])
def test_temporary_files_are_deleted(info, make_labelled, ending, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    metric = ErrorDistance(info)
    metric.update(make_labelled(0))
    assert len(open_files(tmp_path)) == 4
    if ending == "finished":
        metric.finish()
    else:
        del metric
        gc.collect()
    assert not open_files(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_reported():
    class Full:
        def write(self, data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    spool = PointSpool()
    spool._file = Full()
    with pytest.raises(DynavizError, match=r"No space left.*TMPDIR"):
        spool.append(0, np.zeros((5, 3), np.float32))


def test_percentiles_of_evenly_spread_distances():
    """One distance at every 0.1 mm: a percentile is where its share of them is reached."""
    fine = np.zeros(20001, np.int64)
    fine[:10000] = 1
    found = summary(fine)
    assert (found.p10, found.p50, found.p90) == (0.1, 0.5, 0.9)
    assert (found.within_01, found.within_03, found.within_10) == (10.0, 30.0, 100.0)
