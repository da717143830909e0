"""PLY files for tests: binary, of structured arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Little-endian; a field of a shape, as ("vertex_indices", "i4", (3,)), becomes a list."""
    head, body = ["ply", "format binary_little_endian 1.0"], b""
    for name, rows in (("vertex", vertices), ("face", faces)):
        head.append(f"element {name} {len(rows)}")
        kinds: list[tuple[Any, ...]] = []
        for field in rows.dtype.names or ():
            base, shape = rows.dtype[field].base, rows.dtype[field].shape
            head.append(f"property {'list uint8 ' if shape else ''}{base.name} {field}")
            kinds += [(f"length of {field}", "u1")] if shape else []
            kinds.append((field, base.newbyteorder("<"), shape))
        packed = np.zeros(len(rows), kinds)
        for field in rows.dtype.names or ():
            packed[field] = rows[field]
            if rows.dtype[field].shape:
                packed[f"length of {field}"] = rows.dtype[field].shape[0]
        body += packed.tobytes()
    path.write_bytes("\n".join([*head, "end_header", ""]).encode() + body)
