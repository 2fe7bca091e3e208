"""PCD files: written data are read back, other tools agree, and corrupt files are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.pcd_files import write_encoded
from helpers.resource_limits import files_end_at
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynaviz import kernels
from dynaviz.errors import DataError
from dynaviz.io.pcd import ENCODINGS, PcdWriter, read_header, read_pcd, write_pcd

pytestmark = pytest.mark.boundscheck

KINDS = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
in_one_folder = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@st.composite
def clouds(draw: st.DrawFn) -> dict[str, Any]:
    names = draw(
        st.lists(
            st.sampled_from(["x", "y", "z", "intensity", "rgb", "label", "t"]),
            min_size=1,
            unique=True,
        )
    )
    n = draw(st.integers(0, 40))
    kind = st.sampled_from(KINDS).map(np.dtype)
    shape = st.sampled_from([(n,), (n, 2), (n, 5)])
    return {name: draw(hnp.arrays(draw(kind), draw(shape))) for name in names}


def cloud(n: int = 50, seed: int = 0) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    xyz = random.normal(scale=20, size=(n, 3)).astype(np.float32)
    return {
        **dict(zip("xyz", xyz.T, strict=True)),
        "label": (random.random(n) < 0.1).astype(np.uint8),
    }


def pose() -> Any:
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T_world_sensor[:3, 3] = 1.25, -2.5, 3.0
    return T_world_sensor


def text(head: str, body: bytes = b"") -> bytes:
    return head.encode() + body


PLAIN = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n"
)


@in_one_folder
@given(clouds(), st.sampled_from(ENCODINGS))
def test_every_layout_is_read_back_unchanged(
    tmp_path: Path, fields: dict[str, Any], data: str
) -> None:
    path = tmp_path / "a.pcd"
    write_encoded(path, fields, data=data)
    back = read_pcd(path)
    assert back.header.data == data
    assert back.T_world_sensor is None
    assert [field.name for field in back.header.fields] == list(fields)
    for name, array in fields.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)


@pytest.mark.plain
@given(st.data())
def test_lzf_repeats_earlier_bytes(draw: st.DataObject) -> None:
    packed, content = b"", b""
    for _ in range(draw.draw(st.integers(1, 20))):
        run = draw.draw(st.binary(min_size=1, max_size=32))
        packed, content = packed + bytes([len(run) - 1]) + run, content + run
        length, back = (
            draw.draw(st.integers(3, 264)),
            draw.draw(st.integers(0, min(len(content), 1 << 13) - 1)),
        )
        for _ in range(length):
            content += content[-1 - back :][:1]
        first, more = min(length - 2, 7) << 5 | back >> 8, [length - 9] if length > 8 else []
        packed += bytes([first, *more, back & 255])
    out = np.empty(len(content), np.uint8)
    assert (
        kernels.lzf.decompress(kernels.as_readonly(np.frombuffer(packed, np.uint8), np.uint8), out)
        == -1
    )
    assert out.tobytes() == content


def test_open3d_reads_our_files(tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d")
    path, fields = tmp_path / "a.pcd", cloud()
    write_pcd(path, fields, pose())
    theirs = np.asarray(open3d.io.read_point_cloud(str(path)).points)
    np.testing.assert_array_equal(theirs.astype(np.float32), read_pcd(path).xyz)


@pytest.mark.parametrize(("ascii", "compressed"), [(True, False), (False, False), (False, True)])
def test_we_read_files_of_open3d(tmp_path: Path, ascii: bool, compressed: bool) -> None:
    open3d = pytest.importorskip("open3d")
    points = np.random.default_rng(3).normal(size=(500, 3))
    points[100:200] = 1.0  # something to compress
    path = tmp_path / "a.pcd"
    theirs = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    open3d.io.write_point_cloud(str(path), theirs, write_ascii=ascii, compressed=compressed)
    np.testing.assert_allclose(read_pcd(path).xyz, points, atol=1e-6)


def test_the_viewpoint_is_the_pose(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", cloud(), pose())
    np.testing.assert_allclose(read_pcd(tmp_path / "a.pcd").T_world_sensor, pose(), atol=1e-15)  # type: ignore[arg-type]


def test_xyz_is_float32_in_any_order_and_type(tmp_path: Path) -> None:
    fields = {
        "z": np.array([3, 6], np.int32),
        "x": np.array([1.0, 4.0]),
        "y": np.array([2, 5], np.float32),
    }
    write_pcd(tmp_path / "a.pcd", fields)
    xyz = read_pcd(tmp_path / "a.pcd").xyz
    np.testing.assert_array_equal(xyz, [[1, 2, 3], [4, 5, 6]])
    assert xyz.dtype == np.float32
    assert xyz.flags.c_contiguous


@pytest.mark.parametrize("data", ENCODINGS)
@pytest.mark.parametrize("rows", [(0, 50), (7, 9), (40, 90), (9, 7), (50, 60)])
def test_a_slice_equals_the_rows_of_the_file(
    tmp_path: Path, data: str, rows: tuple[int, int]
) -> None:
    write_encoded(tmp_path / "a.pcd", cloud(), data=data)
    part, whole = read_pcd(tmp_path / "a.pcd", rows), read_pcd(tmp_path / "a.pcd")
    np.testing.assert_array_equal(part.xyz, whole.xyz[slice(*rows)])
    assert part.header.points == 50


def test_an_old_header_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(
        b"# 0.5\nCOLUMNS x y z\nPOINTS 2\nDATA ascii\n1 2 3\n\n4 5 6\n"
    )
    pcd = read_pcd(tmp_path / "a.pcd")
    np.testing.assert_array_equal(pcd.xyz, [[1, 2, 3], [4, 5, 6]])
    assert pcd.T_world_sensor is None


def test_padding_has_no_name(tmp_path: Path) -> None:
    head = (
        "FIELDS x _ y\nSIZE 4 1 4\nTYPE F U F\nCOUNT 1 4 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA "
        "binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(text(head, np.arange(6, dtype="<f4").tobytes()))
    pcd = read_pcd(tmp_path / "a.pcd")
    assert "_" not in pcd
    np.testing.assert_array_equal(pcd["y"], [2, 5])


def test_the_writer_counts_points(tmp_path: Path) -> None:
    path, fields = tmp_path / "a.pcd", cloud(20)
    with PcdWriter(path, {name: array.dtype for name, array in fields.items()}, pose()) as writer:
        for rows in (slice(0, 5), slice(5, 5), slice(5, 20)):
            writer.append(**{name: array[rows] for name, array in fields.items()})
        assert not path.exists()
    write_pcd(tmp_path / "at_once.pcd", fields, pose())
    assert path.read_bytes() == (tmp_path / "at_once.pcd").read_bytes()


def test_nothing_appears_when_the_writer_fails(tmp_path: Path) -> None:
    def write() -> None:
        with PcdWriter(tmp_path / "a.pcd", {"x": "f4"}) as writer:
            writer.append(x=np.zeros(3, np.float32))
            raise RuntimeError("in between")

    with pytest.raises(RuntimeError, match="in between"):
        write()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("piecewise", [False, True])
def test_a_full_disk_is_reported_and_no_file_is_left(tmp_path: Path, piecewise: bool) -> None:
    x = np.zeros(1_000_000, np.float32)

    def write() -> None:
        if not piecewise:
            return write_pcd(tmp_path / "a.pcd", {"x": x})
        with PcdWriter(tmp_path / "a.pcd", {"x": "f4"}) as writer:
            for part in np.split(x, 1000):
                writer.append(x=part)

    with (
        files_end_at(1_000_000),
        pytest.raises(DataError, match=r"a\.pcd: cannot be written \(File too large\)"),
    ):
        write()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "fields",
    [{}, {"x "
    "y": np.zeros(1)}, {"_": np.zeros(1)}, {"x": np.zeros(1, "f2")}, {"x": np.zeros((1, 2, 2))},
     {"x": np.zeros(1), "y": np.zeros(2)}, {"x": np.array(["a"])}],
)  # fmt: skip
def test_unsupported_fields_are_refused(tmp_path: Path, fields: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="field"):
        write_pcd(tmp_path / "a.pcd", fields)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "place", "message"),
    [
        (b"", "line 1", "not a PCD file"),
        (b"hello world\n", "line 1", "HELLO"),
        (text(PLAIN), "line 9", "truncated in the header"),
        (text(PLAIN + "DATA binary\n", bytes(23)), "byte 97", "too short"),
        (text(PLAIN + "DATA zip\n"), "line 9", "DATA zip"),
        (text(PLAIN + "DATA ascii\n1 2 3\n4 5 monkey\n"), "line 11", "monkey"),
        (text(PLAIN + "DATA ascii\n1 2 3\n4 5\n 6"), "line 11", "2 were found"),
        (text(PLAIN + "DATA ascii\n100.0 200.0 300.0\n"), "end of file", "contains 1 points"),
        (text(PLAIN.replace("POINTS 2", "POINTS 3") + "DATA ascii\n"), "line 8", "WIDTH x HEIGHT"),
        (text(PLAIN.replace("SIZE 4 4 4", "SIZE 4 4") + "DATA ascii\n"), "line 3", "SIZE 4 4"),
        (text(PLAIN.replace("SIZE 4 4 4", "SIZE 4 4 2") + "DATA ascii\n"), "line 3", "'z'"),
        (text(PLAIN.replace("TYPE F F F", "TYPE F F Q") + "DATA ascii\n"), "line 4", "TYPE F F Q"),
        (
            text(PLAIN.replace("COUNT 1 1 1", "COUNT 1 1 99999999") + "DATA binary\n"),
            "line 2",
            "1 MiB",
        ),
        (text(PLAIN.replace("WIDTH 2", "WIDTH two") + "DATA binary\n"), "line 6", "WIDTH two"),
        (text(PLAIN.replace("2\n", "9" * 15 + "\n") + "DATA binary\n"), "byte", "too short"),
        (text(PLAIN + "VIEWPOINT 0 0 0\nDATA binary\n"), "line 9", "VIEWPOINT"),
        (
            text(PLAIN + "DATA binary_compressed\n", b"\1\0\0\0\377\0\0\0."),
            "byte 108",
            "inconsistent size",
        ),
        (
            text(PLAIN + "DATA binary_compressed\n", b"\3\0\0\0\30\0\0\0\377\377\377"),
            "byte 116",
            "corrupt",
        ),
    ],
)
def test_a_corrupt_file_is_reported_with_the_place(
    tmp_path: Path, content: bytes, place: str, message: str
) -> None:
    path = tmp_path / "bad.pcd"
    path.write_bytes(content)
    with pytest.raises(DataError) as caught:
        read_pcd(path)
    assert str(caught.value).startswith(f"{path}, {place}")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "view", ["1 2 3 0 0 0 0", "1 2 3 1e-9 0 0 0", "1 2 3 1e300 1 1 1", "1 2 nan 1 0 0 0"]
)
def test_a_viewpoint_without_rotation_is_no_pose(tmp_path: Path, view: str) -> None:
    (tmp_path / "a.pcd").write_bytes(text(PLAIN + f"VIEWPOINT {view}\nDATA binary\n", bytes(24)))
    pcd = read_pcd(tmp_path / "a.pcd")
    assert len(pcd.xyz) == 2
    with pytest.raises(DataError, match="quaternion"):
        _ = pcd.T_world_sensor


def test_a_missing_field_is_reported(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", {"x": np.zeros(2), "u": np.zeros(2)})
    with pytest.raises(DataError, match="field 'y' is missing \\(found: x u\\)"):
        _ = read_pcd(tmp_path / "a.pcd").xyz


def test_a_missing_file_and_a_folder_are_reported(tmp_path: Path) -> None:
    for path in (tmp_path / "none.pcd", tmp_path):
        with pytest.raises(DataError, match="cannot be read"):
            read_header(path)


def complete_or_refused(path: Path) -> None:
    """Reading either returns all points or raises a DataError that names the file."""
    refused = None
    try:
        pcd = read_pcd(path)
        _ = pcd.xyz, pcd.T_world_sensor
    except DataError as error:
        refused = error
    if refused is None:
        assert len(pcd) == pcd.header.points
    else:
        assert refused.path == str(path)
        assert len(str(refused)) < 600


@in_one_folder
@given(st.sampled_from(ENCODINGS), st.data())
def test_one_changed_byte_is_read_or_refused(
    tmp_path: Path, data: str, draw: st.DataObject
) -> None:
    path = tmp_path / "a.pcd"
    write_encoded(path, cloud(20), pose(), data)
    content = bytearray(path.read_bytes())
    place = draw.draw(st.integers(0, len(content) - 1))
    content[place] = draw.draw(st.integers(0, 255) | st.sampled_from(b"0123456789 \n-.#FIU"))
    path.write_bytes(content)
    complete_or_refused(path)


@in_one_folder
@given(st.sampled_from(ENCODINGS), st.data())
def test_a_file_truncated_anywhere_is_refused(
    tmp_path: Path, data: str, draw: st.DataObject
) -> None:
    path = tmp_path / "a.pcd"
    write_encoded(path, cloud(20), pose(), data)
    content = path.read_bytes()
    path.write_bytes(content[: draw.draw(st.integers(0, len(content) - 1))])
    if data == "ascii":  # a lost digit of the last number goes unnoticed
        complete_or_refused(path)
    else:
        with pytest.raises(DataError):
            read_pcd(path)
