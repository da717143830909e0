"""Materials and the map from semantic labels to materials.

Conventions: absorption, scattering and transmission are fractions of energy per frequency.
Absorption is what neither returns nor passes through, so absorption + transmission <= 1; the diffuse
share of the reflected rest is the scattering.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.core.numerics.bands import band_means
from soundspaces_sim.core.registry import Entry

_log = logging.getLogger(__name__)
DEFAULT = "default"  # the material of labels without one, unless a label map names another
WITHOUT = "have no material"  # in the note on faces that got the default
_LONGEST_LABEL = 1000  # characters that are looked at
FREE = " (free-hanging)"  # ends the name of a material whose sheets hang free (`scene.porous_layers`)
#: Laws that a material's `reflection` may name, and the modules of `transport.bsdf` that hold them; the first one
#: knows no angles.
REFLECTION_LAWS = {
    "random": Entry(
        "soundspaces_sim.transport.bsdf.random_incidence", "at every angle as at random incidence"
    ),
    "angle": Entry("soundspaces_sim.transport.bsdf.impedance", "by angle, as locally reacting walls do"),
}
_COEFFICIENTS = ("absorption", "scattering", "transmission")


@dataclass(frozen=True)
class MaterialTable:
    """Acoustic coefficients of m materials at k frequencies.

    Parameters
    ----------
    names : (m,) distinct strings
    frequency_hz : (k,) increasing, Hz
    absorption, scattering, transmission : (m, k) energy fractions in [0, 1]
    sheet : (m, k) of materials that are thin and let sound pass where they hang free (`scene.porous_layers`): the
        share that goes through of what a pass does not absorb; NaN of all others, which none is by default
    reflection : (m,) "angle", "random", or "" for what the job says (`SimulationConfig.reflection`), as by default

    Raises `MaterialError` on wrong shapes, values outside [0, 1], or absorption + transmission > 1.
    """

    names: tuple[str, ...]
    frequency_hz: np.ndarray
    absorption: np.ndarray
    scattering: np.ndarray
    transmission: np.ndarray
    sheet: np.ndarray = dataclass_field(default_factory=lambda: np.empty((0, 0)))
    reflection: tuple[str, ...] = dataclass_field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        put = object.__setattr__
        names = tuple(str(name) for name in self.names)
        put(self, "names", names)
        frequency = np.atleast_1d(np.asarray(self.frequency_hz, float))
        put(self, "frequency_hz", frequency)
        if len(set(names)) != len(names) or not names:
            raise MaterialError(f"materials: expected distinct names, at least one, got {names}")
        if frequency.ndim != 1 or len(frequency) == 0 or frequency[0] <= 0.0 or (
            np.any(np.diff(frequency) <= 0.0) or not np.all(np.isfinite(frequency))
        ):  # fmt: skip
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
        reflection = tuple(self.reflection) or ("",) * len(names)
        if len(reflection) != len(names):
            raise MaterialError(f"materials: reflection needs {len(names)} words, got {len(reflection)}")
        for name, how in zip(names, reflection, strict=True):
            if how and how not in REFLECTION_LAWS:
                laws = " or ".join(map(repr, sorted(REFLECTION_LAWS)))
                raise MaterialError(
                    f"materials: reflection of '{name}' must be {laws} (or left out, for what the job says), got "
                    f"{how!r:.40}"
                )
        put(self, "reflection", reflection)
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
        row_of = {name: row for row, name in enumerate(self.names)}
        return np.array([row_of.get(name.removesuffix(FREE), -1) for name in self.names])

    @property
    def free_hanging(self) -> np.ndarray:
        """(m,) which materials are those of sheets that hang free (`FREE`)."""
        return np.array([name.endswith(FREE) for name in self.names])

    def in_bands(self, edges: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(absorption, scattering, transmission), each (m, B): means over bands, see `band_means`."""
        absorption, scattering, transmission = (
            np.clip(band_means(self.frequency_hz, getattr(self, field), edges), 0.0, 1.0)
            for field in _COEFFICIENTS
        )
        return absorption, scattering, limit(absorption, transmission)


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
        (*top.names, *(base.names[i] for i in kept)), frequency, *columns,
        reflection=(*top.reflection, *(base.reflection[i] for i in kept)),
    )  # fmt: skip


