"""README, datasheet and report of a collection, from its records alone; the pictures need its scenes."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from soundspaces_pictures import draw_plan
from soundspaces_pictures.plan import BLUE, VERMILION
from soundspaces_rooms.many_rooms import in_processes

from soundspaces_collections.axonometric import above_picture, inside_picture, write_small
from soundspaces_collections.make import Collection, Log, Task, make_task, split_of
from soundspaces_collections.records import Record, add_record, edges_of, read_records
from soundspaces_collections.rooms import compared, histogram, times_by_use
from soundspaces_sim import DatasetError, JobConfig, __version__, load_scene
from soundspaces_sim.nav import depth_views
from soundspaces_sim.parts import (
    HEADINGS,
    MAKER,
    CollectionFailure as Failure,
    make_folder,
    number_text,
    publish_file as publish,
    read_floorplan,
    read_manifest,
    storeys_of,
)

_AIM = 1000  # buildings that the forecast is of
#: Of the seed paper's table of datasets (ECCV 2020, Table "Summary of SoundSpaces dataset properties").
_PAPER = (
    ("SoundSpaces, Replica", "18", "0.5 m", "44.1 kHz", "97", "47.24 m²", "", "100,000", "1,000"),
    ("SoundSpaces, Matterport3D", "85", "1 m", "16 kHz", "243", "517.34 m²", "", "2,000,000", "1,000"),
)


def described(of: Collection, jobs: int | None, log: Log) -> dict[str, Record]:
    """Records of the buildings that are finished, described if they are not yet, and of those that failed."""
    found = read_records(of.out)
    whole = [name for name in of.names if of.is_whole(name)]
    tasks = [Task(n, of.out, of.config, False) for n in whole if not (n in found and found[n].described)]
    for record in in_processes(make_task, tasks, jobs):
        add_record(of.out, record)
        log(f"{record.scene}: {record.error or 'described'}")
    found = read_records(of.out)
    return {n: found[n] for n in of.names if n in found and (n in whole or found[n].error)}


def nothing(of: Collection, failures: Sequence[str]) -> DatasetError:
    """The error where no building was finished."""
    why = f"; the first failed: {failures[0]}" if failures else ""
    return DatasetError(f"{of.out}: no dataset is finished{why}")


def write_all(
    of: Collection,
    records: Mapping[str, Record],
    failed: Sequence[Failure],
    episodes: Mapping[str, int],
    report_to: Path | None,
    log: Log,
) -> list[Path]:
    """README.md, datasheet.md, report.md and figures/ in the folder; the report once more at `report_to`, with its
    pictures in figures/ beside it. Returns the files in the folder."""
    bands = of.config.simulation.bands
    pictures = write_figures(of.out, of.out / "figures", records, bands)
    text = report(of, records, failed, episodes)
    files = {
        "report.md": text,
        "README.md": _readme(of, records),
        "datasheet.md": _datasheet(of, records),
    }
    for name, content in files.items():
        publish(of.out / name, content.encode())
    if report_to is not None:
        folder = make_folder(report_to.parent / "figures", "choose another --report")
        for picture in pictures:
            shutil.copyfile(picture, folder / picture.name)
        publish(report_to, text.encode())
    log(f"report: {report_to or of.out / 'report.md'}")
    return [*pictures, *(of.out / name for name in files)]


def report(
    of: Collection, records: Mapping[str, Record], failed: Sequence[Failure], episodes: Mapping[str, int]
) -> str:
    """The whole page, in Markdown."""
    rows = list(records.values())
    pairs, size = sum(r.points**2 for r in rows), sum(r.bytes for r in rows)
    parts = [
        f"# A collection of {of.kind}s\n",
        f"{len(rows)} of the generated buildings `{of.kind}-<n>` ([Your own "
        f"scene](../buildings/README.md)), each with "
        f"all room impulse responses between its points: {pairs:,} in {size / 1e9:.2f} GB, "
        f"{size / pairs / 1e3:.2f} kB "
        f"each. Made and described by `make collection HOMES={of.count}` (version {__version__}); "
        f"licence {of.config.dataset.licence or 'not stated'}.\n",
        _beside_the_paper(of, rows, episodes),
        "## Splits\n\nBy building: of ten, the ninth is for validation and the tenth for tests, so that none "
        "changes its "
        "split when more are made.\n",
        _splits(records, episodes),
        "## Time and size\n",
        _cost(rows, failed),
        "## Error bars\n",
        _errors(of.config, rows),
        "## Room acoustics\n",
        _acoustics(of, rows),
        f"![distributions](figures/{DISTRIBUTIONS})\n",
        "Values beyond the ends of an axis are in its outermost bins.\n",
        f"![some of the buildings](figures/{BUILDINGS})\n",
    ]
    return "\n".join(parts)


def _beside_the_paper(of: Collection, rows: Sequence[Record], episodes: Mapping[str, int]) -> str:
    def count(split: str) -> int:
        return sum(n for name, n in episodes.items() if split_of(name) == split)

    own = (
        f"this, {of.kind}s",
        f"{len(rows):,}",
        f"{of.config.grid.spacing:g} m",
        f"{of.config.dataset.rate / 1000:g} kHz",
        f"{np.mean([r.points for r in rows]):.0f}",
        f"{np.mean([r.area for r in rows]):.1f} m²",
        f"{sum(r.points**2 for r in rows):,}",
        f"{count('train'):,}",
        f"{count('test'):,}",
    )
    head = (
        "Dataset",
        "Scenes",
        "Resolution",
        "Sampling rate",
        "Mean nodes",
        "Mean area",
        "Responses",
        "Training episodes",
        "Test episodes",
    )
    without = [r.scene for r in rows if not episodes.get(r.scene)]
    largest = np.mean([r.largest for r in rows])
    none = (
        f"; {len(without)} buildings have no episode, as none of their walks is 4 m long with a detour of 1.1"
        if without
        else ""
    )
    return _table(head, [own, *_PAPER]) + (
        "\nThe rows on SoundSpaces are those of its paper. Sampling rates are the reader's default here: "
        "echograms are stored, and waveforms of any rate made of them. On a grid of "
        f"{of.config.grid.spacing:g} m not every door is passed: the largest connected part of the navigation "
        f"graph has {100 * largest:.0f} % of the nodes in the mean{none}. A finer grid passes more "
        "of them; half the spacing has some sixteen times the pairs.\n"
    )


def _splits(records: Mapping[str, Record], episodes: Mapping[str, int]) -> str:
    rows = []
    for split in ("train", "val", "test"):
        names = [n for n in records if split_of(n) == split]
        if names:
            points = [records[n].points for n in names]
            sums = sum(points), sum(p**2 for p in points), sum(episodes.get(n, 0) for n in names)
            rows.append((split, f"{len(names):,}", *(f"{x:,}" for x in sums)))
    return _table(("Split", "Buildings", "Nodes", "Responses", "Episodes"), rows)


def _cost(rows: Sequence[Record], failed: Sequence[Failure]) -> str:
    timed = [r for r in rows if r.processor_s is not None]
    pairs = np.array([r.points**2 for r in rows], float)
    text = f"{len(failed)} buildings failed" + (":\n\n" if failed else ".\n")
    text += "".join(f"- `{f.scene}`: {f.error}\n" for f in failed)
    sizes = np.array([r.bytes for r in rows], float)
    table = [("bytes a response", f"{sizes.sum() / pairs.sum():,.0f}", "")]
    if timed:
        seconds = np.array([float(r.processor_s or 0.0) for r in timed])
        of_timed = np.array([r.points**2 for r in timed], float)
        table += [
            (
                "processor time of a building, s",
                f"{seconds.mean():.0f} ± {_error(seconds):.0f}",
                f"{seconds.min():.0f} to {seconds.max():.0f}",
            ),
            ("processor time of a response, ms", f"{1e3 * seconds.sum() / of_timed.sum():.1f}", ""),
        ]
    table.append(
        (
            "responses of a building",
            f"{pairs.mean():,.0f} ± {_error(pairs):,.0f}",
            f"{pairs.min():,.0f} to {pairs.max():,.0f}",
        )
    )
    text += "\n" + _table(("", "Mean ± standard error", "Range"), table)
    return text + _forecast(timed, sizes, pairs)


def _forecast(timed: Sequence[Record], sizes: np.ndarray, pairs: np.ndarray) -> str:
    if len(timed) < 2:
        return "\nToo few buildings were timed for a forecast.\n"
    hours = np.array([float(r.processor_s or 0.0) for r in timed]) * _AIM / 3600.0
    total = _AIM * sizes / 1e9
    rate = sum(float(r.processor_s or 0.0) for r in timed) / sum(r.points**2 for r in timed)
    return (
        f"\nForecast of {_AIM:,} from these: {hours.mean():.1f} ± {_error(hours):.1f} core-hours, "
        f"{total.mean():.1f} ± {_error(total):.1f} GB, {_AIM * pairs.mean() / 1e6:.1f} ± "
        f"{_AIM * _error(pairs) / 1e6:.1f} million responses. By the response, 100 buildings of 60 points would "
        f"take {100 * 60**2 * rate / 2 / 3600:.2f} h of two cores. Time is processor time of one thread, of "
        f"{len(timed)} buildings, on {platform.machine()}; other work on the machine lengthens it. Mesh, grid and "
        "navigation graph are in it, episodes and report are not.\n"
    )


def _errors(config: JobConfig, rows: Sequence[Record]) -> str:
    head = ("Band", "energy to 80 ms, %", "energy after, %", "T30, %", "C50, dB", "DRR, dB")
    out = []
    for b, (low, high) in enumerate(pairwise(config.simulation.bands)):
        t30 = [_ratio(r.measures["t30"].error[b], r.measures["t30"].median[b]) for r in rows]
        out.append(
            (
                f"{low:g}–{high:g} Hz",
                _middle([r.early_error[b] for r in rows], 100.0),
                _middle([r.late_error[b] for r in rows], 100.0),
                _middle(t30, 100.0),
                *(_middle([r.measures[m].error[b] for r in rows]) for m in ("c50", "drr")),
            )
        )
    return (
        f"Medians over buildings of the medians over their pairs, of {number_text(config.simulation)} subpaths per "
        f"point.\n\n" + _table(head, out)
    )


def _acoustics(of: Collection, rows: Sequence[Record]) -> str:
    bands = of.config.simulation.bands
    times = times_by_use((room for r in rows for room in r.rooms), bands)
    uses = [(use, str(len(of_use)), _spread(of_use.tolist())) for use, of_use in times.items()]
    text = (
        "T30 of pairs that see each other in one room, mean of the bands about 500 Hz and 1 kHz, medians of rooms; "
        f"doors are as they are. {compared(of.kind, times)} Finishes and furniture are drawn from plausible "
        "sets and are not fitted to a survey.\n\n"
        + _table(("Use", "Rooms", "T30 of 10 %, 50 %, 90 % of them, s"), uses)
        + "\n"
        if uses
        else ""
    )
    out = []
    for b, (low, high) in enumerate(pairwise(bands)):
        cells = [_spread([r.measures[m].median[b] for r in rows]) for m in ("t30", "c50", "drr")]
        out.append((f"{low:g}–{high:g} Hz", *cells))
    head = ("Band", "T30, s", "C50, dB", "DRR, dB")
    return (
        text
        + "Medians over all pairs of a building; 10 %, 50 %, 90 % of the buildings.\n\n"
        + _table(head, out)
    )


def _readme(of: Collection, records: Mapping[str, Record]) -> str:
    rows = list(records.values())
    return f"""\
