"""What a dataset sounds like: responses made from its echograms, and dry sounds through them.

`RirDataset` loads this module when sound is first asked for; its methods say what these functions do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.base.config import DatasetConfig
from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.echo.echogram import Echogram
from soundspaces_sim.reading.sampling import as_points
from soundspaces_sim.sound import auralise
from soundspaces_sim.sound.ambisonics import pair_seed
from soundspaces_sim.sound.binaural import binaural_rirs
from soundspaces_sim.sound.renderers import find_renderer

Ears = Callable[[int, int, ArrayLike], np.ndarray]  # source, listener, (k, 3) orientations -> (k, 2, n)


def response(
    echogram: Echogram, config: DatasetConfig, source: int, listener: int, rate: int
) -> np.ndarray:
    """(9, n) of a pair's echogram; the noise hangs on the dataset's seed and the pair alone."""
    return find_renderer(config.renderer)(echogram, rate, pair_seed(config.seed, source, listener))


def at_the_ears(field: np.ndarray, rate: int, turns: np.ndarray, hrtf: str | Path | None) -> np.ndarray:
    """(k, 2, n) of a response (9, n) for k heads (k, 3)."""
    return binaural_rirs(field, rate, turns, hrtf)


def render(ears: Ears, audio: ArrayLike, source: int, listener: int, heading_deg: float) -> np.ndarray:
    """(2, n): a dry mono signal as heard at the listener."""
    rir = ears(source, listener, [(heading_deg, 0.0, 0.0)])[0]
    return auralise.convolve(auralise.as_mono(audio), rir)


def mix(
    ears: Ears, sounds: Sequence[tuple[ArrayLike, int]], listener: int, heading_deg: float
) -> np.ndarray:
    """(2, n): several dry mono signals at once, each (signal, source)."""
    if not sounds:
        raise ConfigError("sounds: expected at least one (signal, source)")
    return auralise.add_up([render(ears, audio, s, listener, heading_deg) for audio, s in sounds])


def render_path(
    ears: Ears, audio: ArrayLike, sources: ArrayLike, listeners: ArrayLike, orientations_deg: ArrayLike
) -> np.ndarray:
    """(2, n): a dry sound whose source, or whose listener, moves along points at even times."""
    dry = auralise.as_mono(audio)
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    turns = np.atleast_2d(np.asarray(orientations_deg, float))
    if len(a) > 1 and (len(b) > 1 or len(turns) > 1):
        raise ConfigError("render_path: a source that moves needs a listener at rest, and the reverse")
    k = max(len(a), len(b), len(turns))
    if any(len(x) not in (1, k) for x in (b, turns)):
        raise ConfigError(f"render_path: {len(b)} listeners and {len(turns)} orientations do not match")
    places = zip(*(np.broadcast_to(x, (k, *x.shape[1:])) for x in (a, b, turns)), strict=True)
    rirs = [ears(int(s), int(l), [turn])[0] for s, l, turn in places]
    return auralise.along_path(dry, rirs, "source" if len(a) > 1 else "listener")


def spectrogram(
    ears: Ears, audio: ArrayLike, source: int, listener: int, heading_deg: float, rate: int
) -> np.ndarray:
    """(65, frames, 2) of `render`, as long as the dry sound."""
    dry = auralise.as_mono(audio)
    return auralise.spectrogram(render(ears, dry, source, listener, heading_deg)[:, : len(dry)], rate)
