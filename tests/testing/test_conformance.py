"""Every installed method passes the conformance kit, and the kit catches methods that break the
contract.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from dynaviz.contracts import registry
from dynaviz.contracts.evidence import Asked, Evidence, Rule, Term, voxels_around
from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.probe import Mask, Scalar, State
from dynaviz.contracts.scan import Label, Scan
from dynaviz.testing import CHECKS, check_method, crossing

# The base of a BeautyMap column depends on columns at lower x and y, so it changes in a rotated
# world.
NOT_MET = {("beautymap", "scores_alike_in_a_moved_world")}


# Checks that feed kernels unusual indices: empty scans, points without a voxel, points outside the
# extent.
INDICES = ("survives_few_points", "keeps_points_without_a_place", "survives_odd_places")
MARKS = {**dict.fromkeys(INDICES, ("boundscheck",)), "scores_alike_in_a_moved_world": ("slow",)}


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(
            check, id=name, marks=[getattr(pytest.mark, mark) for mark in MARKS.get(name, ())]
        )
        for name, check in CHECKS.items()
    ],
)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            handle.name,
            marks=pytest.mark.slow if handle.name in ("octomap_g", "octomap_gf") else [],
        )
        # both add filters to octomap that have tests of their own
        for handle in registry.handles("methods")
    ],
)
def test_conforms(
    name: str, check: Callable[[Any, Any], None], request: pytest.FixtureRequest
) -> None:
    if (name, check.__name__) in NOT_MET:
        request.applymarker(pytest.mark.xfail(raises=AssertionError, strict=True))
    method = registry.load("methods", name)
    check(method, method.Params())


def labels(dynamic: Any) -> Labels:
    return Labels(dynamic, dynamic.astype(np.uint8))


class Farthest:
    """Removes points farther than a limit from the sensor; conforms to the contract."""

    info = MethodInfo(
        "farthest",
        "Farthest",
        "unpublished",
        (Reason("near", "kept"), Reason("far", "removed")),
        (State("limit", Scalar, "the limit"), State("far", Mask, "far points")),
    )

    @dataclass(frozen=True)
    class Params:
        limit: float = 20.0

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        self.probe = context.probe

    def observe(self, scan: Scan) -> None:
        self.probe.emit("limit", Scalar(self.params.limit))
        if self.probe.wants("far"):
            self.probe.emit("far", Mask(self.label(scan).dynamic))

    def label(self, scan: Scan) -> Labels:
        with np.errstate(invalid="ignore"):
            distance = np.linalg.norm(scan.points - scan.position.astype(np.float32), axis=1)
        return labels(np.isfinite(distance) & (distance > self.params.limit))


@pytest.mark.boundscheck
def test_a_conforming_method_passes() -> None:
    check_method(Farthest)


class UsesWorldAxes(Farthest):
    def label(self, scan: Scan) -> Labels:
        return labels(np.nan_to_num(scan.points[:, 0], posinf=0) > 5)


class DependsOnCalls(Farthest):
    def label(self, scan: Scan) -> Labels:
        self.asked = getattr(self, "asked", 0) + 1
        return labels(super().label(scan).dynamic & (self.asked % 2 == 0))


class EmitsUndeclared(Farthest):
    def observe(self, scan: Scan) -> None:
        self.probe.emit("secret", Scalar(1.0))


class NeverEmits(Farthest):
    def observe(self, scan: Scan) -> None:
        return None


class ModifiesInput(Farthest):
    def observe(self, scan: Scan) -> None:
        super().observe(scan)
        scan.points[:] = 0


class Contradicts(Farthest):
    def evidence(self, asked: Asked) -> Evidence:
        with np.errstate(invalid="ignore"):
            distance = np.linalg.norm(asked.points - asked.scan.position.astype(np.float32), axis=1)
        rule = Rule("far", (Term("distance", distance, ">", self.params.limit + 1, "m"),))
        return Evidence(voxels_around(asked.points, 0.1), (), (rule,))


class StatesNoRule(Farthest):
    def evidence(self, asked: Asked) -> Evidence:
        return Evidence(voxels_around(asked.points, 0.1), (), ())


class DependsOnEvidence(Contradicts):
    def evidence(self, asked: Asked) -> Evidence:
        self.params = dataclasses.replace(self.params, limit=self.params.limit + 1)
        return super().evidence(asked)


class DependsOnProbe(Farthest):
    def label(self, scan: Scan) -> Labels:
        return labels(
            super().label(scan).dynamic
            ^ (self.probe.wants("far") & np.isfinite(scan.points).all(1))
        )


class OneLabelShort(Farthest):
    def label(self, scan: Scan) -> Labels:
        return labels(super().label(scan).dynamic[1:])


class RemovesNan(Farthest):
    def label(self, scan: Scan) -> Labels:
        return labels(super().label(scan).dynamic | np.isnan(scan.points).any(1))


class OneReasonForBoth(Farthest):
    def label(self, scan: Scan) -> Labels:
        return Labels(super().label(scan).dynamic, np.zeros(len(scan), np.uint8))


@pytest.mark.boundscheck
@pytest.mark.parametrize(
    ("method", "complaint"),
    [
        (UsesWorldAxes, "scores_alike_in_a_moved_world: SA and DA change from"),
        (DependsOnCalls, "answers_in_any_order|answers_for_every_point|leaves_its_input_alone"),
        (EmitsUndeclared, "emitted but not declared in info.emits: {'secret'}"),
        (NeverEmits, "declared in info.emits but never emitted"),
        (ModifiesInput, "read-only"),
        (
            DependsOnProbe,
            "answers_alike_when_watched: labels change with a probe|used for both kept and removed",
        ),
        (
            Contradicts,
            r"decides_by_its_evidence: the evidence contradicts the labels of \d+ of 99 points of "
            r"frame",
        ),
        (
            StatesNoRule,
            "decides_by_its_evidence: evidence\\(\\) states no rule for the points of frame 0",
        ),
        (
            DependsOnEvidence,
            "answers_alike_when_watched: labels change with a probe or with questions",
        ),
        (OneLabelShort, r"answers_for_every_point: label\(\) returned 9599 labels for 9600 points"),
        (RemovesNan, "keeps_points_without_a_place: a point that is not finite is removed"),
        (OneReasonForBoth, "reason 'near' is used for both kept and removed points"),
    ],
)
def test_the_checks_catch(method: Any, complaint: str) -> None:
    with pytest.raises(AssertionError, match=complaint):
        check_method(method)


@pytest.mark.boundscheck
def test_the_world_has_dynamic_points_and_is_reproducible() -> None:
    scans = crossing()
    assert all((scan.labels == Label.DYNAMIC).sum() > 50 for scan in scans)
    assert crossing(2)[1].points.tobytes() == scans[1].points.tobytes()
