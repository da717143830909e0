"""Pages: whole pictures by name, and the widths in which they are printed. The command line lists what is here.

A page is a function ``(subject, source, listeners) -> Figure`` of a `data.PlotData` and its points; no
listeners means that the page chooses them. A new one is a function and a line below.
"""

from __future__ import annotations

from collections.abc import Mapping

from soundspaces_sim import ConfigError
from soundspaces_sim.parts import TableEntry as Entry

PAGES: Mapping[str, Entry] = {
    "map": Entry("soundspaces_pictures.pages:map_page", "points and navigation graph on the floor plan"),
    "field": Entry("soundspaces_pictures.pages:field_page", "level of a source everywhere"),
    "overview": Entry(
        "soundspaces_pictures.pages:overview_page", "level of a source everywhere, and a listener's ears"
    ),
    "lobes": Entry("soundspaces_pictures.pages:lobes_page", "where sound comes from"),
    "decay": Entry("soundspaces_pictures.pages:decay_page", "decay curves of a pair, per band"),
    "rir": Entry("soundspaces_pictures.pages:rir_page", "a pair's binaural response"),
    "parameter": Entry(
        "soundspaces_pictures.pages:parameter_page", "a room-acoustic parameter everywhere"
    ),
    "modes": Entry(
        "soundspaces_pictures.pages:modes_page", "level of a source everywhere, at one low frequency"
    ),
    "error": Entry("soundspaces_pictures.pages:error_page", "standard error everywhere"),
}

WIDTHS_CM: Mapping[str, float] = {"column": 8.4, "page": 17.4}  # of two-column journals


def check_width(name: str, option: str = "width") -> float:
    """The width that a name stands for, cm. Raises `ConfigError`."""
    if name not in WIDTHS_CM:
        raise ConfigError(f"{option}: expected {' or '.join(WIDTHS_CM)}, got {name!r}")
    return WIDTHS_CM[name]
