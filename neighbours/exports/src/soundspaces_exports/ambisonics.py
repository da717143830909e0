"""Export of higher orders: one WAV file a pair, float32, ACN, (order + 1)² channels, as sets such as HARP have.

Arrivals are exact; reverberation above order 2 is what a field with the stored moments most likely has
(`rendering.higher_orders`).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import (
    WAV_HEADER as HEADER,
    ExportPlan,
    ExportProgress as Progress,
    check_order,
    choose_pairs,
    make_folder,
    n3d_gains,
    publish_file as publish,
    response_samples_of as samples_of,
    wav_bytes,
)

Normalisation = Literal["sn3d", "n3d"]


def plan_ambisonics(
    ds: RirDataset,
    out: str | Path,
    order: int = 7,
    convention: Normalisation = "sn3d",
    pairs: str | Path = "all",
) -> ExportPlan:
    """`out`/<scene>/<source>_<listener>.wav of the chosen pairs (see `plan.choose_pairs`), of order 3 to 7, and
    `out`/<scene>/format.json, which says what the channels are and where the points. Raises `ConfigError`."""
    order = check_order(order)
    if convention not in get_args(Normalisation):
        names = " or ".join(get_args(Normalisation))
        raise ConfigError(f"convention: expected {names} for higher orders, got {convention!r}")
    rows = choose_pairs(ds, pairs)
    gains = n3d_gains(order) if convention == "n3d" else np.ones((order + 1) ** 2)
    gains = gains.astype(np.float32)[:, None]

    folder = Path(out) / ds.scene

    def write(progress: Progress) -> None:
        make_folder(folder)
        about = {
            "order": order,
            "channels": "ACN",
            "normalisation": convention.upper(),
            "axes": "world: x front, y left, z up",
            "rate": ds.rate,
            "points": np.asarray(ds.points, float).tolist(),
        }
        publish(folder / "format.json", (json.dumps(about, indent=1) + "\n").encode(), durable=False)
        for done, (s, l) in enumerate(rows.tolist()):
            response = gains * ds.ambisonic(s, l, order=order)
            publish(folder / f"{s}_{l}.wav", wav_bytes(response, ds.rate), durable=False)
            progress(done + 1, len(rows))

    size = len(rows) * (HEADER + 4 * (order + 1) ** 2 * samples_of(ds)) + 60 * len(ds.points)
    return ExportPlan(Path(out), len(rows) + 1, size, write, [folder])
