"""Simulate a share of a sequence.

``python -m dynaviz.synthetic.simulate.worker``, for ``parallel``.
"""

from __future__ import annotations

import os
import pickle
import sys

from dynaviz.synthetic.simulate.recording import build, record_sweeps


def main() -> None:
    """Read a preset, the number of frames, a seed and the share from stdin.

    Write each sweep to stdout.
    """
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not end up among the sweeps
    preset, frames, seed, share = pickle.load(sys.stdin.buffer)
    for sweep in record_sweeps(build(preset, frames, seed), preset, frames, seed, share):
        pickle.dump(sweep, output, pickle.HIGHEST_PROTOCOL)
        output.flush()


if __name__ == "__main__":
    main()
