"""What to cite for a dataset or a config."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from soundspaces_sim import ConfigError, Ears, JobConfig, RirDataset, SimulationConfig, __version__
from soundspaces_sim.parts import read_manifest

# BibTeX of what a simulation rests on, by what uses it: equations and references are those of docs/theory.md.
#
# `SOURCES` says which works a part of the package follows, references.bib has their BibTeX. A new technique adds
# a row to the first, and to the second what is not there yet.

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
    "diffraction": ("kouyoumjian1974", "deygout1966", "pierce1974", "svensson1999", "rindel1986"),
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
        "locally reacting walls": simulation.law == "angle",
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


def citation(of: RirDataset | JobConfig | SimulationConfig | str | Path | None = None) -> str:
    """BibTeX of the methods, standards and measured sets that something rests on.

    `of`: an open dataset or its folder; a config; None for the default config. An open dataset counts the HRTF set
    that it was opened with, all else MIT's KEMAR. A comment at the head holds what the dataset's maker asks to be
    cited (`dataset.citation`), which is also where the publication of a scene belongs: a mesh does not name it.
    Raises `DatasetError` for a folder without a readable dataset, `ConfigError` for anything else.
    """
    asked, own_ears = "", None
    if isinstance(of, RirDataset):
        config, asked, own_ears = of.manifest.config, of.manifest.config.dataset.citation, _set_of(of)
    elif isinstance(of, (str, Path)):
        config = read_manifest(Path(of)).config
        asked = config.dataset.citation
    elif of is None or isinstance(of, JobConfig):
        config = of or JobConfig()
    elif isinstance(of, SimulationConfig):
        config = JobConfig(simulation=of)
    else:
        raise ConfigError(f"citation: expected a dataset, its folder or a config, got {of!r:.80}")
    head = f"% The dataset's maker asks to cite: {' '.join(asked.split())}\n\n" if asked.strip() else ""
    if own_ears is None:
        return head + bibtex([*parts_used(config), "KEMAR"])
    name = " ".join(Path(own_ears).name.split())
    return (
        f"{head}% Heard with the HRTF set {name}: cite its publication.\n\n{bibtex(parts_used(config))}"
    )


def _set_of(ds: RirDataset) -> str | Path | None:
    """The file of the HRTF set with which a dataset is heard; None: the bundled one."""
    return ds.hrtf.hrtf if isinstance(ds.hrtf, Ears) else ds.hrtf
