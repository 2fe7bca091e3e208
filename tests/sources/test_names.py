"""What numbers in names of scans mean: frame numbers, or times in any unit, for the whole list."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.sources.hypotheses.names import read_names

START = 1_741_286_117_011_149_430  # nanoseconds; the fraction begins with a zero
TIMES = [START + k * 100_000_000 + 1_234_567 * (k % 7) for k in range(40)]
BOOT = [9_412_345_678 + k * 100_000_000 for k in range(40)]  # the number of digits changes

STAMPED = {
    "seconds.nanoseconds without zeros": lambda t: f"{t // 10**9}.{t % 10**9}",
    "seconds.nanoseconds with zeros": lambda t: f"{t // 10**9}.{t % 10**9:09d}",
    "seconds_nanoseconds": lambda t: f"{t // 10**9}_{t % 10**9:09d}",
    "seconds_nanoseconds without zeros": lambda t: f"cloud_{t // 10**9}_{t % 10**9}",
    "nanoseconds": str,
    "microseconds": lambda t: str(t // 1000),
    "milliseconds": lambda t: f"scan{t // 10**6}",
    "seconds with a fraction": lambda t: f"{t // 10**9}.{t % 10**9 // 1000:06d}",
    "a fraction without zeros at its end": lambda t: str(round(t / 1e9, 4)),
}


@pytest.mark.parametrize("name", STAMPED)
@pytest.mark.parametrize("times", [TIMES, BOOT], ids=["since 1970", "since boot"])
def test_times_are_read_in_any_notation(name: str, times: list[int]) -> None:
    if times is BOOT and name in ("milliseconds",):
        pytest.skip("thousandths since boot are numbers like any other")
    found = read_names([STAMPED[name](t) for t in times])
    assert found.timed
    error = np.abs(np.array(found.keys) - np.array(times))
    assert error.max() <= (1_000_000 if name == "milliseconds" else 100_000)


@pytest.mark.parametrize(
    "stems",
    [
        [f"{k:010d}" for k in range(40)],
        [f"{k}" for k in range(40)],
        [f"scan_{k:06d}" for k in range(0, 400, 10)],
        [f"2013_05_28_{k:010d}" for k in range(40)],
        [f"{k:06d}" for k in (3, 900, 907)],
    ],
    ids=["ten digits", "no zeros", "steps", "a date before", "gaps"],
)
def test_frame_numbers_are_no_times(stems: list[str]) -> None:
    found = read_names(stems)
    assert not found.timed
    assert found.keys == [int(stem.rsplit("_", 1)[-1]) for stem in stems]


def test_poses_show_the_unit_of_times_since_boot() -> None:
    milliseconds = [f"{t // 10**6}" for t in BOOT]
    assert not read_names(milliseconds).timed
    found = read_names(milliseconds, np.array(BOOT))
    assert found.timed
    assert np.abs(np.array(found.keys) - np.array(BOOT)).max() < 1e6
