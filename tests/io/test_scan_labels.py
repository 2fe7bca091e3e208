"""Which points of a scan move, from files of any program."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaviz.errors import DataError
from dynaviz.io.scan_labels import read_moving

MOVING = np.array([0, 1, 1, 0, 1], np.bool_)
CLASSES = np.array(
    [0, 251, 252, 40, 259]
)  # unlabelled, moving, moving car, road, moving other vehicle
INSTANCES = np.array([7, 3, 65535, 0, 1]) << 16


def written(path: Path, values: Any, **others: Any) -> Path:
    if path.suffix == ".label":
        np.asarray(values).astype("<u4").tofile(path)
    elif path.suffix == ".npy":
        np.save(path, values)
    else:
        np.savez(path, **({"labels": values} if values is not None else {}), **others)
    return path


@pytest.mark.parametrize("suffix", [".label", ".npy", ".npz"])
@pytest.mark.parametrize(
    "values", [MOVING.astype(np.uint32), CLASSES, CLASSES + INSTANCES, 9 + 242 * MOVING]
)
def test_every_format_and_meaning(tmp_path: Path, suffix: str, values: np.ndarray) -> None:
    np.testing.assert_array_equal(
        read_moving(written(tmp_path / f"000000{suffix}", values), 5), MOVING
    )


@pytest.mark.parametrize(
    "values", [MOVING, MOVING.astype(np.float32), MOVING.astype(np.int8)[:, None]]
)
def test_arrays_as_networks_write_them(tmp_path: Path, values: np.ndarray) -> None:
    np.testing.assert_array_equal(read_moving(written(tmp_path / "a.npy", values), 5), MOVING)


def test_one_is_an_outlier_among_classes(tmp_path: Path) -> None:
    assert read_moving(written(tmp_path / "a.label", [0, 1, 40, 254]), 4).tolist() == [
        False,
        False,
        False,
        True,
    ]


def test_an_array_is_found_by_name(tmp_path: Path) -> None:
    path = written(tmp_path / "a.npz", CLASSES, confidence=np.linspace(0, 1, 5))
    np.testing.assert_array_equal(read_moving(path, 5, "labels"), MOVING)
    for key, expected in (
        (None, "arrays labels, confidence"),
        ("motion", "confidence, and none named motion"),
    ):
        with pytest.raises(
            DataError,
            match=rf"a\.npz: contains the {'' if key is None else '.*'}{expected}.*key=NAME",
        ):
            read_moving(path, 5, key)


@pytest.mark.parametrize("suffix", [".label", ".npy", ".npz"])
@pytest.mark.parametrize("points", [4, 6, 0])
def test_wrong_lengths_name_the_file_and_both_counts(
    tmp_path: Path, suffix: str, points: int
) -> None:
    path = written(tmp_path / f"000017{suffix}", CLASSES)
    with pytest.raises(
        DataError, match=rf"000017\{suffix}: has 5 labels, but the scan has {points} points"
    ):
        read_moving(path, points)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0, 1, 2, 1, 0], "contains the value 2, which SemanticKITTI does not use"),
        ([0.0, 0.2, 0.9, 1.0, 0.5], "float64 with fractions.*threshold"),
        ([0.0, 1.0, np.nan, 1.0, 0.0], "float64 with fractions"),
        ([0, 1, -1, 0, 0], "contains the value -1"),
        ([0, 1, 255, 1, 0], "contains 1 and 255"),
        (np.zeros((5, 3)), r"array \(5, 3\) of float64"),
        (np.array(list("01011")), r"array \(5,\) of <U1"),
        (np.array([None] * 5), "not a valid NPY file"),
    ],
)
def test_values_of_another_meaning_are_refused(tmp_path: Path, values: Any, expected: str) -> None:
    with pytest.raises(DataError, match=rf"a\.npy: .*{expected}"):
        read_moving(written(tmp_path / "a.npy", values), 5)


def test_a_member_that_is_not_an_array_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("labels.npy", b"not an array")
    with pytest.raises(DataError, match=r"a\.npz: not a valid NPZ file \(labels is not an array\)"):
        read_moving(tmp_path / "a.npz", 5)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    for suffix in (".label", ".npy", ".npz"):
        path = written(tmp_path / f"a{suffix}", CLASSES)
        path.write_bytes(path.read_bytes()[:-3])
        with pytest.raises(DataError, match=rf"a\{suffix}"):
            read_moving(path, 5)
        path.unlink()
        with pytest.raises(DataError, match="cannot be read"):
            read_moving(path, 5)
