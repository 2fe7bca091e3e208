"""The card of a comparison: what changed, in Markdown, with strips of pictures."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.compared_recordings import dynamic_labels
from helpers.worlds import room

import dynaviz as dv
from dynaviz import colours
from dynaviz.contracts.scan import Label, Outcome
from dynaviz.errors import DataError, UsageError
from dynaviz.reports import change_card
from dynaviz.scores.comparison.surfaces import SurfaceChange, SurfaceFate
from dynaviz.scores.result import Result

Command = Callable[..., tuple[int, str, str]]
HEADING = re.compile(r"### (\d+) (.+): (removed|lost) ([\d.]+)[ %]*→ ([\d.]+) %.*, frames? (\d+)")
WORLD = room(6, 2000)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of runs: fine, coarse, one that records scores alone, and one without truth."""
    folder = tmp_path_factory.mktemp("card runs")
    unknown = room(6, 2000, labelled=False)
    made = {
        "fine": (WORLD, 0.15, "errors"),
        "coarse": (WORLD, 0.6, "errors"),
        "scores": (WORLD, 0.6, "scores"),
        "unknown": (unknown, 0.15, "errors"),
        "unknown too": (unknown, 0.6, "errors"),
    }
    for name, (sequence, size, record) in made.items():
        settings = (f"resolution={size}",)
        dv.run("octomap", sequence, out=folder / name, record=record, settings=settings)
    return {name: folder / name for name in made}


