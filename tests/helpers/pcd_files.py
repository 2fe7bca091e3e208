"""PCD files in the encodings that dynaviz reads and does not write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.io.pcd import read_pcd, write_pcd

RUN = 32  # bytes: longest run of literals in LZF


def write_encoded(
    path: Path, fields: Any, T_world_sensor: Any = None, data: str = "binary"
) -> None:
    """Write points in any of ``ENCODINGS``."""
    write_pcd(path, fields, T_world_sensor)
    if data == "binary":
        return
    pcd = read_pcd(path)
    columns = [pcd[name] if pcd[name].ndim > 1 else pcd[name][:, None] for name in fields]
    body = (
        text(columns)
        if data == "ascii"
        else compressed(b"".join(column.tobytes() for column in columns))
    )
    head = path.read_bytes()[: pcd.header.offset].replace(b"DATA binary", f"DATA {data}".encode())
    path.write_bytes(head + body)


def text(columns: list[Any]) -> bytes:
    """One line per point; numbers have enough digits to be read back unchanged."""
    rows = zip(
        *(column.T[k].tolist() for column in columns for k in range(column.shape[1])), strict=True
    )
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()


def compressed(content: bytes) -> bytes:
    """LZF without copies, after the two sizes."""
    runs = [content[at : at + RUN] for at in range(0, len(content), RUN)]
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    return np.array([len(packed), len(content)], "<u4").tobytes() + packed if content else b""
