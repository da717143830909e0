"""`make collection`, stage by stage: forecast, datasets, splits, episodes, statistics, manifest, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_collections import report
from soundspaces_collections.make import (
    Collection,
    Log,
    Progress,
    check_room,
    cores_of,
    forecast_collection,
    make_all,
    split_of,
)
from soundspaces_collections.records import NAME, Record
from soundspaces_sim import JobConfig, __version__
from soundspaces_sim.nav import Episode, NavData, SoundBank, read_episodes, write_episodes
from soundspaces_sim.parts import (
    DEFAULT_SOUND as DEFAULT,
    EPISODES_FOLDER as FOLDER,
    SPLITS,
    CollectionFailure as Failure,
    CollectionManifest,
    EpisodeError,
    EpisodeMaker,
    EpisodeRules as Rules,
    collected_dataset as collected,
    files_beside as beside,
    make_folder,
    need_extras as need,
    publish_file as publish,
    write_collection,
    write_splits,
)

LOG = "log.txt"


def build_collection(
    out: str | Path,
    homes: int = 1000,
    config: JobConfig | None = None,
    jobs: int | None = None,
    engine: str = "local",
    options: Mapping[str, Any] | Sequence[str] = (),
    kind: str = "home",
    episodes_each: int = 20,
    report_to: Path | None = None,
    say: Log = print,
    progress: Progress | None = None,
    finish: bool = False,
) -> CollectionManifest:
    """Buildings ``<kind>-0`` to ``<kind>-<homes - 1>`` as one collection in `out`; goes on where it was stopped.

    `config`: settings of every dataset. `jobs`: processes here, a building each. `engine`, `options`: another
    engine of `build.engines`. `episodes_each`: of each building. `report_to`: a file for the report, by default
    ``report.md`` in
    `out`. `finish`: make no more datasets; close with those that are there. Raises `ConfigError`, `DatasetError`
    and `SimulationError`; what goes wrong with one building is in the manifest's failures.
    """
    need("this command", "figures")
    of = Collection(Path(out), homes, config or JobConfig(), kind, episodes_each)
    make_folder(of.out, "choose another --out")
    log = _Log(of.out / LOG, say)
    if finish:
        records = report.described(of, jobs, log)
    else:
        _announce(of, jobs, log)
        records = make_all(of, jobs, engine, options, log, progress or _quiet)
    return close(of, records, report_to, log)


def close(
    of: Collection, records: Mapping[str, Record], report_to: Path | None, log: Log
) -> CollectionManifest:
    """Splits, episodes, manifest and report of the buildings that are finished."""
    names = [
        name for name in of.names if name in records and records[name].described and of.is_whole(name)
    ]
    if not names:
        failures = [f"{r.scene}: {r.error}" for r in records.values() if r.error]
        raise report.nothing(of, failures)
    splits: dict[str, tuple[str, ...]] = {}
    for split in ("train", "val", "test"):
        chosen = tuple(name for name in names if split_of(name) == split)
        if chosen:
            splits[split] = chosen
    write_splits(of.out, splits)
    counts = _write_episodes(of, log)
    failed = tuple(
        Failure(scene=r.scene, error=r.error)
        for name, r in records.items()
        if name not in names and r.error
    )
    files = report.write_all(of, {name: records[name] for name in names}, failed, counts, report_to, log)
    manifest = CollectionManifest(
        licence=of.config.dataset.licence,
        citation=of.config.dataset.citation,
        command=f"soundspaces-sim collection --homes {of.count}",
        code_version=__version__,
        scenes=tuple(collected(of.out / name) for name in names),
        failures=failed,
        files=beside(
            of.out,
            [
                *(*files, of.out / SPLITS, of.out / NAME),
                *sorted((of.out / FOLDER).rglob("*.json.gz")),
            ],
        ),
    )
    write_collection(of.out, manifest)
    log(
        f"{len(names)} datasets, {manifest.pairs:,} responses, {manifest.bytes / 1e9:.2f} GB; {len(failed)} failed"
    )
    return manifest


def _announce(of: Collection, jobs: int | None, log: Log) -> None:
    expected = forecast_collection(of, log)
    if expected.left == 0:
        return
    if expected.basis == 0:
        log(f"{expected.left:,} to make; none that was tried tells how long")
        return
    basis = f"{expected.basis} {'finished' if expected.finished else 'measured'} buildings"
    hours, error = expected.core_s / 3600.0, expected.core_s_error / 3600.0
    about = f"{hours:.2g}" if expected.basis == 1 else f"{hours:.2g} ± {error:.2g}"
    log(
        f"forecast, from {basis}: {expected.left:,} to make, {about} core-hours, "
        f"{hours / cores_of(jobs):.2g} h on {cores_of(jobs)} cores, {expected.bytes / 1e9:.2g} GB"
    )
    check_room(of, expected)


class _Log:
    """Lines to a file, with the time, and to `say`."""

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        self._path, self._say = path, say
        if not path.exists():
            publish(path, b"")

    def __call__(self, line: str) -> None:
        with open(self._path, "a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")
        self._say(line)


def _quiet(done: int, total: int, what: str) -> None:
    """Tells nobody."""


def _write_episodes(of: Collection, log: Log) -> dict[str, int]:
    """Write ``episodes/replica/v1/<split>/`` for all splits; how many episodes each building has. Those that are
    there are kept. A building in whose graph no walk is long enough has none: agents walk on the grid, and one of
    1 m does not pass every door."""
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
