"""What SeeThrough knows about one scan: measured from all scans so far, and judged by what moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I32, I64, U8, Bool, Intp
from dynaviz.contracts.evidence import Rule, Term

FEW = 3  # minimum number of voting points of a dynamic object
PROOF = 2  # number of earlier scans in which a followed object must have been dynamic
STAYS = 0.25  # share of the points seen clear: an object with more that was hit before and after does not follow
SURE = 12  # number of earlier scans in which an object was dynamic, after which that share may be higher
STAYS_SURE = 0.7  # the share then: noise between the points of a parked car hits them again
WAITED_FOR = 0.1  # share of an object's points that must have been seen clear if the object leaves later
LEAVES = 0.01  # mean vote above which an object may leave later: an error of a pose lets single rays through a wall
LEFT = 0.07  # share of an object's points that must have been seen clear after the last hit
RARELY = 0.1  # maximum mean vote of an object that does not follow because something was already in its place


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What the scans so far show of one of them, wherever objects moved.

    Attributes:
        index: number of the scan.
        position: (3,) float64, metres, world frame: position of the sensor.
        points: (N, 3) float32, metres; voxels: (N,) int64, -1 for none; places: (N,) int64, quarter columns.
        height: (N,) float32, metres above the ground; infinite if unknown. low: (N,) bool, near the ground.
        objects: (N,) int32, the object of each point, -1 for none; n: their number.
        evidence: (7, n) int64, by object: points, voting points, sum of votes, points seen clear, points seen clear
            between two hits, points seen clear after the last hit, evidence against votes.
    """

    index: int
    position: F64
    points: F32
    voxels: I64
    places: I64
    height: F32
    low: Bool
    objects: I32
    n: int
    evidence: I64


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What decided the labels of the scan that was judged last.

    Attributes:
        measured: the scan.
        weighed: (10, objects) int64, without the parts that stay: points, voting points, sum of votes, points seen
            clear, points where an object moved lately, scans in which that one moved, points where the last object
            moved, points seen clear between two hits, points seen clear after the last hit, points where something was
            before any object moved.
        verdict: (N,) uint8: why each point's object is dynamic, or that the point is in a settled part or in a place
            where something always was; 0 otherwise.
    """

    measured: Measured
    weighed: I64
    verdict: U8


def verdicts(weighed: I64, votes: int, share: float) -> tuple[Bool, Bool, Bool]:
    """Which objects waited, which are followed, and which are dynamic by their votes, (objects,) bool each.

    Args:
        weighed: as in ``Judged``.
        votes: maximum vote of a voxel, scans.
        share: mean vote above which an object is dynamic, from 0 to 1.
    """
    size, having, voted, touched, lately, proof, left, between, after, old = weighed
    left_later = (touched > WAITED_FOR * size) & (after - between > LEFT * size)
    waited = (2 * left > size) & left_later & (voted > 1000 * LEAVES * votes * having)
    rarely = voted <= 1000 * RARELY * votes * having
    came = (touched > 0) & (between <= again(proof) * touched) & ~((2 * old > size) & rarely)
    followed = (2 * lately > size) & (proof >= PROOF) & came
    seen = (voted > 1000 * share * votes * having) & (having >= FEW)
    return waited, followed, seen


def again(proof: I64 | F64) -> F64:
    """Maximum share of the points seen clear that are hit before and after, for an object that follows.

    Args:
        proof: (objects,) scans in which the object that it follows was dynamic.
    """
    return np.where(proof >= SURE, STAYS_SURE, STAYS)


def object_rules(judged: Judged, rows: Intp, settled: Bool, votes: int, share: float) -> tuple[Rule, ...]:
    """The rules that remove objects, for the points in some rows; points without an object have NaN.

    Args:
        judged: the scan.
        rows: (K,) rows of points.
        settled: (K,) bool, whether they are in settled parts of their objects, or in places where something always was.
        votes, share: as in ``verdicts``.
    """
    of = judged.measured.objects[rows]
    weighed = np.where(of < 0, np.nan, np.append(judged.weighed, np.zeros((10, 1)), 1)[:, of])
    size, having, voted, touched, lately, proof, left, between, after, old = weighed
    stays = Term("in a part of its object that stays", settled, "<", 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = voted / (1000 * votes * having)
        earlier = np.where(mean > RARELY, 0.0, old)
        shares = {name: part / size for name, part in (("now", lately), ("later", left))}
    gone, moved = after - between, "share of its object where one moved "
    seen = (Term("mean vote of its object", mean, ">", share), Term("votes", having, ">=", FEW), stays)
    return (
        Rule("seen through", seen),
        Rule(
            "followed",
            (
                Term(f"{moved}lately", shares["now"], ">", 0.5),
                Term("scans in which that moved", proof, ">=", PROOF),
                Term("points of its object seen clear", touched, ">", 0),
                Term("of these, hit before and after", between, "<=", again(proof) * touched),
                Term("points of its object where something was before any moved", earlier, "<=", size / 2),
                stays,
            ),
        ),
        Rule(
            "waited",
            (
                Term(f"{moved}last", shares["later"], ">", 0.5),
                Term("points of its object seen clear", touched, ">", WAITED_FOR * size),
                Term("points seen clear after the last hit, less those hit again", gone, ">", LEFT * size),
                Term("mean vote of its object", mean, ">", LEAVES),
                stays,
            ),
        ),
    )


def point_rules(
    height: F32,
    level: F32,
    where: tuple[Bool, Bool, Bool],
    counts: tuple[F64, F64, F64],
    limits: tuple[int, int, float, float],
) -> tuple[Rule, ...]:
    """The rules that remove single points: above the ground, and low under a dynamic object.

    Args:
        height, level: (K,) float32, metres: height above the ground, and that of the scan's own ground around it.
        where: (K,) bool each: too high for a mover, low and near a dynamic object, where something always was.
        counts: (K,) float64 each: scans that hit, passed and saw clear the point's voxel; NaN without one.
        limits: scans that must see a voxel of a point alone clear, and of a foot; maximum height of low points, and
            minimum height of a foot above the scan's own ground, metres.
    """
    (high, under, always), (hits, passed, clear), (votes, empty, low, stands_out) = where, counts, limits
    sees, lowest, raised = "scans that saw it clear", float(np.float32(low)), float(np.float32(stands_out))
    near = Term("low and near a dynamic object", np.where(np.isnan(hits), np.nan, under), ">=", 1)
    alone = (
        Term("height above the ground", height, ">", lowest, "m"),
        Term("more than 4.5 m above the ground", high, "<", 1),
        Term(sees, clear, ">=", votes),
        Term(sees, clear, ">", (hits + passed) / 2),
        Term("far away, where something always was", always, "<", 1),
    )
    stands = Term("height above the ground of this scan", height - level, ">", raised, "m")
    clears = (Term(sees, clear, ">=", empty), Term(sees, clear, ">", hits), Term(sees, clear, ">", passed / 2))
    return Rule("alone", alone), Rule("foot", (near, stands)), Rule("empty foot", (near, *clears))
