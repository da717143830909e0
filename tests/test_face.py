"""The front door: what `dir` shows, what objects say of themselves, what is refused at once."""

from __future__ import annotations

import inspect
import types
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.svg import Curve, Dots, Lines, svg
from soundspaces_sim.dataset.format.floorplan import read_floorplan
from tests.conftest import small_job


def test_dir_shows_the_api() -> None:
    shown = [name for name in dir(ss) if not name.startswith("_")]
    assert "open_dataset" in shown and "simulate" in shown
    assert not [n for n in shown if isinstance(getattr(ss, n), types.ModuleType)]
    assert set(shown) == set(ss.__all__) - {"__version__"}


def test_everything_public_has_a_docstring() -> None:
    bare = []
    for name in ss.__all__:
        thing = getattr(ss, name)
        if not inspect.isclass(thing) and not inspect.isfunction(thing):
            continue
        bare += [name] * (not inspect.getdoc(thing))
        if not inspect.isclass(thing):
            continue
        for member, value in vars(thing).items():
            public = not member.startswith("_") and (
                isinstance(value, property | staticmethod | classmethod) or inspect.isfunction(value)
            )
            if public and not inspect.getdoc(value):
                bare.append(f"{name}.{member}")
    assert bare == []


def _picture(html: str) -> ElementTree.Element:
    return ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + 6])


def test_objects_say_what_they_are(dataset_folder: Path, small_scene: ss.Scene) -> None:
    ds = ss.open_dataset(dataset_folder)
    grid = ss.make_grid(small_scene, 1.5)
    echoes = ss.simulate(small_scene, ds.points[:1], ds.points[1:3], small_job().simulation)
    objects: list[tuple[object, tuple[str, ...]]] = [
        (ds, ("64 pairs of 8 points in 'two_rooms', 0.2 s each", "echograms, 4 bands", "16,000 Hz")),
        (ds.manifest, ("'two_rooms' (complete): 8 points, 4 shards", "GridConfig(spacing=1.5, rays=200)")),
        (ds[0, 1], ("0.2 s in", "bands at 0, 176, 775, 3409, 20000 Hz", "in sight: yes", "standard error")),
        (ds[0, 1].early, (f"Arrivals: {len(ds[0, 1].early)} from",)),
        (ds[0, 1].direct, ("Arrival(", "ms from (", "J/m²")),
        (echoes, ("1 sources × 2 listeners", "4 bands")),
        (small_scene, ("Scene('two_rooms')", "8.0 × 4.0 × ", "1 materials")),
        (small_scene.materials, ("MaterialTable: 1 materials",)),
        (grid, (f"Grid: {len(grid)} points, 1.5 m apart, 1.5 m above 1 floor;",)),
        (ss.make_graph(small_scene, grid), ("WalkGraph:", "2 components")),
        (read_floorplan(dataset_folder), ("1 storey (",)),
        (ss.inspect_scene(small_scene, ss.GridConfig(spacing=1.5, rays=200)), ("SceneReport of 'two_rooms'",)),
        (ss.open_datasets(dataset_folder.parent), ("64 pairs in 1 scenes: two_rooms",)),
        (ss.JobConfig(), ("JobConfig()",)),
        (ss.GridConfig(spacing=1.0), ("GridConfig(spacing=1.0)",)),
    ]  # fmt: skip
    for thing, parts in objects:
        text = repr(thing)
        assert all(part in text for part in parts), text
        assert len(text.splitlines()) <= 3
    for thing in (ds, ds[0, 1], small_scene, grid, read_floorplan(dataset_folder)):
        html = thing._repr_html_()
        assert len(html) < 60_000
        picture = _picture(html)
        assert len(picture) > 0 and float(picture.get("width", "0")) <= 400
    dots = [e for e in _picture(ds._repr_html_()) if e.tag.endswith("circle")]
    assert len(dots) == len(ds.points)


def test_drawings_fit_and_break_at_nan() -> None:
    curve = Curve(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, np.nan], [3.0, 1.0], [4.0, 2.0]]), "red")
    picture = ElementTree.fromstring(svg([curve, Dots(np.zeros((9000, 2)), "blue")], same_scale=False))
    lines = [e for e in picture if e.tag.endswith("polyline")]
    assert [len(e.get("points", "").split()) for e in lines] == [2, 2]
    assert lines[0].get("points", "").split()[0] == "5,195"  # y is up
    assert lines[1].get("points", "").split()[-1] == "315,5"
    assert len(list(picture)) == 2 + 4000  # thinned out
    assert svg([Lines(np.empty((0, 4)), "red")]) == ""


def test_pairs_by_index(dataset_folder: Path) -> None:
    ds = ss.open_dataset(dataset_folder)
    np.testing.assert_array_equal(ds[2, 5].energy, ds.echogram(2, 5).energy)
    np.testing.assert_array_equal(ds[np.int64(2), 5].energy, ds.echogram(2, 5).energy)
    for wrong in (0, (1, 2, 3), "ab"):
        with pytest.raises(ss.PairIndexError, match=r"expected ds\[source, listener\]"):
            ds[wrong]  # type: ignore[index]
    for s, l in ((1.5, 0), ("0", 0), (0, None)):
        with pytest.raises(ss.PairIndexError, match="expected the number of a point"):
            ds.binaural(s, l)  # type: ignore[arg-type]
    for pairs in ([(0.5, 1.0)], [[0, 1, 2]], [("0", "1")]):
        with pytest.raises(ss.PairIndexError, match="pairs: expected integers"):
            ds.get_batch(pairs)
    with pytest.raises(ss.PairIndexError, match="sources: expected one or more numbers of points"):
        ds.render_path(np.ones(9), [0.5, 1.5], 0)


@pytest.mark.parametrize("rate", [0, -1, 7999, 192001, 16000.5, float("nan")])
def test_rates_that_cannot_be_rendered(dataset_folder: Path, rate: float) -> None:
    with pytest.raises(ss.ConfigError, match="rate: expected 8000 to 192000 Hz"):
        ss.open_dataset(dataset_folder, rate=rate)  # type: ignore[arg-type]
    with pytest.raises(ss.ConfigError, match="rate: expected 8000 to 192000 Hz"):
        ss.open_dataset(dataset_folder).ambisonic(0, 1, rate=rate)  # type: ignore[arg-type]


def test_sound_that_is_not_a_finite_mono_signal(dataset_folder: Path) -> None:
    ds = ss.open_dataset(dataset_folder)
    bad = np.ones(50)
    bad[[7, 9]] = np.nan
    with pytest.raises(ss.ConfigError, match=r"finite samples, got nan at sample 7 \(2 of 50\)"):
        ds.render(bad, 0, 1)
    with pytest.raises(ss.ConfigError, match=r"mono signal of shape \(n,\), n >= 1, got \(2, 5\)"):
        ds.render(np.zeros((2, 5)), 0, 1)


def test_table_as_a_data_frame(dataset_folder: Path) -> None:
    pandas = pytest.importorskip("pandas", reason="the extra 'pandas' is not installed")
    ds = ss.open_dataset(dataset_folder)
    frame, rows = ds.table(pandas=True), ds.table()
    assert isinstance(frame, pandas.DataFrame) and list(frame.columns) == list(rows.dtype.names or ())
    near = frame[frame.visible & (frame.distance < 2.0)]
    assert len(near) == (rows["visible"] & (rows["distance"] < 2.0)).sum() > 0
    np.testing.assert_array_equal(frame["t30_1"], rows["t30_1"])
