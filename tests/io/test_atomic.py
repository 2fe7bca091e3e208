"""Files appear whole or not at all, and errors keep their meaning."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from dynaviz.errors import DataError
from dynaviz.io.atomic import opened, whole_file, write_whole


def test_the_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "a.txt"
    with whole_file(path) as beside:
        beside.write_text("content")
        assert not path.exists()
    assert path.read_text() == "content"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    write_whole(tmp_path / "a.txt", b"old")

    def fail() -> None:
        with whole_file(tmp_path / "a.txt") as beside:
            beside.write_text("half")
            raise KeyError("why")

    with pytest.raises(KeyError):
        fail()
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


def test_a_full_disk_is_told(tmp_path: Path) -> None:
    def fill() -> None:
        with whole_file(tmp_path / "a.txt"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(DataError, match=r"a\.txt: cannot be written \(No space left"):
        fill()


def test_a_folder_that_is_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_whole(tmp_path / "file" / "a.txt", b"")


def test_a_folder_in_the_files_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(DataError, match="cannot be written"):
        write_whole(tmp_path / "a.txt", b"")


def test_a_read_error_in_the_body_stays_what_it_is(tmp_path: Path) -> None:
    def read_inside() -> None:
        with whole_file(tmp_path / "a.txt"):
            (tmp_path / "input.txt").read_text()

    with pytest.raises(FileNotFoundError, match=r"input\.txt"):
        read_inside()
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_opened_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none: cannot be read .* Give a file"):
        opened(tmp_path / "none", "Give a file").__enter__()
