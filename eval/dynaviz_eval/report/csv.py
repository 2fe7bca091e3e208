"""A report as comma-separated values: one line per run, with all scalar fields."""

from __future__ import annotations

import csv
import io
import json

import msgspec

from dynaviz.reports.reporting import Study
from dynaviz.scores.collect import StudyRun
from dynaviz.scores.scores import SCORES
from dynaviz_eval.report.boards import n_parameters

_COUNTS = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept", "unlabelled")
_METRICS = (*SCORES, "precision", "IoU")
_RUNTIME = ("mean_s", "std_s", "prepare_s", "threads", "peak_rss_mb")
COLUMNS = (
    *(
        "sequence",
        "method",
        "variant",
        "online",
        "seed",
        "scoring",
        "frames",
        "points",
        *_COUNTS,
        *_METRICS,
    ),
    *(f"runtime_{name}" for name in _RUNTIME),
    *("instrumented", "machine", "n_parameters", "parameters", "sequence_digest", "labels_sha256"),
    *("recording_sha256", "recording", "command", "error"),
)


def csv_report(study: Study) -> str:
    """Comma-separated values, one line per run, including failed ones.

    Numbers unrounded, empty if undefined.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for run in study.runs:
        writer.writerow(_line(study, run))
    return text.getvalue()


def _line(study: Study, run: StudyRun) -> dict[str, object]:
    result = run.result
    head: dict[str, object] = dict.fromkeys(COLUMNS)
    head |= {
        "sequence": run.sequence,
        "method": run.method,
        "variant": run.variant,
        "error": run.error,
    }
    if result is None:
        return head
    return {
        **head,
        "online": result.online,
        "seed": result.seed,
        "scoring": result.scoring,
        "frames": result.sequence.frames,
        "points": result.sequence.points,
        **{name: result.counts.get(name) for name in _COUNTS},
        **{name: result.metrics.get(name) for name in _METRICS},
        **{f"runtime_{name}": getattr(result.runtime, name) for name in _RUNTIME},
        "instrumented": result.instrumented,
        "machine": json.dumps(msgspec.to_builtins(result.environment.machine), sort_keys=True),
        "n_parameters": n_parameters(result),
        "parameters": json.dumps(result.parameters, sort_keys=True),
        "sequence_digest": result.sequence.digest,
        "labels_sha256": result.labels_sha256,
        "recording_sha256": result.recording_sha256,
        "recording": study.link(run.recording) if run.recording else None,
        "command": result.command,
    }
