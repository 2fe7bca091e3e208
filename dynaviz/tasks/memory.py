"""Peak memory of this process."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import sys
from pathlib import Path

_SELF = Path("/proc/self")  # Linux


def peak_rss_mb() -> float | None:
    """Peak memory of this process, or since ``forget_peak``, in MB.

    None on systems without ``resource`` (Windows).
    """
    try:
        import resource
    except ImportError:
        return None
    with contextlib.suppress(
        OSError, StopIteration
    ):  # on Linux, ru_maxrss is never below what the parent had
        lines = (_SELF / "status").read_text().splitlines()
        return round(
            int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1e3, 1
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3), 1)


def forget_peak() -> bool:
    """Return unused memory to the system, and measure the peak from here on.

    False where that is impossible.
    """
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)  # glibc only
    try:
        (_SELF / "clear_refs").write_text("5")
    except OSError:
        return False
    return True
