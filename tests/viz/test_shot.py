"""Pictures of recordings."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.guessing_method import record
from helpers.viewer_client import headless
from helpers.worlds import room

from dynaviz.errors import MissingDependency, UsageError
from dynaviz.viz.shot import shot


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(room(3, 2000), tmp_path_factory.mktemp("viz") / "run.rrd")


@pytest.fixture(scope="module")
def graphics() -> None:
    """Skip on a machine without a graphics adapter."""
    with headless((320, 200)):
        pass


def pixels(png: Path) -> np.ndarray:
    import cv2

    picture = cv2.imread(str(png))
    assert picture is not None
    return np.asarray(picture)


@pytest.mark.usefixtures("graphics")
def test_pictures_of_frames_and_views(recording: Path, tmp_path: Path) -> None:
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


@pytest.mark.usefixtures("graphics")
def test_pictures_of_a_comparison(merged: dict[str, Path], tmp_path: Path) -> None:
    made = shot(merged["two"], tmp_path / "x.png", frames=(1, 3), view="A octomap resolution=0.15", size=(500, 300))
    assert len(made) == 2


@pytest.mark.skipif(sys.platform != "linux", reason="takes Vulkan away the way Linux finds it")
def test_without_a_graphics_adapter(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, os.devnull)
    with pytest.raises(MissingDependency, match="apt-get install mesa-vulkan-drivers"):
        shot(recording, tmp_path / "no.png")
