"""Every table of kinds chosen by name: what it lists can be loaded, and what it does not list is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module

import pytest
from soundspaces_pictures.registry import PAGES

import soundspaces_sim as ss
from soundspaces_sim.build.engines import ENGINES, find_engine
from soundspaces_sim.core.registry import Entry, find, names
from soundspaces_sim.dataset.exporters import EXPORTERS, find_exporter
from soundspaces_sim.rendering.renderers import RENDERERS, check_renderer, find_renderer

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
