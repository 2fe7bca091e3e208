"""Labels of scans that another program wrote are scored, recorded and compared like a run."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import InMemory, room

import dynaviz as dv
from dynaviz.contracts.scan import Scan
from dynaviz.engine.external import default_name
from dynaviz.errors import DataError, UsageError
from dynaviz.runs.export import export_labels
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive


@pytest.fixture(scope="module")
def sequence() -> InMemory:
    return room(frames=5, rays=1003)


@pytest.fixture(scope="module")
def run(sequence: InMemory, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A run with its files and recording, and ``labels/*.label`` in the same folder."""
    folder = tmp_path_factory.mktemp("made") / "run"
    result = dv.run("octomap", sequence, out=folder, threads=1)
    export_labels(folder, folder / "predictions", sequence)
    return folder, result


def rewritten(run: Path, folder: Path, suffix: str) -> Path:
    """The labels of a run as 0 and 1 in another format."""
    folder.mkdir(parents=True)
    for file in sorted((run / "predictions").glob("*.label")):
        moving = (np.fromfile(file, "<u4") & 0xFFFF) == 251
        if suffix == ".npy":
            np.save(folder / f"{file.stem}.npy", moving)
        elif suffix == ".npz":
            np.savez(
                folder / f"{file.stem}.npz",
                moving=moving.astype(np.uint8),
                points=np.zeros((len(moving), 3)),
            )
        else:
            moving.astype("<u4").tofile(folder / f"{file.stem}.label")
    return folder


def removed(run: tuple[Path, Result], scan: Scan) -> np.ndarray:
    labels = np.fromfile(run[0] / f"predictions/{scan.index:06d}.label", "<u4")
    return (labels & 0xFFFF) == 251


@pytest.mark.parametrize("how", ["9 and 251", ".label", ".npy", ".npz"])
def test_labels_of_a_run_are_scored_as_the_run(
    run: tuple[Path, Result], sequence: InMemory, tmp_path: Path, how: str
) -> None:
    folder = (
        run[0] / "predictions" if how == "9 and 251" else rewritten(run[0], tmp_path / "mos", how)
    )
    scored = dv.score(folder, sequence, key="moving" if how == ".npz" else None, name="again")
    assert (scored.method, scored.scoring, scored.labels_sha256) == (
        "again",
        "mask",
        run[1].labels_sha256,
    )
    assert scored.sequence == run[1].sequence
    for section in ("counts", "metrics", "error_distance", "voxelwise"):
        assert getattr(scored.sections, section) == getattr(run[1].sections, section)
    assert scored.sections.breakdown.range == run[1].sections.breakdown.range
    assert scored.sections.breakdown.frame == run[1].sections.breakdown.frame
    assert [case.points for case in scored.failures] == [case.points for case in run[1].failures]
    reasons = scored.sections.reasons.false_positive
    assert reasons == {"labelled_moving": run[1].counts["static_removed"]}
    assert scored.sections.source.unanswered_frames == ()


def test_frames_without_a_file_are_not_scored(
    run: tuple[Path, Result],
    sequence: InMemory,
    run_command: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
) -> None:
    folder = rewritten(run[0], tmp_path / "mos", ".npy")
    (folder / "000010.npy").unlink()
    (folder / "000013.npy").unlink()
    with pytest.warns(
        UserWarning, match=r"mos: has no labels for 2 of 5 frames \(10, 13\); .* not scored"
    ):
        result = dv.score(folder, sequence, out=tmp_path / "out", record="none")
    answered = [scan for scan in sequence.scans if scan.index not in (10, 13)]
    moving, truth = (
        np.concatenate([part(scan) for scan in answered])
        for part in (lambda scan: removed(run, scan), lambda scan: scan.labels > 0)
    )
    assert "mos: 2 of 5 frames have no labels and are not scored" in str(result)
    assert result.counts == {
        "static_kept": int((~moving & ~truth).sum()),
        "static_removed": int((moving & ~truth).sum()),
        "dynamic_removed": int((moving & truth).sum()),
        "dynamic_kept": int((~moving & truth).sum()),
        "unlabelled": 2 * 1003,
    }
    source = Result.load(tmp_path / "out/result.json").sections.source
    assert (source.unanswered_frames, source.unanswered_points) == ((0, 3), 2006)
    digests = [
        hashlib.sha256((folder / f"{scan.index:06d}.npy").read_bytes()).hexdigest()
        for scan in answered
    ]
    assert source.sha256 == hashlib.sha256("".join(digests).encode()).hexdigest()
    assert run_command("report", tmp_path / "out", "-o", tmp_path / "report.md")[0] == 0
    assert "mos on room: 2 of 5 frames have no labels" in (tmp_path / "report.md").read_text()
    with pytest.warns(
        UserWarning, match="2 of 5 frames"
    ):  # the files of that run remember what was not answered
        again = dv.score(tmp_path / "out", sequence)
    assert again.counts == result.counts


