"""What a dataset sounds like: responses made from its echograms, and dry sounds through them.

`RirDataset` loads this module when sound is first asked for; its methods say what these functions do.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.dataset.sampling import as_points, for_each
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.endpoints import Directivity
from soundspaces_sim.rendering import auralise
from soundspaces_sim.rendering import ears as whose
from soundspaces_sim.rendering.ambisonics import pair_seed
from soundspaces_sim.rendering.binaural import binaural_rirs
from soundspaces_sim.rendering.microphones import MicrophoneArray, array_rir
from soundspaces_sim.rendering.renderers import find_renderer

Emits = Directivity | str | None
Sound = tuple[ArrayLike, int] | tuple[ArrayLike, int, Emits]  # signal, source, how that emits


class Ears(Protocol):
    """Source, listener and (k, 3) orientations to (k, 2, n) responses."""

    def __call__(
        self, s: int, l: int, /, orientations_deg: ArrayLike, *, source: Emits = None
    ) -> np.ndarray: ...


def response(
    echogram: Echogram, renderer: str, seed: int, source: int, listener: int, rate: int
) -> np.ndarray:
    """(9, n) of a pair's echogram; the noise hangs on the dataset's seed and the pair alone."""
    return find_renderer(renderer)(echogram, rate, pair_seed(seed, source, listener))


def at_microphones(
    echogram: Echogram,
    array: MicrophoneArray,
    seed: int,
    source: int,
    listener: int,
    rate: int,
    c: float,
) -> np.ndarray:
    """(k, n) of a pair's echogram at an array of microphones."""
    return array_rir(echogram, array, rate, pair_seed(seed, source, listener), c)


def at_the_ears(field: np.ndarray, rate: int, turns: np.ndarray, hrtf: str | Path | None) -> np.ndarray:
    """(k, 2, n) of a response (9, n) for k heads (k, 3)."""
    return binaural_rirs(field, rate, turns, hrtf)


def at_these_ears(
    echogram: Echogram, renderer: str, seed: int, source: int, listener: int, rate: int, turns: np.ndarray,
    ears: whose.Ears, c: float,
) -> np.ndarray:  # fmt: skip
    """(k, 2, n) of a pair's echogram for k heads (k, 3) that have these ears."""
    return whose.ear_rirs(
        echogram, lambda e: response(e, renderer, seed, source, listener, rate), rate, turns, ears, c
    )


def render(
    ears: Ears, audio: ArrayLike, s: int, l: int, heading_deg: float, source: Emits
) -> np.ndarray:
    """(2, n): a dry mono signal as heard at the listener."""
    rir = ears(s, l, [(heading_deg, 0.0, 0.0)], source=source)[0]
    return auralise.convolve(auralise.as_mono(audio), rir)


def mix(ears: Ears, sounds: Sequence[Sound], listener: int, heading_deg: float) -> np.ndarray:
    """(2, n): several dry mono signals at once, each (signal, source) or (signal, source, directivity)."""
    if not sounds or any(len(sound) not in (2, 3) for sound in sounds):
        raise ConfigError(
            "sounds: expected at least one (signal, source) or (signal, source, directivity)"
        )
    return auralise.add_up([
        render(ears, audio, s, listener, heading_deg, more[0] if more else None)
        for audio, s, *more in sounds
    ])  # fmt: skip


def render_path(
    ears: Ears,
    audio: ArrayLike,
    sources: ArrayLike,
    listeners: ArrayLike,
    orientations_deg: ArrayLike,
    source: Emits | Sequence[Emits],
) -> np.ndarray:
    """(2, n): a dry sound whose source, or whose listener, moves or turns at even times."""
    dry = auralise.as_mono(audio)
    a, b = as_points(sources, "sources"), as_points(listeners, "listeners")
    turns = np.atleast_2d(np.asarray(orientations_deg, float))
    ways = len(source) if isinstance(source, list | tuple) else 1
    moves = len(a) > 1 or ways > 1
    if moves and (len(b) > 1 or len(turns) > 1):
        raise ConfigError("render_path: a source that moves needs a listener at rest, and the reverse")
    k = max(len(a), len(b), len(turns), ways)
    if any(n not in (1, k) for n in (len(a), len(b), len(turns), ways)):
        raise ConfigError(
            f"render_path: {len(a)} sources, {ways} directivities, {len(b)} listeners and {len(turns)} "
            "orientations do not match"
        )
    emit = for_each(source[0] if isinstance(source, list | tuple) and ways == 1 else source, k, "source")
    places = zip(*(np.broadcast_to(x, (k, *x.shape[1:])) for x in (a, b, turns)), emit, strict=True)
    rirs = [ears(int(s), int(l), [turn], source=d)[0] for s, l, turn, d in places]
    return auralise.along_path(dry, rirs, "source" if moves else "listener")


def spectrogram(
    ears: Ears, audio: ArrayLike, s: int, l: int, heading_deg: float, rate: int, source: Emits
) -> np.ndarray:
    """(65, frames, 2) of `render`, as long as the dry sound."""
    dry = auralise.as_mono(audio)
    return auralise.spectrogram(render(ears, dry, s, l, heading_deg, source)[:, : len(dry)], rate)
