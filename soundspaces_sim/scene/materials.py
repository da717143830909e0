"""Materials: coefficients, reflection law and mounting of each, in one table.

Conventions: absorption, scattering and transmission are fractions of energy per frequency.
Absorption is what neither returns nor passes through, so absorption + transmission <= 1; the diffuse
share of the reflected rest is the scattering.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field as dataclass_field
from functools import cache, reduce
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.core.numerics.bands import band_means
from soundspaces_sim.core.numerics.reflection_laws import REFLECTION_LAWS

FREE = " (free-hanging)"  # ends the name of a material of layers that hang free (`scene.porous_layers`)
MOUNTINGS = ("wall", "free")
_COEFFICIENTS = ("absorption", "scattering", "transmission")
_read_once = cache(read_toml)  # of the built-in database, which takes 10 ms


@dataclass(frozen=True)
class MaterialTable:
    """Acoustic coefficients of m materials at k frequencies.

    Raises `MaterialError` on wrong shapes, values outside [0, 1], or absorption + transmission > 1.

    Parameters
    ----------
    names : (m,) distinct strings
    frequency_hz : (k,) increasing, Hz
    absorption, scattering, transmission : (m, k) energy fractions in [0, 1]
    sheet : (m, k) of materials that are thin and let sound pass where they hang free (`scene.porous_layers`): the
        share that goes through of what a pass does not absorb; NaN of all others, which none is by default
    reflection : (m,) a law of `REFLECTION_LAWS`, or "" for what the job says (`SimulationConfig.reflection`),
        as by default
    mounting : (m,) "free" for thin layers that hang free in air, "wall" for all others; by default "free" for
        names that end in `FREE`
    """

    names: tuple[str, ...]
    frequency_hz: np.ndarray
    absorption: np.ndarray
    scattering: np.ndarray
    transmission: np.ndarray
    sheet: np.ndarray = dataclass_field(default_factory=lambda: np.empty((0, 0)))
    reflection: tuple[str, ...] = dataclass_field(default=(), kw_only=True)
    mounting: tuple[str, ...] = dataclass_field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        put = object.__setattr__
        names = tuple(str(name) for name in self.names)
        put(self, "names", names)
        frequency = np.atleast_1d(np.asarray(self.frequency_hz, float))
        put(self, "frequency_hz", frequency)
        if len(set(names)) != len(names) or not names:
            raise MaterialError(f"materials: expected distinct names, at least one, got {names}")
        if (
            frequency.ndim != 1
            or len(frequency) == 0
            or frequency[0] <= 0.0
            or (np.any(np.diff(frequency) <= 0.0) or not np.all(np.isfinite(frequency)))
        ):
            raise MaterialError(
                f"materials: frequency_hz must increase from above 0, got {self.frequency_hz}"
            )
        expected = (len(names), len(frequency))
        for field in _COEFFICIENTS:
            values = np.array(getattr(self, field), float)
            if values.shape != expected:
                raise MaterialError(
                    f"materials: {field} has shape {values.shape}, expected {expected} "
                    "(materials, frequencies)"
                )
            bad = ~((values >= 0.0) & (values <= 1.0)).all(axis=1)
            if bad.any():
                i = int(bad.argmax())
                raise MaterialError(
                    f"materials: {field} of '{names[i]}' must lie in [0, 1], got {values[i]}"
                )
            values.setflags(write=False)
            put(self, field, values)
        sheet = np.array(self.sheet, float) if np.size(self.sheet) else np.full(expected, np.nan)
        if sheet.shape != expected or ((sheet < 0.0) | (sheet > 1.0)).any():
            raise MaterialError(
                f"materials: sheet needs shape {expected} and shares in [0, 1], or NaN; got {sheet.shape}"
            )
        sheet.setflags(write=False)
        put(self, "sheet", sheet)
        put(
            self,
            "reflection",
            _words(names, "reflection", self.reflection, ("", *sorted(REFLECTION_LAWS))),
        )
        by_name = tuple("free" if name.endswith(FREE) else "wall" for name in names)
        put(self, "mounting", _words(names, "mounting", self.mounting or by_name, MOUNTINGS))
        total = (self.absorption + self.transmission).max(axis=1)
        if total.max() > 1.0 + 1e-9:
            i = int(total.argmax())
            raise MaterialError(
                f"materials: absorption + transmission of '{names[i]}' reaches {total[i]:.3f}; they "
                "share the energy that is not reflected and may not exceed 1"
            )

    def __repr__(self) -> str:
        low, high = self.frequency_hz[[0, -1]]
        names = ", ".join(self.names[:6]) + (", …" if len(self.names) > 6 else "")
        return f"MaterialTable: {len(self.names)} materials at {low:g} to {high:g} Hz: {names}"

    def index(self, name: str) -> int:
        """Row of a material; `MaterialError` if there is none of that name."""
        try:
            return self.names.index(name)
        except ValueError:
            raise MaterialError(f"no material '{name}'; there are: {', '.join(self.names)}") from None

    @property
    def mounted_rows(self) -> np.ndarray:
        """(m,) row that each material has when it is mounted on a wall: its own, and of one that hangs free
        (`FREE`) that of the material of the same name, or -1 if there is none."""
        on_wall = {n: r for r, n in enumerate(self.names) if self.mounting[r] == "wall"}
        return np.array(
            [
                row if mounting == "wall" else on_wall.get(name.removesuffix(FREE), -1)
                for row, (name, mounting) in enumerate(zip(self.names, self.mounting, strict=True))
            ]
        )

    @property
    def free_hanging(self) -> np.ndarray:
        """(m,) which materials are those of layers that hang free."""
        return np.array([mounting == "free" for mounting in self.mounting])

    def content(self) -> bytes:
        """All that decides the sound: coefficients, laws, and mountings with what each layer is on a wall. Names
        beside that decide nothing. For digests (`Scene.digest`)."""
        columns = self.frequency_hz, *(getattr(self, field) for field in _COEFFICIENTS)
        parts = [np.ascontiguousarray(column, "<f8").tobytes() for column in columns]
        if any(self.reflection):
            parts.append(" ".join(map(repr, self.reflection)).encode())
        free = np.flatnonzero(self.free_hanging)
        if len(free):
            parts.append(f"free-hanging {free.tolist()} {self.mounted_rows[free].tolist()}".encode())
        return b"".join(parts)

    def in_bands(self, edges: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(absorption, scattering, transmission), each (m, B): means over bands, see `band_means`."""
        absorption, scattering, transmission = (
            np.clip(band_means(self.frequency_hz, getattr(self, field), edges), 0.0, 1.0)
            for field in _COEFFICIENTS
        )
        return absorption, scattering, limit(absorption, transmission)


