"""A folder to listen to: sounds at three places and four headings, mono beside binaural, with pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from soundspaces_renderers import dry

from soundspaces_pictures.response import draw_spectrogram
from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import (
    convolve_sound,
    make_folder,
    mono,
    publish_file as publish,
    read_sound,
    wav_bytes,
)

_HEADINGS = (0.0, 90.0, 180.0, 270.0)
_PEAK = 0.7
Progress = Callable[[int, int], None]


def listening_folder(
    ds: RirDataset,
    out: str | Path,
    recordings: Mapping[str, Path] | None = None,
    progress: Progress | None = None,
) -> int:
    """Write <sound>_<place>_mono.wav and <sound>_<place>_<heading>.wav, each with a PNG; their number.

    Places are listeners near the source, far from it in sight, and out of sight. `recordings` replace
    `speech`, `clap` or `music`. All files of a sound share one gain, so that levels compare.
    """
    folder = make_folder(Path(out))
    sounds = {
        "speech": dry.syllables(ds.rate),
        "clap": dry.hand_clap(ds.rate),
        "music": dry.music(ds.rate),
    }
    for name, path in (recordings or {}).items():
        sounds[name] = mono(*read_sound(path, ConfigError), ds.rate).astype(np.float32)
    source, places = listening_places(ds)
    turns = [(heading, 0.0, 0.0) for heading in _HEADINGS]
    done, total = 0, len(sounds) * len(places) * (1 + len(_HEADINGS))
    for sound, signal in sounds.items():
        heard: dict[str, np.ndarray] = {}
        for place, listener in places.items():
            field = ds.ambisonic(source, listener)
            heard[f"{sound}_{place}_mono"] = convolve_sound(signal, field[:1])
            for heading, ears in zip(_HEADINGS, ds.binaurals(source, listener, turns), strict=True):
                heard[f"{sound}_{place}_{heading:03.0f}"] = convolve_sound(signal, ears)
        gain = _PEAK / max(float(np.abs(x).max()) for x in heard.values())
        for name, x in heard.items():
            publish(folder / f"{name}.wav", wav_bytes(gain * x, ds.rate))
            _picture(folder / f"{name}.png", gain * x, ds.rate, name.replace("_", ", "))
            done += 1
            if progress is not None:
                progress(done, total)
    text = [f"{ds.scene}: source at point {source} {np.round(ds.points[source], 2).tolist()} m"]
    text += [
        f"{place}: listener at point {l} {np.round(ds.points[l], 2).tolist()} m"
        for place, l in places.items()
    ]
    text += [
        "The last word of a name: mono (omnidirectional), or the heading in degrees (0 faces +X, 90 +Y)."
    ]
    publish(folder / "README.txt", ("\n".join(text) + "\n").encode())
    return total


def listening_places(ds: RirDataset) -> tuple[int, dict[str, int]]:
    """A source that many points see, and three listeners."""
    table = ds.table()
    seen = np.bincount(table["source"][table["visible"]], minlength=len(ds.points))
    source = int(seen.argmax())
    rows = table[table["source"] == source]
    if not len(rows):
        raise ConfigError(f"{ds.path}: a listening folder needs two points or more")
    sight, hidden = rows[rows["visible"]], rows[~rows["visible"]]
    sight = sight if len(sight) else rows
    near = sight[np.abs(sight["distance"] - 1.5).argmin()]
    far = sight[sight["distance"].argmax()]
    hidden = hidden if len(hidden) else sight
    behind = hidden[np.abs(hidden["distance"] - np.median(hidden["distance"])).argmin()]
    return source, {
        "near": int(near["listener"]),
        "far": int(far["listener"]),
        "hidden": int(behind["listener"]),
    }


def _picture(path: Path, signal: np.ndarray, rate: int, title: str) -> None:
    figure, axes = plt.subplots(
        len(signal),
        1,
        figsize=(6.0, 2.6 * len(signal)),
        layout="constrained",
        squeeze=False,
        sharex=True,
    )
    for ax, channel, name in zip(
        axes[:, 0], signal, ("left", "right") if len(signal) == 2 else ("mono",), strict=True
    ):
        draw_spectrogram(ax, channel, rate)
        ax.set_title(f"{title}: {name}", fontsize=9)
    figure.savefig(path, dpi=80)
    plt.close(figure)
