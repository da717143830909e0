"""Every table of kinds chosen by name: what it lists can be loaded, and what it does not list is refused."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from soundspaces_pictures.registry import PAGES

import soundspaces_sim as ss
from soundspaces_sim.build.engines import ENGINES, find_engine
from soundspaces_sim.core.registry import Entry, find, installed_by_name, names
from soundspaces_sim.dataset.exporters import EXPORTERS, find_exporter
from soundspaces_sim.rendering.renderers import RENDERERS, check_renderer, find_renderer
from soundspaces_sim.scene import formats

TABLES = [RENDERERS, EXPORTERS, PAGES, ENGINES]


@pytest.mark.parametrize("table", TABLES, ids=["renderers", "exporters", "pages", "engines"])
def test_every_entry_is_there(table: Mapping[str, Entry]) -> None:
    for name, entry in table.items():
        try:
            found = find("kind", table, name)
        except ModuleNotFoundError as error:  # an engine whose extra is not installed
            assert table is ENGINES and not str(error.name).startswith("soundspaces_sim")
            continue
        module, _, attribute = entry.target.partition(":")
        assert found is getattr(import_module(module), attribute)
        assert (found if callable(found) else found.run).__doc__ and entry.about
    with pytest.raises(ss.ConfigError, match=r"kind: expected .*, got 'nothing'"):
        find("kind", table, "nothing")


def test_names_read_as_words() -> None:
    entry = Entry("a:b", "")
    assert names({"one": entry}) == "one"
    assert names({"one": entry, "two": entry, "three": entry}) == "one, two or three"


def test_messages_name_the_setting() -> None:
    with pytest.raises(
        ss.ConfigError, match=r"dataset\.renderer: expected default, smooth, paper or direct, got 'loud'"
    ):
        check_renderer("loud")
    with pytest.raises(ss.ConfigError, match=r"dataset\.renderer"):
        find_renderer("loud")
    with pytest.raises(ss.ConfigError, match="engine: expected local"):
        find_engine("steam")
    with pytest.raises(
        ss.ConfigError,
        match="layout: expected soundspaces-v1, sofa, huggingface, lhotse, ambisonics, iso3382, wav or webdataset, got 'mp3'",
    ):
        find_exporter("mp3", {})
    with pytest.raises(ss.ConfigError, match="name: layout wav has no such option"):
        find_exporter("wav", {"name": "mp3d"})


def test_what_a_neighbour_has_is_named_with_its_install_line() -> None:
    table = {"own": Entry("math:sqrt", ""), "other": Entry("not_installed_here.a:b", "", "exports")}
    assert find("layout", table, "own") is math.sqrt
    with pytest.raises(ss.ConfigError, match=r"layout other: .*pip install \./neighbours/exports"):
        find("layout", table, "other")


def _entry(name: str, target: str) -> EntryPoint:
    return EntryPoint(name, target, formats.GROUP)


def test_an_entry_point_that_leads_nowhere_is_named_and_stops_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A distribution that is gone, one that raises, and one that offers what is no format; a sound one beside."""
    (tmp_path / "raises_on_import.py").write_text("raise OSError('no such device')")
    monkeypatch.syspath_prepend(tmp_path)
    good = "soundspaces_sim.scene.formats.obj:FORMAT"
    offers = {
        "gone": "gone_module:FORMAT",
        "bad": "raises_on_import:FORMAT",
        "wrong": "math:pi",
        "good": good,
    }
    found = [_entry(name, target) for name, target in offers.items()]
    monkeypatch.setattr("soundspaces_sim.core.registry.entry_points", lambda **_: found)
    formats.neighbours.cache_clear()
    try:
        with caplog.at_level(logging.WARNING):
            assert formats.neighbours() == (formats.FORMATS["obj"],)
            assert ss.load_scene("demo").name == "demo"
    finally:
        monkeypatch.undo()
        formats.neighbours.cache_clear()
    said = [record.message for record in caplog.records if "cannot be loaded" in record.message]
    assert len(said) == 3  # once, however many scenes are loaded
    assert "'gone', gone_module:FORMAT" in said[0] and "no such device" in said[1]
    assert "expected a SceneFormat, got float" in said[2]


def test_an_entry_point_that_is_asked_for_by_name_names_its_distribution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "some_waves-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: some-waves\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[some.group]\nwaves = gone_module:METHOD\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert installed_by_name("some.group", "rays") is None
    with pytest.raises(ss.ConfigError, match=r"some-waves: .*'waves'.*gone_module.*install it anew"):
        installed_by_name("some.group", "waves")
