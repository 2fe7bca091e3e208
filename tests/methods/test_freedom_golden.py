"""The labels of the public program on the same input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz_methods.freedom.method import Freedom

FEW = 10  # frames of the real sequence


def answers(golden, scans, params):
    """The labels by the map, and those by each scan alone."""
    method = Freedom(params)
    method.begin(Context(Extent.of(*scans), golden.sensor))
    for scan in scans:
        method.observe(scan)
    by_map = np.concatenate([method.label(scan).dynamic for scan in scans])
    method.params = dataclasses.replace(params, own_scan=True)
    return by_map, np.concatenate([method.label(scan).dynamic for scan in scans])


def test_every_label_of_the_port_matches_the_public_program(mini):
    params = dataclasses.replace(resolve(Freedom, "helimos").params, port=True)
    by_map, own = answers(mini, mini.scans, params)
    np.testing.assert_array_equal(by_map, mini.removed["freedom"])
    np.testing.assert_array_equal(own, mini.removed["freedom_online"])


def test_labels_of_single_scans_on_real_data_match_the_public_program(kitti_tracking_0012):
    """Those of the map depend on all 78 scans."""
    scans = kitti_tracking_0012.scans[:FEW]
    _, own = answers(kitti_tracking_0012, scans, resolve(Freedom, "port").params)
    theirs = kitti_tracking_0012.removed["freedom_online"][: len(own)]
    assert theirs.sum() > 100
    np.testing.assert_array_equal(own, theirs)


def test_the_default_removes_more_of_movers_at_the_same_static_accuracy(mini):
    by_map, own = answers(mini, mini.scans, resolve(Freedom, "helimos").params)
    assert mini.scores(by_map) == pytest.approx((99.04, 76.45, 87.01), abs=0.01)
    np.testing.assert_array_equal(own, mini.removed["freedom_online"])