# Room impulse responses of {len(rows)} generated {of.kind}s

{sum(r.points**2 for r in rows):,} responses. Licence: {of.config.dataset.licence or MAKER}

```python
import soundspaces_sim as ss

with ss.open_datasets("path/to/this/folder", split="train") as homes:
    for name, s, l in homes.sample(4):
        print(name, homes[name].binaural(s, l, heading_deg=90.0).shape)
```

`soundspaces-sim verify .` compares every file with `collection.json`. `report.md` has times, sizes, error bars and
distributions, `datasheet.md` what it is for. Episodes: `episodes/replica/v1/<split>`.
"""


def _datasheet(of: Collection, records: Mapping[str, Record]) -> str:
    rows = list(records.values())
    return f"""\
# Datasheet of a collection of {of.kind}s

After Gebru et al., Datasheets for Datasets (2021).

## Motivation
Training and testing of models of sound in rooms, and of agents that hear, on scenes that anyone may copy.

## Composition
{len(rows):,} buildings `{of.kind}-<n>`, {sum(r.points for r in rows):,} points, {
        sum(r.points**2 for r in rows):,} responses
(echograms in {
        len(of.config.simulation.bands) - 1
    } bands, with directions), navigation graphs, floor plans,
episodes. All are
instances that were made, less those that `collection.json` lists as failures. Every response states the standard
error of its early and late energy. No people are in it.

