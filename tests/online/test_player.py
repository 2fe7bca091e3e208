"""Playing a sequence live.

When scans are dropped, and what the report and the rolling recording contain.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.method import Labels
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.online.player import PlayReport, play
from dynaviz.runs.playback import play_live
from dynaviz.sources.drive import Drive
from dynaviz.testing.world import InMemory, crossing


class Simulated:
    """A clock that advances only by sleeping and working."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.time += seconds


class Slow:
    """A session that takes some seconds per scan."""

    restarts = 0

    def __init__(self, clock: Simulated, seconds: list[float]) -> None:
        self.clock, self.seconds, self.began = clock, seconds, list[float]()

    def add(self, scan: Scan) -> Labels:
        self.began.append(round(self.clock.time - 100.0, 6))
        self.clock.time += self.seconds[min(len(self.began), len(self.seconds)) - 1]
        return Labels(np.arange(len(scan)) == 0, np.zeros(len(scan), np.uint8))


def scans(count: int, stamps: bool = True) -> list[Scan]:
    points = np.ones((4, 3), np.float32)
    return [
        Scan(n, points, np.eye(4), 10**18 + 100_000_000 * n if stamps else None)
        for n in range(count)
    ]


@pytest.mark.parametrize("stamps", [True, False])
@pytest.mark.parametrize(
    ("seconds", "rate", "began", "dropped"),
    [
        ([0.05], 1.0, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5], []),
        ([0.05], 2.0, [0.0, 0.05, 0.1, 0.15, 0.2, 0.25], []),
        ([0.25], 1.0, [0.0, 0.25, 0.5], [1, 3, 4]),
        ([0.31, 0.01], 1.0, [0.0, 0.31, 0.4, 0.5], [1, 2]),
        ([0.25], 0.0, [0.0, 0.25, 0.5, 0.75, 1.0, 1.25], []),
    ],
)
def test_scans_are_dropped_when_a_newer_one_has_come(
    stamps: bool, seconds: list[float], rate: float, began: list[float], dropped: list[int]
) -> None:
    clock = Simulated()
    session: Any = Slow(clock, seconds)
    report = play(session, scans(6, stamps), PlayReport("slow", "six", rate), clock=clock)
    assert session.began == pytest.approx(began)
    assert report.dropped == dropped
    assert len(report.latencies) == 6 - len(dropped)
    assert (report.points, report.dynamic) == (4 * len(began), len(began))
    assert report.to_dict()["frames"] == 6
    assert f"dropped because a newer scan had come: {len(dropped)}" in str(report)


def test_time_stands_still_while_a_slow_source_is_read() -> None:
    clock = Simulated()

    def simulation(seconds: float) -> Iterator[Scan]:
        for scan in scans(6):
            clock.time += seconds
            yield scan

    session: Any = Slow(clock, [0.05])
    assert play(session, simulation(0.7), PlayReport("slow", "six", 1.0), clock=clock).dropped == []
    late: Any = Slow(clock, [0.25])
    assert play(late, simulation(0.7), PlayReport("slow", "six", 1.0), clock=clock).dropped == [
        1,
        3,
        4,
    ]


def test_a_report_without_scans_has_no_latencies() -> None:
    report = play(
        SimpleNamespace(restarts=0), [], PlayReport("none", "empty", 1.0), clock=Simulated()
    )  # type: ignore[arg-type]
    assert json.loads(json.dumps(report.to_dict()))["labelled"] == 0
    assert "worst" not in str(report)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate": -1.0}, "rate"),
        ({"minutes": 0.0}, "minutes"),
        ({"port": 9090}, "serve"),
        ({"reach": 0.1}, "reach"),
    ],
)
def test_invalid_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        play_live(Drive.of(InMemory(crossing(1))), "dufomap", **options)


def test_without_a_screen_a_browser_is_suggested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynaviz.views.viewer.has_screen", lambda: False)
    with pytest.raises(
        UsageError,
        match=r"--view: there is no screen to open a viewer on\. Use --serve for a browser",
    ):
        play_live(Drive.of(InMemory(crossing(1))), "octomap", view=True)


def test_a_drive_is_played_and_its_last_minutes_are_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rerun.chunk import RrdReader

    from dynaviz.views import live as recording

    monkeypatch.setattr(recording, "SEGMENT", 0.0)  # a file per scan
    monkeypatch.setattr(recording, "STATES_EVERY", 0.0)
    monkeypatch.setattr(recording.LiveRecording, "_room", lambda self: 3)
    sequence = Drive.of(InMemory(crossing(5)))
    report = play_live(sequence, "dufomap", rate=0, reach=100, out=tmp_path / "live", minutes=0.01)
    files = sorted((tmp_path / "live").glob("*.rrd"))
    assert [path.stem for path in files] == ["live-000002", "live-000003", "live-000004"]
    reader = RrdReader(files[-1])
    assert [each.application_id for each in reader.recordings()] == ["dynaviz live dufomap"], (
        "for its own layout"
    )
    entities = {str(chunk.entity_path) for chunk in reader.stream()}
    shown = {
        "/world/scan",
        "/world/removed_now",
        "/world/removed_lately",
        "/world/map",
        "/world/dufomap/void",
        "/log",
    }
    assert {*shown, "/dufomap/keys/void"} <= entities
    online = dv.run("dufomap", sequence, online=True)
    assert report.dynamic == sum(int(online.labels[frame].sum()) for frame in range(5))
    assert len(report.latencies) == 5
    assert not report.dropped