def limit(absorption: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    """Transmission that leaves absorption + transmission <= 1.

    Published absorption is measured in a reverberation chamber and counts whatever does not return, so
    where a printed row exceeds 1 it is the transmission that gives way. The one place for this rule.
    """
    return np.minimum(transmission, 1.0 - absorption)


def normalise_label(label: str) -> str:
    """Labels are compared in lower case with '-' for blanks and underscores."""
    return "-".join(label.strip().lower().replace("_", " ").replace("-", " ").split())


def material_of(label: str, label_map: LabelMap, table: MaterialTable) -> str | None:
    """The material of a label, or None; see `find_material`."""
    return find_material(label, label_map, table)[0]


def find_material(label: str, label_map: LabelMap, table: MaterialTable) -> tuple[str | None, str]:
    """The material of a label or None, and the words of the label that decided, '' if it was the whole.

    A label may be a material's own name; numbers and a plural at its end are ignored if nothing else fits
    (``Chair.003``, ``windows``). A longer name is looked through for words that are known: those for a stuff
    (materials' names and the map's `words`) go before those for a thing (``glass door``), and things before the
    map's `general` words (``Door - Panel``); of each kind several words together before single ones, and later
    ones before earlier ones (``wall clock``), but the first of several stuffs between slashes (``Textile/Wood``).
    """
    label = label[:_LONGEST_LABEL]
    name = normalise_label(label)
    bare = re.sub(r"[-.]*\d+$", "", name)
    for candidate in (name, bare, bare.removesuffix("s")):
        if candidate in label_map.labels:
            return label_map.labels[candidate], ""
        if candidate in table.names:
            return candidate, ""
    stuff = {n: n for n in table.names if n != label_map.default} | dict(label_map.words)
    things = {n: m for n, m in label_map.labels.items() if n not in label_map.general}
    for text, known in ((_main_last(label), stuff), (label, things), (label, label_map.labels)):
        found = _last_known(_words_of(text), known)
        if found:
            return found
    return None, ""


def _main_last(label: str) -> str:
    """The label with ``a/b`` turned to ``b/a``: of stuffs that are listed the first is the main one."""
    return re.sub(r"\S+/\S+", lambda found: "/".join(reversed(found[0].split("/"))), label)


def _words_of(label: str) -> list[str]:
    words = re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", label))
    return [word.lower() for word in words]


def _last_known(words: list[str], known: Mapping[str, str]) -> tuple[str, str] | None:
    """Of the known phrases in a text the last one of the most words: what it stands for, and itself."""
    longest = max((phrase.count("-") + 1 for phrase in known), default=0)
    for count in range(min(len(words), longest), 0, -1):
        for first in range(len(words) - count, -1, -1):
            phrase = "-".join(words[first : first + count])
            for candidate in (phrase, phrase.removesuffix("s"), phrase.removesuffix("es")):
                if candidate in known:
                    return known[candidate], phrase
    return None


def load_materials(path: str | Path | None = None) -> MaterialTable:
    """Read a material file (format: materials/materials.toml), by default the built-in database."""
    if not (path is None or isinstance(path, str | Path)):
        raise MaterialError(
            f"materials: expected a table or the path of a TOML file, got {repr(path)[:80]}"
        )
    file = Path(path) if path is not None else resource("materials", "materials.toml")
    raw = read_toml(file, MaterialError, "file")
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
            tuple(rows), np.array(raw["frequency_hz"], float),
            arrays["absorption"], arrays["scattering"], transmission, np.array(sheet, float),
            reflection=tuple(row.get("reflection", "") for row in rows.values()),
        )  # fmt: skip
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


def stack_materials(own: MaterialTable | str | Path | None = None) -> MaterialTable:
    """The built-in database with a user's table or file, if there is one, on top."""
    table = load_materials()
    if own is None:
        return table
    return overlay(table, own if isinstance(own, MaterialTable) else load_materials(own))


