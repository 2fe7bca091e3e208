"""Reports on recorded runs: bird's-eye maps, and reproducible bytes."""

from __future__ import annotations

import base64
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.html_pages import Page
from helpers.worlds import room

import dynaviz as dv
from dynaviz.contracts.scan import Outcome
from dynaviz.reports.reporting import StudyOverview
from dynaviz_eval.report import birdseye


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three runs on the little room.

    One with a full recording, one without points in it, one without a recording.
    """
    folder, world = tmp_path_factory.mktemp("recorded"), room(frames=4)
    dv.run("octomap", world, out=folder / "with_points")
    dv.run("octomap_g", world, out=folder / "scores only", record="scores")
    dv.run("erasor", world, out=folder / "none", record="none")
    return folder


@pytest.fixture(scope="module")
def written(recorded: Path) -> Path:
    """Their report as a page."""
    path = recorded / "page.html"
    assert dv.report(recorded, out=path) == path.read_text()
    return path


def decoded(image: dict[str, str | None]) -> np.ndarray:
    content = base64.b64decode((image["src"] or "").removeprefix("data:image/webp;base64,"))
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def test_runs_with_a_recording_have_a_map(written):
    page = Page(written.read_text())
    assert [re.split(r"[,:] ", image["alt"] or "")[0] for image in page.images[:2]] == [
        "Bird's-eye map of room",
        "Bird's-eye map of room as cleaned by octomap",
    ]
    assert "octomap_g: no picture, because its recording contains no points." in page.text
    assert "erasor: no picture, because it has no recording." in page.text
    for image in page.images:
        assert decoded(image).shape == (int(image["height"] or 0), int(image["width"] or 0), 3)
    places = [link for link in page.links if link.endswith("run.rrd")]
    assert len(places) == 2
    assert all((written.parent / place.replace("%20", " ")).is_file() for place in places)


def test_a_broken_recording_only_loses_its_picture(recorded, tmp_path):
    shutil.copytree(recorded / "with_points", tmp_path / "a")
    whole = (tmp_path / "a/run.rrd").read_bytes()
    (tmp_path / "a/run.rrd").write_bytes(whole[: len(whole) // 2])
    page = Page(dv.report(tmp_path, format="html"))
    assert not page.images
    assert "is incomplete" in page.text


def test_the_same_results_give_the_same_bytes(recorded, written):
    code = "import sys, dynaviz as dv; sys.stdout.write(dv.report(sys.argv[1], out=sys.argv[2]))"
    words = [sys.executable, "-c", code, recorded, recorded / "again.html"]
    environment = {**os.environ, "PYTHONHASHSEED": "1", "PYTHONUTF8": "1"}
    again = subprocess.run(words, check=True, env=environment, capture_output=True)
    assert again.stdout == written.read_bytes()


def pixels(points: list[tuple[float, float, float]], outcomes: list[Outcome]) -> set[int]:
    frame = [(x, y, 0.0) for x in (-20.0, 20.0) for y in (-10.0, 10.0)]
    overview = StudyOverview(
        np.array(frame + points, np.float32),
        np.array([Outcome.STATIC_KEPT] * 4 + outcomes, np.uint8),
    )
    image = birdseye.View.of_map(overview).draw(overview)
    middle = image[
        image.shape[0] // 2 - 8 : image.shape[0] // 2 + 8,
        image.shape[1] // 2 - 8 : image.shape[1] // 2 + 8,
    ]
    return set(np.unique(middle).tolist()) - {birdseye.BACKGROUND}


def test_a_pixel_shows_the_prevailing_outcome():
    here, above = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    assert pixels([here], [Outcome.FALSE_POSITIVE]) == {birdseye.HOLE}
    assert pixels([here], [Outcome.FALSE_NEGATIVE]) == {birdseye.GHOST}
    assert pixels([here], [Outcome.DYNAMIC_REMOVED]) == {birdseye.RIGHT}
    assert pixels([here, above], [Outcome.FALSE_POSITIVE, Outcome.STATIC_KEPT]) >= {
        birdseye.GREY + birdseye.SHADES - 1
    }
    assert pixels([here, above], [Outcome.FALSE_NEGATIVE, Outcome.STATIC_KEPT]) == {birdseye.GHOST}
    assert pixels([(float("nan"), 0.0, 0.0)], [Outcome.FALSE_NEGATIVE]) == set()
