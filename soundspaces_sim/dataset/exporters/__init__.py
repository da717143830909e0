"""Exporters: layouts in which datasets are written for others. The command line lists what is here.

An exporter is a function ``(ds, out, …) -> ExportPlan``, whose other arguments are options of the layout.
A new one is a file in this room, or in a distribution of its own, and a line below.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.registry import Entry, find

if TYPE_CHECKING:
    from soundspaces_sim.dataset.exporters.plan import ExportPlan
    from soundspaces_sim.dataset.reader import RirDataset

Export = Callable[["RirDataset", Path], "ExportPlan"]

EXPORTERS: Mapping[str, Entry] = {
    "soundspaces-v1": Entry(
        "soundspaces_exports.soundspaces1:plan_soundspaces1",
        "as published with SoundSpaces 1",
        "exports",
    ),
    "sofa": Entry(
        "soundspaces_exports.sofa:plan_sofa",
        "AES69, a SingleRoomSRIR file per source or listener",
        "exports",
    ),
    "huggingface": Entry(
        "soundspaces_exports.huggingface:plan_huggingface",
        "parquet of waveforms and labels that `datasets` loads",
        "exports",
    ),
    "lhotse": Entry(
        "soundspaces_exports.lhotse:plan_lhotse",
        "recordings and supervisions for Lhotse",
        "exports",
    ),
    "ambisonics": Entry(
        "soundspaces_exports.ambisonics:plan_ambisonics",
        "WAV files of order 3 to 7, 16 to 64 channels",
        "exports",
    ),
    "iso3382": Entry(
        "soundspaces_parameters.iso3382:plan_iso3382",
        "impulse responses and ISO 3382-1 tables for programs that measure rooms",
        "parameters",
    ),
    "wav": Entry("soundspaces_sim.dataset.exporters.wav:plan_wav", "plain WAV files"),
    "webdataset": Entry(
        "soundspaces_exports.webdataset:plan_webdataset",
        "tar files for training that streams",
        "exports",
    ),
}


def find_exporter(
    layout: str, options: Mapping[str, Any], flags: Mapping[str, str] | None = None
) -> Export:
    """The exporter of a layout with these options set; `flags`: other names of theirs, for messages. Raises
    `ConfigError` for a layout or an option that is not there."""
    function = find("layout", EXPORTERS, layout)
    known = [name for name in inspect.signature(function).parameters if name not in ("ds", "out")]
    for name in options:
        if name not in known:
            shown = (flags or {}).get(name, name)
            has = ", ".join((flags or {}).get(n, n) for n in known)
            raise ConfigError(f"{shown}: layout {layout} has no such option; it has: {has}")
    return partial(function, **options)
