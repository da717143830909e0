"""Reverberation times and how straight a decay is (ISO 3382-1, ISO 3382-2 annex B). Functions of a `Response` give
(1, K): their errors are stored with the pair."""

from __future__ import annotations

import numpy as np

from soundspaces_parameters.response import Response
from soundspaces_sim.parts import BIN_S, RANGES, decay_curve, reverberation_times

_LIMITS = {name.lower(): (upper, lower) for name, upper, lower in RANGES}


def _time(response: Response, name: str) -> np.ndarray:
    return reverberation_times(response.estimate, BIN_S, *_LIMITS[name])[0]


def t20(response: Response) -> np.ndarray:
    """s, from -5 to -25 dB."""
    return response.once(_t20)


def t30(response: Response) -> np.ndarray:
    """s, from -5 to -35 dB."""
    return response.once(_t30)


def _t20(response: Response) -> np.ndarray:
    return _time(response, "t20")


def _t30(response: Response) -> np.ndarray:
    return _time(response, "t30")


def edt(response: Response) -> np.ndarray:
    """s, from 0 to -10 dB."""
    return _time(response, "edt")


def curvature(response: Response) -> np.ndarray:
    """Percent by which T30 exceeds T20 (ISO 3382-2, B.3): 0 to 5 is usual; above 10 the decay is no straight
    line."""
    return np.asarray(100.0 * (t30(response) / t20(response) - 1.0))


def nonlinearity(response: Response) -> np.ndarray:
    """Per mille of the variance of the decay curve from -5 to -35 dB that its straight line leaves, 1000 (1 - r²)
    (ISO 3382-2, B.2): 0 to 5 is usual; above 10 the decay is no straight line. NaN where T30 is."""
    curve = decay_curve(response.estimate)
    upper, lower = _LIMITS["t30"]
    use = (curve <= upper) & (curve >= lower)
    count = np.maximum(use.sum(axis=-1, keepdims=True), 1)
    t = np.arange(curve.shape[-1], dtype=float)
    y = np.where(use, curve, 0.0)
    dt = np.where(use, t - (use * t).sum(axis=-1, keepdims=True) / count, 0.0)
    dy = np.where(use, y - y.sum(axis=-1, keepdims=True) / count, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        r2 = (dt * dy).sum(axis=-1) ** 2 / ((dt * dt).sum(axis=-1) * (dy * dy).sum(axis=-1))
    return np.where(np.isfinite(t30(response)), 1000.0 * (1.0 - r2), np.nan)


def ratio(response: Response, name: str) -> np.ndarray:
    """(1, K): "c50", "c80" (dB), "d50", "ts" (s) or "drr" (dB), as the table of pairs has them."""
    found = response.ratios[name]
    seen = response.echogram.visible or name != "drr"
    return np.where(seen & np.isfinite(found), found, np.nan)


def c50(response: Response) -> np.ndarray:
    """dB, energy up to 50 ms to the rest."""
    return ratio(response, "c50")


def c80(response: Response) -> np.ndarray:
    """dB, energy up to 80 ms to the rest."""
    return ratio(response, "c80")


def d50(response: Response) -> np.ndarray:
    """Share of the energy up to 50 ms."""
    return ratio(response, "d50")


def ts(response: Response) -> np.ndarray:
    """s, centre of gravity of the energy."""
    return ratio(response, "ts")


def drr(response: Response) -> np.ndarray:
    """dB, energy up to 2.5 ms to the rest; NaN out of sight."""
    return ratio(response, "drr")