@pytest.fixture(scope="module")
def card(runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("card") / "card.md"
    dv.compare(recording(runs, "fine"), recording(runs, "coarse"), card=file)
    return file


def recording(runs: dict[str, Path], name: str) -> Path:
    return runs[name] / "run.rrd"


def test_it_begins_with_the_verdict_and_what_differs(card: Path, runs: dict[str, Path]) -> None:
    written = card.read_text()
    found = dv.compare(recording(runs, "fine"), recording(runs, "coarse"))
    assert written.split("\n\n")[1] == f"**{found.verdicts()[0]}**"
    assert "What differs: resolution 0.15 → 0.6\n" in written
    delta = found.pairs[0].scores.DA.delta
    assert delta is not None
    assert f"{delta:+.2f}".replace("-", "−") in written


def test_the_share_removed_of_an_object_is_that_of_the_labels(
    card: Path, runs: dict[str, Path]
) -> None:
    rows = [HEADING.match(line) for line in card.read_text().splitlines()]
    objects = [row for row in rows if row and row[3] == "removed"]
    assert len(objects) == 1  # the one box that moves
    for column, name in ((4, "fine"), (5, "coarse")):
        labels = dynamic_labels(runs[name])
        moving = [scan.labels == Label.DYNAMIC for scan in WORLD.scans]
        removed = sum(int(found[of].sum()) for found, of in zip(labels, moving, strict=True))
        share = 100 * removed / sum(int(of.sum()) for of in moving)
        assert objects[0][column] == f"{share:.0f}"


def test_changes_are_in_the_order_of_what_they_change(card: Path) -> None:
    gains = [
        float(found.replace("−", "-"))
        for found in re.findall(r"^### .* ([+−][\d.]+) [SD]A, frame", card.read_text(), re.M)
    ]
    assert len(gains) > 2
    assert [abs(gain) for gain in gains] == sorted(map(abs, gains), reverse=True)


def test_strips_show_both_runs_in_the_frames_that_are_named(card: Path) -> None:
    written = card.read_text()
    strips = re.findall(r"!\[frames ([\d, ]+): A above, B below\]\((.+?)\)", written)
    assert strips
    named = {name for _, name in strips}
    assert named == {path.name for path in card.parent.glob("*.png")}
    width, height = change_card.TILE
    for frames, name in strips:
        pixels = cv2.imread(str(card.with_name(name)))[:, :, ::-1]
        numbers = [int(frame) for frame in frames.split(", ")]
        assert numbers == sorted(set(numbers))
        assert set(numbers) <= set(range(6))
        assert pixels.shape[1] == change_card.SIDE + len(numbers) * (width + change_card.GAP)
        for frame in range(len(numbers)):
            left = change_card.SIDE + frame * (width + change_card.GAP)
            for run in (0, 1):
                top = change_card.HEAD + run * (height + change_card.GAP)
                tile = pixels[top : top + height, left : left + width].reshape(-1, 3)
                assert (tile != tile[0]).any()  # not empty


@pytest.mark.parametrize("seed", range(20))
def test_any_case_has_frames_in_which_it_is_drawn(seed: int) -> None:
    random = np.random.default_rng(seed)
    frames = np.sort(random.integers(0, random.integers(1, 40), random.integers(1, 60)))
    xyz = random.normal(size=(len(frames), 3)).astype(np.float32)
    worst = int(random.integers(0, 40))
    nothing = SurfaceFate(0.0)
    surface = SurfaceChange("wall", (0.0,) * 3, (1.0,) * 3, 0, 39, 1.0, nothing, nothing)
    strip = change_card._strip(change_card.PlacedChange(surface, 0, 1), worst, frames, xyz)
    known = set(frames.tolist())
    assert set(strip.frames) <= known
    assert len(strip.frames) == min(len(known), change_card.FRAMES)
    assert worst in strip.frames or worst not in known
    assert all((low <= high).all() for low, high in zip(strip.low, strip.high, strict=True))


def test_the_run_that_removed_less_of_an_object_shows_more_of_it(card: Path) -> None:
    pixels = cv2.imread(str(card.with_name("card_1.png")))[:, :, ::-1]
    kept = (pixels == colours.BRIGHT[Outcome.FALSE_NEGATIVE]).all(2)
    middle = change_card.HEAD + change_card.TILE[1]
    assert kept[middle:].sum() > 1.2 * kept[:middle].sum() > 0


def test_links_lead_to_the_recording_of_the_case(card: Path, runs: dict[str, Path]) -> None:
    links = re.findall(r"\[Recording\]\((.+?)\) · `(.+)`", card.read_text())
    assert links
    for link, command in links:
        file = (card.parent / link.replace("%20", " ")).resolve()
        assert file in (recording(runs, "fine"), recording(runs, "coarse"))
        case = re.search(r"--case (\d+)", command)
        assert case is not None
        assert 1 <= int(case[1]) <= len(Result.load(file.with_name("result.json")).failures)


def test_several_runs_have_a_part_each(runs: dict[str, Path], tmp_path: Path) -> None:
    names = ("fine", "coarse", "fine")
    card = tmp_path / "three.md"
    dv.compare(*(recording(runs, name) for name in names), card=card)
    written = card.read_text()
    assert re.findall(r"^## A .* → (\w) ", written, re.M) == ["B", "C"]
    assert {path.name[:7] for path in tmp_path.glob("*.png")} == {"three_B"}
    assert "No object and no listed surface changed." in written


def test_recordings_of_scores_alone_have_no_pictures(runs: dict[str, Path], tmp_path: Path) -> None:
    dv.compare(recording(runs, "fine"), recording(runs, "scores"), card=tmp_path / "card.md")
    assert [path.name for path in tmp_path.iterdir()] == ["card.md"]
    assert HEADING.search((tmp_path / "card.md").read_text())


def test_without_ground_truth_nothing_is_called_better(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    card = tmp_path / "card.md"
    dv.compare(recording(runs, "unknown"), recording(runs, "unknown too"), card=card)
    written = card.read_text()
    assert "neither run is known to be better" in written
    assert "no object or surface is known to have changed" in written
    assert list(tmp_path.iterdir()) == [card]


def test_another_suffix_is_refused_before_anything_is_written(
    run_command: Command, runs: dict[str, Path], tmp_path: Path
) -> None:
    files = recording(runs, "fine"), recording(runs, "coarse")
    out = tmp_path / "both.rrd"
    code, _, err = run_command("compare", *files, "-o", out, "--card", tmp_path / "card.html")
    assert code == 2
    assert "Give a name that ends in .md" in err
    with pytest.raises(UsageError, match=r"ends in \.md"):
        dv.compare(*files, out=out, card=tmp_path / "card")
    assert not list(tmp_path.iterdir())


def test_the_command_says_where_the_card_is(
    run_command: Command, runs: dict[str, Path], tmp_path: Path
) -> None:
    files = recording(runs, "fine"), recording(runs, "coarse")
    card = tmp_path / "deep/card.md"
    code, shown, _ = run_command("compare", *files, "-o", tmp_path / "c.rrd", "--card", card)
    assert code == 0
    assert f"Written to {card}" in shown
    assert card.read_text().startswith("# A octomap")
    blocked = tmp_path / "c.rrd/card.md"
    with pytest.raises(DataError):
        dv.compare(*files, card=blocked)
