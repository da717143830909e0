"""Figures for print: sizes, type and captions; colours that dichromats can tell apart; the gallery's figures."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from soundspaces_pictures.decay import BAND_COLOURS
from soundspaces_pictures.plan import BLUE, GREEN, ORANGE, VERMILION
from soundspaces_pictures.printed import as_printed, save_printed
from soundspaces_pictures.registry import WIDTHS_CM

from soundspaces_sim.core.errors import ConfigError

DOCS = Path(__file__).resolve().parents[3] / "docs"
#: What dichromats see of linear RGB: Machado, Oliveira & Fernandes 2009, severity 1.
DICHROMATS = {
    "none": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


def lab(colour: str, kind: str) -> np.ndarray:
    """(3,) CIELAB (D65) of a colour as one kind of observer sees it."""
    s = np.array(to_rgb(colour))
    linear = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.asarray(DICHROMATS[kind]) @ linear, 0.0, 1.0)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    ratio = np.asarray(to_xyz) @ seen / [0.9505, 1.0, 1.089]
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", DICHROMATS)
def test_colours_can_be_told_apart(kind: str) -> None:
    """Differences of 12 and more in CIELAB; 2.3 can just be seen (Mahy, Van Eycken & Oosterlinck 1994)."""
    for palette in (BAND_COLOURS[:4], [BLUE, VERMILION], [BLUE, ORANGE, GREEN]):
        seen = np.array([lab(c, kind) for c in palette])
        apart = np.linalg.norm(seen[:, None] - seen[None], axis=2)[np.triu_indices(len(seen), 1)]
        assert apart.min() > 12.0, (palette, apart)
    for name in ("viridis", "inferno", "magma"):  # of maps: lighter from end to end for everyone
        colours = matplotlib.colormaps[name](np.linspace(0.0, 1.0, 64))[:, :3]
        light = [lab(tuple(c), kind)[0] for c in colours]  # type: ignore[arg-type]
        assert (np.diff(light) > -0.15).all() and light[-1] - light[0] > 70.0


def figure() -> Figure:
    """A title, a legend below the axes, large type, a label that is too long."""
    made, ax = plt.subplots(figsize=(9.0, 5.0), layout="constrained")
    ax.plot([0, 1], [0, 1], lw=1.5, label="one")
    ax.set_title("What it shows", fontsize=14)
    ax.set_ylabel("a label that is much longer than the axis is high, in dB re the direct sound at 1 m")
    ax.text(0.5, 0.5, "note", fontsize=4)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09))
    return made


@pytest.mark.parametrize("width", WIDTHS_CM)
def test_sizes_are_those_of_paper(width: str) -> None:
    made = figure()
    assert as_printed(made, width) == "What it shows"
    assert made.get_size_inches()[0] * 2.54 == pytest.approx(WIDTHS_CM[width])
    assert made.get_size_inches()[1] / made.get_size_inches()[0] == pytest.approx(5.0 / 9.0)
    shown = [t for t in made.findobj(Text) if isinstance(t, Text) and t.get_text()]
    assert all(6.0 <= float(t.get_fontsize()) <= 8.0 for t in shown)
    assert "What it shows" not in [t.get_text() for t in shown]
    made.draw_without_rendering()
    drawn, (wide, high) = made.get_tightbbox(), made.get_size_inches()
    assert drawn.x0 > -0.01 and drawn.y0 > -0.01  # nothing is cut off
    assert drawn.x1 < wide + 0.01 and drawn.y1 < high + 0.01
    (legend,) = made.legends
    assert [t.get_text() for t in legend.get_texts()] == ["one"]
    plt.close(made)


def test_files_are_vectors_with_letters_of_that_size(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg", "c.pdf"):
        made = figure()
        assert save_printed(made, tmp_path / name, "column") == "What it shows"
        plt.close(made)
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text()  # no date, no chance
    width = re.search(r'<svg [^>]*width="([\d.]+)pt"', text)
    assert width is not None and float(width[1]) / 72.0 * 2.54 == pytest.approx(8.4, abs=0.01)
    assert "<text" in text and "What it shows" in text and "<image" not in text
    page = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ", (tmp_path / "c.pdf").read_bytes())
    assert page is not None and float(page[1]) / 72.0 * 2.54 == pytest.approx(8.4, abs=0.01)
    made = figure()
    for path, size, message in (("a.tiff", "column", "ends in"), ("a.pdf", "poster", "column or page")):
        with pytest.raises(ConfigError, match=message):
            save_printed(made, tmp_path / path, size)
    plt.close(made)


def test_the_gallery_shows_every_figure_with_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are there in the widths of print; the page that the site makes holds each, and the code that draws it."""
    source = (DOCS / "gallery_figures.py").read_text()
    monkeypatch.syspath_prepend(str(DOCS))  # as MkDocs does
    hooks: dict[str, object] = {"__file__": str(DOCS / "site_hooks.py"), "__name__": "site_hooks"}
    exec(compile((DOCS / "site_hooks.py").read_text(), "site_hooks.py", "exec"), hooks)
    page = hooks["_gallery"]()  # type: ignore[operator]
    names = [
        n.name for n in ast.parse(source).body
        if isinstance(n, ast.FunctionDef) and not n.name.startswith("_") and n.name != "main"
    ]  # fmt: skip
    assert len(names) >= 6
    pictures = {p.stem for p in (DOCS / "figures" / "gallery").iterdir()}
    assert pictures == set(names)
    for name in names:
        assert f"figures/gallery/{name}.svg" in page
        text = (DOCS / "figures" / "gallery" / f"{name}.svg").read_text()
        width = re.search(r'<svg [^>]*width="([\d.]+)pt"', text)
        assert width is not None
        assert min(abs(float(width[1]) / 72.0 * 2.54 - w) for w in WIDTHS_CM.values()) < 0.01
        assert re.search(r"\((m|s|ms|Hz|dB)\b", text), name  # units are named
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        ast.parse("def f():\n" + "".join(f"    {line}\n" for line in block.splitlines()))
