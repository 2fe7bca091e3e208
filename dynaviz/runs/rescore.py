"""Score the stored labels of a run again: digests, counts, and the scores of every protocol, in one pass."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dynaviz.contracts import registry
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.protocol import EvaluationProtocol, ProtocolScores
from dynaviz.contracts.scan import Outcome, Scan, Sequence, stream
from dynaviz.engine.packed_bits import PackedBits
from dynaviz.errors import DataError
from dynaviz.runs.run import Run
from dynaviz.sources.summary import ScanDigest

COUNTS = {
    "static_kept": (Outcome.STATIC_KEPT,),
    "static_removed": (Outcome.FALSE_POSITIVE,),
    "dynamic_removed": (Outcome.DYNAMIC_REMOVED,),
    "dynamic_kept": (Outcome.FALSE_NEGATIVE,),
    "unlabelled": (Outcome.UNLABELLED_KEPT, Outcome.UNLABELLED_REMOVED),
}
"""The counts of a result, and the outcomes that each adds up."""


@dataclass(frozen=True)
class Rescored:
    """What the stored labels of a run and its sequence give.

    Attributes:
        labels_sha256: digest of the stored labels.
        sequence_digest: digest of the frames that the labels are for.
        counts: as in ``Result.counts``.
        protocols: scores by name of the protocol.
        positions: of the frames in the sequence.
    """

    labels_sha256: str
    sequence_digest: str
    counts: Mapping[str, int]
    protocols: Mapping[str, ProtocolScores]
    positions: tuple[int, ...]


def as_it_is(position: int, scan: Scan) -> Scan:
    """The scan with its own ground truth."""
    return scan


def rescore(run: Run, sequence: Sequence, corrected: Callable[[int, Scan], Scan] = as_it_is) -> Rescored:
    """Score the stored labels of a run.

    Args:
        run: with ``labels.npz`` in its folder.
        sequence: contains the frames of the run, and possibly others.
        corrected: gives a scan other ground truth, which is scored; it receives the position in the run, and the scan.

    Raises:
        DataError: if the labels cannot be read, or are for other frames or points.
    """
    labels = run.labeller
    file = labels.path
    protocols: dict[str, EvaluationProtocol] = {
        name: kind(run.result.scoring) for name, kind in registry.loadable("protocols").items()
    }
    digest, bits, outcomes = ScanDigest(), PackedBits(), np.zeros(len(Outcome), np.int64)
    positions: list[int] = []
    for position, scan in enumerate(stream(sequence)):
        if scan.index not in labels.frames:
            continue
        answer = labels.label(scan)
        if len(answer) != len(scan):
            problem = f"has {len(answer)} labels for frame {scan.index}, which has {len(scan)} points"
            raise DataError(file, problem, hint="Give the sequence of the run with --sequence")
        digest.add(scan)
        truth = corrected(len(positions), scan)
        labelled = Labelled.of(len(positions), truth, answer.dynamic, answer.reasons, answer.answered)
        bits.append(answer.dynamic)
        outcomes += np.bincount(labelled.outcome, minlength=len(Outcome))
        positions.append(position)
        for protocol in protocols.values():
            protocol.update(labelled)
    if len(positions) != len(labels.frames):
        problem = f"has labels for {len(labels.frames)} frames, of which {sequence.name} has {len(positions)}"
        raise DataError(file, problem, hint="Give the sequence of the run with --sequence")
    counts = {name: int(sum(outcomes[kind] for kind in kinds)) for name, kinds in COUNTS.items()}
    scores = {name: protocol.finish() for name, protocol in protocols.items()}
    return Rescored(bits.sha256(), digest.hexdigest(), counts, scores, tuple(positions))
