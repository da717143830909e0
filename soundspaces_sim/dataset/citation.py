"""What to cite for a dataset or a config."""

from __future__ import annotations

from pathlib import Path

from soundspaces_sim.core.citations import bibtex, parts_used
from soundspaces_sim.core.config import JobConfig, SimulationConfig
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.dataset.format.manifest import read_manifest
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.rendering.ears import Ears


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
