"""Files are written completely or not at all, and unrelated errors are passed on."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from dynaviz.errors import DataError
from dynaviz.io.atomic import atomic_file, open_file, write_atomic


def test_the_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "a.txt"
    with atomic_file(path) as temporary:
        temporary.write_text("content")
        assert not path.exists()
    assert path.read_text() == "content"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", b"old")

    def fail() -> None:
        with atomic_file(tmp_path / "a.txt") as temporary:
            temporary.write_text("half")
            raise KeyError("why")

    with pytest.raises(KeyError):
        fail()
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    def fill() -> None:
        with atomic_file(tmp_path / "a.txt"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(DataError, match=r"a\.txt: cannot be written \(No space left"):
        fill()


def test_a_parent_that_is_a_file_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_atomic(tmp_path / "file" / "a.txt", b"")


def test_a_folder_at_the_path_is_reported(tmp_path: Path) -> None:
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(DataError, match="cannot be written"):
        write_atomic(tmp_path / "a.txt", b"")


def test_a_read_error_in_the_body_is_passed_on(tmp_path: Path) -> None:
    def read_inside() -> None:
        with atomic_file(tmp_path / "a.txt"):
            (tmp_path / "input.txt").read_text()

    with pytest.raises(FileNotFoundError, match=r"input\.txt"):
        read_inside()
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_opened_is_reported(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none: cannot be read .* Give a file"):
        open_file(tmp_path / "none", "Give a file").__enter__()
