"""What the numbers in the names of scans mean: frame numbers, or times in some unit.

It is decided for all names at once. Each reading gives an order; one that has two scans at the same
time, an implausible rate or irregular steps loses against one that has not, and so does one whose
times are not those of the poses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, I64

# seconds between two scans: of a sensor, and of keyframes whose times are since 1970
RATE = (0.004, 4.0)
SLOWEST = 120.0
# nanoseconds since 1970: the years 1995 to 2095
SINCE_1970 = (788_918_400 * 10**9, 3_944_678_400 * 10**9)
UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
SMALL_STEP = 1000  # largest usual difference of frame numbers
LARGEST_NUMBER = 10**9  # of a frame
INSIDE = 0.5  # share of the scans that the poses must cover
_LIMIT = 1 << 63
_END = re.compile(r"(\d+)(?:([._])(\d+))?$")
_TWO = re.compile(r"(\d+)_(\d+)$")

Words = Sequence[re.Match[str]]


@dataclass(frozen=True)
class Naming:
    """What the names of scans mean.

    Attributes:
        keys: (N,) numbers of the scans in the order of the names: frame numbers, or nanoseconds.
        timed: whether they are times.
        words: the reading, such as ``seconds_nanoseconds``.
        since_1970: whether the times are since 1970; otherwise since an unknown start.
    """

    keys: list[int]
    timed: bool
    words: str
    since_1970: bool = False

    def __str__(self) -> str:
        if not self.timed:
            return self.words
        start = "since 1970" if self.since_1970 else "since an unknown start"
        rate = self.step
        hertz = f", {1 / rate:.3g} Hz" if rate > 0 else ""
        return f"{self.words} {start}{hertz}"

    @property
    def step(self) -> float:
        """Median time between two scans, seconds, or difference of two frame numbers."""
        if len(self.keys) < 2:
            return 0.0
        steps = np.diff(np.sort(np.array(self.keys, np.float64)))
        return float(np.median(steps)) / (1e9 if self.timed else 1.0)

    @property
    def irregular(self) -> float:
        """Mean difference of the steps from their median, as a share of it."""
        steps = np.diff(np.sort(np.array(self.keys, np.float64)))
        if len(steps) < 2:
            return 0.0
        usual = float(np.median(steps))
        return float(np.minimum(np.abs(steps - usual) / max(usual, 1e-9), 10.0).mean())

    @property
    def unique(self) -> bool:
        """Whether no two scans have the same number, and all fit into 64 bits."""
        return len(set(self.keys)) == len(self.keys) and max(self.keys, default=0) < _LIMIT

    @property
    def plausible(self) -> bool:
        """Whether the rate is that of a sensor, or of keyframes with known times."""
        if not self.timed or len(self.keys) < 2:
            return True
        slowest = SLOWEST if self.since_1970 else RATE[1]
        return RATE[0] <= self.step <= slowest

    def covered(self, first: float, last: float) -> float:
        """Share of the scans within a span of time, nanoseconds."""
        keys = np.array(self.keys, np.float64)
        slack = 1e9 * max(self.step, 1e-3)
        return float(((keys >= first - slack) & (keys <= last + slack)).mean())


def read_names(stems: Sequence[str], poses: I64 | None = None) -> Naming:
    """The reading of the names that holds for all of them.

    Args:
        stems: names without suffixes; each ends in a digit.
        poses: (K,) int64, nanoseconds: times of the poses, if they are known.

    Returns:
        The reading. If none is without a fault, the numbers as they are.
    """
    found = [each for each in _readings(stems) if each.unique and each.plausible]
    if not found:
        return _plain(stems)
    if poses is not None and len(poses) > 1:
        span = float(poses.min()), float(poses.max())
        inside = [each for each in found if each.timed and each.covered(*span) >= INSIDE]
        found = inside or found
    return min(enumerate(found), key=lambda row: (_faults(row[1]), row[0]))[1]


def _faults(each: Naming) -> tuple[float, ...]:
    """What speaks against a reading: frame numbers that are times, and irregular times."""
    steps = not each.timed and (each.step > SMALL_STEP or max(each.keys) >= LARGEST_NUMBER)
    unknown = each.timed and not each.since_1970
    return (float(steps), float(unknown), round(each.irregular, 1))


def _readings(stems: Sequence[str]) -> Iterator[Naming]:
    """All readings of the names, the usual ones first."""
    ends = [_END.search(stem) for stem in stems]
    words = [end for end in ends if end is not None]
    if len(words) < len(stems):
        return
    separators = {word[2] for word in words}
    if separators <= {".", None} and "." in separators:
        yield _naming(words, _decimal, "seconds")
        yield _naming(words, _nanosecond_part, "seconds.nanoseconds")
        return
    if separators == {"_"} and len({word[1] for word in words}) > 1:
        if all(len(word[3]) <= 9 for word in words):
            yield _naming(words, _nanosecond_part, "seconds_nanoseconds")
        if all(len(word[3]) <= 6 for word in words):
            yield _naming(words, _microsecond_part, "seconds_microseconds")
    yield from _whole(words)


def _whole(words: Words) -> Iterator[Naming]:
    """Readings of whole numbers: times since 1970, frame numbers, times since another start."""
    texts = [word[3] or word[1] for word in words]
    keys = [int(text) for text in texts]
    padded = any(text.startswith("0") and len(text) > 1 for text in texts)
    timed = [
        Naming([key * unit for key in keys], True, name, _since_1970(keys, unit))
        for name, unit in UNITS.items()
    ]
    if not padded:
        yield from (each for each in timed if each.since_1970)
    number = Naming(keys, False, "frame numbers")
    yield number
    yield from (each for each in timed if not each.since_1970)


def _since_1970(keys: list[int], unit: int) -> bool:
    return SINCE_1970[0] <= min(keys) * unit and max(keys) * unit <= SINCE_1970[1]


def _naming(words: Words, key: Callable[[re.Match[str]], int], name: str) -> Naming:
    keys = [key(word) for word in words]
    return Naming(keys, True, name, _since_1970(keys, 1))


def _decimal(word: re.Match[str]) -> int:
    """The number as it is written, in seconds."""
    return int(word[1]) * 10**9 + int((word[3] or "0").ljust(9, "0")[:9])


def _nanosecond_part(word: re.Match[str]) -> int:
    """Seconds and nanoseconds, both as whole numbers."""
    return int(word[1]) * 10**9 + int(word[3] or "0")


def _microsecond_part(word: re.Match[str]) -> int:
    """Seconds and microseconds, both as whole numbers."""
    return int(word[1]) * 10**9 + int(word[3] or "0") * 1000


def _plain(stems: Sequence[str]) -> Naming:
    """The last number of each name."""
    keys = []
    for stem in stems:
        end = _END.search(stem)
        keys.append(int((end[3] or end[1]) if end else 0))
    return Naming(keys, False, "frame numbers")


def regular(times: F64) -> bool:
    """Whether times, (N,) in any unit, increase at a rate that hardly changes."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return usual > 0 and float((np.abs(steps - usual) < 0.5 * usual).mean()) > 0.5