@dataclass(frozen=True)
class LabelMap:
    """Material name of each normalised label, of `words` for a stuff that may be part of a label, and of labels
    that are not listed. `general`: labels that, as part of a longer one, decide only where no other does."""

    labels: Mapping[str, str]
    default: str = DEFAULT
    words: Mapping[str, str] = dataclass_field(default_factory=dict)
    general: frozenset[str] = frozenset()


def load_labels(source: str | Path | Mapping[str, str] | None = None) -> LabelMap:
    """The built-in label map, with a user's entries (mapping or TOML file) put on top."""
    raw = read_toml(resource("materials", "labels.toml"), MaterialError, "file")
    labels, words, default = dict(raw["labels"]), dict(raw["words"]), str(raw["default"])
    if isinstance(source, Mapping):
        labels.update(_entries(source, "labels"))
    elif source is not None:
        own = read_toml(source, MaterialError, "file")
        materials = {"frequency_hz", "materials"}  # one file may hold both, for --materials and --labels
        unknown = sorted(set(own) - {"default", "labels", "words"} - materials)
        if unknown:
            raise MaterialError(
                f"{source}: unknown setting '{unknown[0]}'; expected [labels], [words] and `default`"
            )
        labels.update(_entries(own.get("labels", {}), f"{source}: [labels]"))
        words.update(_entries(own.get("words", {}), f"{source}: [words]"))
        default = str(own.get("default", default))
    return LabelMap(labels, default, words, frozenset(raw["general"]))


def _entries(raw: Any, where: str) -> dict[str, str]:
    """Normalised labels and names of materials."""
    if not isinstance(raw, Mapping) or not all(
        isinstance(k, str) and isinstance(v, str) for k, v in raw.items()
    ):
        raise MaterialError(f"{where}: expected names of materials per label, got {raw!r:.80}")
    return {normalise_label(k): v for k, v in raw.items()}


class Assigned(NamedTuple):
    """`rows` (F,) of the table; `notes`: which labels were matched by a word, and `lost`, which not at all."""

    rows: np.ndarray
    notes: tuple[str, ...]
    lost: str = ""


def assign_materials(
    labels: Sequence[str],
    face_label: np.ndarray,
    face_area: np.ndarray,
    table: MaterialTable,
    label_map: LabelMap,
    strict: bool = False,
) -> Assigned:
    """A material for every face, from its label ((F,) row of `labels`, -1 = none).

    Labels without a material get the default, with one warning that counts faces and area; with
    `strict`, that is a `MaterialError`.
    """
    default = table.index(label_map.default)
    rows = np.empty(len(labels) + 1, np.int64)
    rows[-1] = default
    unmapped = np.zeros(len(labels) + 1, bool)
    unmapped[-1] = bool(len(labels))
    guessed: list[str] = []
    used = set(np.unique(face_label).tolist())
    for i, label in enumerate(labels):
        name, words = find_material(label, label_map, table)
        unmapped[i] = name is None
        rows[i] = table.index(name) if name is not None else default
        if words and i in used:
            guessed.append(f"'{label}' by '{words}' {name}")
    notes: list[str] = []
    if guessed:
        notes.append(f"labels matched by a word: {_some(guessed)} (override with labels=)")
    hit = unmapped[face_label]
    if hit.any() or (strict and not len(labels)):
        names = sorted({labels[i] for i in np.unique(face_label[hit]) if i >= 0})
        area, share = face_area[hit].sum(), 100.0 * face_area[hit].sum() / max(face_area.sum(), 1e-300)
        what = f"{int(hit.sum())} faces ({area:.1f} m2, {share:.1f} % of the area) {WITHOUT}"
        if not len(labels):
            what = f"none of {len(face_label)} faces has a label"
        which = f"; labels without an entry: {_some(names)}" if names else ""
        if strict:
            raise MaterialError(
                f"{what}{which}; add them under [labels] in a file of yours (--labels), or leave out "
                "--strict-materials"
            )
        lost = f"{what} and get '{label_map.default}'{which}"
        _log.warning("%s", lost)
        return Assigned(rows[face_label], (*notes, lost), lost)
    return Assigned(rows[face_label], tuple(notes))


def _some(items: list[str], most: int = 8) -> str:
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(items[:most]) + more
