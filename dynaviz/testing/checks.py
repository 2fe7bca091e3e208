"""Checks that every method must pass.

Each takes a method class and its parameters, and fails with a message.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I64, U8, Bool
from dynaviz.contracts.evidence import Asked, Explains, Verdict
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context, Live, Method
from dynaviz.contracts.params import resolve, to_toml
from dynaviz.contracts.probe import SILENT, MemoryProbe, Probe
from dynaviz.contracts.scan import Label, Scan
from dynaviz.engine.loop import RunSpec, execute
from dynaviz.testing.live import check_live
from dynaviz.testing.world import SENSOR, InMemory, crossing, moved, turn

MOVES = (  # transforms of the world, and the percentage points by which SA and DA may change
    # maps voxels of most sizes onto voxels, so hardly any label may change
    (
        turn(90.0, 16.0, -8.0, 4.0),
        1.0,
    ),
    # points fall into other voxels, and DA depends on few objects
    (
        turn(30.0, 13.37, -7.1, 0.45),
        4.0,
    ),
)

SAMPLE = 97  # the evidence on every N-th point is compared with its label


def check_method(method: type[Method], params: Any = None) -> None:
    """Run every check of ``CHECKS``.

    Args:
        method: the class of the method.
        params: its parameters; None for the defaults.

    Raises:
        AssertionError: for the first check that fails; the message gives the method, the check and
            the reason.
    """
    for name, check in CHECKS.items():
        try:
            check(method, method.Params() if params is None else params)
        except Exception as failure:
            what = "" if isinstance(failure, AssertionError) else f"{type(failure).__name__}: "
            raise AssertionError(f"{method.info.name}: {name}: {what}{failure}") from failure


@dataclasses.dataclass(frozen=True)
class AnsweredScans:
    """The labels of a run, scan by scan: arrays (N,) bool and (N,) uint8."""

    dynamic: list[Bool]
    reasons: list[U8]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, AnsweredScans) and all(
            len(mine) == len(theirs) and all(map(np.array_equal, mine, theirs))
            for mine, theirs in ((self.dynamic, other.dynamic), (self.reasons, other.reasons))
        )


def ask(
    method: type[Method],
    params: Any,
    scans: Sequence[Scan],
    probe: Probe = SILENT,
    extent: Extent | None = None,
) -> AnsweredScans:
    """Run a new instance of a method: observe all scans, then label all."""
    running = method(params)
    _begin(running, scans, probe, extent)
    _observe(running, scans)
    return _answers(running, scans)


def _begin(
    running: Method, scans: Sequence[Scan], probe: Probe = SILENT, extent: Extent | None = None
) -> None:
    raw_map = np.concatenate([scan.points for scan in scans]) if running.info.needs_map else None
    running.begin(Context(extent or Extent.of(*scans), SENSOR, probe, 0, raw_map))


def _observe(running: Method, scans: Sequence[Scan]) -> None:
    for scan in scans:
        running.observe(scan)


def _answers(running: Method, scans: Sequence[Scan]) -> AnsweredScans:
    labels = [running.label(scan) for scan in scans]
    return AnsweredScans(
        [np.asarray(each.dynamic).copy() for each in labels],
        [np.asarray(each.reasons).copy() for each in labels],
    )


@cache
def _crossing(frames: int = 8) -> tuple[Scan, ...]:
    """Labelled scans of the small world, simulated once per process."""
    return tuple(crossing(frames))


def _bare() -> list[Scan]:
    """The scans without ground truth, as methods receive them."""
    return [scan.without_truth() for scan in _crossing()]


@dataclasses.dataclass(frozen=True)
class _Run:
    """Labels of a run; of a watched run also its states, and the verdicts of its evidence on some
    points.

    ``verdicts`` has for each scan the rows of the points (K,) and the verdicts (K,), None if no
    rules were stated; it is empty for a method without evidence.
    """

    labels: AnsweredScans
    probe: MemoryProbe
    verdicts: list[tuple[I64, Bool | None]]


@lru_cache(maxsize=2)
def _remembered(method: type[Method], params: Any, watched: bool) -> _Run:
    kernels.set_threads(None)
    if not watched:
        return _Run(ask(method, params, _bare()), MemoryProbe(), [])
    running = method(params)
    scans = _bare()
    probe = MemoryProbe()
    _begin(running, scans, probe)
    firsts = np.cumsum([0, *map(len, scans)])
    asked = [Asked(s, np.arange(k, len(s), SAMPLE), int(firsts[k])) for k, s in enumerate(scans)]
    verdicts = [Verdict() for _ in scans] if isinstance(running, Explains) else []
    for scan in scans:
        running.observe(scan)
        _question(running, asked, verdicts)
    labels = []
    for k, scan in enumerate(scans):
        labels.append(_answers(running, [scan]))
        _question(running, asked[k : k + 1], verdicts[k : k + 1])
    answers = AnsweredScans([a.dynamic[0] for a in labels], [a.reasons[0] for a in labels])
    decided = [
        (points.rows, verdict.dynamic()) for points, verdict in zip(asked, verdicts, strict=False)
    ]
    return _Run(answers, probe, decided)


def _question(running: Method, asked: list[Asked], verdicts: list[Verdict]) -> None:
    """Add the evidence on points to their verdicts; nothing if there are no verdicts."""
    for points, verdict in zip(asked, verdicts, strict=False):
        assert isinstance(running, Explains)
        verdict.add(running.evidence(points))


def _run(method: type[Method], params: Any, watched: bool) -> _Run:
    """A run, remembered for the last method and parameters."""
    try:
        hash(params)
    except TypeError:
        return _remembered.__wrapped__(method, params, watched)
    return _remembered(method, params, watched)


def _expected(method: type[Method], params: Any) -> AnsweredScans:
    """Labels of a plain run, which other runs must repeat."""
    return _run(method, params, watched=False).labels


def _replaced(scan: Scan, points: Any) -> Scan:
    return dataclasses.replace(scan, points=points)


def _check_shapes(method: type[Method], answers: AnsweredScans, scans: Sequence[Scan]) -> None:
    for scan, dynamic, reasons in zip(scans, answers.dynamic, answers.reasons, strict=True):
        assert dynamic.dtype == np.bool_, f"label() returned dynamic as {dynamic.dtype}, not bool"
        assert reasons.dtype == np.uint8, f"label() returned reasons as {reasons.dtype}, not uint8"
        assert dynamic.shape == (len(scan),), (
            f"label() returned {len(dynamic)} labels for {len(scan)} points"
        )
        assert reasons.shape == (len(scan),), (
            f"label() returned {len(reasons)} reasons for {len(scan)} points"
        )
        assert not len(scan) or reasons.max() < len(method.info.reasons), (
            f"label() returned reason code {reasons.max()}; info.reasons ends at "
            f"{len(method.info.reasons) - 1}"
        )


def describes_itself(method: type[Method], params: Any) -> None:
    """The method's name is an identifier; title and paper are set.

    Names of reasons and of states are unique.
    """
    info = method.info
    assert info.name.isidentifier(), f"info.name '{info.name}' is not an identifier"
    assert info.title, "info.title is empty"
    assert info.paper, "info.paper is empty"
    assert 0 < len(info.reasons) <= 256, (
        f"info.reasons has {len(info.reasons)} entries; give 1 to 256"
    )
    for kind, names in (
        ("reasons", [r.name for r in info.reasons]),
        ("states", [s.name for s in info.emits]),
    ):
        assert len(set(names)) == len(names), f"names of {kind} are not unique: {names}"
    assert dataclasses.is_dataclass(method.Params), "Params is not a dataclass"
    assert method.Params.__dataclass_params__.frozen, "Params is not frozen"  # type: ignore[attr-defined]


def parameters_survive_a_file(method: type[Method], params: Any) -> None:
    """Parameters are unchanged after writing them to a config file and reading them back."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "config.toml"
        file.write_bytes(to_toml(method.info.name, params, {}))
        again = resolve(method, config=file).params
    assert again == params, f"parameters changed in a config file: {params} became {again}"