def test_a_comparison_leaves_unanswered_frames_out(
    run: tuple[Path, Result], sequence: InMemory, tmp_path: Path
) -> None:
    folder = rewritten(run[0], tmp_path / "mos", ".label")
    (folder / "000011.label").unlink()
    with pytest.warns(UserWarning, match="1 of 5 frames"):
        result = dv.score(folder, sequence, out=tmp_path / "out")
    compared = dv.compare(run[0] / "run.rrd", tmp_path / "out/run.rrd", out=tmp_path / "both.rrd")
    pair = compared.pairs[0]
    assert compared.unscored_frames == (1,)
    assert "1 of 5 frames are left out" in str(compared)
    assert compared.to_dict()["unscored_frames"] == [1]
    assert pair.scores.SA.first == pair.scores.SA.second == pytest.approx(result.metrics["SA"])
    assert pair.scores.FP.first == pair.scores.FP.second == result.counts["static_removed"]
    assert pair.places == ()
    assert not pair.right.static.only_first


def test_folders_as_programs_write_them(
    run: tuple[Path, Result], sequence: InMemory, tmp_path: Path
) -> None:
    expected = run[1].counts
    files = run[0] / "predictions"
    (tmp_path / "mapmos/bin/sequences/08").mkdir(parents=True)
    shutil.copytree(files, tmp_path / "mapmos/bin/sequences/08/predictions")
    for below in ("bin", "bin/sequences", "bin/sequences/08", "bin/sequences/08/predictions"):
        scored = dv.score(tmp_path / "mapmos" / below, sequence)
        assert (scored.counts, scored.method) == (expected, "mapmos")
    shutil.copytree(files, tmp_path / "mapmos/bin/sequences/21/predictions")
    with pytest.raises(
        DataError, match=r"several folders with labels: sequences/08/predictions, sequences/21/pred"
    ):
        dv.score(tmp_path / "mapmos/bin", sequence)
    named = InMemory(sequence.scans, "semantickitti_08", sequence.sensor)
    assert dv.score(tmp_path / "mapmos/bin", named).counts == expected
    files = tmp_path / "mapmos/bin/sequences/08/predictions"
    (files / "poses.npy").write_bytes(b"not a label file")
    (files / "000099.label").write_bytes(b"of a frame that is not used")
    assert dv.score(files, Drive.of(sequence).select("1:4")).counts["unlabelled"] == 0


def remove_all(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()


def rename(folder: Path) -> None:
    for file in folder.iterdir():
        file.rename(file.with_stem(f"{int(file.stem) + 900:06d}"))


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (remove_all, r"mos: contains no label files\. Give a folder with"),
        (rename, r"mos: labels the frames 910 to 914, but room has the frames 10 to 14"),
        (
            lambda folder: (folder / "12.npy").touch(),
            r"12\.npy: labels the same frame as 000012\.label",
        ),
        (
            lambda folder: np.zeros(1000, "<u4").tofile(folder / "000012.label"),
            r"000012\.label: has 1,000 labels, but the scan has 1,003 points\. Write a label for "
            r"each point",
        ),
    ],
)
def test_mistakes_are_reported_and_nothing_is_written(
    run: tuple[Path, Result],
    sequence: InMemory,
    tmp_path: Path,
    damage: Callable[[Path], None],
    expected: str,
) -> None:
    folder = rewritten(run[0], tmp_path / "mos", ".label")
    damage(folder)
    with pytest.raises(DataError, match=expected):
        dv.score(folder, sequence, out=tmp_path / "out", record="none")
    assert not list((tmp_path / "out").glob("*.*"))


def test_a_run_does_not_overwrite_what_it_scores(
    run: tuple[Path, Result], sequence: InMemory, tmp_path: Path
) -> None:
    folder = rewritten(run[0], tmp_path / "mos", ".label")
    for scored, out in ((folder, folder), (run[0], run[0])):
        with pytest.raises(UsageError, match="would overwrite"):
            dv.score(scored, sequence, out=out)
    with pytest.raises(UsageError, match="key = a: give it only for a folder"):
        dv.score(run[0], sequence, key="a")


def test_names_for_tables(tmp_path: Path) -> None:
    (tmp_path / "4dmos/sequences/08/predictions").mkdir(parents=True)
    assert default_name(tmp_path / "4dmos/sequences/08/predictions") == "4dmos"
    assert default_name(tmp_path / "v1.0") == "v1"
    (tmp_path / "v1.0").mkdir()
    assert default_name(tmp_path / "v1.0") == "v1.0"
