"""What agents hear: the goal's sound through the dataset's binaural responses, as observations.

A one-second clip is heard anew in every step: the first second of clip ∗ response. Of a longer clip, step t
plays second t modulo its length, with the tail of the seconds before it; the first has none, as in
SoundSpaces' code. Spectrograms are kept in half precision whether they come from a file, from memory or
straight from the responses, so that observations do not depend on the cache.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import scipy.fft

from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.nav.baked_arrays import read_arrays, write_arrays
from soundspaces_sim.nav.cache import Block, BlockCache
from soundspaces_sim.nav.navigation_graph import HEADINGS
from soundspaces_sim.nav.sounds import SoundBank
from soundspaces_sim.rendering.auralise import spectrogram

Cache = Literal["memory", "disk", "none"]
PadMode = Literal["constant", "reflect"]
MEMORY = 1_000_000_000  # bytes of responses kept
#: RMS of a dry sound of RMS 1 at 1 m in the open (`data_schema/waveform-2.json`).
RMS_AT_1_M = float(np.sqrt(1.0 / (4.0 * np.pi)))
_FORMAT = "soundspaces_sim/heard-1"
_TURNS = [(float(h), 0.0, 0.0) for h in HEADINGS]


def frames(rate: int) -> int:
    """Columns of the spectrogram of one second: 26 at 16 kHz, 69 at 44.1 kHz."""
    return -(-(rate // 160 + 1) // 4)


def seconds_of(clip: np.ndarray, rate: int) -> int:
    """How many whole seconds a clip has: steps until it starts again."""
    return max(len(clip) // rate, 1)


def through(clip: np.ndarray, responses: np.ndarray, second: int, rate: int) -> np.ndarray:
    """(k, 2, rate) float32: second `second` of a clip through responses (k, 2, n), tails included."""
    # Of a one-second clip only the response's first second can be heard within the step.
    n = min(responses.shape[2], (second + 1) * rate)
    responses = responses[:, :, :n]
    first = max(0, second * rate - (n - 1))
    part = clip[first : (second + 1) * rate]
    size = int(scipy.fft.next_fast_len(len(part) + n - 1, real=True))
    spectrum = scipy.fft.rfft(part.astype(np.float32, copy=False), size)
    whole = scipy.fft.irfft(scipy.fft.rfft(responses, size) * spectrum, size)
    begin = second * rate - first
    out = whole[:, :, begin : begin + rate]
    if out.shape[2] < rate:
        out = np.pad(out, ((0, 0), (0, 0), (0, rate - out.shape[2])))
    return np.asarray(out, np.float32)


def intensity(ears: np.ndarray) -> np.ndarray:
    """(…, 2) float32 RMS of each ear of (…, 2, n)."""
    return np.asarray(np.sqrt(np.mean(np.square(ears, dtype=np.float64), axis=-1)), np.float32)


def add_noise(ears: np.ndarray, snr_db: float, rng: np.random.Generator) -> np.ndarray:
    """Ears (2, n) in white noise, `snr_db` below the observation's own RMS over both ears."""
    rms = float(np.sqrt(np.mean(np.square(ears, dtype=np.float64))))
    noise = rng.standard_normal(ears.shape, dtype=np.float32) * np.float32(
        rms * 10.0 ** (-snr_db / 20.0)
    )
    return np.asarray(ears + noise, np.float32)


def picture(ears: np.ndarray, rate: int, pad_mode: PadMode = "constant") -> np.ndarray:
    """(65, frames, 2) half precision: the spectrogram of ears (2, rate), see `auralise.spectrogram`."""
    return np.asarray(spectrogram(ears, rate, pad_mode=pad_mode), np.float16)


def check_cache(cache: str) -> None:
    """Raises `ConfigError` unless there is such a kind of cache."""
    if cache not in get_args(Cache):
        raise ConfigError(f"cache: expected {', '.join(get_args(Cache))}, got {cache!r}")