def answers_for_every_point(method: type[Method], params: Any) -> None:
    """``label`` returns one bool and one reason per point, and each reason belongs to one label
    only.
    """
    answers = _expected(method, params)
    _check_shapes(method, answers, _crossing())
    dynamic = np.concatenate(answers.dynamic)
    reasons = np.concatenate(answers.reasons)
    for code in set(reasons[dynamic]) & set(reasons[~dynamic]):
        raise AssertionError(
            f"reason '{method.info.reasons[code].name}' is used for both kept and removed points"
        )


def leaves_its_input_alone(method: type[Method], params: Any) -> None:
    """The method accepts read-only memory-mapped points, and does not modify the points it
    receives.
    """
    scans = [scan.without_truth() for scan in crossing(len(_crossing()))]
    with tempfile.TemporaryDirectory() as folder:
        mapped = []
        for scan in scans:
            file = Path(folder) / f"{scan.index}.bin"
            scan.points.tofile(file)
            mapped.append(
                _replaced(scan, np.memmap(file, np.float32, "r", shape=scan.points.shape))
            )
        answers = ask(method, params, mapped)
        del mapped
    assert answers == _expected(method, params), "labels differ for memory-mapped points"
    same = all(
        mine.points.tobytes() == new.points.tobytes()
        for mine, new in zip(_bare(), scans, strict=True)
    )
    # those of the expected labels, which are in memory
    assert same, "the method modified the points of a scan"


