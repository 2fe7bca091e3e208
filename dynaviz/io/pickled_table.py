"""Read tables that pandas pickled, without pandas and without executing what the file contains.

A pickle names functions to call. Here every name stands for a record of the call, so nothing is
imported and nothing runs; columns are then built from the records of arrays.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import pickle
import pickletools
import re
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

Columns = dict[str, NDArray[Any]]

HINT = "Copy the file again, or write it with pandas.DataFrame.to_pickle, text as objects"
LARGEST = 1 << 29  # bytes of a table when unpacked; a frame of 200,000 points has 10 million
_NUMBER = re.compile(r"[fiu][1248]|b1")
_MEMO = ("PUT", "BINPUT", "LONG_BINPUT")


class _Record:
    """What a pickle would have called: its name, arguments and state."""

    origin = ""

    args: tuple[Any, ...]
    state: Any

    def __new__(cls, *args: Any) -> _Record:
        record = super().__new__(cls)
        record.args = args
        record.state = None
        return record

    def __init__(self, *args: Any) -> None:
        """Arguments are kept by ``__new__``, which pickles also call on its own."""

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Recorder(pickle.Unpickler):
    """Makes a record of every name in a pickle."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self._kinds: dict[str, type[_Record]] = {}

    def find_class(self, module: str, name: str) -> type[_Record]:
        if name not in self._kinds:
            self._kinds[name] = type("_Named", (_Record,), {"origin": name})
        return self._kinds[name]

    def persistent_load(self, pid: Any) -> Any:
        raise ValueError("refers to objects outside the file")


def read_pickled_table(path: str | os.PathLike[str]) -> Columns:
    """Read all columns of a pickled ``pandas.DataFrame``, compressed with gzip or not.

    Args:
        path: the file.

    Returns:
        (rows,) arrays by name: numbers in the types of the file, everything else as objects.

    Raises:
        DataError: if the file cannot be read, is corrupt or is not such a table.
    """
    with open_file(path, HINT) as file:
        content = file.read(LARGEST + 1)
    try:
        if content[:2] == b"\x1f\x8b":
            with gzip.GzipFile(fileobj=io.BytesIO(content)) as packed:
                content = packed.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise ValueError(f"larger than {LARGEST >> 20} MB")
        return _columns(_frame(_unpickled(content)))
    except (MemoryError, RecursionError, OSError, EOFError, zlib.error) as error:
        raise DataError(path, f"not a valid table ({str(error)[:80]})", hint=HINT) from None
    except Exception as error:  # a damaged pickle raises many types of errors
        problem = f"not a pickled table of pandas ({str(error)[:80]})"
        raise DataError(path, problem, hint=HINT) from None


def numbers(path: str | os.PathLike[str], table: Columns, names: Sequence[str]) -> Columns:
    """Columns of a table as float64.

    Args:
        path: the file, for error messages.
        table: as ``read_pickled_table`` returns it.
        names: of the columns.

    Raises:
        DataError: if a column is missing or holds something other than finite numbers.
    """
    found = {}
    for name in names:
        column = _column(path, table, name)
        try:
            values = column.astype(np.float64)
        except (ValueError, TypeError, OverflowError):
            raise DataError(path, f"column {name} holds no numbers", hint=HINT) from None
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            problem = f"column {name} holds a number that is not finite"
            raise DataError(path, problem, at=f"row {row}", hint=HINT)
        found[name] = values
    return found


def texts(path: str | os.PathLike[str], table: Columns, name: str) -> list[str]:
    """A column of a table as text.

    Raises:
        DataError: if the column is missing.
    """
    return [str(value) for value in _column(path, table, name).tolist()]


def _column(path: str | os.PathLike[str], table: Columns, name: str) -> NDArray[Any]:
    if name not in table:
        found = " ".join(table)
        raise DataError(path, f"column {name} is missing (found: {found[:120]})", hint=HINT)
    return table[name]


def _unpickled(content: bytes) -> Any:
    """The records of a pickle. Its instructions are checked before they are followed."""
    for instruction, argument, _ in pickletools.genops(content):
        if instruction.name in _MEMO and int(argument or 0) > len(content):
            raise ValueError("a reference beyond the end of the file")
    return _Recorder(io.BytesIO(content)).load()