def _words(
    names: tuple[str, ...], what: str, words: Sequence[str], allowed: tuple[str, ...]
) -> tuple[str, ...]:
    """(m,) words of materials' `what`, checked; none are all the first one that is allowed."""
    words = tuple(words) or allowed[:1] * len(names)
    if len(words) != len(names):
        raise MaterialError(f"materials: {what} needs {len(names)} words, got {len(words)}")
    for name, word in zip(names, words, strict=True):
        if word not in allowed:
            expected = " or ".join(repr(a) for a in allowed if a)
            rest = " (or left out, for what the job says)" if "" in allowed else ""
            raise MaterialError(
                f"materials: {what} of '{name}' must be {expected}{rest}, got {word!r:.40}"
            )
    return words


def overlay(base: MaterialTable, top: MaterialTable) -> MaterialTable:
    """`top`'s materials and those of `base` that it does not name, at the frequencies of both.

    A table is a staircase over log frequency (see `band_means`): each takes its nearest given value.
    """
    frequency = np.union1d(base.frequency_hz, top.frequency_hz)
    kept = [i for i, name in enumerate(base.names) if name not in top.names]

    def at(table: MaterialTable, values: np.ndarray) -> np.ndarray:
        steps = np.sqrt(table.frequency_hz[:-1] * table.frequency_hz[1:])
        return values[:, np.searchsorted(steps, frequency, "right")]

    columns = [
        np.concatenate([at(top, getattr(top, field)), at(base, getattr(base, field))[kept]])
        for field in (*_COEFFICIENTS, "sheet")
    ]
    return MaterialTable(
        (*top.names, *(base.names[i] for i in kept)),
        frequency,
        *columns,
        reflection=(*top.reflection, *(base.reflection[i] for i in kept)),
        mounting=(*top.mounting, *(base.mounting[i] for i in kept)),
    )


