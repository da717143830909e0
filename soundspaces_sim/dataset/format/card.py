"""What lies beside a dataset for people: README.md (a card as Hugging Face shows it), datasheet.md, CITATION.cff.

Made from the manifest alone, the same for the same dataset. What only its maker knows is marked as such; files
that are there already are left as they are.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.simulation_config import number_text
from soundspaces_sim.dataset.format.manifest import Manifest, read_manifest, rebuild_command

MAKER = "*To be said by whoever made it.*"
CARDS = ("README.md", "datasheet.md", "CITATION.cff")
_SIZES = ((1e3, "n<1K"), (1e4, "1K<n<10K"), (1e5, "10K<n<100K"), (1e6, "100K<n<1M"), (1e7, "1M<n<10M"))


def write_cards(folder: str | Path) -> list[Path]:
    """Write the files that are not there; their paths. Raises `DatasetError`."""
    folder = Path(folder)
    manifest = read_manifest(folder)
    out = []
    for name, make in zip(CARDS, (_readme, _datasheet, _citation), strict=True):
        path = folder / name
        if not path.exists() and not path.is_symlink():
            publish(path, make(manifest).encode())
            out.append(path)
    return out


def _facts(m: Manifest) -> dict[str, str]:
    bands = m.config.simulation.bands
    size = sum(e.bytes for e in m.shards)
    forms = " and ".join(sorted({f"{e.form}s" for e in m.shards}))
    return {
        "responses": f"{len(m.points) ** 2:,}, between all pairs of {len(m.points)} points",
        "length": f"{m.duration:.2f} s",
        "stored as": f"{forms}, {size / 1e6:,.1f} MB in {len(m.shards)} HDF5 files",
        "bands": ", ".join(f"{low:g}–{high:g} Hz" for low, high in pairwise(bands)),
        "grid": f"{m.config.grid.spacing:g} m",
        "subpaths per point": number_text(m.config.simulation),
        "seed": str(m.config.dataset.seed),
        "code": f"soundspaces_sim {_plain(m.code)}, for {_plain(m.target) or 'a machine not recorded'}",
        "made by": f"`{rebuild_command(m)}`" if rebuild_command(m) else "a command that is not recorded",
        "scene digest": f"`{_plain(m.scene_digest)}`",
        "key": f"`{_plain(m.key)}`",
    }


def _text(name: str) -> str:
    """A scene's name where Markdown and YAML take it for nothing else."""
    return "".join(c if c.isalnum() or c in " ._-" else "_" for c in name)


def _plain(text: str) -> str:
    """A digest, a version or the name of a machine, for which a stranger's manifest may hold anything: within
    quotes in YAML and within a row in Markdown it is text."""
    return "".join(c if c.isalnum() or c in " .,:;+-_=()/" else "_" for c in text[:500])


def _table(m: Manifest) -> str:
    rows = "\n".join(f"| {name} | {value} |" for name, value in _facts(m).items())
    return f"| | |\n|---|---|\n{rows}\n"


def _readme(m: Manifest) -> str:
    count = len(m.points) ** 2
    size = next((label for limit, label in _SIZES if count < limit), "n>10M")
    name = _text(m.scene)
    return f"""\
---
pretty_name: "Room impulse responses of {name}"
license: other
license_name: that-of-the-scene
tags: [room-impulse-response, acoustics, ambisonics, binaural, simulation]
size_categories: ["{size}"]
---

# Room impulse responses of {name}

{_table(m)}
```python
import soundspaces_sim as ss

ds = ss.open_dataset("path/to/this/folder")
ears = ds.binaural(0, 1, heading_deg=90.0)  # (2, n) float32
```

`soundspaces-sim verify --full` says whether every byte of the data is as it was written, `soundspaces-sim report`
makes a page of histograms, maps and sounds. Every pair states the standard error of its early and late energy.
The scene's
licence governs what may be done with the responses, which are derived from it: {MAKER}
"""


def _datasheet(m: Manifest) -> str:
    return f"""\
# Datasheet of {_text(m.scene)}

After Gebru et al., Datasheets for Datasets (2021). What the files say is filled in.

## Motivation
{MAKER}

## Composition
{_table(m)}
A response is energy against time, per band and direction, from a source to a listener, both omnidirectional
points; it becomes a waveform with noise seeded by (dataset seed, source, listener).{_low(m)}
Energies are estimates: their
standard errors are in the shards and in `ds.table()`. Pairs have a status: ok, silent, or failed. No people are
recorded in it.

## Collection process
Simulated from a triangle mesh with a material per face, by bidirectional path tracing with multiple importance
sampling; direct sound and mirror reflections of up to second order are exact. {_edges(m)}
{_modes(m)} Where the mesh and its materials come from: {MAKER}

## Preprocessing
Grid points that are not enclosed, or that no sound reaches from where one can stand, were dropped.

## Uses
Made for training and testing of audio and embodied-AI models, and for auralisation. A model that is to work in real
rooms should be tested in real rooms. Uses that it should not be put to: {MAKER}

## Distribution and maintenance
{MAKER}
"""


def _edges(m: Manifest) -> str:
    if m.config.simulation.diffraction.enabled:
        return (
            "Diffraction is that of the uniform theory, for rigid edges: one, two, or a way round many."
        )
    return "Diffraction round edges was turned off."


def _low(m: Manifest) -> str:
    low = m.config.simulation.low
    if low.method == "rays":
        return ""
    edge = m.config.simulation.bands[1] if low.edge is None else low.edge
    return f" Below {edge:g} Hz pressure and velocity are stored as waves."


def _modes(m: Manifest) -> str:
    low = m.config.simulation.low
    if low.method == "rays":
        return "Not simulated: waves below the transition frequency (modes)."
    return (
        "Waves below the edge are those of a finite-difference solver whose walls react locally, with "
        f"{low.cells_per_wavelength:g} cells per wavelength at the edge."
    )


def _citation(m: Manifest) -> str:
    return f"""\
cff-version: 1.2.0
message: If you use this dataset, please cite it and what it was made with.
title: "Room impulse responses of {_text(m.scene)}"
type: dataset
authors:
  - name: "whoever made this dataset"
identifiers:
  - type: other
    value: "{_plain(m.key)}"
    description: key of the dataset, which its scene, settings and code decide
references:
  - type: software
    title: soundspaces_sim
    version: "{_plain(m.code_version)}"
    authors:
      - name: the soundspaces_sim maintainers
"""
