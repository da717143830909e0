"""A report on a dataset for the lab that receives it: one HTML file that loads nothing and runs no script."""

from __future__ import annotations

import base64
import io
import logging
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import soundfile
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from soundspaces_parameters.of_waves import has_octave, octaves_below
from soundspaces_renderers.dry import hand_clap

from soundspaces_pictures.decay import BAND_COLOURS, draw_decay
from soundspaces_pictures.html_page import write_page
from soundspaces_pictures.listen import listening_places
from soundspaces_pictures.pages import draw_page
from soundspaces_pictures.plot_data import dataset_subject
from soundspaces_pictures.response import draw_spectrogram
from soundspaces_sim import DatasetError, JobConfig, RirDataset, open_dataset, verify_dataset
from soundspaces_sim.parts import (
    MANIFEST_NAME as NAME,
    Manifest,
    config_differences as differences,
    convolve_sound as convolve,
    file_sha256,
    nominal,
    rebuild_command,
    undefined_times,
    version_text,
)

_log = logging.getLogger(__name__)
_DPI = 100
_WORST = 10
_MEASURES = (("t30", "T30 (s)"), ("edt", "EDT (s)"), ("c50", "C50 (dB)"), ("drr", "DRR (dB)"))
_ERRORS = (
    ("early_error", "standard error to 80 ms (%)"),
    ("late_error", "standard error after 80 ms (%)"),
    ("t30_error", "standard error of T30 (s)"),
    ("c50_error", "standard error of C50 (dB)"),
)
_SPREAD_PAIRS = 12
_SPREADS = (
    ("t30_spread", "T30, by how well absorption is known (s)"),
    ("edt_spread", "EDT, by the same (s)"),
    ("c50_spread", "C50, by the same (dB)"),
)
_CITATION = """\
@software{soundspaces_sim,
  title  = {soundspaces\\_sim: datasets of room impulse responses by bidirectional path tracing},
  author = {{The soundspaces\\_sim maintainers}},
  version = {VERSION}
}
@inproceedings{chen2020soundspaces,
  title     = {SoundSpaces: Audio-Visual Navigation in 3D Environments},
  author    = {Chen, Changan and Jain, Unnat and Schissler, Carl and Amengual Gar{\\'i}, Sebasti{\\`a} Vicen{\\c c}
               and Al-Halah, Ziad and Ithapu, Vamsi Krishna and Robinson, Philip and Grauman, Kristen},
  booktitle = {ECCV},
  year      = {2020}
}"""


class _Pair(NamedTuple):
    title: str
    sound: str
    picture: str


