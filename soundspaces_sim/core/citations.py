"""BibTeX of what a simulation rests on, by what uses it: equations and references are those of docs/theory.md.

`SOURCES` says which works a part of the package follows, references.bib has their BibTeX. A new technique adds a
row to the first, and to the second what is not there yet.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from soundspaces_sim.core.config import JobConfig
from soundspaces_sim.core.version import __version__

#: Keys of references.bib by part of the package.
SOURCES: dict[str, tuple[str, ...]] = {
    "package": ("soundspaces_sim", "chen2020soundspaces"),
    "path tracing": (
        "siltanen2007",
        "veach1995",
        "georgiev2012",
        "cao2016",
        "wilkie2014",
        "cerou2007",
        "kahn1953",
        "allen1979",
    ),
    "radiance transfer": ("siltanen2007", "bai2015"),
    "diffraction": ("kouyoumjian1974", "pierce1974", "svensson1999", "rindel1986"),
    "locally reacting walls": ("paris1928", "kuttruff2009"),
    "scattering by size": ("rindel1986", "christensen2005"),
    "air": ("iso9613",),
    "error bars": ("mccarthy1969", "smyth2004", "iso3382"),
    "denoising": ("starck1994", "gao1997"),
    "binaural decoding": ("zaunschirm2018", "vilkamo2013"),
    "KEMAR": ("gardner1994",),
    "tasks": ("wen2008", "lebart2001", "leroux2019", "merimaa2005", "owen2007", "liu2025"),
}


@cache
def entries() -> dict[str, str]:
    """BibTeX by key: what is in references.bib, with the version of this package."""
    text = (
        (Path(__file__).parent / "references.bib").read_text("utf-8").replace("@VERSION@", __version__)
    )
    return {
        found[1]: found[0]
        for found in re.finditer(r"^@\w+\{(\w+),\n.*?^\}\n", text, re.DOTALL | re.MULTILINE)
    }


def parts_used(config: JobConfig) -> list[str]:
    """Rows of `SOURCES` that a dataset with this config rests on, but for whose ears."""
    simulation = config.simulation
    used = {
        "package": True,
        "path tracing": True,
        "radiance transfer": simulation.radiance_transfer.enabled,
        "diffraction": simulation.diffraction.enabled,
        "locally reacting walls": simulation.reflection == "angle",
        "scattering by size": simulation.scattering == "size",
        "air": simulation.air_absorption,
        "error bars": True,
        "denoising": simulation.denoise,
        "binaural decoding": True,
    }
    return [part for part, wanted in used.items() if wanted]


def bibtex(parts: Iterable[str]) -> str:
    """The BibTeX of these rows of `SOURCES`, each work once, in their order."""
    keys = dict.fromkeys(key for part in parts for key in SOURCES[part])
    return "\n".join(entries()[key] for key in keys)