class AudioSensor:
    """Observations of one dataset and a bank of sounds. `kinds`: of spectrogram, intensity, audiogoal, what is
    asked for. `cache`: ``memory`` keeps up to a gigabyte of `memory` shared by scenes, ``disk`` reads what was
    baked in place, ``none`` makes everything anew; what was not baked is made from responses in any case.
    `pad_mode`: of spectrograms; baked ones have ``constant``, and serve no other."""

    def __init__(
        self, ds: RirDataset, bank: SoundBank, kinds: frozenset[str], cache: Cache = "memory",
        memory: BlockCache | None = None, pad_mode: PadMode = "constant",
    ) -> None:  # fmt: skip
        check_cache(cache)
        self.pad_mode: PadMode = pad_mode
        if bank.rate != ds.rate:
            raise ConfigError(f"sounds at {bank.rate} Hz do not fit a dataset at {ds.rate} Hz")
        self.ds, self.bank, self.kinds, self.cache = ds, bank, kinds, cache
        self.memory = memory or BlockCache(MEMORY)
        self._baked: dict[str, Baked | None] = {}
        self._keys: dict[str, tuple[str, ...]] = {}

    def seconds(self, sound: str) -> int:
        """Whole seconds of a sound."""
        return seconds_of(self.bank[sound], self.ds.rate)

    def ears(
        self,
        sound: str,
        goal: int,
        node: int,
        second: int = 0,
        ways: Sequence[int] = range(len(HEADINGS)),
    ) -> np.ndarray:
        """(k, 2, rate) waveforms at a node, of a sound at a goal, facing `HEADINGS` of each of `ways`."""
        clip, rate = self.bank[sound], self.ds.rate
        responses = self.ds.binaurals(goal, node, [_TURNS[way] for way in ways])
        # One by one: transforms of many rows at once may round otherwise than those of few.
        return np.stack([through(clip, one[None], second, rate)[0] for one in responses])

    def block(self, sound: str, goal: int, node: int, step: int = 0) -> Block:
        """What is heard in step `step` of an episode: arrays (4, …) by heading of every kind asked for."""
        second = step % self.seconds(sound)
        if self.cache == "none":
            return self._make(sound, goal, node, second)
        if self.cache == "disk" and (found := self._from_disk(sound, goal, node, second)) is not None:
            return found
        key = (self._key(sound), self.kinds, self.pad_mode, second, goal, node)
        return self.memory.get(key, lambda: self._load(sound, goal, node, second))

    def facing(self, way: int, sound: str, goal: int, node: int, step: int = 0) -> Block:
        """The same of one heading, `HEADINGS[way]`: arrays (…). Without a cache the others are not made."""
        if self.cache == "none":
            second = step % self.seconds(sound)
            block, row = self._make(sound, goal, node, second, (way,)), 0
        else:
            block, row = self.block(sound, goal, node, step), way
        return {name: array[row] for name, array in block.items()}

    def _key(self, sound: str) -> tuple[str, ...]:
        """What is kept in a memory of many scenes belongs to this dataset and this sound."""
        if sound not in self._keys:
            self._keys[sound] = tuple(_belongs(self.ds, self.bank, sound).values())
        return self._keys[sound]

    def _load(self, sound: str, goal: int, node: int, second: int) -> Block:
        found = self._from_disk(sound, goal, node, second)
        if found is None:
            return self._make(sound, goal, node, second)
        return {name: np.array(array) for name, array in found.items()}

    def _make(
        self, sound: str, goal: int, node: int, second: int, ways: Sequence[int] = range(len(HEADINGS))
    ) -> Block:
        ears = self.ears(sound, goal, node, second, ways)
        out: Block = {}
        if "audiogoal" in self.kinds:
            out["audiogoal"] = ears
        if "intensity" in self.kinds:
            out["intensity"] = intensity(ears)
        if "spectrogram" in self.kinds:
            out["spectrogram"] = np.stack([picture(one, self.ds.rate, self.pad_mode) for one in ears])
        return out

    def _from_disk(self, sound: str, goal: int, node: int, second: int) -> Block | None:
        if "audiogoal" in self.kinds:
            return None  # waveforms are not baked: a second of two ears is twenty spectrograms
        if "spectrogram" in self.kinds and self.pad_mode != "constant":
            return None
        if sound not in self._baked:
            self._baked[sound] = open_baked(self.ds, self.bank, sound)
        baked = self._baked[sound]
        return baked.block(goal, node, second, self.kinds) if baked is not None else None


