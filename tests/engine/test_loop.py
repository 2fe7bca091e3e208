"""The loop: order of calls, what a method gets to see, what is timed, and the files that appear."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import InMemory

from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.probe import SILENT, MemoryProbe, Scalar, State
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.engine.outputs import LabelsFile, MapFiles
from dynaviz.engine.packed_bits import PackedBits
from dynaviz.errors import PluginError
from dynaviz.scores.result import Result
from dynaviz.sources.summary import SequenceSummary


@dataclass(frozen=True)
class AboveParams:
    height: float = 0.5


class Above:
    """Removes what is higher than a height, and remembers how it was called."""

    info = MethodInfo(
        "above",
        "Above",
        "none",
        (Reason("low", "is low"), Reason("high", "is high")),
        (State("observed", Scalar, "number of scans so far"),),
    )
    Params = AboveParams

    def __init__(self, params: AboveParams):
        self.params, self.calls = params, []

    def begin(self, context: Context) -> None:
        self.calls, self.context = [], context

    def observe(self, scan: Scan) -> None:
        assert scan.labels is None
        assert scan.instances is None
        self.calls.append(("observe", scan.index))
        self.context.probe.emit("observed", Scalar(len(self.calls)))

    def label(self, scan: Scan) -> Labels:
        self.calls.append(("label", scan.index))
        dynamic = scan.points[:, 2] > self.params.height
        return Labels(dynamic, dynamic.astype(np.uint8))


class Total:
    """Counts points."""

    def __init__(self, info: MethodInfo):
        self.points = 0

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        self.points += len(labelled.scan)
        return {"points": self.points}

    def finish(self) -> Mapping[str, Any]:
        return {"total": self.points}

    def figures(self) -> Mapping[str, Figure]:
        return {}


class Diary(Listener):
    def __init__(self) -> None:
        self.said: list[Any] = []

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        self.said.append(("begin", summary.points))

    def observing(self, frame: int, scan: Scan) -> None:
        self.said.append(("observing", frame, scan.index))

    def observed(self, frame: int) -> None:
        self.said.append(("observed", frame))

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        self.said.append(("labelled", labelled.frame, dict(curves)))

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        self.said.append(("finish", result.sections.other))


def a_run(sequence: InMemory, **changes: Any) -> RunSpec:
    params = AboveParams()
    return replace(RunSpec(Above(params), sequence, params, (Total(Above.info),)), **changes)


def test_two_passes_or_one(little_room: InMemory) -> None:
    run = a_run(little_room)
    execute(run)
    assert run.labeller.calls == [(c, 10 + f) for c in ("observe", "label") for f in range(6)]
    execute(replace(run, online=True))
    assert run.labeller.calls == [(c, 10 + f) for f in range(6) for c in ("observe", "label")]


def test_callbacks_are_called_in_order(little_room: InMemory) -> None:
    diary = Diary()
    execute(a_run(little_room, online=True), [diary])
    n = len(little_room[0])
    assert diary.said[:4] == [
        ("begin", 6 * n),
        ("observing", 0, 10),
        ("observed", 0),
        ("labelled", 0, {"points": n}),
    ]
    assert diary.said[-1] == ("finish", {"total": 6 * n})


def test_the_result_describes_the_run(little_room: InMemory) -> None:
    result = execute(a_run(little_room, seed=3, command="typed"))
    assert (result.method, result.parameters, result.seed, result.command) == (
        "above",
        {"height": 0.5},
        3,
        "typed",
    )
    assert result.sequence.frames == result.runtime.frames == 6
    assert result.sections.plain() == {"total": result.sequence.points}
    assert not result.instrumented
    assert result.runtime.mean_s > 0
    everything = np.concatenate([scan.points[:, 2] > 0.5 for scan in little_room.scans])
    assert result.labels_sha256 == hashlib.sha256(np.packbits(everything).tobytes()).hexdigest()


@pytest.mark.parametrize(
    "answer",
    [
        lambda n: np.zeros(n, bool),
        lambda n: Labels(np.zeros(n, np.uint8), np.zeros(n, np.uint8)),
        lambda n: Labels(np.zeros(n + 1, bool), np.zeros(n, np.uint8)),
        lambda n: Labels([False], np.zeros(n, np.uint8)),
        lambda n: Labels(np.zeros(n, bool), np.zeros(n, np.int64)),
        lambda n: Labels(np.zeros(n, bool), np.zeros(n - 1, np.uint8)),
    ],
)
def test_labels_of_the_wrong_type_or_shape_are_rejected(little_room: InMemory, answer: Any) -> None:
    run = a_run(little_room)
    run.labeller.label = lambda scan: answer(len(scan))  # type: ignore[method-assign]
    with pytest.raises(
        PluginError, match=r"above: label\(\) returned .*, not (dynaviz.*Labels|bool |uint8 )"
    ):
        execute(run)


def test_a_probe_receives_states_and_the_run_counts_as_instrumented(little_room: InMemory) -> None:
    probe = MemoryProbe()
    assert execute(a_run(little_room), probe=probe).instrumented
    assert [value.value for value in probe.values["observed"]] == [1, 2, 3, 4, 5, 6]


def test_a_method_that_needs_the_map_gets_all_points(little_room: InMemory) -> None:
    class Offline(Above):
        info = replace(Above.info, needs_map=True)

    run = a_run(little_room, labeller=Offline(AboveParams()))
    execute(run)
    np.testing.assert_array_equal(
        run.labeller.context.raw_map, np.concatenate([s.points for s in little_room.scans])
    )
    plain = a_run(little_room)
    execute(plain)
    assert plain.labeller.context.raw_map is None
    assert plain.labeller.context.probe is SILENT


def test_an_error_while_reading_ends_the_run_and_leaves_no_file(
    little_room: InMemory, tmp_path: Path
) -> None:
    class Torn(InMemory):
        reads = 0

        def __getitem__(self, position: int) -> Scan:
            self.reads += 1
            if self.reads > 10:
                raise RuntimeError("torn")
            return super().__getitem__(position)

    with (
        pytest.raises(RuntimeError, match="torn"),
        LabelsFile(tmp_path) as labels,
        MapFiles(tmp_path) as maps,
    ):
        execute(a_run(Torn(little_room.scans)), [labels, maps])
    assert list(tmp_path.iterdir()) == []
    assert not [t for t in threading.enumerate() if t.name == "read-ahead"]


def test_the_files_contain_the_labels(little_room: InMemory, tmp_path: Path) -> None:
    from dynaviz.io.pcd import read_pcd

    with LabelsFile(tmp_path) as labels, MapFiles(tmp_path) as maps:
        result = execute(a_run(little_room), [labels, maps])
    everything = np.concatenate([scan.points for scan in little_room.scans])
    expected = everything[:, 2] > 0.5
    with np.load(tmp_path / "labels.npz") as z:
        np.testing.assert_array_equal(np.unpackbits(z["dynamic"])[: z["points"].sum()], expected)
        np.testing.assert_array_equal(z["reasons"], expected)
        assert z["reason_names"].tolist() == ["low", "high", "at_sensor"]
        assert z["frames"].tolist() == [10, 11, 12, 13, 14, 15]
        assert str(z["sequence_digest"]) == result.sequence.digest
        assert (
            str(z["labels_sha256"])
            == result.labels_sha256
            == hashlib.sha256(z["dynamic"].tobytes()).hexdigest()
        )
    np.testing.assert_array_equal(read_pcd(tmp_path / "static_map.pcd").xyz, everything[~expected])
    np.testing.assert_array_equal(
        read_pcd(tmp_path / "dynamic_points.pcd").xyz, everything[expected]
    )


def test_outcomes_cross_truth_and_answer(little_room: InMemory) -> None:
    scan = little_room[2]
    labelled = Labelled.of(0, scan, np.ones(len(scan), bool), np.zeros(len(scan), np.uint8))
    assert set(labelled.outcome) == {Outcome.DYNAMIC_REMOVED, Outcome.FALSE_POSITIVE}
    blind = Labelled.of(
        0, scan.without_truth(), np.zeros(len(scan), bool), np.zeros(len(scan), np.uint8)
    )
    assert set(blind.outcome) == {Outcome.UNLABELLED_KEPT}


@pytest.mark.parametrize("held", [1 << 20, 3])
@pytest.mark.parametrize("sizes", [[0], [3, 0, 5, 8], [1] * 20, [17, 31], [50, 3, 40]])
def test_packed_bits_have_no_gaps(sizes: list[int], held: int) -> None:
    random, bits, whole = np.random.default_rng(1), PackedBits(held), []
    for size in sizes:
        whole.append(random.random(size) < 0.5)
        bits.append(whole[-1])
        expected = np.packbits(np.concatenate(whole))
        np.testing.assert_array_equal(bits.packed(), expected)
        assert bits.sha256() == hashlib.sha256(expected.tobytes()).hexdigest()
