"""Small pictures as SVG, for notebooks: plans and curves of a few kilobytes, without matplotlib.

Coordinates are the caller's, y up; everything is scaled to fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

BLUE, ORANGE, VERMILION, GREEN = "#0072B2", "#E69F00", "#D55E00", "#009E73"
GREY, BLACK = "#777777", "#222222"
CYCLE = (BLUE, ORANGE, GREEN, VERMILION)
_MOST = 4000  # shapes of a layer; more are thinned out


class Lines(NamedTuple):
    """Segments (n, 4) x0 y0 x1 y1."""

    segments: np.ndarray
    colour: str
    width: float = 1.0


class Curve(NamedTuple):
    """A line through (n, 2); breaks where a value is not finite."""

    points: np.ndarray
    colour: str


class Dots(NamedTuple):
    """Places (n, 2)."""

    points: np.ndarray
    colour: str
    radius: float = 2.0


Layer = Lines | Curve | Dots


def svg(layers: Sequence[Layer], width: int = 320, height: int = 200, same_scale: bool = True) -> str:
    """An SVG of the layers, the first at the bottom; ``same_scale``: one metre is as long either way."""
    everything = [_places(layer) for layer in layers]
    places = np.concatenate([p[np.isfinite(p).all(axis=1)] for p in everything] or [np.empty((0, 2))])
    if not len(places):
        return ""
    low, high = places.min(axis=0), places.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    room = np.array([width - 10.0, height - 10.0])
    scale = room / span
    if same_scale:
        scale = np.full(2, scale.min())
    size = scale * span + 10.0

    def at(p: np.ndarray) -> np.ndarray:
        x, y = 5.0 + scale[0] * (p[..., 0] - low[0]), size[1] - 5.0 - scale[1] * (p[..., 1] - low[1])
        return np.round(np.stack([x, y], axis=-1), 1)

    body = "".join(_shapes(layer, at) for layer in layers)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size[0]:.0f}" height="{size[1]:.0f}" '
        f'style="background:white">{body}</svg>'
    )


def html(text: str, picture: str) -> str:
    """Lines of text above a picture, for `_repr_html_`."""
    return f"<div><pre>{escape(text)}</pre>{picture}</div>"


def _places(layer: Layer) -> np.ndarray:
    return np.asarray(layer[0], float).reshape(-1, 2)


def _shapes(layer: Layer, at: Callable[[np.ndarray], np.ndarray]) -> str:
    if isinstance(layer, Curve):
        p = np.asarray(layer.points, float)
        runs = np.split(p, np.flatnonzero(~np.isfinite(p).all(axis=1)))
        runs = [at(r[np.isfinite(r).all(axis=1)]) for r in runs]
        return "".join(
            f'<polyline fill="none" stroke="{layer.colour}" stroke-width="1.5" points="'
            + " ".join(f"{x:g},{y:g}" for x, y in run)
            + '"/>'
            for run in runs
            if len(run) > 1
        )
    if isinstance(layer, Lines):
        ends = at(_thin(np.asarray(layer.segments, float).reshape(-1, 4)).reshape(-1, 2, 2))
        path = "".join(f"M{a[0]:g} {a[1]:g}L{b[0]:g} {b[1]:g}" for a, b in ends)
        return f'<path stroke="{layer.colour}" stroke-width="{layer.width:g}" d="{path}"/>'
    dots = at(_thin(_places(layer)))
    return "".join(
        f'<circle cx="{x:g}" cy="{y:g}" r="{layer.radius:g}" fill="{layer.colour}"/>' for x, y in dots
    )


def _thin(rows: np.ndarray) -> np.ndarray:
    """At most `_MOST` rows, evenly chosen."""
    if len(rows) <= _MOST:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, _MOST).astype(int)])
