"""Contexts for tests."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from soundspaces_rlr.api import (
    BoxMaterialCategories,
    ChannelLayout,
    ChannelLayoutType,
    Config,
    Context,
)

MONO = ChannelLayout(ChannelLayoutType.Mono, 1)
BINAURAL = ChannelLayout(ChannelLayoutType.Binaural, 2)
SIZE = (6.0, 5.0, 2.7)


def foa(channels: int = 4) -> ChannelLayout:
    return ChannelLayout(ChannelLayoutType.Ambisonics, channels)


def quick(**settings: object) -> Config:
    """A config of few rays at a low rate."""
    config = Config()
    config.sample_rate, config.indirect_ray_count, config.max_ir_length = 16000.0, 400, 0.3
    for name, value in settings.items():
        setattr(config, name, value)
    return config


def material(
    name: str, absorption: float, scattering: float = 0.3, labels: Sequence[str] = ()
) -> dict[str, Any]:
    """A row of a material database, flat over frequency."""
    curves = {"absorption": absorption, "scattering": scattering, "transmission": 0.0, "damping": 0.0}
    flat = {key: [20.0, value, 20000.0, value] for key, value in curves.items()}
    return {"name": name, "labels": list(labels), "speed": 1484.0, "density": 998.7, **flat}


def write_database(path: Path, *rows: dict[str, Any]) -> str:
    path.write_text(json.dumps({"materials": rows}))
    return str(path)


def room(
    config: Config,
    sources: Sequence[Sequence[float]],
    listeners: Sequence[tuple[Sequence[float], ChannelLayout]],
    database: str | None = None,
) -> Context:
    """A box of `SIZE` of the category "wall", or the default material."""
    context = Context(config)
    if database is not None:
        context.set_material_database_json(database)
    context.add_object()
    sides = BoxMaterialCategories(*["wall" if database else "default"] * 6)
    context.set_object_box(0, [0, 0, 0], SIZE, sides)
    return populate(context, sources, listeners)


def populate(
    context: Context,
    sources: Sequence[Sequence[float]],
    listeners: Sequence[tuple[Sequence[float], ChannelLayout]],
) -> Context:
    for i, position in enumerate(sources):
        context.add_source()
        context.set_source_position(i, position)
    for i, (position, layout) in enumerate(listeners):
        context.add_listener(layout)
        context.set_listener_position(i, position)
    return context


def response(context: Context, listener: int = 0, source: int = 0) -> np.ndarray:
    """(C, n)"""
    return context.get_listener_source_audio(listener, source)