def knows_no_truth(method: type[Method], params: Any) -> None:
    """Labels do not depend on the ground truth."""
    inverted = [
        dataclasses.replace(scan, labels=1 - np.asarray(scan.labels)) for scan in _crossing()
    ]
    digests = {
        execute(RunSpec(method(params), InMemory(world), params)).labels_sha256
        for world in (inverted, _bare())
    }
    assert len(digests) == 1, "labels depend on the ground truth"


def answers_alike_when_watched(method: type[Method], params: Any) -> None:
    """Labels do not change with a probe that receives every state, nor with questions about the
    evidence.
    """
    same = _run(method, params, watched=True).labels == _expected(method, params)
    assert same, "labels change with a probe or with questions about the evidence"


def decides_by_its_evidence(method: type[Method], params: Any) -> None:
    """The rules of a method with evidence give the labels, for points of every scan.

    Other methods pass.
    """
    labels = _expected(method, params).dynamic
    for frame, (rows, verdict) in enumerate(_run(method, params, watched=True).verdicts):
        assert verdict is not None, f"evidence() states no rule for the points of frame {frame}"
        different = np.flatnonzero(verdict != labels[frame][rows])
        assert not len(different), (
            f"the evidence contradicts the labels of {len(different)} of {len(rows)} points of "
            f"frame {frame}, "
            f"the first in row {rows[different[0]]}"
        )


def answers_alike_on_any_threads(method: type[Method], params: Any) -> None:
    """Labels are the same on one thread and on all threads."""
    expected = _expected(method, params)  # of all threads
    try:
        kernels.set_threads(1)
        single = ask(method, params, _bare())
    finally:
        kernels.set_threads(None)
    assert single == expected, "labels change with the number of threads"


def answers_alike_for_any_memory(method: type[Method], params: Any) -> None:
    """Labels are the same for float64 points, and for a strided view of a larger array."""
    strided = []
    for scan in _bare():
        wide = np.zeros((2 * len(scan), 5))
        wide[::2, 1:4] = scan.points
        strided.append(_replaced(scan, wide[::2, 1:4]))
    assert ask(method, params, strided) == _expected(method, params), (
        "labels change with the memory layout"
    )


def forgets_an_earlier_sequence(method: type[Method], params: Any) -> None:
    """``begin`` discards the state of an earlier sequence."""
    scans = _bare()
    running = method(params)
    for world in ([_replaced(scan, scan.points[::-1] + np.float32(0.3)) for scan in scans], scans):
        _begin(running, world)
        _observe(running, world)
    assert _answers(running, scans) == _expected(method, params), (
        "labels depend on an earlier sequence"
    )


def answers_in_any_order(method: type[Method], params: Any) -> None:
    """``label`` returns the same labels when called again, from the last scan to the first."""
    scans = _bare()
    running = method(params)
    _begin(running, scans)
    _observe(running, scans)
    first = _answers(running, scans)
    backwards = _answers(running, scans[::-1])
    assert first == AnsweredScans(backwards.dynamic[::-1], backwards.reasons[::-1]), (
        "labels differ on a second call"
    )


def answers_online(method: type[Method], params: Any) -> None:
    """``label`` also works directly after the ``observe`` of the same scan, as in online mode."""
    scans = _bare()
    running = method(params)
    _begin(running, scans)
    answers = []
    for scan in scans:
        running.observe(scan)
        answers.append(_answers(running, [scan]))
    _check_shapes(
        method,
        AnsweredScans([a.dynamic[0] for a in answers], [a.reasons[0] for a in answers]),
        scans,
    )


def answers_live(method: type[Method], params: Any) -> None:
    """A method that implements ``Live`` gives the labels of online mode in a window that reaches
    all points.

    If it needs the map, these are the labels of offline runs over the scans that are not forgotten.
    In a window that forgets, while the sensor drives away and returns, it still answers for every
    point.
    """
    if issubclass(method, Live):
        tour, answers = check_live(method, params, _bare())
        _check_shapes(method, AnsweredScans(*answers), tour)


