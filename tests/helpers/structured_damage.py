"""Damage that keeps the structure of a file.

Values of another type or size in its records, tables, headers and chunks.

Random bytes rarely get past the parser of a format; these changes test what comes after it.
"""

from __future__ import annotations

import copy
import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from helpers.damage import messages, recording_of

TEXTS = (
    "",
    "nan",
    "-inf",
    "1e999",
    "-1",
    "0",
    "9" * 30,
    "9" * 5000,
    "x" * 5000,
    "\x00",
    "ü",
    "../x",
    "true",
    "0x10",
    "1_0",
)
ENCODINGS = (
    "utf-16",
    "utf-7",
    "martian",
    "idna",
    "base64",
    "latin-1",
    "cp037",
    "utf-32",
    "ascii",
    "",
)
VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        0,
        -1,
        10**400,
        1 << 63,
        -(1 << 63) - 1,
        1 << 31,
        0.5,
        1e308,
        float("nan"),
        float("inf"),
        [],
        {},
    ),
    *([1], [[]], {"a": 1}, [None] * 4, [10**400] * 3, [float("nan")] * 4, [1e308] * 3, *TEXTS),
)
DOUBLES = (float("nan"), float("inf"), -1e308, 1e300, 1e-320, 0.0, -1.0, 1e19)


def json_values(content: bytes, random: Random) -> bytes:
    """Replace, remove or repeat a value anywhere in the tree."""
    try:
        tree = json.loads(content)
    except ValueError:
        return words(content, random)
    places: list[tuple[Any, Any]] = []

    def visit(node: Any) -> None:
        pairs = (
            node.items()
            if isinstance(node, dict)
            else enumerate(node)
            if isinstance(node, list)
            else ()
        )
        for key, value in pairs:
            places.append((node, key))
            visit(value)

    visit(tree)
    if not places or random.random() < 0.02:
        return json.dumps(random.choice(VALUES)).encode()
    node, key = random.choice(places)
    change = random.random()
    if change < 0.75:
        node[key] = random.choice(VALUES)
    elif change < 0.85:
        del node[key]
    elif change < 0.95:
        other, there = random.choice(places)
        node[key] = copy.deepcopy(other[there]) if isinstance(other, dict) else 0
    elif isinstance(node, list):
        node.append(node[key])
    return json.dumps(tree).encode()


def xml_values(content: bytes, random: Random) -> bytes:
    """Change the encoding, the text of an element, a tag, or the order of elements."""
    text = content.decode("latin-1")
    change = random.random()
    if change < 0.2:
        head = (
            f'<?xml version="{random.choice(["1.0", "1.1", "9"])}" '
            f'encoding="{random.choice(ENCODINGS)}"?>'
        )
        return re.sub(r"<\?xml.*?\?>", "", text, count=1).join((head, "")).encode("latin-1")
    pattern = r"(?<=>)[^<>]*(?=<)" if change < 0.8 else r"</?\w+"
    found = random.choice(list(re.finditer(pattern, text)))
    new = (
        random.choice(TEXTS)
        if change < 0.8
        else random.choice(["<item", "</item", "<!--", "<![CDATA[", "<count", ""])
    )
    return (text[: found.start()] + new + text[found.end() :]).encode("utf-8", "replace")


def words(content: bytes, random: Random) -> bytes:
    """Replace a word of a text, or of the header of a binary file."""
    found = list(re.finditer(rb"[^\s,;:=\"']+", content[:4000]))
    if not found:
        return random.choice(TEXTS).encode()
    place = random.choice(found)
    new = random.choice(TEXTS).encode() if random.random() < 0.7 else random.choice(found)[0]
    return content[: place.start()] + new + content[place.end() :]


def numbers(content: bytes, random: Random) -> bytes:
    """Overwrite an aligned number."""
    width, form, choices = random.choice([
        (8, "<d", DOUBLES), (4, "<f", (float("nan"), float("inf"), -3e38, 1e-40)),
        (8, "<Q", (0, 1, 1 << 31, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)),
        (4, "<I", (0, 1, 1 << 24, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)),
        (2, "<H", (0, 1, 0x7FFF, 0xFFFF)),
    ])  # fmt: skip
    near = random.random() < 0.5
    at = random.randrange(max(1, min(len(content), 400) if near else len(content)))
    at -= at % random.choice([1, 2, width])
    return content[:at] + struct.pack(form, random.choice(choices)) + content[at + width :]


