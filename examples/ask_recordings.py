"""Three questions to recordings, without dynaviz.

    pip install "rerun-sdk[catalog]"
    python ask_recordings.py a/run.rrd b/run.rrd

A row of ``/cases`` is a failure case, on the timeline ``case``; a row of ``/answers`` is a scan.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr
from rerun.catalog import DatasetEntry

RANGES = (0, 10, 20, 30, 50, np.inf)  # metres
DYNAMIC = 1  # of the ground truth; 0 is static, 255 unlabelled
ANSWERS = "/answers:dynaviz.Answers:"


def cases(runs: DatasetEntry) -> pd.DataFrame:
    """The failure cases of all recordings, a row each."""
    rows = runs.filter_contents("/cases").reader(index="case").to_pandas()
    columns = [name for name in rows if name.startswith("/cases:")]
    table = pd.DataFrame({name.removeprefix("/cases:"): rows[name].str[0] for name in columns})
    return table.assign(run=rows["rerun_segment_id"], number=rows["case"])


def false_negatives(found: pd.DataFrame) -> pd.DataFrame:
    """What false negatives cost, in percentage points of DA, by cause and range."""
    kept = found[found["kind"] == "false_negative"]
    by = [kept["cause"], pd.cut(kept["range"], RANGES)]
    return kept.groupby(by, observed=True)["cost"].sum().unstack().round(2)


def objects(found: pd.DataFrame) -> pd.DataFrame:
    """The objects that cost most, and in which recordings."""
    named = found[found["instance"].notna()]
    by = named.groupby(["what", "instance"])
    table = by.agg(cost=("cost", "sum"), runs=("run", "nunique"), seen=("looks_through", "mean"))
    return table.sort_values("cost", ascending=False).head(10)


def reasons(runs: DatasetEntry) -> pd.Series:
    """Dynamic points that were kept, by the code of the reason."""
    rows = runs.filter_contents("/answers").reader(index="frame").to_pandas()
    whole = {
        name: np.concatenate(rows[f"{ANSWERS}{name}"].dropna().tolist())
        for name in ("truth", "removed", "reason")
    }
    kept = (whole["truth"] == DYNAMIC) & (whole["removed"] == 0)
    return pd.Series(whole["reason"][kept]).value_counts()


def main(recordings: list[str]) -> None:
    """Print the answers."""
    paths = [str(Path(each).resolve()) for each in recordings]
    with rr.server.Server(host="127.0.0.1", datasets={"runs": paths}) as server:
        runs = server.client().get_dataset("runs")
        found = cases(runs)
        print("False negatives, % of DA by cause and range:", false_negatives(found), sep="\n")
        print("Objects that cost most:", objects(found), sep="\n")
        print("Kept dynamic points by reason:", reasons(runs), sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
