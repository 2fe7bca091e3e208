"""The explorer: a page on this machine with the cases of a run, the viewer, and why a clicked point
got its label.

Private: other packages do not import it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from dynaviz.progress import Progress, silent

if TYPE_CHECKING:
    from dynaviz.explorer.server import Explorer
    from dynaviz.scores.result import Result


def explore(
    run: str | os.PathLike[str] | Result, *others: str | os.PathLike[str] | Result, port: int = 0
) -> Explorer:
    """Open the explorer of a run, on this machine.

    In a notebook, the returned object shows the page; elsewhere open its ``url`` in a browser.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``; or a result, also of a run on arrays in
            this process. It needs a recording with points.
        others: up to eight runs on the same frames, to compare.
        port: to listen on; 0 for any free port.

    Returns:
        The running server: ``url`` is the address of the page, ``close()`` stops it. It also is a
        context manager.

    Raises:
        DataError: for a recording that cannot be read, is of a run that did not finish, or contains
            no points.
        UsageError: if the runs are of different sequences or too many, or for a result without a
            recording.
        MissingDependency: without the packages of the extra ``explore``.
    """
    from dynaviz.explorer.answers import Explored
    from dynaviz.explorer.run import ExploredRun
    from dynaviz.explorer.server import Explorer

    return Explorer(Explored(*map(ExploredRun, (run, *others))), port)


def export_page(
    path: str | os.PathLike[str],
    run: str | os.PathLike[str] | Result,
    *others: str | os.PathLike[str] | Result,
    progress: Progress = silent,
) -> Path:
    """Write the page of a run as one HTML file, for people without dynaviz.

    It opens offline, with the cases, their pictures, and the evidence and ledgers that the
    recording stores.

    Args:
        path: of the file, which ends in ``.html``.
        run, others: as for ``explore``.
        progress: called with ``export``, the number of finished cases, and their number.

    Returns:
        The file.

    Raises:
        DataError: as ``explore``, or if the file cannot be written.
        UsageError: as ``explore``, or if the name does not end in ``.html``.
    """
    from dynaviz.explorer import sent
    from dynaviz.explorer.answers import Explored
    from dynaviz.explorer.run import ExploredRun

    sent.checked(path)
    return sent.write_page(path, Explored(*map(ExploredRun, (run, *others))), progress)
