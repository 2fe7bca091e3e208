"""Checks that hold for any method. Each takes a method's class and its parameters, and fails with a sentence."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, U8, Bool
from dynaviz.engine.loop import RunSpec, execute
from dynaviz.method import Context, Method
from dynaviz.params import resolve, to_toml
from dynaviz.probe import SILENT, MemoryProbe, Probe
from dynaviz.scan import Label, Scan
from dynaviz.spatial.extent import Extent
from dynaviz.testing.world import SENSOR, InMemory, crossing, moved, turn

MOVES = (  # of the world, and the percent by which SA and DA may change
    (turn(90.0, 16.0, -8.0, 4.0), 1.0),  # voxels of most sizes fall on voxels: nothing but habit may change a label
    (turn(30.0, 13.37, -7.1, 0.45), 4.0),  # points fall into voxels otherwise; a few objects decide DA
)


def check_method(method: type[Method], params: Any = None) -> None:
    """Run every check of ``CHECKS``.

    Args:
        method: the class.
        params: its parameters; None for the defaults.

    Raises:
        AssertionError: naming the first check that failed, and how.
    """
    for name, check in CHECKS.items():
        try:
            check(method, method.Params() if params is None else params)
        except Exception as failure:
            what = "" if isinstance(failure, AssertionError) else f"{type(failure).__name__}: "
            raise AssertionError(f"{method.info.name}: {name}: {what}{failure}") from failure


@dataclasses.dataclass(frozen=True)
class RunLabels:
    """A method's answers, scan by scan."""

    dynamic: list[Bool]
    reasons: list[U8]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RunLabels) and all(
            len(mine) == len(theirs) and all(map(np.array_equal, mine, theirs))
            for mine, theirs in ((self.dynamic, other.dynamic), (self.reasons, other.reasons))
        )


def ask(
    method: type[Method], params: Any, scans: Sequence[Scan], probe: Probe = SILENT, extent: Extent | None = None
) -> RunLabels:
    """Run a fresh method over scans: observe all, then label and explain all."""
    running = method(params)
    _begin(running, scans, probe, extent)
    _observe(running, scans)
    return _answers(running, scans)


def _begin(running: Method, scans: Sequence[Scan], probe: Probe = SILENT, extent: Extent | None = None) -> None:
    raw_map = np.concatenate([scan.points for scan in scans]) if running.info.needs_map else None
    running.begin(Context(extent or Extent.of(*scans), SENSOR, probe, 0, raw_map))


def _observe(running: Method, scans: Sequence[Scan]) -> None:
    for scan in scans:
        running.observe(scan)


def _answers(running: Method, scans: Sequence[Scan]) -> RunLabels:
    labels = [running.label(scan) for scan in scans]
    return RunLabels(
        [np.asarray(each.dynamic).copy() for each in labels], [np.asarray(each.reasons).copy() for each in labels]
    )


def _bare() -> list[Scan]:
    return [scan.without_truth() for scan in crossing()]


def _replaced(scan: Scan, points: Any) -> Scan:
    return dataclasses.replace(scan, points=points)


def _check_shapes(method: type[Method], answers: RunLabels, scans: Sequence[Scan]) -> None:
    for scan, dynamic, reasons in zip(scans, answers.dynamic, answers.reasons, strict=True):
        assert dynamic.dtype == np.bool_, f"label() gave {dynamic.dtype}, not bool"
        assert reasons.dtype == np.uint8, f"explain() gave {reasons.dtype}, not uint8"
        assert dynamic.shape == reasons.shape == (len(scan),), f"{len(scan)} points got {len(dynamic)} answers"
        assert not len(scan) or reasons.max() < len(method.info.reasons), f"reason {reasons.max()} has no legend"


def describes_itself(method: type[Method], params: Any) -> None:
    """Names are fit for paths, and no reason or state has the name of another."""
    info = method.info
    assert info.name.isidentifier(), f"name '{info.name}' is no identifier"
    assert info.title, "info.title is empty"
    assert info.paper, "info.paper is empty"
    assert 0 < len(info.reasons) <= 256, f"{len(info.reasons)} reasons do not fit into a byte"
    for kind, names in (("reasons", [r.name for r in info.reasons]), ("states", [s.name for s in info.emits])):
        assert len(set(names)) == len(names), f"two {kind} have one name: {names}"
    assert dataclasses.is_dataclass(method.Params), "Params is no dataclass"
    assert method.Params.__dataclass_params__.frozen, "Params is not frozen"  # type: ignore[attr-defined]


