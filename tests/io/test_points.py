"""Point clouds in other formats, as written by independent programs; corrupt files are refused."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynaviz.errors import DataError, MissingDependency
from dynaviz.io.fields import read_points
from dynaviz.io.pcd import write_pcd

XYZ = np.random.default_rng(0).normal(scale=30, size=(500, 3)).astype(np.float32)


def ply(
    path: Path, order: str, kind: str, rows: np.ndarray, before: bytes = b"", after: bytes = b""
) -> Path:
    """Write a file with intensities between the coordinates.

    ``before`` and ``after`` are extra header lines.
    """
    form = {"<": "binary_little_endian", ">": "binary_big_endian", "=": "ascii"}[order]
    head = f"ply\nformat {form} 1.0\ncomment x y z\n".encode() + before
    head += f"element vertex {len(rows)}\n".encode()
    head += b"".join(f"property {kind} {name}\n".encode() for name in ("x", "intensity", "y", "z"))
    head += after + b"end_header\n"
    four = rows[:, [0, 0, 1, 2]]
    if order == "=":
        body = b"".join(b" ".join(repr(float(v)).encode() for v in row) + b"\n" for row in four)
    else:
        body = four.astype(order + {"float": "f4", "double": "f8"}[kind]).tobytes()
    path.write_bytes(head + body)
    return path


@pytest.mark.parametrize("ascii_", [True, False])
def test_ply_written_by_open3d(tmp_path: Path, ascii_: bool) -> None:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(XYZ.astype(np.float64)))
    cloud.colors = o3d.utility.Vector3dVector(np.full((len(XYZ), 3), 0.5))
    o3d.io.write_point_cloud(str(tmp_path / "a.ply"), cloud, write_ascii=ascii_)
    np.testing.assert_allclose(read_points(tmp_path / "a.ply"), XYZ, rtol=1e-5 if ascii_ else 0)


def test_the_vertices_of_a_mesh(tmp_path: Path) -> None:
    import open3d as o3d

    box = o3d.geometry.TriangleMesh.create_box(1, 2, 3)
    for ascii_ in (True, False):
        o3d.io.write_triangle_mesh(str(tmp_path / "a.ply"), box, write_ascii=ascii_)
        np.testing.assert_array_equal(
            read_points(tmp_path / "a.ply"), np.asarray(box.vertices, np.float32)
        )


@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    hnp.arrays(np.float32, st.tuples(st.integers(0, 9), st.just(3)), elements=st.floats(width=32)),
    st.sampled_from("<>="),
    st.sampled_from(["float", "double"]),
)
def test_every_order_and_precision_of_ply(
    tmp_path: Path, rows: np.ndarray, order: str, kind: str
) -> None:
    np.testing.assert_array_equal(read_points(ply(tmp_path / "a.ply", order, kind, rows)), rows)


def test_open3d_agrees_on_big_endian_ply(tmp_path: Path) -> None:
    import open3d as o3d

    path = ply(tmp_path / "a.ply", ">", "float", XYZ)
    np.testing.assert_array_equal(
        np.asarray(o3d.io.read_point_cloud(str(path)).points), read_points(path)
    )


def test_elements_before_the_vertices_of_ply_are_skipped(tmp_path: Path) -> None:
    head = b"element camera 2\nproperty uchar k\nproperty float f\n"
    body = {"<": b"\x01....\x02....", "=": b"1 0.5\n2 0.5\n"}
    for order, content in body.items():
        path = ply(tmp_path / "a.ply", order, "float", XYZ[:7], before=head)
        path.write_bytes(path.read_bytes().replace(b"end_header\n", b"end_header\n" + content))
        np.testing.assert_array_equal(read_points(path), XYZ[:7])


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_scale_and_offset_of_las(tmp_path: Path, suffix: str) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.offsets, header.scales = [100, -200, 5], [0.001, 0.002, 0.01]
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.add(XYZ, [100.0, -200.0, 5.0]).T
    las.write(tmp_path / f"a.{suffix}")
    found = read_points(tmp_path / f"a.{suffix}") - [100, -200, 5]
    assert (np.abs(found - XYZ) <= np.array([0.001, 0.002, 0.01]) / 2 + 2e-5).all()
    whole = (tmp_path / f"a.{suffix}").read_bytes()
    for size in (0, 100, 300, len(whole) // 2):
        (tmp_path / f"b.{suffix}").write_bytes(whole[:size])
        with pytest.raises(DataError, match=rf"b\.{suffix}"):
            read_points(tmp_path / f"b.{suffix}")


def test_las_without_laspy_names_the_package_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingDependency, match=r"pip install 'laspy\[lazrs\]'"):
        read_points(tmp_path / "a.las")


def test_pcd_and_npy(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.PCD", dict(zip("xyz", XYZ.T, strict=True)))
    np.save(tmp_path / "a.npy", np.c_[XYZ.astype(np.float64), np.ones(len(XYZ))])
    for name in ("a.PCD", "a.npy"):
        np.testing.assert_array_equal(read_points(tmp_path / name), XYZ)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def _replace(old: bytes, new: bytes) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        content = path.read_bytes()
        assert old in content
        path.write_bytes(content.replace(old, new))

    return change


@pytest.mark.parametrize(
    ("order", "damage", "message"),
    [
        ("<", _cut, r"byte \d+: file is too short: 500 vertices need 8000 bytes, 7995 are left"),
        ("=", lambda path: path.write_bytes(path.read_bytes()[:-40]), "line 509: cannot be read"),
        (
            "=",
            _replace(b"vertex 500", b"vertex 501"),
            "contains 500 vertices, but the header states 501",
        ),
        ("=", _replace(b"vertex 500", b"vertex 99999999999999999999"), "line 4.*is not valid PLY"),
        ("=", _replace(b"vertex 500", b"vertex -1"), "line 4"),
        ("<", _replace(b"ply\n", b"plx\n"), "line 1: not a PLY file"),
        ("<", _replace(b"property float z", b"property float w"), "the vertices have no z"),
        ("<", _replace(b"property float z", b"property float x"), "duplicate names"),
        ("<", _replace(b"property float z", b"property half z"), "line 8"),
        ("<", _replace(b"property float z", b"property list uchar float z"), "list properties"),
        ("<", _replace(b"element vertex", b"element corner"), "no element 'vertex'"),
        ("<", _replace(b"binary_little_endian", b"binary"), "line 2"),
        ("<", _replace(b"element", b"property float x\nelement"), "line 4"),
        ("<", _replace(b"end_header\n", b""), "line|header"),
    ],
)
def test_corrupt_ply_is_refused(
    tmp_path: Path, order: str, damage: Callable[[Path], None], message: str
) -> None:
    path = ply(tmp_path / "a.ply", order, "float", XYZ)
    damage(path)
    with pytest.raises(DataError, match=message):
        read_points(path)


def test_invalid_arrays_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    for array in (np.zeros(6), np.zeros((4, 2)), np.zeros((4, 3), complex), np.zeros((4, 3), "U2")):
        np.save(path, array)
        with pytest.raises(DataError, match="not \\(N, 3 or more\\) numbers"):
            read_points(path)
    np.save(path, np.array([None, 1]), allow_pickle=True)
    with pytest.raises(DataError, match="not a valid NPY file"):
        read_points(path)
    np.save(path, XYZ)
    for size in (0, 20, 200):
        path.write_bytes(path.read_bytes()[:size])
        with pytest.raises(DataError, match=r"a\.npy"):
            read_points(path)


@pytest.mark.parametrize(
    ("arrays", "found"),
    [
        ({"a": XYZ, "normals": XYZ}, "2 arrays"),
        ({"a": XYZ[:, :2], "normals": XYZ.astype("U9")}, "no arrays"),
    ],
)
def test_an_archive_must_tell_which_array_is_the_cloud(
    tmp_path: Path, arrays: dict[str, np.ndarray], found: str
) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(
        DataError,
        match=rf"a\.npz.*contains {found} \(N, 3 or more\) of numbers, and none named points",
    ):
        read_points(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", xyz=XYZ + 1, **arrays)
    np.testing.assert_array_equal(read_points(tmp_path / "a.npz"), XYZ + 1)


def test_an_unknown_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        DataError,
        match=r"a\.obj: unknown point cloud format.*\.las, \.laz, \.npy, \.npz, \.pcd, \.ply",
    ):
        read_points(tmp_path / "a.obj")


@pytest.mark.parametrize("suffix", ["pcd", "ply", "npy", "las"])
def test_a_missing_file_is_reported(tmp_path: Path, suffix: str) -> None:
    if suffix == "las":
        pytest.importorskip("laspy")
    with pytest.raises(DataError, match=r"absent.*cannot be read"):
        read_points(tmp_path / f"absent.{suffix}")
