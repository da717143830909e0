"""The bank of sounds that goals make: 102 of one second each by formula, in 20 families, or a folder of files.

The split 73 / 11 / 18 into train, val and test is that of the paper, by family: a sound of the test split is
like none that an agent was trained with. Every sound has RMS 1.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.sound import mono, read_sound
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.core.keywords import nearest
from soundspaces_sim.nav.synthetic_sounds import FAMILIES, SPLIT_OF, synthesise

DEFAULT = "telephone"
_SUFFIXES = (".wav", ".flac")
_SHARES = {"train": 73, "val": 11, "test": 18}
_LONGEST = 600.0  # s


class SoundBank(Mapping[str, np.ndarray]):
    """Sounds by name: (n,) float32 at `rate` Hz, RMS 1. `splits`: names by split. `folder`: WAV and FLAC files
    instead of formulas, mixed to mono and resampled; its `sounds.toml`, ``train = ["name", …]``, parts them,
    else `seed` does, in the shares 73 : 11 : 18. A pickle is folder, rate and seed.

    Raises `ConfigError` for sounds that cannot be read, are silent, empty or not finite.
    """

    def __init__(self, rate: int, folder: str | Path | None = None, seed: int = 0) -> None:
        self.rate, self.folder, self.seed = int(rate), Path(folder) if folder is not None else None, seed
        if self.folder is None:
            self.splits = {
                split: tuple(n for n in _FORMULA if SPLIT_OF[_FORMULA[n][0]] == split)
                for split in _SHARES
            }
        else:
            self._files = _find_files(self.folder)
            self.splits = _file_splits(self.folder, sorted(self._files), seed)
        self._sounds: dict[str, np.ndarray] = {}

    def __getstate__(self) -> dict[str, object]:
        return {"rate": self.rate, "folder": self.folder, "seed": self.seed}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def __iter__(self) -> Iterator[str]:
        return iter(_FORMULA if self.folder is None else sorted(self._files))

    def __len__(self) -> int:
        return len(_FORMULA) if self.folder is None else len(self._files)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._sounds:
            self._sounds[name] = self._make(self.check(name))
        return self._sounds[name]

    def check(self, name: str) -> str:
        """`name`, if there is such a sound. Raises `ConfigError` with the nearest name otherwise."""
        if name not in list(self):
            where = f"in {self.folder}" if self.folder else "in the bank of formulas"
            raise ConfigError(
                f"sound '{name}' is not {where} of {len(self)} sounds{nearest(name, self)}; "
                "`soundspaces-sim nav sounds` lists them"
            )
        return name

    def names(self, split: str) -> tuple[str, ...]:
        """Names of a split. Raises `ConfigError`."""
        if split not in self.splits:
            raise ConfigError(f"sounds of split '{split}': expected one of {', '.join(self.splits)}")
        return self.splits[split]

    def digest(self, name: str) -> str:
        """SHA-256 of a sound's samples: what a cache of responses to it is checked against."""
        return hashlib.sha256(np.ascontiguousarray(self[name], "<f4").tobytes()).hexdigest()

    def _make(self, name: str) -> np.ndarray:
        if self.folder is None:
            family, variant = _FORMULA[name]
            signal = synthesise(family, variant, self.rate, self.seed)
            return _level(signal, f"sound '{name}'")
        return _read_file(self._files[name], self.rate)


_FORMULA: dict[str, tuple[str, int]] = {
    (DEFAULT if (family, k) == ("ring", 0) else f"{family}_{k}"): (family, k)
    for family, (count, _) in FAMILIES.items()
    for k in range(count)
}


def _level(signal: np.ndarray, what: str) -> np.ndarray:
    """RMS 1, or an error."""
    if signal.size == 0:
        raise ConfigError(f"{what}: this sound is empty")
    if not np.isfinite(signal).all():
        raise ConfigError(f"{what}: this sound has samples that are not finite numbers")
    rms = float(np.sqrt(np.mean(np.square(signal, dtype=np.float64))))
    if rms < 1e-6:
        raise ConfigError(f"{what}: this sound is silent (RMS {rms:.1e} of full scale)")
    out = np.asarray(signal / rms, np.float32)
    out.setflags(write=False)
    return out


def _find_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder of sounds; give one with WAV or FLAC files")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in _SUFFIXES:
            if path.stem in files:
                raise ConfigError(
                    f"{path}: there is a second sound of this name, {files[path.stem].name}; rename one"
                )
            files[path.stem] = path
    if not files:
        raise ConfigError(f"{folder}: holds no WAV or FLAC file")
    return files


def _read_file(path: Path, rate: int) -> np.ndarray:
    """Mono, at `rate` Hz, at least a second (padded with zeros), RMS 1 where it sounds."""
    samples, own = read_sound(path, ConfigError, _LONGEST)
    level = _level(mono(samples, own, rate), str(path))
    return level if len(level) >= rate else np.pad(level, (0, rate - len(level)))


def _file_splits(folder: Path, names: list[str], seed: int) -> dict[str, tuple[str, ...]]:
    table = folder / "sounds.toml"
    if table.exists():
        raw = read_toml(table, ConfigError, "table of splits")
        for split, members in raw.items():
            for name in members if isinstance(members, list) else [members]:
                if name not in names:
                    raise ConfigError(
                        f"{table}: {split}: no sound '{name}' in this folder{nearest(str(name), names)}"
                    )
        return {split: tuple(members) for split, members in raw.items()}
    order = list(np.random.default_rng(seed).permutation(names))
    total, out, first = sum(_SHARES.values()), {}, 0.0
    for split, share in _SHARES.items():
        last = first + share / total * len(order)
        out[split] = tuple(sorted(str(n) for n in order[round(first) : round(last)]))
        first = last
    return out
