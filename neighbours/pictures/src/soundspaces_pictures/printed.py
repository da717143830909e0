"""Figures as journals print them: as wide as a column or a page, type of 6 to 8 pt, vectors, the title as caption.

Widths are those of two-column journals (8.4 and 17.4 cm). Nothing is drawn anew: `as_printed` resizes a figure
whose layout is ``constrained`` and sets its type, lines and legends to sizes that can be read on paper.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from soundspaces_pictures.plan import FURNITURE_NAME
from soundspaces_pictures.registry import check_width
from soundspaces_sim import ConfigError, SoundSpacesSimError

SUFFIXES = (".pdf", ".svg", ".png")
_CM = 1.0 / 2.54  # inches
_TALLEST_CM = 23.0
_TYPE = (0.8, 6.0, 8.0)  # of its size on a screen; least and most, pt
_LINE, _THINNEST = 0.7, 0.4  # of its width; pt
_MARK = 0.7
_DPI = 600  # of PNG, and of what vectors cannot hold
_SAVING = {"svg.fonttype": "none", "pdf.fonttype": 42, "svg.hashsalt": "soundspaces_sim"}


def as_printed(figure: Figure, width: str = "column") -> str:
    """Make a figure as wide as a ``column`` or a ``page``; its title, which leaves it, for the caption. Raises
    `ConfigError`."""
    wide = check_width(width) * _CM
    before = figure.get_size_inches()
    figure.set_size_inches(wide, min(wide * before[1] / before[0], _TALLEST_CM * _CM))
    caption = _taken_title(figure)
    for ax in figure.axes:
        _legend_below(figure, ax, 1 if width == "column" else 3)
    for artist in figure.findobj():
        _shrink(artist)
    for ax in figure.axes:
        ax.tick_params(width=0.5, length=2.5, pad=2.0)
        ax.xaxis.labelpad = ax.yaxis.labelpad = 2.0
    figure.draw_without_rendering()  # axes have sizes from here on
    for ax in figure.axes:
        _wrap_label(ax)
    figure.draw_without_rendering()
    for ax in figure.axes:
        _drop_names(ax)
    return caption


def save_printed(figure: Figure, path: str | Path, width: str = "column") -> str:
    """`as_printed`, written to a .pdf, .svg or .png file: of that width exactly, letters as letters. The caption,
    which is also the file's title. Raises `ConfigError`, `SoundSpacesSimError`."""
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ConfigError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}")
    caption = as_printed(figure, width)
    undated = {".pdf": "CreationDate", ".svg": "Date"}.get(path.suffix)
    metadata = {"Title": caption} | ({undated: None} if undated else {})
    try:
        with matplotlib.rc_context(_SAVING):  # type: ignore[arg-type]
            figure.savefig(path, dpi=_DPI, metadata=metadata)
    except (OSError, ValueError) as error:
        raise SoundSpacesSimError(f"{path}: cannot write this picture ({error})") from error
    return caption


def _taken_title(figure: Figure) -> str:
    """The title of the whole, or of the first axes that have one; it is taken away."""
    whole = getattr(figure, "_suptitle", None)
    if whole is not None and whole.get_text():
        text = str(whole.get_text())
        whole.remove()
        figure._suptitle = None  # type: ignore[attr-defined] # or it keeps its place in the layout
        return text
    for ax in figure.axes:
        if ax.get_title():
            text = str(ax.get_title())
            ax.set_title("")
            return text
    return ""


def _legend_below(figure: Figure, ax: Axes, columns: int) -> None:
    """A legend that hangs below its axes, at a share of their height, goes below the figure, where it has room."""
    legend = ax.get_legend()
    if legend is None:
        return
    box = legend.get_bbox_to_anchor().transformed(ax.transAxes.inverted())
    if box.y1 < 0.0:
        handles = [h for h in legend.legend_handles if h is not None]
        names = [t.get_text() for t in legend.get_texts()]
        legend.remove()
        figure.legend(
            handles=handles, labels=names, loc="outside lower center", ncols=columns, frameon=False
        )


def _wrap_label(ax: Axes) -> None:
    """Break a label that is longer than its axis into lines."""
    label = ax.yaxis.label
    box = ax.get_window_extent()
    length = label.get_window_extent().height
    if length > box.height:
        text = label.get_text()
        ax.set_ylabel("\n".join(textwrap.wrap(text, max(int(len(text) * box.height / length), 8))))


def _drop_names(ax: Axes) -> None:
    """Names of furniture that would lie on one another or over the edge."""
    kept: list[Bbox] = []
    frame = ax.get_window_extent()
    for text in (t for t in ax.texts if t.get_gid() == FURNITURE_NAME):
        box = text.get_window_extent()
        inside = frame.x0 <= box.x0 and box.x1 <= frame.x1
        if inside and not any(box.overlaps(other) for other in kept):
            kept.append(box)
        else:
            text.set_visible(False)


def _shrink(artist: Artist) -> None:
    """Type, lines and marks in sizes for paper."""
    if isinstance(artist, Text):
        share, least, most = _TYPE
        artist.set_fontsize(float(np.clip(share * float(artist.get_fontsize()), least, most)))
    elif isinstance(artist, Line2D):
        artist.set_linewidth(max(_LINE * artist.get_linewidth(), _THINNEST))
        artist.set_markersize(_MARK * artist.get_markersize())
    elif isinstance(artist, Collection):
        widths = np.atleast_1d(np.asarray(artist.get_linewidth(), float))
        artist.set_linewidth([max(_LINE * w, _THINNEST) if w > 0.0 else 0.0 for w in widths.tolist()])