def survives_few_points(method: type[Method], params: Any) -> None:
    """Scans without points or with a single point work, also if the sequence has no others."""
    scans = _bare()
    few = [_replaced(scans[4], scans[4].points[:0]), _replaced(scans[5], scans[5].points[:1])]
    for world in (few, few[:1], [*scans[:4], *few, *scans[6:]]):
        _check_shapes(method, ask(method, params, world), world)


def keeps_points_without_a_place(method: type[Method], params: Any) -> None:
    """Points that are not finite are kept, and do not change the labels of other points."""
    scans = _bare()
    rows = np.arange(0, len(scans[0]), 50)
    bad = np.array([[np.nan, 0, 0], [np.inf, 1, 1], [0, -np.inf, 2], [np.nan] * 3], np.float32)
    mixed = [
        _replaced(scan, np.insert(scan.points, rows, np.resize(bad, (len(rows), 3)), axis=0))
        for scan in scans
    ]
    answers = ask(method, params, mixed)
    _check_shapes(method, answers, mixed)
    for scan, dynamic, expected in zip(
        mixed, answers.dynamic, _expected(method, params).dynamic, strict=True
    ):
        finite = np.isfinite(scan.points).all(1)
        assert not dynamic[~finite].any(), "a point that is not finite is removed"
        assert np.array_equal(dynamic[finite], expected), (
            "points that are not finite change the labels of other points"
        )


def survives_odd_places(method: type[Method], params: Any) -> None:
    """Points at the sensor, a repeated scan, and scans far outside the extent of the
    context work.
    """
    scans = _bare()
    at_sensor = _replaced(scans[3], np.repeat(scans[3].position[None], 40, 0))
    mixed = _replaced(scans[4], np.concatenate([scans[4].points, at_sensor.points]))
    far = [moved(scan, turn(0.0, 500.0, 300.0, 20.0)) for scan in scans[6:8]]
    for world in (
        [*scans[:3], at_sensor, mixed],
        [scans[0], dataclasses.replace(scans[0], index=1)],
        [*scans[:6], *far],
    ):
        _check_shapes(method, ask(method, params, world, extent=Extent.of(*scans[:6])), world)


def scores_alike_in_a_moved_world(method: type[Method], params: Any) -> None:
    """SA and DA hardly change if the whole world is rotated about z and shifted."""
    scans = _crossing(24)
    truth = np.concatenate([scan.labels for scan in scans if scan.labels is not None])

    def scores(T: F64) -> F64:
        dynamic = np.concatenate(
            ask(method, params, [moved(scan, T).without_truth() for scan in scans]).dynamic
        )
        return np.array(
            [
                100 * np.mean(~dynamic[truth == Label.STATIC]),
                100 * np.mean(dynamic[truth == Label.DYNAMIC]),
            ]
        )

    before = scores(np.eye(4))
    for T, percent in MOVES:
        after = scores(T)
        assert np.abs(after - before).max() < percent, (
            f"SA and DA change from {before} to {after} in a moved world"
        )


def shows_what_it_declares(method: type[Method], params: Any) -> None:
    """The method emits every state in ``info.emits``, with a value of its kind, and
    no other state.
    """
    probe = _run(method, params, watched=True).probe
    kinds = {state.name: state.kind for state in method.info.emits}
    undeclared = set(probe.values) - set(kinds)
    missing = set(kinds) - set(probe.values)
    assert not undeclared, f"emitted but not declared in info.emits: {undeclared}"
    assert not missing, f"declared in info.emits but never emitted: {missing}"
    for name, values in probe.values.items():
        for value in values:
            assert type(value) is kinds[name], (
                f"state '{name}' is declared as {kinds[name].__name__} but emitted as "
                f"{type(value).__name__}"
            )


CHECKS: dict[str, Callable[[type[Method], Any], None]] = {
    check.__name__: check
    for check in (
        describes_itself,
        parameters_survive_a_file,
        answers_for_every_point,
        leaves_its_input_alone,
        knows_no_truth,
        answers_alike_when_watched,
        decides_by_its_evidence,
        answers_alike_on_any_threads,
        answers_alike_for_any_memory,
        forgets_an_earlier_sequence,
        answers_in_any_order,
        answers_online,
        answers_live,
        survives_few_points,
        keeps_points_without_a_place,
        survives_odd_places,
        scores_alike_in_a_moved_world,
        shows_what_it_declares,
    )
}
"""The checks by name, in the order of ``check_method``; each can run alone, as with
``pytest.mark.parametrize``."""
