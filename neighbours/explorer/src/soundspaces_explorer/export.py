"""The explorer as a folder that opens from disk: the page, and as much of a dataset as a browser may hold.

Pages that are opened from disk may load scripts but no other files, so the data are scripts. All pairs of some
points, spread over the dataset, are in it, at four headings; between two of them the page takes their mixture.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np

from soundspaces_explorer import payloads
from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import make_folder, publish_file as publish

HEADINGS = (0.0, 90.0, 180.0, 270.0)


def export_explorer(
    ds: RirDataset, out: str | Path, count: int = 12, progress: Callable[[int, int], None] | None = None
) -> int:
    """Write the explorer of a dataset with `count` of its points to the folder `out`; bytes written.

    Raises `ConfigError`, `DatasetError`.
    """
    if count < 1:
        raise ConfigError(f"--points {count}: expected at least 1")
    folder = make_folder(Path(out))
    chosen = _spread(ds.points, count)
    size = 0

    def write(name: str, data: bytes) -> None:
        nonlocal size
        publish(folder / name, data)
        size += len(data)

    for name in ("index.html", "common.js", "explore.js", "explore.css"):
        write(name, (files("soundspaces_explorer") / "page" / name).read_bytes())
    whole = {
        **payloads.overview(ds),
        "chosen": chosen,
        "headings": list(HEADINGS),
        "sounds": {name: _text(payloads.sound(name, ds.rate)) for name in payloads.SOUNDS},
    }
    write("data.js", _script("overview", whole))
    for k, s in enumerate(chosen):
        pairs = {}
        for l in chosen:
            ears = ds.binaurals(s, l, [(h, 0.0, 0.0) for h in HEADINGS])
            peak = float(np.abs(ears).max()) or 1.0
            whole_numbers = np.round(ears / peak * 32767.0).astype("<i2")
            pairs[l] = {**payloads.pair(ds, s, l), "peak": peak, "ears": _text(whole_numbers)}
        write(
            f"source-{s}.js",
            _script("source", {"source": s, "level": payloads.field(ds, s), "pairs": pairs}),
        )
        if progress is not None:
            progress(k + 1, len(chosen))
    return size


def _text(values: np.ndarray) -> str:
    return base64.b64encode(values.astype("<i2" if values.dtype == "<i2" else "<f4").tobytes()).decode()


def _script(kind: str, content: object) -> bytes:
    # "<" as an escape: no text of a dataset can end the script it stands in
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f"window.explorerData({json.dumps(kind)},{text});\n".encode()


def _spread(points: np.ndarray, count: int) -> list[int]:
    """Rows of points, each the farthest from those before it; the first is nearest to the middle."""
    chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())]
    away = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return sorted(chosen)
