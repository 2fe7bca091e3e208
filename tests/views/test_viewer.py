"""A viewer that follows a run, and machines without a screen."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.guessing_method import guess_run, record
from helpers.worlds import InMemory, room

from dynaviz.engine.loop import Listener, execute
from dynaviz.errors import DynavizError, UsageError
from dynaviz.views import viewer
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.read.view import tunnel, view
from dynaviz.views.record.recorder import Recorder


def test_a_viewer_may_be_closed_during_the_run(
    little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file stays the same and the run does not fail."""
    gone: list[int] = []

    class Closing(Listener):
        def observing(self, frame: int, scan: Any) -> None:
            if frame == 3 and not gone:
                process.terminate()
                gone.append(process.wait())

    port = viewer.free_port()
    process = subprocess.Popen(
        [viewer.program(), "--serve-grpc", f"--bind={viewer.HOME}", f"--port={port}"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while not viewer.listens(port):
        assert process.poll() is None
    monkeypatch.setattr(viewer, "open_window", lambda: port)
    with Recorder(tmp_path / "run.rrd", live=True) as recorder:
        execute(guess_run(little_room), [recorder, Closing()], recorder)
    assert gone
    alone = record(little_room, tmp_path / "alone.rrd")
    assert RunRecording(tmp_path / "run.rrd").entities() == RunRecording(alone).entities()
    assert len(list(RunRecording(tmp_path / "run.rrd").answers())) == 6


def test_a_run_does_not_need_the_viewer_it_was_given(
    little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer, "open_window", viewer.free_port)
    with Recorder(tmp_path / "run.rrd", live=True) as recorder:
        execute(guess_run(little_room), [recorder], recorder)
    assert RunRecording(tmp_path / "run.rrd").complete


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="these always have a screen")
def test_without_a_screen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UsageError, match="no screen"):
        view([record(room(2, 200), tmp_path / "run.rrd")])
    with pytest.raises(UsageError, match="no screen"):
        Recorder(tmp_path / "run.rrd", live=True)


def test_a_busy_viewer_is_asked_again() -> None:
    answers = iter([TimeoutError(), TimeoutError(), 7])

    def request() -> int:
        if isinstance(answer := next(answers), int):
            return answer
        raise answer

    def never() -> int:
        raise TimeoutError

    assert viewer.patient(request) == 7
    with pytest.raises(DynavizError, match="the viewer does not answer in time"):
        viewer.patient(never)


class StoredLayout:
    """Stands for a viewer that stores its layout in some form."""

    def __init__(self, layout: dict[str, Any]) -> None:
        self.blueprint = layout
        self.sent: dict[str, Any] = {}

    def get_blueprint(self) -> StoredLayout:
        return self

    def set_blueprint(self, layout: dict[str, Any], of: str) -> None:
        self.sent = {of: layout}


@pytest.mark.parametrize("layout", [{}, {"/viewport": {}}, {"/viewport": {"Viewport": {}}}])
def test_a_viewer_that_stores_its_layout_differently_names_the_entity(layout: Any) -> None:
    with pytest.raises(DynavizError, match=r"its entity /viewport has no ViewportBlueprint"):
        viewer.maximize(StoredLayout(layout), "7")  # type: ignore[arg-type]


def test_a_view_gets_the_whole_window() -> None:
    client = StoredLayout({"/viewport": {"ViewportBlueprint": {"auto_views": False}}})
    viewer.maximize(client, "7")  # type: ignore[arg-type]
    shown = {"auto_views": False, "maximized": "7"}
    assert client.sent == {"recording": {"/viewport": {"ViewportBlueprint": shown}}}


@pytest.mark.skipif(sys.platform == "win32", reason="the viewer is replaced by a shell script")
def test_a_viewer_that_ends_at_start_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\necho no graphics >&2\nexit 3\n")
    broken.chmod(0o755)
    run = record(room(2, 200), tmp_path / "run.rrd")
    monkeypatch.setattr(viewer, "program", lambda: str(broken))
    monkeypatch.setattr(viewer, "has_screen", lambda: True)
    for web in (False, True):
        with pytest.raises(DynavizError, match=r"^the viewer did not start: no graphics$"):
            view([run], web=web)


def test_the_port_of_the_page(tmp_path: Path) -> None:
    run = record(room(2, 200), tmp_path / "run.rrd")
    with pytest.raises(UsageError, match=r"--port 9090: is the port of a page\. Add --web"):
        view([run], port=9090)
    with socket.socket() as taken:
        taken.bind((viewer.HOME, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(
            UsageError, match=rf"--port {port}: port {port} cannot be used .* Give another one"
        ):
            view([run], web=True, port=port)
    assert tunnel(9090, 9091).startswith("ssh -L 9090:127.0.0.1:9090 -L 9091:127.0.0.1:9091 ")