class Baked:
    """A file of observations of one sound, mapped into memory: `spectrogram` (S, G, K, 4, 65, F, 2) half
    precision, `intensity` (S, G, K, 4, 2) single, by second, goal, node and heading."""

    def __init__(
        self, arrays: dict[str, np.ndarray], goals: np.ndarray, nodes: np.ndarray, points: int
    ) -> None:
        self.arrays, self.goals = arrays, goals
        self.goal_row, self.node_row = np.full(points, -1), np.full(points, -1)
        self.goal_row[goals], self.node_row[nodes] = np.arange(len(goals)), np.arange(len(nodes))

    def block(self, goal: int, node: int, second: int, kinds: frozenset[str]) -> Block | None:
        """None if the goal was not baked."""
        g, k = self.goal_row[goal], self.node_row[node]
        if g < 0 or k < 0:
            return None
        return {name: self.arrays[name][second, g, k] for name in kinds}


def baked_path(ds: RirDataset, sound: str) -> Path:
    """Where the observations of a sound are kept, beside the dataset's shards; those of each renderer that is not
    the dataset's own in a file apart."""
    own = ds.renderer == ds.manifest.config.dataset.renderer
    return ds.path / f"heard_{sound}{'' if own else f'.{ds.renderer}'}.h5"


def _belongs(ds: RirDataset, bank: SoundBank, sound: str) -> dict[str, str]:
    """All that decides what is heard."""
    config = ds.manifest.config.dataset
    parts = (ds.manifest.key, ds.rate, ds.renderer, config.seed, ds.hrtf)
    return {
        "format": _FORMAT,
        "dataset": hashlib.sha256(repr(parts).encode()).hexdigest(),
        "sound": bank.digest(sound),
    }


def open_baked(ds: RirDataset, bank: SoundBank, sound: str) -> Baked | None:
    """What was baked of a sound, or None. Raises `DatasetError` if the file is of another dataset or sound."""
    nodes, seconds = len(ds.manifest.nodes), seconds_of(bank[sound], ds.rate)
    found = read_arrays(
        baked_path(ds, sound), f"observations of '{sound}'", _belongs(ds, bank, sound),
        {
            "spectrogram": (seconds, None, nodes, len(HEADINGS), 65, frames(ds.rate), 2),
            "intensity": (seconds, None, nodes, len(HEADINGS), 2), "goals": (None,),
        },
    )  # fmt: skip
    if found is None:
        return None
    goals = np.array(found.pop("goals"))
    if not all(array.shape[1] == len(goals) for array in found.values()):
        raise DatasetError(f"{baked_path(ds, sound)}: damaged; delete this file and bake anew")
    return Baked(found, goals, np.array(ds.manifest.nodes, np.int64), len(ds.points))


def bake_sound(
    ds: RirDataset, bank: SoundBank, sound: str, goals: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Write what is heard of a sound at some goals, at every node, unless the file has them. Returns its path."""
    path = baked_path(ds, sound)
    wanted = np.unique(np.asarray(goals, np.int64))
    found = open_baked(ds, bank, sound)
    if found is not None:
        if np.isin(wanted, found.goals).all():
            return path
        wanted = np.union1d(wanted, found.goals)
    nodes = np.array(ds.manifest.nodes, np.int64)
    kinds = frozenset(("spectrogram", "intensity"))
    audio = AudioSensor(ds, bank, kinds, "disk" if found is not None else "none", BlockCache(0))
    seconds = audio.seconds(sound)
    shape = (seconds, len(wanted), len(nodes), 4)
    pictures = np.empty((*shape, 65, frames(ds.rate), 2), np.float16)
    levels = np.empty((*shape, 2), np.float32)
    for s in range(seconds):
        for i, goal in enumerate(wanted):
            for j, node in enumerate(nodes):
                block = audio.block(sound, int(goal), int(node), s)
                pictures[s, i, j], levels[s, i, j] = block["spectrogram"], block["intensity"]
            if progress is not None:
                progress(s * len(wanted) + i + 1, seconds * len(wanted))
    arrays: dict[str, np.ndarray] = {"goals": wanted, "spectrogram": pictures, "intensity": levels}
    return write_arrays(path, _belongs(ds, bank, sound), arrays)
