"""dynaviz doctor, as a user types it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.bags import BagWriter

from dynaviz.cli import main
from dynaviz.io.pcd import write_pcd
from dynaviz.testing.world import crossing


def write(folder: Path, in_sensor_frame: bool = False) -> Path:
    for scan in crossing(6):
        T = scan.T_world_sensor
        points = (scan.points - T[:3, 3]) @ T[:3, :3] if in_sensor_frame else scan.points
        write_pcd(
            folder / f"pcd/{scan.index:06d}.pcd",
            dict(zip("xyz", points.T.astype(np.float32), strict=True)),
            T,
        )
    return folder


def command(*words: object) -> int:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["dynaviz", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
    return int(end.value.code or 0)


def test_exit_codes_list_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("doctor", write(tmp_path / "good")) == 0
    assert "no problems found" in capsys.readouterr().out
    bad = write(tmp_path / "bad", in_sensor_frame=True)
    assert command("doctor", bad, "--json", tmp_path / "findings.json") == 1
    out, err = capsys.readouterr()
    assert "points in sensor frame" in out
    assert "Fix: " in out
    assert "reading 6/6 frames" in err
    written = json.loads((tmp_path / "findings.json").read_text())
    assert [(row["name"], row["confidence"]) for row in written["findings"]] == [
        ("points in sensor frame", "certain")
    ]
    assert command("doctor", tmp_path / "absent") == 2
    assert capsys.readouterr().err.count("\n") == 1
    # The suggested fix works.
    assert command("doctor", f"files:{bad}", "--points-in", "sensor") == 0


def test_help_begins_with_examples(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("doctor", "--help") == 0
    out = capsys.readouterr().out
    assert out.index("  dynaviz doctor") < out.index("Options:")


def test_a_bag_without_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its scans are examined, its topics listed, and the command proposed that
    estimates the poses.
    """
    with BagWriter(tmp_path / "drive") as bag:
        for k, scan in enumerate(crossing(6)):
            T = scan.T_world_sensor
            local = (scan.points - T[:3, 3]) @ T[:3, :3]
            bag.cloud(k / 10, dict(zip("xyz", local.T.astype(np.float32), strict=True)))
    cleaning = f"dynaviz clean {bag.path} -o drive_clean.laz"
    assert command("doctor", bag.path, "--quiet") == 1
    out = " ".join(capsys.readouterr().out.split())
    assert "no poses were found, but the clouds move" in out
    assert "poses missing" in out
    assert "all poses are zero" not in out
    assert f"clean the map with: {cleaning}" in out
    assert command("info", bag.path, "--quiet") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert f"clean the map with: {cleaning}" in out
    assert command("info", bag.path, "--quiet", "--json", "-") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["/points"] == "sensor_msgs/msg/PointCloud2, 6 messages, 12.0 Hz"
    assert facts["poses"].startswith("none: has no poses")
    assert facts["distance"] == "unknown"
    assert command("doctor", bag.path, "--poses", tmp_path / "absent.tum") == 2
