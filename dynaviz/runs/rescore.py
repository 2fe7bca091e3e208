"""Score the stored labels of a run again.

Digests, counts, and the scores of every protocol, in one pass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from dynaviz.contracts import registry
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.protocol import EvaluationProtocol, ProtocolScores
from dynaviz.contracts.scan import Scan, Sequence, stream
from dynaviz.engine.packed_bits import PackedBits
from dynaviz.errors import DataError
from dynaviz.runs.run import Run
from dynaviz.scores.scores import Counts
from dynaviz.sources.summary import ScanDigest


@dataclass(frozen=True)
class Rescored:
    """What the stored labels of a run and its sequence give.

    Attributes:
        labels_sha256: digest of the stored labels.
        sequence_digest: digest of the frames that the labels are for.
        counts: points by ground truth and answer.
        protocols: scores by name of the protocol.
    """

    labels_sha256: str
    sequence_digest: str
    counts: Counts
    protocols: Mapping[str, ProtocolScores]


def as_it_is(position: int, scan: Scan) -> Scan:
    """The scan with its own ground truth."""
    return scan


def rescore(
    run: Run, sequence: Sequence, corrected: Callable[[int, Scan], Scan] = as_it_is
) -> Rescored:
    """Score the stored labels of a run.

    Args:
        run: with ``labels.npz`` in its folder.
        sequence: contains the frames of the run, and possibly others.
        corrected: gives a scan other ground truth, which is scored; it receives the position in the
            run, and the scan.

    Raises:
        DataError: if the labels cannot be read, or are for other frames or points.
    """
    labels = run.labeller
    file = labels.path
    protocols: dict[str, EvaluationProtocol] = {
        name: kind(run.result.scoring) for name, kind in registry.loadable("protocols").items()
    }
    digest = ScanDigest()
    bits = PackedBits()
    counts = Counts()
    frames = 0
    for scan in stream(sequence):
        if scan.index not in labels.frames:
            continue
        answer = labels.label(scan)
        if len(answer) != len(scan):
            problem = (
                f"has {len(answer)} labels for frame {scan.index}, which has {len(scan)} points"
            )
            raise DataError(file, problem, hint="Give the sequence of the run with --sequence")
        digest.add(scan)
        labelled = Labelled.of(
            frames, corrected(frames, scan), answer.dynamic, answer.reasons, answer.answered
        )
        bits.append(answer.dynamic)
        counts += Counts.of(labelled.outcome)
        frames += 1
        for protocol in protocols.values():
            protocol.update(labelled)
    if frames != len(labels.frames):
        problem = (
            f"has labels for {len(labels.frames)} frames, of which {sequence.name} has {frames}"
        )
        raise DataError(file, problem, hint="Give the sequence of the run with --sequence")
    scores = {name: protocol.finish() for name, protocol in protocols.items()}
    return Rescored(bits.sha256(), digest.hexdigest(), counts, scores)