def write_report(
    folder: str | Path,
    out: str | Path,
    full: bool = False,
    hrtf: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[str]:
    """Write the report on the dataset in `folder` to the file `out`; what is wrong with the dataset's files.

    `full` compares every byte first. Raises `DatasetError`, and the errors of whatever cannot be drawn.
    """
    tell = progress or (lambda _done, _total: None)
    manifest, found = verify_dataset(folder, full)
    tell(1, 5)
    with open_dataset(folder, hrtf=hrtf) as ds:
        everything = ds.table(collocated=True)
        table = everything[~everything["collocated"]]
        tell(2, 5)
        context = {
            "scene": ds.scene,
            "summary": _summary(ds),
            "problems": [f"{p.file}: {p.what}" for p in found],
            "checked": "Every byte is as it was written."
            if full
            else "Sizes and layout of all files are as written; soundspaces-sim verify --full compares every byte.",
            "provenance": _provenance(Path(folder), manifest),
            "code": ("scene digest", "job key", "manifest", "made by"),
            "paper": _paper_row(ds),
            "map": _map(ds),
            "histograms": png(_histograms(table, ds)),
            "bands": _band_names(ds),
            "medians": _medians(table, len(_band_names(ds))) + _spreads(ds, table),
            "undefined": [n for n in manifest.notes if n.startswith("cut: ")]
            + undefined_times(ds, table),
            "low": low_medians(ds, table),
            "worst": _worst(table, len(_band_names(ds))),
            "silent": int((everything["status"] == 1).sum()),
            "failed": int((everything["status"] == 2).sum()),
            "citation": _CITATION.replace("VERSION", manifest.code_version),
            "version": version_text(),
        }
        tell(3, 5)
        context["pairs"] = _pairs(ds)
    tell(4, 5)
    write_page(Path(__file__).with_name("report.html"), context, out)
    tell(5, 5)
    return [f"{p.file}: {p.what}" for p in found]


def _map(ds: RirDataset) -> str:
    """Nothing if the floor plan cannot be read, which the problems say."""
    try:
        return png(draw_page(dataset_subject(ds), "map"))
    except DatasetError as error:
        _log.warning("%s", error)
        return ""


def _summary(ds: RirDataset) -> str:
    m = ds.manifest
    size = sum(e.bytes for e in m.shards)
    forms = " and ".join(sorted({f"{e.form}s" for e in m.shards}))
    return (
        f"{len(ds):,} room impulse responses between all pairs of {len(ds.points)} points, {m.duration:.2f} s "
        f"each, as {forms}: {size / 1e6:,.1f} MB in {len(m.shards)} files."
    )


def _provenance(folder: Path, m: Manifest) -> list[tuple[str, str]]:
    changed = differences(JobConfig(), m.config)
    return [
        ("scene digest", m.scene_digest),
        ("job key", m.key),
        ("manifest", f"SHA-256 {file_sha256(folder / NAME)}"),
        (
            "made by",
            rebuild_command(m) or "a command that is not shown, since it is no plain `rirs` command",
        ),
        ("version", f"soundspaces_sim {m.code}; manifest version {m.version}"),
        ("machine", m.target or "not recorded"),
        ("settings", "; ".join(changed) or "the defaults"),
        ("seed", str(m.config.dataset.seed)),
    ]


def _paper_row(ds: RirDataset) -> dict[str, str]:
    m = ds.manifest
    area = len(m.nodes) * m.config.grid.spacing**2  # a node stands for a cell of the grid
    return {
        "scenes": "1",
        "resolution": f"{m.config.grid.spacing:g} m",
        "sampling rate": f"{m.config.dataset.rate} Hz",
        "points": str(len(ds.points)),
        "nodes one can walk to": str(len(m.nodes)),
        "area to walk on": f"{area:.1f} m²",
        "responses": f"{len(ds):,}",
    }


def _band_names(ds: RirDataset) -> list[str]:
    bands = ds.manifest.config.simulation.bands
    return [f"{low:g}–{high:g} Hz" for low, high in pairwise(bands)]


def _usable(table: np.ndarray, name: str, b: int) -> np.ndarray:
    """Finite values of pairs that are not silent, failed, or a point with itself."""
    rows = table["status"] == 0
    values = table[f"{name}_{b}"][rows].astype(float)
    return np.asarray(values[np.isfinite(values)])


def _histograms(table: np.ndarray, ds: RirDataset) -> Figure:
    names = _band_names(ds)
    figure, axes = plt.subplots(5, 2, figsize=(10.0, 13.5), layout="constrained")
    for ax, (name, label) in zip(axes.flat, (*_MEASURES, *_ERRORS), strict=False):
        scale = 100.0 if label.endswith("(%)") else 1.0
        columns = [scale * _usable(table, name, b) for b in range(len(names))]
        _steps(ax, columns, names, label)
    if axes[0, 0].get_legend_handles_labels()[0]:  # some band has a T30
        axes[0, 0].legend(fontsize=8)
    for ax, name, label in (
        (axes[4, 0], "distance", "distance (m)"),
        (axes[4, 1], "geodesic", "on foot (m)"),
    ):
        values = table[name].astype(float)
        _steps(ax, [values[np.isfinite(values)]], ["all pairs"], label)
    return figure


def _steps(ax: Axes, columns: list[np.ndarray], names: list[str], label: str) -> None:
    """Histograms as outlines on common bins; the outermost percent is put into the last bins."""
    every = np.concatenate(columns)
    ax.set_xlabel(label)
    ax.set_ylabel("share of pairs")
    if len(every) == 0:
        ax.text(0.5, 0.5, "no values", ha="center", va="center", transform=ax.transAxes)
        return
    low, high = np.quantile(every, [0.005, 0.995])
    edges = np.linspace(low, high if high > low else low + 1.0, 41)
    for k, (values, name) in enumerate(zip(columns, names, strict=True)):
        if len(values):
            counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
            ax.stairs(
                counts / len(values),
                edges,
                label=name,
                color=BAND_COLOURS[k % len(BAND_COLOURS)],
                lw=1.4,
            )
    ax.set_ylim(bottom=0.0)


def _spreads(ds: RirDataset, table: np.ndarray) -> list[tuple[str, list[str]]]:
    """What some pairs' measures owe to how well absorption is known; nothing without counts of reflections."""
    if not ds.materials or not len(table):
        return []
    rows = table[np.linspace(0, len(table) - 1, min(len(table), _SPREAD_PAIRS)).astype(int)]
    return _medians(ds.with_spreads(rows), len(_band_names(ds)), _SPREADS)


def _medians(
    table: np.ndarray, bands: int, columns: Sequence[tuple[str, str]] = (*_MEASURES, *_ERRORS)
) -> list[tuple[str, list[str]]]:
    out = []
    for name, label in columns:
        scale = 100.0 if label.endswith("(%)") else 1.0
        digits = (
            3 if name in ("t30_error", "t30_spread", "edt_spread") else 2 if label.endswith("(s)") else 1
        )
        row = []
        for b in range(bands):
            row.append(median_text(scale * _usable(table, name, b), digits))
        out.append((label, row))
    return out


def _worst(table: np.ndarray, bands: int) -> list[tuple[str, ...]]:
    early, late = (
        np.stack([table[f"{name}_{b}"].astype(float) for b in range(bands)]).max(axis=0)
        for name, _ in _ERRORS[:2]
    )
    one_way = table["source"] < table["listener"]  # the way back has the same subpaths
    usable = np.flatnonzero((table["status"] == 0) & one_way & np.isfinite(late))
    order = usable[np.argsort(-late[usable], kind="stable")][:_WORST]
    return [
        (
            str(table["source"][k]),
            str(table["listener"][k]),
            f"{table['distance'][k]:.2f} m",
            "yes" if table["visible"][k] else "no",
            f"{100 * early[k]:.1f} %",
            f"{100 * late[k]:.1f} %",
        )
        for k in order
    ]


def _pairs(ds: RirDataset) -> list[_Pair]:
    """Three listeners of one source: near, far in sight, out of sight."""
    source, places = listening_places(ds)
    clap = hand_clap(ds.rate)
    heard = {place: convolve(clap, ds.binaural(source, l)) for place, l in places.items()}
    gain = 0.7 / max(float(np.abs(x).max()) for x in heard.values())
    out = []
    for place, l in places.items():
        figure, axes = plt.subplots(1, 2, figsize=(10.0, 3.0), layout="constrained")
        if any(e.form == "echogram" for e in ds.manifest.shards):
            draw_decay(axes[0], ds.echogram(source, l))
        else:
            axes[0].axis("off")
        draw_spectrogram(axes[1], ds.binaural(source, l)[0], ds.rate)
        apart = float(np.linalg.norm(ds.points[source] - ds.points[l]))
        title = f"{place}: from point {source} to point {l}, {apart:.1f} m"
        out.append(_Pair(title, _flac(gain * heard[place], ds.rate), png(figure)))
    return out


def png(figure: Figure) -> str:
    """A figure as a data URL of PNG; it is closed."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=_DPI, bbox_inches="tight")
    plt.close(figure)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def _flac(signal: np.ndarray, rate: int) -> str:
    data = io.BytesIO()
    soundfile.write(data, signal.T, rate, format="FLAC", subtype="PCM_16")
    return "data:audio/flac;base64," + base64.b64encode(data.getvalue()).decode()


_PAIRS = 60
_LOW_MEASURES = {"t30": ("T30 (s)", 2), "edt": ("EDT (s)", 2), "c50": ("C50 (dB)", 1)}


def median_text(values: np.ndarray, digits: int) -> str:
    """Median, and where 10 to 90 % lie, of finite values (n,)."""
    if len(values) == 0:
        return "–"
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})".replace("-", "−")


def low_medians(ds: RirDataset, table: np.ndarray) -> dict[str, Any]:
    """Names of octaves below the edge of waves, and medians of measures of waves over up to 60 of the pairs of
    `table`. Nothing without waves, or if no octave lies below their edge."""
    low = ds.manifest.config.simulation.low
    edge = ds.manifest.config.simulation.bands[1] if low.edge is None else low.edge
    usable = table[table["status"] == 0]
    stored = any(e.form == "echogram" for e in ds.manifest.shards)
    if low.method != "waves" or not has_octave(edge) or not len(usable) or not stored:
        return {}
    rows = usable[np.linspace(0, len(usable) - 1, min(len(usable), _PAIRS)).astype(int)]
    pairs = np.stack([rows["source"], rows["listener"]], axis=1)
    found = ds.parameters(tuple(_LOW_MEASURES), octaves_below(edge), pairs, waves=True)
    medians = []
    for name, (label, digits) in _LOW_MEASURES.items():
        columns = found[name].T
        medians.append((label, [median_text(x[np.isfinite(x)], digits) for x in columns]))
    return {"bands": [f"{nominal(f):g} Hz" for f in found.bands.centre], "medians": medians}
