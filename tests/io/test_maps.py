"""Maps of every format, read back: attributes bit by bit, coordinates far from zero, tiles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynaviz.errors import UsageError
from dynaviz.io.fields import read_fields
from dynaviz.io.maps import (
    DIVIDED_METADATA,
    DIVIDED_TILES,
    PROJECTOR,
    check_map_path,
    divided_map,
    open_map,
)

N = 500
FAR = np.array([500_000.0, 5_400_000.0, 0.0])


def attributes() -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    whole = {"ring": "u2", "return_number": "u1", "red": "u2", "green": "u2", "blue": "u2"}
    fields = {name: random.integers(0, 6, N).astype(kind) for name, kind in whole.items()}
    fields["t"] = random.integers(0, 1 << 63, N).astype("u8")  # too large for a float64
    fields["gps_time"] = random.random(N) * 1e9
    fields["intensity"] = random.random(N).astype("f4")
    fields["reflectivity"] = np.where(np.arange(N) % 7 == 0, np.nan, random.random(N)).astype("f4")
    return fields


def write(
    path: Path, xyz: np.ndarray, fields: dict[str, np.ndarray], origin: np.ndarray
) -> dict[str, np.ndarray]:
    """Write in two pieces, and read all fields."""
    with open_map(path, {name: array.dtype for name, array in fields.items()}, origin) as append:
        for part in (slice(0, 200), slice(200, N)):
            append(xyz[part], {name: array[part] for name, array in fields.items()})
    return read_fields(path)


@pytest.mark.parametrize("suffix", [".pcd", ".las", ".laz", ".npz"])
def test_attributes_are_stored_bit_by_bit(tmp_path: Path, suffix: str) -> None:
    fields, xyz = attributes(), np.random.default_rng(1).random((N, 3)) * 300 + FAR
    found = write(tmp_path / f"map{suffix}", xyz, fields, FAR)
    if suffix in (".las", ".laz"):
        found["intensity"] = found.pop("intensity_float32")
    for name, array in fields.items():
        assert found[name].dtype == array.dtype
        assert found[name].tobytes() == array.tobytes()
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(
            found[name], xyz[:, axis], rtol=0, atol=5.1e-5 if "la" in suffix else 0
        )


def test_ply_leaves_out_what_it_cannot_store(tmp_path: Path) -> None:
    fields = attributes()
    with pytest.warns(
        UserWarning, match=r"PLY cannot store uint64; the map has no t\. Write PCD, LAZ or NPZ"
    ):
        found = write(tmp_path / "map.ply", np.zeros((N, 3)), fields, np.zeros(3))
    assert found.keys() == fields.keys() - {"t"} | set("xyz")
    assert all(found[name].tobytes() == fields[name].tobytes() for name in fields.keys() - {"t"})


@pytest.mark.parametrize("suffix", [".pcd", ".ply"])
def test_names_that_a_header_cannot_contain_become_plain(tmp_path: Path, suffix: str) -> None:
    fields = {
        name: np.full(N, k, np.uint8)
        for k, name in enumerate(("sun light", "sun_light", "ü", "lidar ü id"))
    }
    found = write(tmp_path / f"map{suffix}", np.zeros((N, 3)), fields, np.zeros(3))
    names = ("sun_light", "sun_light_4", "field", "lidar_id")
    assert [int(found[name][0]) for name in names] == [0, 1, 2, 3]


def test_whole_numbers_use_the_own_intensity_of_las(tmp_path: Path) -> None:
    fields = {"intensity": np.arange(N).astype(np.uint16)}
    found = write(tmp_path / "map.laz", np.zeros((N, 3)), fields, np.zeros(3))
    assert "intensity_uint16" not in found
    np.testing.assert_array_equal(found["intensity"], fields["intensity"])


def test_coordinates_near_zero_are_float32(tmp_path: Path) -> None:
    xyz = np.random.default_rng(1).random((N, 3)).astype(np.float32)
    found = write(tmp_path / "map.pcd", xyz.astype(np.float64), {}, np.zeros(3))
    assert found["x"].dtype == np.float32
    np.testing.assert_array_equal(np.column_stack([found[axis] for axis in "xyz"]), xyz)


def test_tiles_are_named_by_their_corners_in_the_metadata(tmp_path: Path) -> None:
    xyz = np.random.default_rng(2).uniform(-30, 50, (N, 3)) + FAR
    stale = tmp_path / DIVIDED_TILES / "tile_99_99.pcd"
    stale.parent.mkdir()
    stale.touch()
    with divided_map(tmp_path, {"ring": np.dtype("u2")}, FAR) as append:
        for part in (slice(0, 100), slice(100, N)):
            append(xyz[part], {"ring": np.arange(N, dtype=np.uint16)[part]})
    lines = (tmp_path / DIVIDED_METADATA).read_text().splitlines()
    assert lines[:2] == ["x_resolution: 20.0", "y_resolution: 20.0"]
    rings = []
    for line in lines[2:]:
        name, _, corner = line.partition(": ")
        x, y = (float(word) for word in corner.strip("[]").split(","))
        tile = read_fields(tmp_path / DIVIDED_TILES / name)
        assert (
            (tile["x"] >= x) & (tile["x"] < x + 20) & (tile["y"] >= y) & (tile["y"] < y + 20)
        ).all()
        assert {tile[axis].dtype for axis in "xyz"} == {np.dtype(np.float32)}
        local = np.column_stack([tile[axis] for axis in "xyz"])
        np.testing.assert_allclose(local, (xyz - FAR)[tile["ring"]], atol=1e-5)
        rings += tile["ring"].tolist()
    assert sorted(rings) == list(range(N))
    projector = (tmp_path / PROJECTOR).read_text().splitlines()
    assert projector[-1] == "projector_type: Local"
    offset = [float(word) for word in projector[0].split("[")[1].rstrip("]").split(",")]
    np.testing.assert_array_equal(offset, FAR)
    assert not stale.exists()
    assert len(list(stale.parent.iterdir())) == len(lines) - 2


def test_an_unknown_format_is_refused() -> None:
    with pytest.raises(
        UsageError, match=r"map\.xyz: unknown map format\. Give a file that ends in \.las, \.laz"
    ):
        check_map_path(Path("map.xyz"))
