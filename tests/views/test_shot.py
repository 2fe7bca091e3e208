"""Pictures of recordings."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.guessing_method import record
from helpers.viewer_client import headless
from helpers.worlds import room

from dynaviz.errors import MissingDependency, UsageError
from dynaviz.views.read.shot import parse_size, shot


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(room(3, 2000), tmp_path_factory.mktemp("viz") / "run.rrd")


@pytest.fixture(scope="module")
def graphics() -> None:
    """Skip on a machine without a graphics adapter."""
    with headless((320, 200)):
        pass


def pixels(png: Path) -> np.ndarray:
    picture = cv2.imread(str(png))
    assert picture is not None
    return np.asarray(picture)


@pytest.mark.usefixtures("graphics")
def test_pictures_of_frames_and_views(recording: Path, tmp_path: Path) -> None:
    made = shot(recording, tmp_path / "map.png", frames=(0,), view="map", size=(640, 400))
    assert len({tuple(c) for c in pixels(made[0]).reshape(-1, 3)}) > 100
    made = shot(
        recording, tmp_path / "reasons.png", frames=(2,), view="reasons", size=(640, 400)
    )  # behind a tab
    assert len({tuple(c) for c in pixels(made[0]).reshape(-1, 3)}) > 10
    with pytest.raises(UsageError, match=r"--frame 3: .* has the frames 0 to 2"):
        shot(recording, tmp_path / "no.png", frames=(3,))
    with pytest.raises(UsageError, match=r"--view-name nothing: choose from .*map"):
        shot(recording, tmp_path / "no.png", view="nothing")
    assert not (tmp_path / "no.png").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("graphics")
def test_pictures_of_a_comparison(merged: dict[str, Path], tmp_path: Path) -> None:
    made = shot(
        merged["two"],
        tmp_path / "x.png",
        frames=(1, 3),
        view="A octomap resolution=0.15",
        size=(500, 300),
    )
    assert [path.name for path in made] == ["x-0001.png", "x-0003.png"]


@pytest.mark.slow
@pytest.mark.usefixtures("graphics")
def test_a_picture_and_a_clip_of_a_case(runs: dict[str, Path], tmp_path: Path) -> None:
    run = runs["errors/coarse"] / "run.rrd"
    (made,) = shot(run, tmp_path / "case.png", case=1, size=(480, 360))
    assert pixels(made).shape == (360, 480, 3)
    (opening,) = shot(run, tmp_path / "opening.png", size=(480, 360))
    # It opens at its first case. Under load, software rendering differs in single pixels.
    assert (pixels(opening) != pixels(made)).any(-1).mean() < 0.05
    (made,) = shot(run, tmp_path / "case.mp4", case=1, size=(321, 321))
    clip = cv2.VideoCapture(str(made))
    assert clip.get(cv2.CAP_PROP_FRAME_COUNT) == 6
    pictures = np.stack([clip.read()[1] for _ in range(6)])
    assert (pictures[:, :321].max(-1) > 200).any()  # ghosts or holes
    below = pictures[:, 321:].astype(
        int
    )  # words, colours, and the case over time with a cursor that moves
    assert below.shape[1] > 60
    assert (np.abs(np.diff(below, axis=0)).max((1, 2, 3)) > 100).all()


def test_a_case_that_is_not_listed(
    runs: dict[str, Path], merged: dict[str, Path], recording: Path
) -> None:
    with pytest.raises(UsageError, match=r"--case 99: .*run.rrd lists the cases 1 to \d+$"):
        shot(runs["errors/coarse"] / "run.rrd", "no.png", case=99)
    with pytest.raises(UsageError, match=r"--case 1: .*run.rrd lists no case$"):
        shot(recording, "no.png", case=1)
    with pytest.raises(
        UsageError, match=r"contains a comparison, which has no cases\. Give --frame"
    ):
        shot(merged["scores"], "no.png", case=1)
    with pytest.raises(UsageError, match=r"--case 99: .*two.rrd has the cases 1 to \d+$"):
        shot(merged["two"], "no.png", case=99)
    with pytest.raises(
        UsageError, match=r"--clip no.mp4: .* contains a comparison. Give the run.rrd of a run"
    ):
        shot(merged["two"], "no.mp4", case=1)
    with pytest.raises(UsageError, match=r"--case and --frame cannot be combined\. Give one"):
        shot(recording, "no.png", case=1, frames=(0,))


def test_sizes_are_parsed() -> None:
    assert parse_size("3840x2160") == (3840, 2160)
    for text in ("1600", "1600x", "x900", "1600:900", "axb", "-5x5"):
        with pytest.raises(
            UsageError, match=f"--size {text}: give WIDTHxHEIGHT in pixels, for example 1600x900"
        ):
            parse_size(text)


def test_a_window_without_pixels_is_refused(recording: Path) -> None:
    with pytest.raises(UsageError, match="--size 100x900: each edge must have 200 to 7680 pixels"):
        shot(recording, "no.png", size=(100, 900))


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (
            ("--case", "1"),
            "--case: not with a window. Give -o IMAGE.png, or --case N --clip VIDEO.mp4",
        ),
        (("-o", "case.png", "--web"), "--web: not with -o or --clip"),
        (
            ("--clip", "case.mp4"),
            "--clip shows the frames of a case. Give its number with --case N",
        ),
        (("--case", "1", "--clip", "case.gif"), "--clip case.gif: the name must end in .mp4"),
        (("-o", "case.mp4"), "-o case.mp4: is for images. Give --clip case.mp4"),
    ],
)
def test_the_command_says_what_is_missing(
    arguments: tuple[str, ...], problem: str, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    assert run_command("view", "run.rrd", *arguments) == (2, "", f"dynaviz: {problem}\n")


@pytest.mark.skipif(sys.platform != "linux", reason="takes Vulkan away the way Linux finds it")
def test_without_a_graphics_adapter(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, os.devnull)
    with pytest.raises(MissingDependency, match="apt-get install mesa-vulkan-drivers"):
        shot(recording, tmp_path / "no.png")