def arrow_columns(content: bytes, random: Random) -> bytes:
    """Change the type or the values of a column of a Feather file, or leave it out."""
    import pyarrow as pa
    from pyarrow import feather

    table = feather.read_table(pa.BufferReader(content))
    k = random.randrange(table.num_columns)
    name, rows = table.column_names[k], table.num_rows
    new: list[Any] = [
        [float("nan")] * rows, [1e308] * rows, [1 << 62] * rows, [-1] * rows, [None] * rows,
        ["x"] * rows,
        [b"x"] * rows, [[1]] * rows, [{"a": 1}] * rows, [True] * rows, ["9" * 3000] * rows,
        [0] * rows,
    ]  # fmt: skip
    change = random.random()
    if change < 0.1:
        table = table.remove_column(k)
    elif change < 0.2:
        table = table.slice(0, random.choice([0, 1]))
    elif change < 0.3:
        table = table.rename_columns(
            [random.choice(table.column_names) if n == name else n for n in table.column_names]
        )
    else:
        values, kept = random.choice(new), table[name].to_pylist()
        one = random.random() < 0.5 and rows
        try:
            column = pa.array([*kept[:-1], values[-1]] if one else values)
        except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError):
            column = pa.array(values)
        table = table.set_column(k, name, column)
    out = io.BytesIO()
    feather.write_feather(table, out)
    return out.getvalue()


def arrays(content: bytes, random: Random) -> bytes:
    """Change the shape, type or values of an array of an NPZ or NPY file, or leave it out."""
    loaded = np.load(io.BytesIO(content), allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        out = io.BytesIO()
        np.save(out, _changed(loaded, random))
        return out.getvalue()
    entries = {name: loaded[name] for name in loaded.files}
    name = random.choice(list(entries))
    if random.random() < 0.1:
        del entries[name]
    else:
        entries[name] = _changed(entries[name], random)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for key, array in entries.items():
            with archive.open(f"{key}.npy", "w") as file:
                np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    return out.getvalue()


def _changed(array: np.ndarray[Any, Any], random: Random) -> np.ndarray[Any, Any]:
    changes: list[Callable[[], Any]] = [
        lambda: array[:-1] if array.ndim else array,
        lambda: np.concatenate([array, array]) if array.ndim else array,
        lambda: array[None],
        lambda: np.full(array.shape, -1),
        lambda: np.full(array.shape, np.nan),
        lambda: np.full(array.shape, (1 << 64) - 1, np.uint64),
        lambda: np.full(array.shape, 1e308),
        lambda: np.full(array.shape, "x" * 20),
        lambda: np.full(array.shape, 1 + 1j),
        lambda: np.zeros(array.shape, "datetime64[ns]"),
        lambda: np.zeros(array.shape, [("a", "f4")]),
        lambda: np.zeros(0),
        lambda: array.astype(bool) if array.dtype.kind in "iufb" else array,
    ]
    return np.asarray(random.choice(changes)())


def recording_chunks(content: bytes, random: Random) -> bytes:
    """Damage, remove, repeat or exchange chunks; sizes of messages stay right."""
    parts = messages(content)
    k, other = random.randrange(len(parts)), random.randrange(len(parts))
    kind, part = parts[k]
    change = random.random()
    if change < 0.45:
        damaged = bytearray(part)
        for _ in range(random.choice([1, 1, 2, 8])):
            damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
        parts[k] = kind, bytes(damaged)
    elif change < 0.75:
        parts[k] = kind, numbers(part, random)
    elif change < 0.8:
        parts[k] = kind, part[: random.randrange(len(part) + 1)]
    elif change < 0.85:
        del parts[k]
    elif change < 0.9:
        parts.insert(other, parts[k])
    elif change < 0.95:
        parts[k], parts[other] = parts[other], parts[k]
    else:
        return numbers(content, random)
    return recording_of(content, parts)


BY_SUFFIX: dict[str, tuple[Callable[[bytes, Random], bytes], ...]] = {
    ".json": (json_values,),
    ".xml": (xml_values,),
    ".feather": (arrow_columns, arrow_columns, numbers),
    ".npz": (arrays, arrays, numbers),
    ".npy": (arrays, numbers),
    ".rrd": (recording_chunks,),
    **dict.fromkeys((".bag", ".db3", ".mcap", ".las", ".laz", ".bin"), (numbers,)),
    **dict.fromkeys((".pcd", ".ply"), (words, words, numbers)),
}


def damaged_structure(path: Path, content: bytes, random: Random) -> bytes:
    """The content of a file after a change that suits its format.

    Anything else is treated as text.
    """
    change = random.choice(BY_SUFFIX.get(path.suffix, (words,)))
    return change(content, random)
