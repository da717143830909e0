"""Exporters: layouts in which datasets are written for others. The command line lists what is here.

An exporter is a function ``(ds, out, *, progress, …) -> files written``; its other keyword arguments are
options of the layout. A new one is a file in this room and a line below.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.registry import Entry, find

if TYPE_CHECKING:
    from soundspaces_sim.reading.dataset import RirDataset

Progress = Callable[[int, int], None]  # done, total
Export = Callable[["RirDataset", Path, Progress | None], int]

EXPORTERS: Mapping[str, Entry] = {
    "soundspaces-v1": Entry(
        "soundspaces_sim.exchange.soundspaces1:export_soundspaces1", "as published with SoundSpaces 1"
    ),
    "sofa": Entry(
        "soundspaces_sim.exchange.sofa:export_sofa", "AES69, a SingleRoomSRIR file per source"
    ),
    "wav": Entry("soundspaces_sim.exchange.wav:export_wav", "plain WAV files"),
}


def find_exporter(layout: str, options: Mapping[str, Any]) -> Export:
    """The exporter of a layout with these options set. Raises `ConfigError` for a layout or an option that
    is not there."""
    function = find("layout", EXPORTERS, layout)
    for name in options:
        if name not in inspect.signature(function).parameters:
            raise ConfigError(f"--{name}: layout {layout} has no such option")

    def export(ds: RirDataset, out: Path, progress: Progress | None) -> int:
        return int(function(ds, out, progress=progress, **options))

    return export
