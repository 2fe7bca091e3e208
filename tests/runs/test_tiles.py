"""Runs on tiles: the labels are those of one run, and an interrupted run continues."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.toy_method import write_room
from helpers.worlds import room

import dynaviz as dv
from dynaviz.arrays import F32
from dynaviz.blocks.blocks import BlockGrid
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.runs.tiles.grid import TileGrid, packed, unpacked
from dynaviz.runs.tiles.index import SequenceIndex
from dynaviz.runs.tiles.tile import CYCLE, NEAR, TileFrames, TileTask
from dynaviz.sources.datasets.drives import OBJECTS, Drives
from dynaviz.sources.drive import Drive
from dynaviz.tasks.local import WorkerProcesses
from dynaviz.testing import InMemory
from dynaviz.views.read.reader import AnyRecording, RunRecording
from dynaviz_methods.seethrough.clear_grid import ClearGrid

SIZE = 12.0  # metres: the room lies in four tiles


@pytest.fixture(scope="module")
def long_room() -> InMemory:
    return room(frames=12, rays=4000)


def labels(folder: Path) -> tuple[bytes, bytes]:
    with np.load(folder / "labels.npz") as z:
        return z["dynamic"].tobytes(), z["reasons"].tobytes()


@pytest.mark.filterwarnings("ignore:the sensor is unknown")
@pytest.mark.parametrize(
    "method",
    [
        *("octomap", "dufomap", "seethrough"),
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("octomap_g", "octomap_gf", "freedom")
        ),
    ],
)
def test_labels_and_reasons_equal_those_of_one_run(
    method: str, long_room: InMemory, tmp_path: Path
) -> None:
    settings = ("sky=false",) if method == "freedom" else ()
    whole = dv.run(method, long_room, out=tmp_path / "whole", record="none", settings=settings)
    tiled = dv.run(
        method, long_room, out=tmp_path / "tiled", record="none", settings=settings, tiles=SIZE
    )
    assert labels(tmp_path / "tiled") == labels(tmp_path / "whole")
    assert tiled.counts == whole.counts
    assert tiled.counts["dynamic_removed"] > 0
    assert tiled.sequence == whole.sequence
    assert tiled.pose_noise == whole.pose_noise
    assert tiled.sections.tiling
    assert tiled.sections.tiling.tiles == 4
    assert (tmp_path / "tiled/config.toml").read_text() == (
        tmp_path / "whole/config.toml"
    ).read_text()


def test_online_labels_are_tiled_too(long_room: InMemory, tmp_path: Path) -> None:
    whole = dv.run("dufomap", long_room, online=True)
    tiled = dv.run("dufomap", long_room, online=True, out=tmp_path, record="none", tiles=SIZE)
    assert tiled.labels_sha256 == whole.labels_sha256


@pytest.mark.parametrize("method", [pytest.param("octomap", marks=pytest.mark.slow), "dufomap"])
def test_a_map_far_from_the_origin_is_judged_like_one_at_the_origin(
    method: str, tmp_path: Path
) -> None:
    def placed(scan: Scan, x: float) -> Scan:
        # exact in float32 at both places, and so is the pose
        points = np.round(scan.points * 64) / 64
        pose = np.round(scan.T_world_sensor * 64) / 64
        pose[0, 3] += x
        return Scan(scan.index, points + np.float32([x, 0, 0]), pose, labels=scan.labels)

    scans = room(frames=12, rays=4000).scans
    near, far = (
        InMemory([placed(scan, x) for scan in scans], "room", room(1).sensor)
        for x in (0.0, 12_800.0)
    )
    whole = dv.run(method, near)
    assert (
        dv.run(method, far).labels_sha256 != whole.labels_sha256
    )  # out of reach: all points are kept
    tiled = dv.run(method, far, out=tmp_path, record="none", tiles=SIZE)
    assert tiled.labels_sha256 == whole.labels_sha256


@pytest.mark.slow
def test_two_processes_run_all_tiles_with_the_same_labels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []

    class Counted(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            started.append(self)
            super().__init__(*arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", Counted)
    folder = write_room(tmp_path / "room", frames=6)
    whole = dv.run("octomap", folder)
    tiled = dv.run("octomap", folder, out=tmp_path / "out", record="none", tiles=SIZE, workers=2)
    assert tiled.labels_sha256 == whole.labels_sha256
    assert [process.returncode for process in started] == [0, 0], "four tiles, two processes"
    assert {path.name for path in tmp_path.glob("out/tiles/*/*")} == {"answers.npz"}


def test_a_process_that_dies_loses_one_tile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[subprocess.Popen[bytes]] = []
    take = WorkerProcesses._take

    def killed(processes: WorkerProcesses, log: Path) -> subprocess.Popen[bytes]:
        taken.append(take(processes, log))
        if len(taken) == 2:
            taken[1].kill()
        return taken[-1]

    monkeypatch.setattr(WorkerProcesses, "_take", killed)
    folder = write_room(tmp_path / "room", frames=6)
    options = dict[str, Any](out=tmp_path / "out", record="none", tiles=SIZE, workers=2)
    with pytest.raises(DataError, match=r"1 of 4 tiles failed \(.*killed by SIGKILL"):
        dv.run("octomap", folder, **options)
    assert len(list(tmp_path.glob("out/tiles/*/answers.npz"))) == 3
    assert (
        dv.run("octomap", folder, **options).labels_sha256
        == dv.run("octomap", folder).labels_sha256
    )


def test_finished_tiles_are_kept_and_others_run(
    long_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []
    run = TileTask.run

    def counted(task: TileTask, folder: Path, *others: object) -> None:
        ran.append(task.path.name)
        run(task, folder, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(TileTask, "run", counted)
    first = dv.run("dufomap", long_room, out=tmp_path, record="none", tiles=SIZE)
    assert sorted(ran) == ["-1_-1", "-1_0", "0_-1", "0_0"]
    (tmp_path / "tiles/0_-1/answers.npz").unlink()
    (tmp_path / "tiles/-1_0/answers.npz").write_bytes(b"half a file")
    ran.clear()
    again = dv.run("dufomap", long_room, out=tmp_path, record="none", tiles=SIZE)
    assert sorted(ran) == ["-1_0", "0_-1"]
    assert again.labels_sha256 == first.labels_sha256
    ran.clear()
    dv.run(
        "dufomap", long_room, out=tmp_path, record="none", tiles=SIZE, settings=("hit_margin=0.1",)
    )
    assert len(ran) == 4, "answers with other parameters are of no use"


def test_a_tile_that_fails_is_named_and_the_others_are_finished(
    long_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = TileTask.run

    def broken(task: TileTask, folder: Path, *others: object) -> None:
        if task.tile == (0, 0):
            raise DataError("scan.pcd", "cannot be read")
        run(task, folder, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(TileTask, "run", broken)
    with pytest.raises(
        DataError, match=r"1 of 4 tiles failed \(0_0\): scan.pcd: cannot be read.*same command"
    ):
        dv.run("octomap", long_room, out=tmp_path, record="none", tiles=SIZE)
    assert len(list(tmp_path.glob("tiles/*/answers.npz"))) == 3
    assert not (tmp_path / "result.json").exists()


def test_a_method_that_needs_the_whole_map_is_refused(long_room: InMemory, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"hmm_mos cannot run on tiles.*octomap"):
        dv.run("hmm_mos", long_room, out=tmp_path, tiles=SIZE)
    with pytest.raises(UsageError, match="removert cannot run on tiles"):
        dv.run("removert", long_room, out=tmp_path, tiles=SIZE, preset="port")


@pytest.mark.parametrize(("tiles", "words"), [(3.0, "from 10 to 1000"), (float("nan"), "from 10")])
def test_an_impossible_size_is_refused(
    tiles: float, words: str, long_room: InMemory, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=words):
        dv.run("octomap", long_room, out=tmp_path, tiles=tiles)
    with pytest.raises(UsageError, match="out=FOLDER"):
        dv.run("octomap", long_room, tiles=SIZE)
    with pytest.raises(UsageError, match="give tiles=METRES"):
        dv.run("octomap", long_room, out=tmp_path, workers=2)


def test_drives_far_from_zero_have_one_origin() -> None:
    scans = room(frames=2, rays=3000).scans

    @dataclasses.dataclass(frozen=True)
    class Far(InMemory):
        origin: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))

    def far(kilometre: float) -> Far:
        return Far(scans, "far", room(1).sensor, np.array([1000.0 * kilometre, 0, 0]))

    both = Drives.of([far(500), far(502)])
    assert both.origin.tolist() == [500_000, 0, 0]
    assert (both[1].points == scans[1].points).all()
    assert both[2].position.tolist() == np.add(scans[0].position, [2000, 0, 0]).tolist()
    assert both[3].instances is not None
    assert set(both[3].instances.tolist()) == {0, OBJECTS + 1}
    other = InMemory(scans, "other", dataclasses.replace(room(1).sensor, name="another"))
    with pytest.raises(UsageError, match="different sensors cannot be joined: another, test"):
        Drives.of([far(500), other])


def test_several_drives_are_one_map(
    tmp_path: Path, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    first, second = (
        write_room(tmp_path / name, frames=6, seed=seed)
        for seed, name in enumerate(("first", "second"))
    )
    code, _, err = run_command(
        "run", "octomap", first, second, "-o", tmp_path / "run", "--tiles", SIZE
    )
    assert code == 0, err
    result, both = dv.Result.load(tmp_path / "run/result.json"), dv.open([first, second])
    assert result.sequence.name == "first+second"
    assert [scan.index for scan in (both[0], both[6], both[11])] == [0, 6, 11]
    assert result.labels_sha256 == dv.run("octomap", both).labels_sha256
    assert dv.why(tmp_path / "run", 7, 0).sequence == "first+second"


def test_a_car_that_is_gone_in_the_second_drive_is_removed_from_the_first(tmp_path: Path) -> None:
    y, z = (axis.ravel() for axis in np.meshgrid(np.arange(-4, 4, 0.05), np.arange(-1, 1, 0.05)))
    wall = np.stack([np.full(len(y), 15.0), y, z], 1).astype(np.float32)
    behind = np.abs(y) < 1.5
    parked = np.where(
        behind[:, None], wall * np.float32(0.4), wall
    )  # at 6 m, on the rays to the wall

    def drive(points: F32) -> InMemory:
        labels = (points[:, 0] < 10).astype(np.uint8)
        return InMemory(
            [Scan(k, points, np.eye(4), labels=labels) for k in range(4)], "drive", room(1).sensor
        )

    both = Drives.of(
        [drive(parked), drive(wall), drive(wall), drive(wall)]
    )  # three misses outweigh a hit
    result = dv.run("octomap", both, out=tmp_path, record="none", tiles=SIZE)
    assert result.labels[0][behind].mean() > 0.9
    assert not result.labels[0][~behind].any()
    assert not result.labels[5].any()


def test_every_point_has_one_tile() -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-5000, 5000, (1000, 3)).astype(np.float32)
    points[::50, 1] = np.nan
    grid, pose = TileGrid(37.0), np.eye(4)
    pose[:3, 3] = 50, -50, 0
    owners = grid.owners(Scan(0, points, pose))
    for tile in np.unique(owners).tolist():
        assert packed(unpacked(tile)) == tile
        low, high = grid.bounds(unpacked(tile))
        own = points[owners == tile]
        own = own[np.isfinite(own).all(1), :2].astype(np.float64)
        assert (own >= low).all()
        assert (own < high).all()
    assert set(owners[::50].tolist()) == {packed((1, -2))}


def test_the_points_of_a_tile_are_those_it_owns() -> None:
    points = np.random.default_rng(2).uniform(-60, 60, (3000, 3)).astype(np.float32)
    points[::50, 1], points[1::50, 2], points[2::50] = np.nan, np.inf, 64.0 - 37.0
    grid, origin, pose = TileGrid(37.0), np.array([64.0, 0, 0]), np.eye(4)
    pose[:3, 3] = 40, -20, 1
    for offset in (np.zeros(3), origin):
        scan = Scan(0, points, pose)
        owners = grid.owners(scan.moved(offset))
        tiles, of, counts = grid.counted(scan.moved(offset))
        assert (tiles[of] == owners).all()
        assert counts.tolist() == np.unique(owners, return_counts=True)[1].tolist()
        for tile in tiles.tolist():
            assert (
                grid.rows(scan, unpacked(tile), offset).tolist()
                == np.flatnonzero(owners == tile).tolist()
            )
    nothing = Scan(0, points[:0], pose)
    assert [len(found) for found in grid.counted(nothing)] == [0, 0, 0]
    assert len(grid.rows(nothing, (0, 0), origin)) == 0


@pytest.mark.parametrize("several", [False, True])
def test_rays_that_end_beyond_a_tile_mark_its_voxels(several: bool) -> None:
    random, pose = np.random.default_rng(3), np.eye(4)
    near = random.uniform(-30, 30, (200, 3)).astype(np.float32) * np.float32([1, 1, 0.05])
    points = np.concatenate([near, 2 * near])  # each ray to a far point passes a near one
    points[::40] = np.nan
    origins = random.integers(0, 2, (400, 1)) * np.array([[0.03, 0.0, 0.0]]) if several else None
    scan = Scan(0, points, pose, origins=origins)
    whole = Extent.of(scan)
    cut = whole.cropped(np.array([8.0, 8.0]), np.array([30.0, 30.0]))

    def marked(grid: BlockGrid, scan: Scan) -> dict[tuple[int, ...], list[int]]:
        if isinstance(grid, ClearGrid):
            marks = grid.mark_once(scan, grid.locate(scan.points))
        else:
            marks = grid.mark(scan, np.ones(len(scan), np.bool_), np.ones(len(scan), np.bool_))
        return dict(
            zip(map(tuple, grid.blocks[marks.blocks].tolist()), marks.bits.tolist(), strict=True)
        )

    for kind in (BlockGrid, ClearGrid):
        grid = kind(cut, 0.1)
        own, expected = set(map(tuple, grid.blocks.tolist())), marked(kind(whole, 0.1), scan)
        assert marked(grid, scan) == {
            block: bits for block, bits in expected.items() if block in own
        }
        assert marked(grid, scan) != marked(
            grid, scan.chosen(np.flatnonzero(grid.locate(points) >= 0))
        )


@pytest.mark.parametrize("size", [37.0, 1000.0])
def test_moving_a_far_tile_to_its_origin_and_back_changes_no_point(size: float) -> None:
    random, grid = np.random.default_rng(1), TileGrid(size)
    points = random.uniform(-60_000, 60_000, (2000, 3)).astype(np.float32)
    points[1000:, 1] /= 40  # far along x only
    scan = Scan(0, points, np.eye(4))
    owners, moves = grid.owners(scan), 0
    for tile in np.unique(owners).tolist():
        origin = grid.local_origin(unpacked(tile), NEAR)
        own = Scan(0, points[owners == tile], np.eye(4))
        local = own.moved(-origin)
        assert np.abs(local.points[:, :2]).max() <= NEAR
        assert (local.moved(origin).points == own.points).all()
        moves += bool(origin.any())
    assert moves > 100


def test_all_frames_whose_rays_touch_a_tile_are_found(long_room: InMemory) -> None:
    size, margin = 4.0, 0.5
    index = SequenceIndex.of(long_room, size)
    skipped = 0
    for tile in index.tiles:
        low, high = TileGrid(size).bounds(tile) + np.array([[-margin], [margin]])
        touching = []
        for position in range(len(long_room)):
            scan = long_room[position]
            along = np.linspace(0, 1, 50)[:, None, None]
            xy = (scan.position + along * (scan.points[::5] - scan.position))[..., :2]
            if ((xy >= low) & (xy <= high)).all(-1).any():
                touching.append(position)
        found = index.frames_reaching(tile, margin).tolist()
        assert set(touching) <= set(found)
        skipped += len(long_room) - len(found)
    assert index.count_of.sum() == sum(len(scan) for scan in long_room.scans)
    narrow = dataclasses.replace(index, farthest=index.farthest * 0 + 1.0)
    assert sum(
        len(narrow.frames_reaching(tile, margin)) for tile in index.tiles
    ) < skipped + 12 * len(index.tiles)


@pytest.mark.parametrize("direction", [(1, 0), (0, 1), (-1, 0), (0, -1), (1, -1)])
def test_a_frame_reaches_tiles_only_in_the_directions_in_which_it_sees(
    direction: tuple[int, int],
) -> None:
    position, size = np.array([103.0, -58.0, 0.0]), 4.0
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = position
    far = position + 30.0 * np.array([*direction, 0.0])
    scan = Scan(0, np.array([far, position + 0.1], np.float32), T_world_sensor)
    index = SequenceIndex.of(InMemory([scan]), size)

    def reached(metres: float) -> bool:
        x, y = np.floor((position[:2] + metres * np.array(direction)) / size).astype(int).tolist()
        return len(index.frames_reaching((x, y), 0.1)) == 1

    assert reached(20.0)
    assert reached(0.0)
    assert not reached(-20.0)
    assert not reached(45.0)


def test_gaps_keep_every_nth_frame_in_step(long_room: InMemory) -> None:
    n = 10 * CYCLE
    index = dataclasses.replace(
        SequenceIndex.of(long_room, SIZE), numbers=np.arange(n), positions=np.zeros((n, 3))
    )
    wanted = np.array([7, 8, 8 + 2 * CYCLE - 1, 9 * CYCLE + 3])
    frames = TileFrames.of(Drive.of(long_room), index, wanted, np.zeros(3))
    at = np.flatnonzero(frames.rows >= 0)
    assert frames.rows[at].tolist() == wanted.tolist()
    assert (at % CYCLE).tolist() == (wanted % CYCLE).tolist()
    assert len(frames) < 5 * CYCLE
    assert len(frames[0]) == 0, "an empty scan stands for a frame that does not see the tile"


def test_the_evidence_of_a_tile_is_that_of_its_points(long_room: InMemory, tmp_path: Path) -> None:
    dv.run("octomap", long_room, out=tmp_path, tiles=SIZE)
    assert AnyRecording(tmp_path / "overview.rrd").kind == "overview"
    ledgers = 0
    for path in tmp_path.glob("tiles/*/run.rrd"):
        column, row = map(int, path.parent.name.split("_"))
        low, high = TileGrid(SIZE).bounds((column, row))
        recording = RunRecording(path)
        for ledger in (each for case in range(1, 21) for each in recording.ledgers(case)):
            assert ((ledger.position[:2] >= low) & (ledger.position[:2] < high)).all()
            scan = next(scan for scan in long_room.scans if scan.index == ledger.index)
            own = TileGrid(SIZE).rows(scan, (column, row), np.zeros(3))
            assert scan.points[own[ledger.point]].tolist() == list(ledger.position)
            ledgers += 1
    assert ledgers > 50


@pytest.mark.slow
def test_the_command_line_runs_tiles(
    tmp_path: Path, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    run, room_folder = tmp_path / "run", write_room(tmp_path / "room", frames=6)
    code, out, err = run_command("run", "dufomap", room_folder, "-o", run, "--tiles", "12")
    assert code == 0, err
    assert "dufomap" in out
    result = dv.Result.load(run / "result.json")
    assert result.sections.tiling
    recorded = {path.parent.name: RunRecording(path).result for path in run.glob("tiles/*/run.rrd")}
    assert AnyRecording(run / "overview.rrd").kind == "overview"
    assert len(recorded) == result.sections.tiling.tiles == 4
    for name in ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept"):
        rows = {
            f"{row.column}_{row.row}": getattr(row, name) for row in result.sections.tiling.tile
        }
        assert {tile: each.counts[name] for tile, each in recorded.items() if each} == rows
        assert sum(rows.values()) == result.counts[name]
    code, out, err = run_command("info", run / "result.json", "--failures")
    assert code == 0, err
    whole = dv.run("dufomap", room_folder, out=tmp_path / "whole")
    comparison = dv.compare(tmp_path / "whole/run.rrd", run / "run.rrd")
    assert comparison.pairs[0].differ is not None
    assert whole.labels_sha256 == dv.Result.load(run / "result.json").labels_sha256
