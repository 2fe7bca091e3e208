from __future__ import annotations

import tomllib

import numpy as np

import dynaviz
from dynaviz.synthetic.simulate import simulate

TEXT = "hall_vlp16_real?frames=2&seed=4&brushing=3"


def test_a_sequence_without_files_has_the_scans_that_are_written(tmp_path):
    written = dynaviz.open(str(simulate(TEXT, tmp_path / "hall")))
    read = dynaviz.open(f"simulate:{TEXT}")
    assert len(read) == len(written) == 2
    assert read.sensor == written.sensor
    assert read.has_labels
    assert read.name == "hall_vlp16_real-brushing-3-seed4"
    for a, b in zip(written, read, strict=True):
        for name in ("points", "labels", "classes", "instances", "stamp_ns"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_allclose(a.T_world_sensor, b.T_world_sensor, atol=1e-12)
        assert a.class_names == b.class_names
    facts = tomllib.loads((tmp_path / "hall" / "sequence.toml").read_text())
    assert facts["seed"] == 4
    assert facts["effects"]["brushing"] == 3
    assert facts["effects"]["jitter_m"] == 0.03


def test_several_lidars_keep_their_origins(tmp_path):
    text = "square_vlp32c?frames=1&jitter_m=0.03"
    written, read = (
        dynaviz.open(str(simulate(text, tmp_path / "square")))[0],
        dynaviz.open(f"simulate:{text}")[0],
    )
    np.testing.assert_array_equal(written.points, read.points)
    np.testing.assert_allclose(written.origins, read.origins, atol=1e-9)