def parameters_survive_a_file(method: type[Method], params: Any) -> None:
    """Parameters written to a config file and read again are the same."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "config.toml"
        file.write_bytes(to_toml(method.info.name, params, {}))
        again = resolve(method, config=file).params
    assert again == params, f"{again} is not {params}"


def answers_for_every_point(method: type[Method], params: Any) -> None:
    """One bool and one reason a point; a reason stands for one label only."""
    scans = _bare()
    answers = ask(method, params, scans)
    _check_shapes(method, answers, scans)
    dynamic, reasons = np.concatenate(answers.dynamic), np.concatenate(answers.reasons)
    for code in set(reasons[dynamic]) & set(reasons[~dynamic]):
        raise AssertionError(f"reason '{method.info.reasons[code].name}' is given for kept and for removed points")


def leaves_its_input_alone(method: type[Method], params: Any) -> None:
    """Works on read-only memory-mapped arrays, and changes no byte of arrays that could be written."""
    scans = _bare()
    with tempfile.TemporaryDirectory() as folder:
        mapped, before = [], [scan.points.tobytes() for scan in scans]
        for scan in scans:
            file = Path(folder) / f"{scan.index}.bin"
            scan.points.tofile(file)
            mapped.append(_replaced(scan, np.memmap(file, np.float32, "r", shape=scan.points.shape)))
        answers = ask(method, params, mapped)
        del mapped
    assert answers == ask(method, params, scans), "memory-mapped points got other answers"
    assert [scan.points.tobytes() for scan in scans] == before, "points of a scan were changed"


def knows_no_truth(method: type[Method], params: Any) -> None:
    """Labels do not depend on the ground truth."""
    scans = crossing()
    lies = [dataclasses.replace(scan, labels=1 - np.asarray(scan.labels)) for scan in scans]
    digests = {
        execute(RunSpec(method(params), InMemory(world), params)).labels_sha256 for world in (scans, lies, _bare())
    }
    assert len(digests) == 1, "labels changed with the ground truth"


def answers_alike_when_watched(method: type[Method], params: Any) -> None:
    """The same answers with a probe that wants every state."""
    scans = _bare()
    assert ask(method, params, scans) == ask(method, params, scans, MemoryProbe()), "a probe changed answers"


def answers_alike_on_any_threads(method: type[Method], params: Any) -> None:
    """The same answers on one thread and on all."""
    scans, answers = _bare(), []
    try:
        for threads in (1, None):
            kernels.set_threads(threads)
            answers.append(ask(method, params, scans))
    finally:
        kernels.set_threads(None)
    assert answers[0] == answers[1], "the number of threads changed answers"


def answers_alike_for_any_memory(method: type[Method], params: Any) -> None:
    """The same answers for points in float64, and for every second row of a larger array."""
    scans = _bare()
    strided = []
    for scan in scans:
        wide = np.zeros((2 * len(scan), 5))
        wide[::2, 1:4] = scan.points
        strided.append(_replaced(scan, wide[::2, 1:4]))
    assert ask(method, params, scans) == ask(method, params, strided), "the layout of memory changed answers"


def forgets_an_earlier_sequence(method: type[Method], params: Any) -> None:
    """``begin`` starts anew."""
    scans, running = _bare(), method(params)
    fresh = ask(method, params, scans)
    for world in ([_replaced(scan, scan.points[::-1] + np.float32(0.3)) for scan in scans], scans):
        _begin(running, world)
        _observe(running, world)
    assert _answers(running, scans) == fresh, "an earlier sequence changed answers"


def answers_in_any_order(method: type[Method], params: Any) -> None:
    """``label`` and ``explain`` change nothing: asked again, and from the last scan to the first, they say the same."""
    scans, running = _bare(), method(params)
    _begin(running, scans)
    _observe(running, scans)
    first, backwards = _answers(running, scans), _answers(running, scans[::-1])
    assert first == RunLabels(backwards.dynamic[::-1], backwards.reasons[::-1]), "asked again, it answered otherwise"


def answers_online(method: type[Method], params: Any) -> None:
    """Answers right after each scan was observed, too."""
    scans, running = _bare(), method(params)
    _begin(running, scans)
    answers = []
    for scan in scans:
        running.observe(scan)
        answers.append(_answers(running, [scan]))
    _check_shapes(method, RunLabels([a.dynamic[0] for a in answers], [a.reasons[0] for a in answers]), scans)


def survives_few_points(method: type[Method], params: Any) -> None:
    """Scans without a point, with one, and a sequence of nothing else."""
    scans = _bare()
    few = [_replaced(scans[4], scans[4].points[:0]), _replaced(scans[5], scans[5].points[:1])]
    for world in (few, few[:1], [*scans[:4], *few, *scans[6:]]):
        _check_shapes(method, ask(method, params, world), world)


def keeps_points_without_a_place(method: type[Method], params: Any) -> None:
    """Points that are not finite are kept, and change no answer for others."""
    scans = _bare()
    rows = np.arange(0, len(scans[0]), 50)
    bad = np.array([[np.nan, 0, 0], [np.inf, 1, 1], [0, -np.inf, 2], [np.nan] * 3], np.float32)
    spoilt = [_replaced(scan, np.insert(scan.points, rows, np.resize(bad, (len(rows), 3)), axis=0)) for scan in scans]
    expected, answers = ask(method, params, scans), ask(method, params, spoilt)
    _check_shapes(method, answers, spoilt)
    for scan, dynamic, alone in zip(spoilt, answers.dynamic, expected.dynamic, strict=True):
        finite = np.isfinite(scan.points).all(1)
        assert not dynamic[~finite].any(), "a point that is not finite was removed"
        assert np.array_equal(dynamic[finite], alone), "points that are not finite changed answers for others"


def survives_odd_places(method: type[Method], params: Any) -> None:
    """Points at the sensor, the same scan twice, and a scan far from all that was announced."""
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
    """A turn and a shift of the whole world hardly change SA and DA."""
    scans = crossing(24)
    truth = np.concatenate([scan.labels for scan in scans if scan.labels is not None])

    def scores(T: F64) -> F64:
        dynamic = np.concatenate(ask(method, params, [moved(scan, T).without_truth() for scan in scans]).dynamic)
        return np.array(
            [100 * np.mean(~dynamic[truth == Label.STATIC]), 100 * np.mean(dynamic[truth == Label.DYNAMIC])]
        )

    before = scores(np.eye(4))
    for T, percent in MOVES:
        after = scores(T)
        assert np.abs(after - before).max() < percent, f"SA, DA were {before}, in a moved world {after}"


def shows_what_it_declares(method: type[Method], params: Any) -> None:
    """Every declared state is emitted, with a value of its kind, and no other."""
    probe, kinds = MemoryProbe(), {state.name: state.kind for state in method.info.emits}
    ask(method, params, _bare(), probe)
    assert set(probe.values) <= set(kinds), f"emitted but not declared: {set(probe.values) - set(kinds)}"
    assert set(kinds) <= set(probe.values), f"declared but never emitted: {set(kinds) - set(probe.values)}"
    for name, values in probe.values.items():
        for value in values:
            assert type(value) is kinds[name], f"{name} is declared as {kinds[name].__name__}, emitted as {type(value)}"


CHECKS: dict[str, Callable[[type[Method], Any], None]] = {
    check.__name__: check
    for check in (
        describes_itself,
        parameters_survive_a_file,
        answers_for_every_point,
        leaves_its_input_alone,
        knows_no_truth,
        answers_alike_when_watched,
        answers_alike_on_any_threads,
        answers_alike_for_any_memory,
        forgets_an_earlier_sequence,
        answers_in_any_order,
        answers_online,
        survives_few_points,
        keeps_points_without_a_place,
        survives_odd_places,
        scores_alike_in_a_moved_world,
        shows_what_it_declares,
    )
}
"""By name, in the order of ``check_method``; each may be run alone, as by ``pytest.mark.parametrize``."""
