"""The limits that docs/limits.md states: where they lie, and what happens beyond."""

from __future__ import annotations

import dataclasses
import re
import tracemalloc
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaviz import kernels
from dynaviz.contracts import registry
from dynaviz.contracts.extent import FAR, Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.engine import loop
from dynaviz.engine.loop import RunSpec, execute
from dynaviz.errors import DataError, DynavizError, UsageError
from dynaviz.io import records
from dynaviz.sources.datasets.files import numbered_files
from dynaviz.sources.summary import SequenceSummary
from dynaviz.spatial import grid
from dynaviz.testing import InMemory, crossing
from dynaviz.testing.world import SENSOR, moved, turn

METHODS = [handle.name for handle in registry.handles("methods")]
PAGE = Path(__file__).parents[1] / "docs/limits.md"


def loaded(name: str) -> Any:
    kind = registry.load("methods", name)
    return kind(kind.Params())


def test_the_page_states_what_the_code_has() -> None:
    stated = re.sub(r"\s+", " ", PAGE.read_text())
    for number in (
        f"{FAR / 1000:.0f} km",
        f"{kernels.blocks.REACH:,} voxels",
        f"{grid.REACH:,} voxels",
        f"{loop.MAX_MAP_POINTS:,} points",
        f"{records._MAX_RECORD >> 20} MiB",
    ):
        assert number in stated, number


FAR_REACHING = {"freedom", "hmm_mos"}  # their voxels are larger, so that 4 km is within their reach


@pytest.mark.parametrize("name", METHODS)
def test_what_lies_beyond_a_methods_reach_is_kept_and_harms_nobody(name: str) -> None:
    """Two more crossings, 4 (or 20) and 90 km away, in opposite corners.

    The first keeps its labels.
    """
    near = [scan.without_truth() for scan in crossing(4)]
    world = list(near)
    for k, far in enumerate((20_000.0 if name in FAR_REACHING else 4_000.0, -90_000.0), 1):
        world += [
            dataclasses.replace(moved(scan, turn(0, far, far, 0)), index=10 * k + scan.index)
            for scan in near
        ]
    answers = []
    for scans in (near, world):
        method = loaded(name)
        raw_map = np.concatenate([scan.points for scan in scans]) if method.info.needs_map else None
        method.begin(Context(Extent.of(*scans), SENSOR, raw_map=raw_map))
        for scan in scans:
            method.observe(scan)
        answers.append([method.label(scan) for scan in scans])
    for before, after in zip(*answers, strict=False):
        np.testing.assert_array_equal(before.dynamic, after.dynamic)
    codes = [reason.name for reason in method.info.reasons]
    if "out_of_reach" in codes:
        for labels in answers[1][len(near) :]:
            assert not labels.dynamic.any()
            assert (labels.reasons == codes.index("out_of_reach")).all()


def test_a_map_of_more_points_than_can_be_numbered_is_refused() -> None:
    sequence = InMemory(crossing(1))
    seen = SequenceSummary(Extent.of(*sequence.scans), 9000, loop.MAX_MAP_POINTS + 1, "")
    method = loaded("erasor")
    with pytest.raises(UsageError, match=r"2,147,483,648 in 9,000 frames.*stride=N"):
        loop.context_of(RunSpec(method, sequence, method.params), seen, loop.SILENT)


@dataclass(frozen=True)
class Endless:
    """The same few points again and again, made when asked for."""

    frames: int
    name: str = "endless"
    sensor: Sensor = SENSOR
    has_labels: bool = False

    def __len__(self) -> int:
        return self.frames

    def __getitem__(self, position: int) -> Scan:
        points = np.random.default_rng(position % 50).uniform(-5, 5, (40, 3)).astype(np.float32)
        return Scan(position, points, np.eye(4))


def test_memory_grows_with_the_place_not_with_the_frames() -> None:
    """A bit a point for the digest of labels, and a number a frame for its time."""

    def peak(frames: int) -> int:
        method = loaded("octomap")
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        execute(RunSpec(method, Endless(frames), method.params))
        return tracemalloc.get_traced_memory()[1] - before

    tracemalloc.start()
    try:
        peak(50)  # warm
        few, many = peak(50), peak(350)
    finally:
        tracemalloc.stop()
    assert many - few < 300 * 150, f"{few} bytes for 50 frames, {many} for 350"


def test_a_frame_of_a_million_points() -> None:
    points = (np.random.default_rng(0).uniform(-1, 1, (1_000_000, 3)) * [6, 6, 0.5]).astype(
        np.float32
    )
    method, sequence = loaded("octomap"), InMemory([Scan(0, points, np.eye(4))])
    tracemalloc.start()
    try:
        result = execute(RunSpec(method, sequence, method.params))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert result.sequence.points == len(points)
    assert peak < 150 * len(points), f"{peak / len(points):.0f} bytes a point"


@pytest.mark.parametrize("number", ["9223372036854775808", "1" * 5000])
def test_a_frame_number_beyond_64_bits_is_refused(number: str) -> None:
    class Folder:
        def glob(self, pattern: str) -> list[Path]:
            return [Path(f"scans/{number}.pcd")]

    with pytest.raises(DataError, match="not a frame number"):
        numbered_files(Folder(), ".pcd")  # type: ignore[arg-type]


def test_the_place_itself_is_told() -> None:
    with pytest.raises(DynavizError, match="km from the world's origin"):
        Extent.of(Scan(0, np.full((1, 3), 1.001 * FAR, np.float32), np.eye(4)))