def _is(value: Any, name: str) -> bool:
    return isinstance(value, _Record) and value.origin == name


def _frame(frame: Any) -> tuple[Any, Any, list[tuple[Any, Any]]]:
    """Column names, row names, and the blocks of columns with their positions."""
    if not _is(frame, "DataFrame"):
        raise ValueError("holds something else")
    state = frame.state
    manager = state.get("_mgr", state.get("_data"))
    if manager.state is not None:  # pandas before 1.3
        parts = manager.state[3]["0.14.1"]
        blocks = [(block["values"], block["mgr_locs"]) for block in parts["blocks"]]
        names, rows = parts["axes"]
    else:
        blocks = [(block.args[0], block.args[1]) for block in manager.args[0]]
        names, rows = manager.args[1]
    return names, rows, blocks


def _columns(frame: tuple[Any, Any, list[tuple[Any, Any]]]) -> Columns:
    """The columns of a table, in its order."""
    axis, rows, blocks = frame
    names = [str(name) for name in _axis(axis)]
    count = len(_axis(rows))
    columns: dict[int, NDArray[Any]] = {}
    for values, place in blocks:
        array = _array(values)
        positions = _positions(place, len(names))
        if array.shape != (len(positions), count):
            raise ValueError(f"{array.shape} values for {len(positions)} columns, {count} rows")
        columns |= dict(zip(positions, array, strict=True))
    if sorted(columns) != list(range(len(names))) or len(set(names)) != len(names):
        raise ValueError("its columns do not match their names")
    return {name: columns[position] for position, name in enumerate(names)}


def _axis(index: Any) -> Sequence[Any]:
    """The names of columns, or of rows."""
    if not _is(index, "_new_Index"):
        raise ValueError("names of another kind")
    facts = index.args[1]
    if "data" in facts:
        names: list[Any] = _array(facts["data"]).tolist()
        return names
    return range(int(facts["start"]), int(facts["stop"]), int(facts["step"]))


def _positions(place: Any, columns: int) -> list[int]:
    """The positions of the columns of a block."""
    if _is(place, "BlockPlacement"):
        place = place.args[0]
    if _is(place, "slice"):
        return list(range(columns))[slice(*place.args)]
    return [int(position) for position in _array(place).tolist()]


def _array(record: Any) -> NDArray[Any]:
    """The array of a record, without a copy of its bytes."""
    if _is(record, "_frombuffer"):
        content, kind, shape, order = record.args
    elif _is(record, "_reconstruct"):
        _, shape, kind, fortran, content = record.state
        order = "F" if fortran else "C"
    else:
        kind = getattr(record, "origin", type(record).__name__)
        raise ValueError(f"values of the type {kind}, which only pandas reads")
    shape = tuple(int(size) for size in shape)
    dtype = _dtype(kind)
    if isinstance(content, list):
        if not dtype.hasobject or len(content) != math.prod(shape):
            raise ValueError("values that do not match their number")
        flat = np.empty(len(content), object)
        flat[:] = [_value(value) for value in content]
    else:
        if dtype.hasobject:
            raise ValueError("objects in bytes")
        flat = np.frombuffer(content, dtype)
    return flat.reshape(shape, order=order)


def _dtype(record: Any) -> np.dtype[Any]:
    """A type of numbers, or of objects."""
    code = str(record.args[0])
    if code.startswith("O"):
        return np.dtype(object)
    if not _is(record, "dtype") or not _NUMBER.fullmatch(code):
        raise ValueError(f"values of the type {code[:20]}")
    order = record.state[1] if record.state else "="
    return np.dtype(f"{order}{code}" if order in ("<", ">") else code)


def _value(value: Any) -> Any:
    """A value of a column of objects: text, a number, a truth value, or None."""
    if _is(value, "scalar"):  # of NumPy
        return np.frombuffer(value.args[1], _dtype(value.args[0]))[0].item()
    if isinstance(value, str | int | float | bool | None):
        return value
    raise ValueError(f"a value of the type {type(value).__name__}")
