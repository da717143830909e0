"""Room parameters of a dataset: the table's values, files, the command line, maps."""

from __future__ import annotations

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import soundspaces_parameters
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.echogram.measure_names import MEASURES
from tests.command_line import run_command


@pytest.fixture
def ds(dataset_folder: Path) -> ss.RirDataset:
    return ss.open_dataset(dataset_folder)


def test_stored_bands_give_the_table(ds: ss.RirDataset) -> None:
    """The eight measures that a dataset stores, and their errors: the same numbers, but for what files round: 95 in
    100 within 0.1 dB (of D50 that is 0.006) or 3 ms."""
    table = ds.table()
    pairs = [(int(row["source"]), int(row["listener"])) for row in table]
    found = ds.parameters(MEASURES, "stored", pairs)
    off, compared = list[float](), 0
    for row, (s, l) in enumerate(pairs):
        (stored,) = table[(table["source"] == s) & (table["listener"] == l)]
        for name in MEASURES:
            for b in range(4):
                value, error, interpolation = found.values[name][row, b]
                if np.isfinite(value) and np.isfinite(stored[f"{name}_{b}"]):
                    near = {"c50": 0.1, "c80": 0.1, "drr": 0.1, "d50": 0.006}.get(name, 3e-3)
                    off.append(abs(value - stored[f"{name}_{b}"]) / near)
                    assert error == pytest.approx(stored[f"{name}_error_{b}"], nan_ok=True)
                    assert interpolation == 0.0
                    compared += 1
    assert compared > 1000 and np.quantile(off, 0.95) < 1.0 and max(off) < 3.0


def test_octaves_within_a_band_have_its_value(ds: ss.RirDataset) -> None:
    """This room absorbs alike in all bands: octaves differ by the air's absorption, and by what early arrivals add that come
    together, those there and back between two walls among them; so that little is uncertain about their course."""
    found = ds.parameters(
        ("c50", "g", "sti"), pairs=[(0, 3)], speech=soundspaces_parameters.Speech(60.0, [40.0] * 7)
    )
    assert found.bands.centre == (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
    stored = ds.parameters(("c50", "g"), "stored", [(0, 3)])
    for name in ("c50", "g"):
        octaves, bands = found[name][0, 1:4], stored[name][0, :2]
        np.testing.assert_allclose([octaves[0], octaves[1:].mean()], bands, atol=0.03)
        np.testing.assert_allclose(
            octaves[1:], bands[1], atol=0.05
        )  # air takes more of the upper octave
        assert (found.values[name][0, :8, 2] < 0.05).all()  # as near as the octaves are
        error = found.values[name][0, :8, 1]
        assert (np.isnan(error) | (error > 0.0)).all()  # not known where few subpaths bring the energy
    quiet = ds.parameters("sti", pairs=[(0, 3)])
    assert 0.0 < found["sti"][0, 0] < quiet["sti"][0, 0] < 1.0


def test_tables_as_files(ds: ss.RirDataset, tmp_path: Path) -> None:
    """CSV with its metadata, and a data frame: rows of pairs and octaves, and one of single numbers."""
    found = ds.parameters(("t30", "c80", "sti"), pairs=[(0, 3), (3, 0)])
    assert repr(found).startswith("ParameterTable: t30, c80, sti of 2 pairs at 63, 125")
    path, beside = found.write(tmp_path / "p.csv")
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 9 and [r["band_hz"] for r in rows[:9]][-1] == "0.0"
    assert float(rows[4]["c80"]) == found["c80"][0, 4] and float(rows[8]["sti"]) == found["sti"][0, 0]
    meta = json.loads(beside.read_text())["tableSchema"]
    assert meta["primaryKey"] == ["source", "listener", "band_hz"]
    assert {c["name"]: c["schema:unitText"] for c in meta["columns"]}["c80_error"] == "dB"
    frame = found.pandas()
    assert frame["band_hz"].tolist() == found.rows()["band_hz"].tolist()
    with pytest.raises(ss.ConfigError, match=r"\.csv, \.xlsx, \.parquet"):
        found.write(tmp_path / "p.txt")


def test_a_workbook(ds: ss.RirDataset, tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="the extra `xlsx` is not installed")
    found = ds.parameters(("c80", "lf"), pairs=[(0, 3)])
    (path,) = found.write(tmp_path / "p.xlsx")
    book = openpyxl.load_workbook(path)
    rows = list(book["parameters"].values)
    assert rows[0] == found.rows().dtype.names and len(rows) == 10
    assert rows[1][5] == pytest.approx(found["c80"][0, 0]) and "dB" in [
        r[1] for r in book["columns"].values
    ]


def test_what_does_not_exist_is_told(ds: ss.RirDataset) -> None:
    with pytest.raises(ss.PairIndexError, match="out of range"):
        ds.parameters("t30", pairs=[(0, 99)])
    with pytest.raises(ss.ConfigError, match="at least 4"):
        ds.office(0, [1, 2])
    with pytest.raises(ss.PairIndexError, match="is the source"):
        ds.office(0, [0, 1, 2, 3])


def test_an_office(ds: ss.RirDataset) -> None:
    """Two rooms of 8 m: the level at 4 m is that of a room, above the open field's."""
    found = ds.office(0, list(range(1, len(ds.points))), noise_db=[45, 42, 40, 36, 33, 30, 27])
    assert 0.0 < found.d2s.value < 12.0 and found.lpas4m.value > 57.4 - 20.0 * np.log10(4.0)
    assert found.lpas4m.error > 0.0 and (np.diff(found.sti[np.argsort(found.distance)]) < 0.3).all()


def test_directive_sources_have_half_samples_alone(ds: ss.RirDataset) -> None:
    """Stored errors are those of omnidirectional ends."""
    found = ds.parameters(("t20", "g"), pairs=[(0, 3)], source="talker")
    assert np.isnan(found.values["t20"][0, :, 1]).all() and (found.values["g"][0, :8, 1] > 0.0).all()


def test_commands(ds: ss.RirDataset, tmp_path: Path) -> None:
    run, of = partial(run_command, cwd=tmp_path), ("parameters", str(ds.path), "--source", "0")
    done = run(*of, "--names", "c80, sti", "--out", "o.csv")
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "o.csv").read_text().splitlines()) == 1 + 7 * 9
    done = run(*of, "--thirds", "--names", "g", "--out", "t.csv")
    assert done.returncode == 0 and "6300.0" in (tmp_path / "t.csv").read_text(), done.stderr
    for wrong, what in (
        ((*of, "--noise", "1,2,x", "--out", "w.csv"), "seven numbers"),
        ((*of, "--names", "t31", "--out", "w.csv"), "there is no 't31'"),
        (
            ("plot", str(ds.path), "--what", "map", "--parameter", "sti", "--out", "w.png"),
            "belong to --what parameter",
        ),
        (("report", str(ds.path), "--source", "1", "--out", "w.html"), "belongs to --receiver"),
    ):
        done = run(*wrong)
        assert done.returncode != 0 and what in done.stderr, (wrong, done)


@pytest.mark.parametrize("name", ["sti", "lf"])
def test_maps(ds: ss.RirDataset, tmp_path: Path, name: str) -> None:
    out = tmp_path / "map.png"
    done = CliRunner().invoke(app, ["plot", str(ds.path), "--parameter", name, "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    assert out.stat().st_size > 5000
    done = CliRunner().invoke(app, ["plot", str(ds.path), "--parameter", "lf", "--band", "31000"])
    assert "expected one of 63, 125" in done.output
