"""Which material a category gets."""

from pathlib import Path

import numpy as np
import pytest
from soundspaces_rlr.materials import DEFAULT, concatenate_tables, load_database

from neighbours.rlr_audio_propagation.tests.rooms import material, write_database


@pytest.fixture
def database(tmp_path: Path) -> str:
    return write_database(
        tmp_path / "m.json",
        material("Carpet", 0.3, labels=["floor", "floor", "mat"]),
        material("Wood Floor", 0.1, labels=["cabinet", "stair"]),
        material("Steel", 0.05, labels=["sink", "railing"]),
        material("Glass", 0.02, labels=["window", "sink window"]),
    )


@pytest.mark.parametrize(
    ("category", "name"),
    [
        ("Wood Floor", "Wood Floor"),  # its own name, though "floor" is a label of Carpet
        ("wood floor", "Wood Floor"),
        ("floor mat", "Carpet"),
        ("KITCHEN_SINK", "Steel"),
        ("sink window", "Glass"),  # two hits against one
        ("stair railing", "Steel"),  # one hit each: the longer label
        ("unheard of", "(default)"),
    ],
)
def test_most_label_hits_win_after_the_name(database: str, category: str, name: str) -> None:
    assert load_database(database).materials([category])[0].names[0] == name


def test_categories_without_a_material_are_told_at_once(
    database: str, caplog: pytest.LogCaptureFixture
) -> None:
    found = load_database(database).materials(["floor", "vase", "Default", "lamp"])
    assert [table.names[0] for table in found] == ["Carpet", *["(default)"] * 3]
    assert [r.message for r in caplog.records] == [
        "no material for 'vase', 'lamp': the default (.1, .5, 0)"
    ]


def test_default_and_coefficients(tmp_path: Path) -> None:
    row = material("Odd", 1.2)
    row["transmission"] = [1000.0, 0.3]
    row["scattering"] = [4000.0, 0.6, 250.0, 0.2]  # in any order
    del row["damping"]
    table = load_database(write_database(tmp_path / "m.json", row)).materials(["odd"])[0]
    assert table.absorption.max() == 1.0  # of a reverberation chamber
    assert table.transmission.max() == 0.0  # nothing is left to pass
    assert table.scattering[
        0, np.searchsorted(table.frequency_hz, [250.0, 1000.0, 4000.0])
    ] == pytest.approx([0.2, 0.4, 0.6])
    assert (DEFAULT.absorption[0, 0], DEFAULT.scattering[0, 0], DEFAULT.transmission[0, 0]) == (
        0.1,
        0.5,
        0.0,
    )


def test_concatenated_tables_keep_their_rows(tmp_path: Path) -> None:
    a = load_database(write_database(tmp_path / "a.json", material("a", 0.2))).materials(["a"])[0]
    row = material("b", 0.4)
    row["absorption"] = [125.0, 0.1, 1000.0, 0.5, 4000.0, 0.9]
    b = load_database(write_database(tmp_path / "b.json", row)).materials(["b"])[0]
    whole = concatenate_tables([a, b, DEFAULT, b])
    bands = (88.0, 177.0, 707.0, 1414.0, 2828.0, 5657.0)
    for i, table in enumerate((a, b, DEFAULT, b)):
        for mine, theirs in zip(whole.in_bands(bands), table.in_bands(bands), strict=True):
            np.testing.assert_allclose(mine[i], theirs[0], rtol=1e-12)
