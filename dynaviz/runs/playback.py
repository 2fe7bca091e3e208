"""Play a sequence live with everything around it: outputs, sensor facts, the report."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from dynaviz import kernels
from dynaviz.contracts.probe import SILENT
from dynaviz.contracts.registry import BEST
from dynaviz.contracts.scan import stream
from dynaviz.engine.needs import suited
from dynaviz.errors import UsageError
from dynaviz.online import check_numbers, why_not_live
from dynaviz.online.player import PERIOD, Played, PlayReport, play
from dynaviz.online.session import LiveSession, Settings, warm_up
from dynaviz.progress import Progress, silent
from dynaviz.runs.options import MethodOptions
from dynaviz.sources.drive import Drive


def play_live(
    sequence: Drive,
    method: str = BEST,
    *,
    rate: float = 1.0,
    reach: float = 60.0,
    options: MethodOptions = MethodOptions(),  # noqa: B008  # it is immutable
    view: bool = False,
    serve: bool = False,
    port: int | None = None,
    out: str | os.PathLike[str] | None = None,
    minutes: float = 5.0,
    progress: Progress = silent,
    announce: Callable[[str], object] = print,
    finished: Callable[[PlayReport], object] = lambda report: None,
) -> PlayReport:
    """Play a sequence to a method as a sensor would, and report how it kept up.

    Args:
        sequence: what to play.
        method: its name.
        rate: speed as a multiple of the recorded one; 0 plays every scan as fast as possible.
        reach: metres around the sensor within which points are judged.
        options: with which parameters the method starts.
        view: show it in a viewer.
        serve: show it in a browser on this machine.
        port: of the page, with ``serve``.
        out: folder of the rolling recording; None for none.
        minutes: how much of the past that recording keeps.
        progress: called with the number of scans so far.
        announce: called with the address of the page, and with the report if playing is
            interrupted.
        finished: called with the report after the last scan, while the page is still served.

    Raises:
        UsageError: for an invalid number or a method that cannot run live.
        DataError: for data that cannot be read, or a folder that cannot be written.
    """
    if not 0 <= rate < float("inf"):
        raise UsageError(
            f"rate = {rate}: give a number of at least 0; 0 plays every scan as fast as possible"
        )
    if not 0 < minutes < float("inf"):
        raise UsageError(f"minutes = {minutes}: give a number above 0")
    if port is not None and not serve:
        raise UsageError(f"port {port} is that of a page: add --serve")
    check_numbers(reach, 0, 0.2)
    kind, resolved = options.resolved(method)
    if reason := why_not_live(kind):
        raise UsageError(f"{method} cannot run live: {reason}")
    sequence = suited(kind, resolved.params, sequence)
    settings = Settings(
        reach, 20 if kind.info.needs_map else 0, seed=options.seed or resolved.seed or 0
    )
    period = 1 / sequence.sensor.rate if sequence.sensor.rate else PERIOD
    kernels.set_threads(options.threads)
    warm_up(kind, resolved.params, sequence.sensor, settings)
    with contextlib.ExitStack() as stack:
        recording = None
        if view or serve or out is not None:
            from dynaviz.views import viewer
            from dynaviz.views.live import LiveRecording
            from dynaviz.views.read.view import serving

            if view and not viewer.has_screen():
                raise UsageError(
                    "--view: there is no screen to open a viewer on. Use --serve for a browser"
                )
            inlet = viewer.open_window() if view else None
            if serve:
                inlet, lines, _ = stack.enter_context(serving(port))
                for line in lines:
                    announce(line)
            folder = None if out is None else Path(out)
            recording = LiveRecording(kind.info, sequence.name, folder, minutes, inlet, period)
            stack.callback(recording.close)
        session = LiveSession(kind(resolved.params), sequence.sensor, settings, recording or SILENT)
        report = PlayReport(method, sequence.name, rate)

        def shown(played: Played) -> None:
            progress("play", played.frame + 1, len(sequence))
            if recording is not None:
                static_map = session.map() if recording.wants_map() else None
                recording.show(played, len(report.dropped), static_map)

        try:
            play(session, stream(sequence), report, shown, period=period)
        except (KeyboardInterrupt, SystemExit):  # Ctrl-C, or SIGTERM from a supervisor
            if report.latencies:
                announce(str(report))
            raise
        finished(report)
        return report