def limit(absorption: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    """Transmission that leaves absorption + transmission <= 1.

    Published absorption is measured in a reverberation chamber and counts whatever does not return, so
    where a printed row exceeds 1 it is the transmission that gives way. The one place for this rule.
    """
    return np.minimum(transmission, 1.0 - absorption)


def load_materials(path: str | Path | None = None) -> MaterialTable:
    """Read a material file (format: materials/materials.toml), by default the built-in database."""
    if not (path is None or isinstance(path, str | Path)):
        raise MaterialError(
            f"materials: expected a table or the path of a TOML file, got {repr(path)[:80]}"
        )
    file = Path(path) if path is not None else resource("materials", "materials.toml")
    raw = (_read_once if path is None else read_toml)(file, MaterialError, "file")
    rows = raw.get("materials")
    if not isinstance(rows, dict) or not rows or "frequency_hz" not in raw:
        raise MaterialError(
            f"{file}: expected `frequency_hz = [...]` and at least one [materials.<name>] table"
        )
    columns: dict[str, list[Any]] = {field: [] for field in _COEFFICIENTS}
    for name, row in rows.items():
        for field in _COEFFICIENTS:
            if not isinstance(row, dict) or field not in row:
                raise MaterialError(f"{file}: material '{name}' has no `{field}`")
            columns[field].append(row[field])
    try:
        arrays = {field: np.array(values, float) for field, values in columns.items()}
        transmission = limit(arrays["absorption"], arrays["transmission"])
        sheet = [
            _sheet(row.get("sheet", False), a)
            for row, a in zip(rows.values(), arrays["absorption"], strict=True)
        ]
        return MaterialTable(
            tuple(rows),
            np.array(raw["frequency_hz"], float),
            arrays["absorption"],
            arrays["scattering"],
            transmission,
            np.array(sheet, float),
            reflection=tuple(row.get("reflection", "") for row in rows.values()),
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise MaterialError(
            f"{file}: every coefficient needs as many numbers as `frequency_hz` ({error})"
        ) from error
    except MaterialError as error:
        raise MaterialError(f"{file}: {error}") from error


def porous_share(absorption: np.ndarray) -> np.ndarray:
    """Share, of what a thin porous sheet does not absorb in a pass, that goes through it.

    At normal incidence a sheet of flow resistance r (over that of air) absorbs 4 r / (2 + r)², at most half, and
    transmits 4 / (2 + r)² (Kuttruff, Room Acoustics).
    """
    a = np.minimum(np.asarray(absorption, float), 0.5)
    r = np.where(a > 0.0, 2.0 * (1.0 - a - np.sqrt(1.0 - 2.0 * a)) / np.maximum(a, 1e-12), 0.0)
    return np.asarray(4.0 / (4.0 + r**2))


def pass_absorption(absorption: np.ndarray) -> np.ndarray:
    """What a pass absorbs of a sheet that takes `absorption` before a wall, where it is passed twice."""
    return np.asarray(1.0 - np.sqrt(1.0 - absorption))


def _sheet(given: Any, absorption: np.ndarray) -> np.ndarray:
    """(k,) shares of a row's `sheet`: true (as a porous sheet does), a number, one per frequency, or false."""
    if given is True:
        return porous_share(pass_absorption(absorption))
    return np.full(len(absorption), np.nan) if given is False else np.zeros(len(absorption)) + given


def stack_materials(
    own: MaterialTable | str | Path | None = None, of_scene: Iterable[MaterialTable] = ()
) -> MaterialTable:
    """The built-in database with a scene's tables and then a user's table or file, if there are any, on top."""
    table = reduce(overlay, of_scene, load_materials())
    if own is None:
        return table
    return overlay(table, own if isinstance(own, MaterialTable) else load_materials(own))
