"""The labels of the public program on the same input."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz_methods.hmm_mos.method import HmmMos

FEW = 12  # frames of the real sequence; the method is online, so later frames do not change them


def labels(scans, preset=None):
    method = HmmMos(resolve(HmmMos, preset).params)
    method.begin(Context(Extent.of(*scans)))
    for scan in scans:
        method.observe(scan)
    return np.concatenate([method.label(scan).dynamic for scan in scans])


def test_every_label_of_the_port_matches_the_public_program(mini):
    np.testing.assert_array_equal(labels(mini.scans, "port"), mini.removed["hmm_mos"])


def test_every_label_on_real_data_matches_the_public_program(kitti_tracking_0012):
    scans = kitti_tracking_0012.scans[:FEW]
    found = labels(scans, "port")
    theirs = kitti_tracking_0012.removed["hmm_mos"][: len(found)]
    assert theirs.sum() > 500
    np.testing.assert_array_equal(found, theirs)


def test_rounding_down_instead_of_towards_zero_changes_few_labels(mini):
    found = labels(mini.scans)
    assert 0 < (found != mini.removed["hmm_mos"]).sum() < 1000
    assert mini.scores(found) == pytest.approx((99.89, 62.58, 79.06), abs=0.01)
