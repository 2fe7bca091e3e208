"""Streaming the records of a JSON table gives the same as json.load, for any chunk size."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynaviz.errors import DataError
from dynaviz.io import records
from dynaviz.io.records import read_records

value = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=4,
)


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.lists(st.dictionaries(st.text(), value, max_size=4), max_size=5),
    st.integers(1, 40),
    st.booleans(),
)
def test_records_equal_json_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: list[Any], chunk: int, plain: bool
) -> None:
    monkeypatch.setattr(records, "_CHUNK", chunk)
    path = tmp_path / "table.json"
    path.write_text(
        json.dumps(rows, indent=None if plain else 1, ensure_ascii=plain),
        encoding="utf-8",
        errors="replace",
    )
    assert list(read_records(path)) == json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("content", "number"),
    [
        (b"", 0),
        (b"{}", 0),
        (b"[", 0),
        (b"[1]", 0),
        (b'[{"a": 1}', 1),
        (b'[{"a": 1} {}]', 1),
        (b'[{"a": 1},', 1),
        (b'[{"a": 1},]', 1),
        (b'[{"a": 1}, {"a": tru', 1),
        (b'[{"a": "\xff"}]', 0),
    ],
)
def test_an_invalid_list_is_reported_with_the_record(
    tmp_path: Path, content: bytes, number: int
) -> None:
    path = tmp_path / "table.json"
    path.write_bytes(content)
    with pytest.raises(
        DataError, match=rf"table\.json, record {number}: not a valid list of records"
    ):
        list(read_records(path))


def test_a_record_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "_CHUNK", 10)
    monkeypatch.setattr(records, "_MAX_RECORD", 50)
    path = tmp_path / "table.json"
    path.write_text('[{"a": "' + "x" * 1000)
    with pytest.raises(DataError, match="record 0"):
        list(read_records(path))
