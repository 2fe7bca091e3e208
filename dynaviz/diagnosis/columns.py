"""Check the columns of ``.bin`` files, which do not name them: their number and their order."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynaviz.diagnosis.finding import Confidence, Finding
from dynaviz.errors import DataError
from dynaviz.io.velodyne import FIELDS, detect_columns, read_velodyne
from dynaviz.sources.drive import Drive

FEWEST = 500  # points from which an order is judged
NEGATIVE = 0.05  # share of negative values from which a column is a coordinate
HEIGHTS = 0.3  # metres; standard deviation from which it is not a time either


def check_columns(sequence: Drive, index: int, position: int) -> Iterator[Finding]:
    """A finding if a file has more or fewer columns than its format reads, or has them in another
    order.

    Args:
        sequence: the sequence; other files than ``.bin`` name their columns.
        index: number of the frame whose file is examined.
        position: its position in the sequence.
    """
    file = sequence.scan_file(index)
    if file is None or file.suffix.lower() != ".bin":
        return
    try:
        read = 3 + len(sequence.attributes(position))
        found = detect_columns(file)
        columns = read_velodyne(file, len(found))
    except DataError:
        return  # an unreadable frame is a finding of its own
    if len(found) != read:
        problem = (
            f"the scans have {len(found)} columns ({' '.join(found)}), but this layout reads {read}"
        )
        fix = (
            f"Write {' '.join(FIELDS[:read])} as float32, or open the folder as files:PATH, which "
            "detects the columns"
        )
        yield Finding("columns", Confidence.CERTAIN, problem, fix, file=str(file))
    elif read > 3 and len(columns) >= FEWEST:
        negative = (columns[:, :4] < 0).mean(0)
        if negative[3] > NEGATIVE and columns[:, 3].std() > HEIGHTS and negative[:3].min() == 0:
            first = int(np.argmin(negative[:3])) + 1
            problem = (
                "the columns are not in the order x y z intensity: column 4 has negative values "
                f"at {negative[3]:.0%} "
                f"of the points, unlike an intensity, and column {first} has none"
            )
            yield Finding(
                "columns",
                Confidence.LIKELY,
                problem,
                "Write x y z intensity as float32",
                file=str(file),
            )
