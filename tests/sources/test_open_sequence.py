"""Detecting a format, forcing one, and the errors for unknown formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynaviz.contracts import registry
from dynaviz.errors import DataError, PluginError, UsageError
from dynaviz.io.pcd import write_pcd
from dynaviz.sources.datasets import open_sequence


def drive(folder: Path) -> Path:
    write_pcd(
        folder / "pcd/000000.pcd", {axis: np.zeros(2, np.float32) for axis in "xyz"}, np.eye(4)
    )
    return folder


def test_a_missing_path_is_reported(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="none: does not exist"):
        open_sequence(str(tmp_path / "none"))


def test_an_empty_folder_is_reported_with_a_hint(tmp_path: Path) -> None:
    with pytest.raises(
        DataError,
        match=r"found an empty folder\. List the supported layouts with 'dynaviz list datasets'",
    ):
        open_sequence(str(tmp_path))


@pytest.mark.parametrize("typed", [".", "street/gt_cloud.pcd"])
def test_a_sequence_nearby_is_suggested(tmp_path: Path, typed: str) -> None:
    street = drive(tmp_path / "street")
    (street / "gt_cloud.pcd").write_text("")
    with pytest.raises(DataError, match=rf"\. Did you mean {street}\? List"):
        open_sequence(str(tmp_path / typed))


def test_the_content_of_the_path_is_described(tmp_path: Path) -> None:
    for name in ("a.txt", "b.txt", "c.md"):
        (tmp_path / name).write_text("")
    with pytest.raises(DataError, match=r"found a folder \(\.txt files: 2, \.md files: 1\)"):
        open_sequence(str(tmp_path))
    with pytest.raises(DataError, match="found a file of 0 bytes"):
        open_sequence(str(tmp_path / "a.txt"))


def test_a_prefix_forces_the_format(tmp_path: Path) -> None:
    assert len(open_sequence(f"benchmark:{drive(tmp_path)}")) == 1
    with pytest.raises(DataError, match="velodyne"):
        open_sequence(f"semantickitti:{tmp_path}")
    with pytest.raises(UsageError, match="Did you mean 'benchmark'"):
        open_sequence(f"benchmrk:{tmp_path}")


def test_a_path_may_contain_a_colon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive(tmp_path / "benchmark:1")
    monkeypatch.chdir(tmp_path)
    assert open_sequence("benchmark:1").name == "benchmark:1"


def test_the_sensor_can_be_set(tmp_path: Path) -> None:
    assert open_sequence(str(drive(tmp_path)), sensor="vlp16").sensor.rings == 16


def test_a_broken_plug_in_does_not_affect_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = registry.PluginHandle(
        "datasets", "a_broken_one", "no_such_module:Nothing", "somebody's", "1.0"
    )
    handles = registry.handles

    monkeypatch.setattr(registry, "handles", lambda kind: [broken, *handles(kind)])
    assert len(open_sequence(str(drive(tmp_path)))) == 1
    with pytest.raises(PluginError, match="a_broken_one"):
        open_sequence(f"a_broken_one:{tmp_path}")