## Collection process
Meshes and materials are made by code from the number of a building; shapes, sizes, finishes and furniture are drawn
from tables that are part of soundspaces_sim, with sources where there are published figures. Responses are
simulated by bidirectional path tracing. Not simulated: waves below the transition frequency (modes).

## Preprocessing
Grid points at which an agent cannot stand were left out.

## Uses
A model that is to work in real rooms should be tested in real rooms. The buildings resemble dwellings of one kind
of programme; they are no sample of any country's dwellings, and reverberation times are not fitted to a survey.

## Distribution and maintenance
Licence: {of.config.dataset.licence or MAKER}. Where it is kept: {MAKER}
"""


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def _known(values: Sequence[float | None]) -> np.ndarray:
    return np.array([v for v in values if v is not None], float)


def _middle(values: Sequence[float | None], scale: float = 1.0) -> str:
    known = _known(values)
    return f"{scale * np.median(known):.{1 if scale > 1.0 else 2}f}" if len(known) else "–"


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def _spread(values: Sequence[float | None]) -> str:
    known = _known(values)
    return " / ".join(f"{q:.2f}" for q in np.quantile(known, (0.1, 0.5, 0.9))) if len(known) else "–"


DISTRIBUTIONS, BUILDINGS = "collection_distributions.png", "collection_buildings.png"
_MOST = 6  # buildings on the page


def write_figures(
    out: Path, folder: Path, records: Mapping[str, Record], bands: Sequence[float]
) -> list[Path]:
    """Both pictures into a folder; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    write_small(distributions(records, bands), folder / DISTRIBUTIONS, 80)
    names = list(records)
    chosen = [
        names[k] for k in np.unique(np.linspace(0, len(names) - 1, min(_MOST, len(names))).astype(int))
    ]
    write_small(buildings(out, chosen), folder / BUILDINGS, 80)
    return [folder / DISTRIBUTIONS, folder / BUILDINGS]


