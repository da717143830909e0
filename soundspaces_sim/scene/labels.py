"""The map from semantic labels of surfaces to materials.

A label is compared in lower case, as a whole and by the words that it consists of (`find_material`).
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field as dataclass_field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.scene.materials import MaterialTable

_log = logging.getLogger(__name__)
DEFAULT = "default"  # the material of labels without one, unless a label map names another
WITHOUT = "have no material"  # in the note on faces that got the default
_LONGEST_LABEL = 1000  # characters that are looked at


def normalise_label(label: str) -> str:
    """Labels are compared in lower case with '-' for blanks and underscores."""
    return "-".join(label.strip().lower().replace("_", " ").replace("-", " ").split())


def find_material(label: str, label_map: LabelMap, table: MaterialTable) -> tuple[str | None, str]:
    """The material of a label or None, and the words of the label that decided, '' if it was the whole.

    A label may be a material's own name, or a thing and one (``wall-brick``); numbers and a plural at its end are
    ignored if nothing else fits (``Chair.003``, ``windows``). A longer name is looked through for words that are
    known: those for a stuff (materials' names and the map's `words`) go before those for a thing (``glass door``),
    and things before the map's `general` words (``Door - Panel``); of each kind several words together before
    single ones, and later ones before earlier ones (``wall clock``), but the first of several stuffs between
    slashes (``Textile/Wood``).
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
    parts = name.split("-")
    for k in range(1, len(parts)):  # a thing and what it is made of, as generated buildings have it
        made_of = "-".join(parts[k:])
        if "-".join(parts[:k]) in label_map.labels and made_of in stuff:
            return stuff[made_of], ""
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


@dataclass(frozen=True)
class LabelMap:
    """Material name of each normalised label, of `words` for a stuff that may be part of a label, and of labels
    that are not listed. `general`: labels that, as part of a longer one, decide only where no other does."""

    labels: Mapping[str, str]
    default: str = DEFAULT
    words: Mapping[str, str] = dataclass_field(default_factory=dict)
    general: frozenset[str] = frozenset()


def load_labels(
    source: str | Path | Mapping[str, str] | None = None, of_scene: Mapping[str, str] | None = None
) -> LabelMap:
    """The built-in label map, with a scene's own entries and then a user's (mapping or TOML file) put on top."""
    raw = read_toml(resource("materials", "labels.toml"), MaterialError, "file")
    labels, words, default = dict(raw["labels"]), dict(raw["words"]), str(raw["default"])
    labels.update(_entries(of_scene or {}, "labels of the scene"))
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
