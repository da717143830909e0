"""What agents learn and are tested in: the datasets of a folder, parted into splits (`dataset.format.splits`)."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.core.keywords import nearest
from soundspaces_sim.dataset.format.manifest import NAME, datasets_in
from soundspaces_sim.dataset.format.splits import SPLITS, read_splits, scenes_of_split
from soundspaces_sim.dataset.reader import RirDataset, open_dataset
from soundspaces_sim.nav.navigation_graph import NavigationGraph
from soundspaces_sim.rendering.renderers import check_renderer


class NavData:
    """`root`; `splits`: scenes by split; `renderer`: a name of `rendering.renderers` that is heard instead of the
    datasets' own; `hrtf`: a SOFA file of the ears, instead of KEMAR's. Datasets and worlds are opened when first
    asked for; a pickle is the path, the renderer and the ears.
    Raises `ConfigError` for splits that share a scene or name a missing one, and for an unknown renderer,
    `DatasetError` if there is no dataset."""

    def __init__(
        self, root: str | Path, renderer: str | None = None, hrtf: str | Path | None = None
    ) -> None:
        self.root, self.renderer, self.hrtf = Path(root), renderer, hrtf
        if renderer is not None:
            check_renderer(renderer)
        found = [folder.name for folder in datasets_in(self.root)]
        if not found:
            raise DatasetError(
                f"no dataset in a folder in {self.root}; make one with `make rirs SCENE=home-0 OUT={self.root} "
                "SPACING=1`"
            )
        self.splits = read_splits(self.root / SPLITS, found)
        self._datasets: dict[str, RirDataset] = {}
        self._graphs: dict[str, NavigationGraph] = {}

    def __getstate__(self) -> dict[str, Path | str | None]:
        return {"root": self.root, "renderer": self.renderer, "hrtf": self.hrtf}

    def __setstate__(self, state: dict[str, Path | str | None]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def scenes(self, split: str) -> tuple[str, ...]:
        """Names of a split's scenes. Raises `ConfigError` for an unknown split."""
        return scenes_of_split(self.root, self.splits, split)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All scenes of all splits."""
        return tuple(scene for scenes in self.splits.values() for scene in scenes)

    def dataset(self, scene: str) -> RirDataset:
        """The dataset of a scene. Raises `ConfigError` if there is none."""
        if scene not in self._datasets:
            if not (self.root / scene / NAME).is_file():
                raise ConfigError(
                    f"scene '{scene}' has no dataset in {self.root}: there are {', '.join(self.names[:12])}"
                    f"{' …' if len(self.names) > 12 else ''}{nearest(scene, self.names)}"
                )
            self._datasets[scene] = open_dataset(
                self.root / scene, hrtf=self.hrtf, renderer=self.renderer
            )
        return self._datasets[scene]

    def graph(self, scene: str) -> NavigationGraph:
        """The scene as an agent sees it."""
        if scene not in self._graphs:
            self._graphs[scene] = NavigationGraph(self.dataset(scene))
        return self._graphs[scene]

    def close(self) -> None:
        """Close all files."""
        for ds in self._datasets.values():
            ds.close()
