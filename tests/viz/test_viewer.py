"""Pictures, the layout as the viewer takes it, a viewer that looks on, and what is said where there is none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from helpers.guessing_method import Guess, guess_run, record, settled
from helpers.worlds import InMemory, room
from rerun.experimental import ViewerClient

from dynaviz.engine.loop import Listener, execute
from dynaviz.errors import DataError, MissingDependency, UsageError
from dynaviz.viz import viewer
from dynaviz.viz.layout import WRONG
from dynaviz.viz.reader import RunRecording
from dynaviz.viz.recorder import Recorder
from dynaviz.viz.shot import push, shot
from dynaviz.viz.view import view


@pytest.fixture(scope="module")
def client() -> Any:
    try:
        with viewer.headless((1200, 800)) as running:
            yield running
    except MissingDependency as missing:
        pytest.skip(str(missing))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(room(3, 2000), tmp_path_factory.mktemp("viz") / "run.rrd")


def pixels(png: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(png) as picture:
        return np.asarray(picture.convert("RGB"))


def test_the_layout_shows_everything_without_a_complaint(client: ViewerClient, recording: Path) -> None:
    push(recording, client)
    shown = settled(client)
    assert {"map", "frame", "scores so far [%]", WRONG, "report"} <= set(shown)
    assert set(shown) >= {state.name for state in Guess.info.emits if state.name != "remark"}
    assert {name: reports for name, reports in shown.items() if reports} == {}


def test_pictures(client: ViewerClient, recording: Path, tmp_path: Path) -> None:
    made = shot(recording, tmp_path / "map.png", frames=(0, 2), view="map", size=(640, 400))
    assert [p.name for p in made] == ["map-0000.png", "map-0002.png"]
    colours = {tuple(c) for c in pixels(made[1]).reshape(-1, 3)}
    assert len(colours) > 100
    behind_a_tab = shot(recording, tmp_path / "reasons.png", view="reasons", size=(640, 400))
    assert len({tuple(c) for c in pixels(behind_a_tab[0]).reshape(-1, 3)}) > 10
    with pytest.raises(UsageError, match=r"--frame 3: .* has the frames 0 to 2"):
        shot(recording, tmp_path / "no.png", frames=(3,))
    with pytest.raises(UsageError, match=r"--view-name nothing: choose from .*map"):
        shot(recording, tmp_path / "no.png", view="nothing")
    assert not (tmp_path / "no.png").exists()


def test_a_viewer_may_look_on_and_go(little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever becomes of the viewer, the file is the same and the run does not fail."""
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


def test_a_viewer_that_is_not_there_is_done_without(
    little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer, "open_window", viewer.free_port)
    with Recorder(tmp_path / "run.rrd", live=True) as recorder:
        execute(guess_run(little_room), [recorder], recorder)
    assert RunRecording(tmp_path / "run.rrd").complete


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="these always have a screen")
def test_without_a_screen(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UsageError, match="no screen"):
        view([recording])
    with pytest.raises(UsageError, match="no screen"):
        Recorder(tmp_path / "run.rrd", live=True)


@pytest.mark.skipif(sys.platform != "linux", reason="takes Vulkan away the way Linux finds it")
def test_without_a_graphics_adapter(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, os.devnull)
    with pytest.raises(MissingDependency, match="apt-get install mesa-vulkan-drivers"):
        shot(recording, tmp_path / "no.png")


def foreign(path: Path) -> None:
    stream = rr.RecordingStream("other")
    stream.save(path)
    stream.log("a", rr.Points3D([[0, 0, 0]]), static=True)
    stream.disconnect()


def cut(path: Path) -> None:
    whole = record(room(2, 200), path)
    path.write_bytes(whole.read_bytes()[:-1000])


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "Is a directory"),
        (lambda path: path.write_bytes(b""), "is not a recording"),
        (lambda path: path.write_bytes(b"# .PCD v0.7"), "byte 0: is not a recording"),
        (foreign, "not of dynaviz"),
        (cut, r"cut off.*dynaviz repair"),
    ],
    ids=["missing", "folder", "empty", "cloud", "foreign", "cut"],
)
def test_files_that_are_no_recording(tmp_path: Path, make: Any, problem: str) -> None:
    path = tmp_path / "run.rrd"
    make(path)
    with pytest.raises(DataError, match=problem) as caught:
        RunRecording(path)
    assert str(caught.value).startswith(str(path))
