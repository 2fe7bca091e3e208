"""Labels of a run as SemanticKITTI label files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.errors import DataError
from dynaviz.runs.export import export_labels
from dynaviz.sources.datasets.convert import convert


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence and its run; the frames do not fill sequence bytes of the packed labels."""
    path = tmp_path_factory.mktemp("run")
    convert(room(frames=4, rays=1003), path / "room")
    dv.run("octomap", path / "room", out=path / "run", record="none", threads=1)
    return path


def test_each_frame_has_a_file_with_a_label_per_point(folder: Path, tmp_path: Path) -> None:
    counted = export_labels(folder / "run", tmp_path / "labels")
    with np.load(folder / "run/labels.npz") as z:  # all frames unpacked at once
        removed_points = np.unpackbits(z["dynamic"])[: z["points"].sum()]
    files = sorted((tmp_path / "labels").iterdir())
    assert [file.name for file in files] == [f"{index:06d}.label" for index in (10, 11, 12, 13)]
    labels = np.concatenate([np.fromfile(file, "<u4") for file in files])
    np.testing.assert_array_equal(labels, np.where(removed_points, 251, 9))
    assert 0 < removed_points.sum() < len(removed_points)
    assert removed_points.sum() in counted
    assert all(file.stat().st_size == 4 * 1003 for file in files)


def test_the_files_are_read_as_labels_of_the_sweeps(folder: Path, tmp_path: Path) -> None:
    """In the folder of a SemanticKITTI sequence, they are read as its ground truth."""
    run, data = folder / "run", tmp_path / "sequences/08"
    sequence = dv.open(folder / "room")
    (data / "velodyne").mkdir(parents=True)
    for scan in sequence:
        local = np.column_stack(
            [scan.points - scan.position.astype(np.float32), np.zeros(len(scan), np.float32)]
        )
        local.astype("<f4").tofile(data / f"velodyne/{scan.index:06d}.bin")
    pose = "1 0 0 0 0 1 0 0 0 0 1 0"
    (data / "calib.txt").write_text(f"Tr: {pose}\n")
    (data / "poses.txt").write_text(f"{pose}\n" * 14)
    export_labels(run, data / "labels", sequence)
    with np.load(run / "labels.npz") as z:
        removed_points = np.unpackbits(z["dynamic"])[: z["points"].sum()]
    np.testing.assert_array_equal(
        np.concatenate([scan.labels for scan in dv.open(data)]), removed_points
    )


def test_labels_of_a_different_sequence_are_refused(folder: Path, tmp_path: Path) -> None:
    sequence, part = dv.open(folder / "room"), dv.open(folder / "room", frames="0:2")
    with pytest.raises(DataError, match="is from a different sequence"):
        export_labels(folder / "run", tmp_path / "out", part)
    with pytest.raises(DataError, match=r"room: contains no result\.json"):
        export_labels(folder / "room", tmp_path / "out", sequence)
    with pytest.raises(DataError, match=r"absent: cannot be read"):
        export_labels(tmp_path / "absent", tmp_path / "out", sequence)
    with pytest.raises(DataError, match="already exists"):
        export_labels(folder / "run", folder / "run", sequence)
    assert not list(tmp_path.iterdir())