def test_an_interrupted_play_reports_what_was_played() -> None:
    class Interrupted(Slow):
        def add(self, scan: Scan) -> Labels:
            if scan.index == 4:
                raise KeyboardInterrupt
            return super().add(scan)

    clock, report = Simulated(), PlayReport("slow", "six", 1.0)
    session: Any = Interrupted(clock, [0.05])
    with pytest.raises(KeyboardInterrupt):
        play(session, scans(6), report, clock=clock)
    assert (len(report.latencies), report.seconds) == (4, pytest.approx(0.4))


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_a_stopped_session_reports_what_was_played(
    stop: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(
        session: object, scans: object, report: PlayReport, *args: object, **options: object
    ) -> None:
        report.latencies.append(0.02)
        raise stop

    said: list[str] = []
    monkeypatch.setattr("dynaviz.runs.playback.play", stopped)
    with pytest.raises(stop):
        play_live(
            Drive.of(InMemory(crossing(2))), "octomap", rate=0, reach=20, announce=said.append
        )
    assert "1 of 1 scans labelled" in said[-1]


def test_the_view_shows_a_trail_of_dynamic_points_on_both_timelines() -> None:
    from dynaviz.views.live import TRACES, _layout

    layout = _layout(registry.load("methods", "octomap").info, period=0.05)
    view = layout.root_container.contents[0].contents[0]
    ranges = view.visualizer_overrides[f"/{TRACES}"].ranges.as_arrow_array().to_pylist()
    starts = {each["timeline"]: each["range"]["start"] for each in ranges}
    assert starts == {"frame": -100, "sensor_time": -5 * 10**9}


def test_the_page_is_served_until_the_report_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    from dynaviz.views import viewer

    announced: list[str] = []

    def finished(report: PlayReport) -> None:
        assert len(report.latencies) == 2
        assert viewer.listens(page)
        assert viewer.listens(page + 1)

    page = next(
        port
        for port in range(20_000, 30_000, 10)
        if not viewer.listens(port) and not viewer.listens(port + 1)
    )
    monkeypatch.setattr(viewer, "has_screen", lambda: False)
    scans_, options = Drive.of(InMemory(crossing(2))), {"rate": 0, "serve": True, "port": page}
    play_live(scans_, "octomap", **options, announce=announced.append, finished=finished)
    assert announced[0].startswith(
        f"Watch it in a browser on this machine at http://127.0.0.1:{page}/?theme=dark&url="
    )
    assert announced[1].startswith(f"From another machine, run 'ssh -L {page}:127.0.0.1:{page} ")
    assert not viewer.listens(page)
    for port in (page, page + 1):
        with socket.socket() as taken:
            taken.bind((viewer.HOME, port))
            taken.listen()
            with pytest.raises(
                UsageError, match=rf"--port {page}: port {port} cannot be used .* Give another one"
            ):
                play_live(scans_, "octomap", **options)


def test_a_file_of_a_killed_live_session_is_repaired(tmp_path: Path) -> None:
    from dynaviz.views.read.reader import AnyRecording, RunRecording
    from dynaviz.views.read.repair import repaired
    from dynaviz.views.read.shot import shot

    play_live(
        Drive.of(InMemory(crossing(5))),
        "dufomap",
        rate=0,
        reach=100,
        out=tmp_path / "live",
        minutes=1.0,
    )
    whole = tmp_path / "live" / "live-000000.rrd"
    assert (AnyRecording(whole).kind, AnyRecording(whole).span) == ("live", range(5))
    killed = tmp_path / "live-000001.rrd"
    killed.write_bytes(whole.read_bytes()[: whole.stat().st_size * 9 // 10])
    with pytest.raises(DataError, match="dynaviz info"):
        AnyRecording(killed)
    with pytest.warns(UserWarning, match=r"is incomplete.* Saved (\d) of \1 frames"):
        salvaged = repaired(killed)
    assert (AnyRecording(salvaged).kind, len(AnyRecording(salvaged).span)) in {
        ("live", n) for n in range(1, 6)
    }
    with pytest.raises(DataError, match="contains a live session, not a run"):
        RunRecording(salvaged)
    with pytest.raises(
        UsageError, match=r"contains a live session, which has no cases\. Give --frame"
    ):
        shot(salvaged, tmp_path / "case.png", case=1)