def distributions(records: Mapping[str, Record], bands: Sequence[float]) -> Figure:
    """T30 by room beside what was published; C50, DRR and T30 of pairs by band; sizes and error bars."""
    rows, kind = list(records.values()), next(iter(records)).rpartition("-")[0]
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    axes = figure.subplots(2, 3)
    histogram(axes[0, 0], kind, times_by_use((room for r in rows for room in r.rooms), bands))
    for ax, name, label in (
        (axes[0, 1], "t30", "T30 of pairs, s"),
        (axes[0, 2], "c50", "C50 of pairs, dB"),
        (axes[1, 0], "drr", "direct-to-reverberant ratio of pairs, dB"),
    ):
        _pairs_histogram(ax, rows, name, label, bands)
    axes[1, 1].scatter([r.area for r in rows], [r.points for r in rows], s=12, color=BLUE)
    axes[1, 1].set(xlabel="floor area, m²", ylabel="points")
    errors = [[100.0 * (v or np.nan) for v in r.late_error] for r in rows]
    axes[1, 2].plot(np.arange(len(bands) - 1), np.array(errors).T, "o", color=VERMILION, ms=3)
    axes[1, 2].set_xticks(
        np.arange(len(bands) - 1), [f"{a:g}–{b:g}" for a, b in pairwise(bands)], fontsize=7
    )
    axes[1, 2].set(xlabel="band, Hz", ylabel="median error of late energy, %", ylim=(0, None))
    return figure


def _pairs_histogram(
    ax: Axes, rows: Sequence[Record], name: str, label: str, bands: Sequence[float]
) -> None:
    edges = edges_of(name)
    for b, (low, high) in enumerate(pairwise(bands)):
        counts = np.sum([r.measures[name].counts[b] for r in rows], axis=0)
        ax.stairs(counts / max(counts.sum(), 1), edges, label=f"{low:g}–{high:g} Hz", lw=1.2)
    total = np.sum([r.measures[name].counts for r in rows], axis=(0, 1))
    seen = np.flatnonzero(total > 1e-3 * total.max())
    if len(seen):
        ax.set_xlim(edges[seen[0]], edges[seen[-1] + 1])
    ax.set(xlabel=label, ylabel="share of pairs")
    ax.legend(fontsize=7)


def buildings(out: Path, names: Sequence[str]) -> Figure:
    """Each from above, its plan with the points, and from within where one sees farthest."""
    figure = Figure(figsize=(10.5, 2.9 * len(names)), layout="constrained")
    for row, name in zip(figure.subplots(len(names), 3, squeeze=False), names, strict=True):
        scene, folder = load_scene(name), out / name
        manifest = read_manifest(folder)
        points = np.array(manifest.points)
        row[0].imshow(above_picture(scene))
        row[0].set_title(f"{name}: {len(points)} points", fontsize=9)
        plan = read_floorplan(folder)
        draw_plan(row[1], plan)
        lowest = storeys_of(plan, points) == 0
        row[1].plot(*points[lowest, :2].T, ".", color=BLUE, ms=4)
        row[1].set_title("lowest storey", fontsize=9)
        far = np.median(depth_views(scene, points, np.array(HEADINGS), 16), axis=(2, 3))
        k, heading = np.unravel_index(far.argmax(), far.shape)
        row[2].imshow(inside_picture(scene, points[k], float(HEADINGS[heading])))
        for ax in (row[0], row[2]):
            ax.axis("off")
    return figure
