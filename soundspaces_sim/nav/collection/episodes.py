"""Episodes of a collection: of each building as many, drawn by the building's own number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from soundspaces_sim.nav.collection.make import Collection
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episodes import Episode, read_episodes, write_episodes
from soundspaces_sim.nav.errors import EpisodeError
from soundspaces_sim.nav.generate import EpisodeMaker, Rules
from soundspaces_sim.nav.sounds import DEFAULT, SoundBank

FOLDER = "episodes/replica/v1"
Log = Callable[[str], None]


def write_all(of: Collection, log: Log) -> dict[str, int]:
    """Write ``episodes/replica/v1/<split>/`` for all splits; how many episodes each building has. Those that are
    there
    are kept. A building in whose graph no walk is long enough has none: agents walk on the grid, and one of 1 m
    does not pass every door."""
    data = NavData(of.out)
    bank = SoundBank(of.config.dataset.rate)
    counts: dict[str, int] = {}
    for split in data.splits:
        maker = EpisodeMaker(data, split, bank, (DEFAULT,), Rules())
        folder = of.out / FOLDER / split
        found: list[Episode] = []
        for name in data.scenes(split):
            some = _kept(folder / "content" / f"{name}.json.gz", data, of.episodes) or _drawn(
                maker, name, of.episodes
            )
            counts[name] = len(some)
            found += some
        write_episodes(found, folder)
        log(f"episodes: {len(found):,} of split {split}")
    data.close()
    return counts


def _kept(path: Path, data: NavData, count: int) -> Sequence[Episode]:
    """Those of a file, if they are as many as are wanted."""
    if not path.exists():
        return ()
    found = read_episodes(path, data)
    return found if len(found) == count else ()


def _drawn(maker: EpisodeMaker, name: str, count: int) -> Sequence[Episode]:
    rng = np.random.default_rng((maker.seed, int(name.rpartition("-")[2])))
    try:
        return [maker.draw(rng, f"{name}-{k}", name) for k in range(count)]
    except EpisodeError:
        return ()
