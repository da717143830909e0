"""Room parameters of a dataset: the table's values, files, the command line, maps and the page on a receiver."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.cli.app import app
from soundspaces_sim.dataset.room_parameters.registry import PARAMETERS
from soundspaces_sim.echogram.echogram import EDGE, KINDS, Arrivals
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.viz.receiver_report import Reflection, _line, edges_told, planes_told, reflections
from tests.viz.test_report import _Page


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
    found = ds.parameters(("c50", "g", "sti"), pairs=[(0, 3)], speech=ss.Speech(60.0, [40.0] * 7))
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


def test_reflections_have_surfaces(ds: ss.RirDataset) -> None:
    """Two rooms of 4 m x 4 m x 2.5 m side by side: first-order reflections come off their six planes and the wall
    between, and every corner lies on one; path lengths say so too."""
    s, l = ds.points[0], ds.points[3]
    found = ds.echogram(0, 3)
    planes = planes_told([(found, s, l)], 343.0)
    assert len(planes) >= 4
    walls = {0: (0.0, 4.0, 8.0), 1: (0.0, 4.0), 2: (0.0, 2.5)}
    for plane in planes.values():
        axis = int(np.abs(plane.normal).argmax())
        assert abs(plane.normal[axis]) > 0.999
        assert min(abs(plane.point[axis] - x) for x in walls[axis]) < 0.01
        legs = np.linalg.norm(plane.point - s) + np.linalg.norm(plane.point - l)
        assert np.abs(found.early.delay * 343.0 - legs).min() < 1e-3
    listed = reflections(found, s, l, planes, {}, 2, 343.0)
    assert [r.number for r in listed] == list(range(listed[0].number, listed[0].number + len(listed)))
    assert [r.delay for r in listed] == sorted(r.delay for r in listed)
    assert any("facing up at z = 0.00 m" in r.surfaces for r in listed)
    direct = [r for r in listed if r.number == 0]
    assert all(abs(r.azimuth) < 1e-6 and r.surfaces == "direct sound" for r in direct)


def _arrivals(*arrivals: tuple[float, int, tuple[int, int], tuple[int, int], bool]) -> Arrivals:
    """Of (delay, kind, planes, edges, whether it is heard)."""
    delay, kind, planes, edges, heard = zip(*arrivals, strict=True)
    energy = 1e-4 * np.array(heard, float)[:, None]
    direction = np.tile([1.0, 0.0, 0.0], (len(delay), 1))
    return Arrivals(
        np.array(delay), energy, direction, np.array(planes), np.array(kind), np.array(edges)
    )


def test_edges_are_told_by_their_places_and_numbers_have_no_gaps(ds: ss.RirDataset) -> None:
    edge, both = (
        KINDS.index(KINDS[EDGE]),
        next(k for k, name in enumerate(KINDS) if name.startswith("edge,")),
    )
    early = _arrivals(
        (0.03, edge, (-1, -1), (15, -1), True), (0.04, 0, (7, -1), (-1, -1), False),
        (0.05, both, (7, -1), (15, -1), True), (0.06, both, (7, -1), (16, -1), True),
    )  # fmt: skip
    found = replace(ds.echogram(0, 3), early=early, bands=(0.0, 1e4), direct=None)
    s, l = ds.points[0], ds.points[3]
    bends = edges_told([(found, s, l)], 343.0)
    place = "({:.2f}, {:.2f}, {:.2f}) m".format(*bends[15])
    listed = reflections(found, s, l, {}, bends, 0, 343.0)
    assert [r.number for r in listed] == [1, 2, 3]
    assert listed[0].surfaces == f"edge at {place}"
    assert listed[1].surfaces.startswith(f"edge through {place}, then a surface")
    assert listed[2].surfaces.startswith("an edge that no other path tells of, then")


@pytest.mark.parametrize(
    ("value", "text"), [(-0.3, "0"), (-0.6, "−1"), (0.0, "0"), (-0.0, "0"), (12.0, "12")]
)
def test_there_is_no_sign_before_nothing(value: float, text: str) -> None:
    line = _line(Reflection(0, 0.01, value, 179.9, value, ""), [Reflection(0, 0.01, 0.0, 0.0, 0.0, "")])
    assert line[6] == f"{text}°" and line[5] == "behind" and "−0.0" not in line[3:5]


def test_commands(ds: ss.RirDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = CliRunner()
    done = run.invoke(
        app,
        [
            "table",
            str(ds.path),
            "--octaves",
            "--parameters",
            "c80, sti",
            "--source",
            "0",
            "--out",
            "o.csv",
        ],
    )
    assert done.exit_code == 0, done.output
    assert len(Path("o.csv").read_text().splitlines()) == 1 + 7 * 9
    thirds = ["--thirds", "--parameters", "g", "--source", "0", "--out", "t.csv"]
    done = run.invoke(app, ["table", str(ds.path), *thirds])
    assert done.exit_code == 0 and "6300.0" in Path("t.csv").read_text(), done.output
    for wrong, what in (
        (["table", str(ds.path), "--parameters", "g"], "belong to --octaves"),
        (["table", str(ds.path), "--octaves", "--noise", "1,2,x", "--out", "w.csv"], "seven numbers"),
        (
            ["table", str(ds.path), "--octaves", "--parameters", "t31", "--out", "w.csv"],
            "there is no 't31'",
        ),
        (
            ["plot", str(ds.path), "--what", "map", "--parameter", "sti", "--out", "w.png"],
            "belong to --what parameter",
        ),
        (["report", str(ds.path), "--source", "1", "--out", "w.html"], "belongs to --receiver"),
    ):
        done = run.invoke(app, wrong)
        assert done.exit_code != 0 and what in str(done.exception), (wrong, done.exception, done.output)


@pytest.mark.parametrize("name", ["sti", "lf"])
def test_maps(ds: ss.RirDataset, tmp_path: Path, name: str) -> None:
    out = tmp_path / "map.png"
    done = CliRunner().invoke(app, ["plot", str(ds.path), "--parameter", name, "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    assert out.stat().st_size > 5000
    done = CliRunner().invoke(app, ["plot", str(ds.path), "--parameter", "lf", "--band", "31000"])
    assert "expected one of 63, 125" in str(done.exception)


def test_the_page_on_a_receiver(ds: ss.RirDataset, tmp_path: Path) -> None:
    """It has every parameter, every reflection with its surfaces, and loads and runs nothing."""
    out = tmp_path / "r.html"
    done = CliRunner().invoke(
        app,
        [
            "report",
            str(ds.path),
            "--receiver",
            "3",
            "--source",
            "0",
            "--out",
            str(out),
            "--noise",
            "40,40,40,35,30,25,20",
        ],
    )
    assert done.exit_code == 0, (done.output, done.exception)
    page = _Page(out.read_text("utf-8"))
    assert (
        "script" not in page.tags and len([x for x in page.loads if x.startswith("data:image/png")]) == 2
    )
    assert all(x.startswith("data:") for x in page.loads)
    for name in PARAMETERS:
        assert name in page.text
    for text in ("direct sound", "facing up at z = 0.00 m", "noise 40 40 40 35 30 25 20 dB", "±"):
        assert text in page.text, text
    assert page.text.count("surface facing") + page.text.count("edge") >= len(ds.echogram(0, 3).early)
