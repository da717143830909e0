"""What reads datasets takes those with waves: exporters, tables, `verify`, `report`, `inspect`, the explorer, `pack`."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import sofar
import soundfile
from soundspaces_parameters.of_waves import low_measures, octaves_below
from soundspaces_pictures.report import low_medians, write_report

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.dataset.exporters import EXPORTERS, find_exporter
from soundspaces_sim.dataset.exporters.plan import carry_out
from tests.command_line import run_command
from tests.marks import ci_slow

SIZE, RATE = (3.2, 2.7, 2.4), 8000
POINTS = np.random.default_rng(1).uniform(0.1, 0.9, (4, 3)) * SIZE


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `build_dataset` makes it: echograms and waveforms of four points."""
    low = ss.LowConfig(method="waves", cells_per_wavelength=8.0)
    job = ss.JobConfig(
        simulation=ss.SimulationConfig(walks=32, duration=0.6, low=low),
        dataset=DatasetConfig(store="both", rate=RATE, headings=(0.0,)),
    )
    room = ss.shoebox(SIZE, absorption=0.3, scattering=0.2)
    out = tmp_path_factory.mktemp("clients")
    return ss.build_dataset(room, out, job, points=POINTS).folder


@pytest.fixture(scope="module")
def ds(folder: Path) -> ss.RirDataset:
    return ss.open_dataset(folder)


def _low_level(signal: np.ndarray, rate: int = RATE) -> float:
    """dB, from 30 to 150 Hz."""
    power = np.abs(np.fft.rfft(signal, 1 << 14)) ** 2
    return float(10.0 * np.log10(power[int(30 / rate * 2**14) : int(150 / rate * 2**14)].sum()))


@pytest.mark.parametrize("layout", list(EXPORTERS))
def test_exports_hold_waves(ds: ss.RirDataset, layout: str, tmp_path: Path) -> None:
    """Every layout is written; what it holds below the edge is what the reader renders of the waves there, which is not
    what the echogram alone is rendered to."""
    (tmp_path / "pairs.txt").write_text("0 1\n2 3\n")
    out = tmp_path / "out"
    carry_out(find_exporter(layout, {"pairs": tmp_path / "pairs.txt"})(ds, out))
    files = [path for path in out.rglob("*") if path.is_file()]
    assert files
    sounds = sorted(path for path in files if path.suffix in (".wav", ".flac"))
    plain = ss.ambisonic_rir(replace(ds[0, 1], low=None), RATE)[0]
    assert abs(_low_level(ds.monaural(0, 1)[0]) - _low_level(plain)) > 0.3
    if layout == "sofa":
        field = np.asarray(sofar.read_sofa(files[0], verbose=False).Data_IR)[0, 0]
        assert _low_level(field) == pytest.approx(_low_level(ds.ambisonic(0, 1)[0]), abs=0.3)
    elif layout in ("ambisonics", "iso3382"):
        found = [np.atleast_2d(soundfile.read(path)[0].T)[0] for path in sounds]
        for signal, (s, l) in zip(found, ((0, 1), (2, 3)), strict=True):
            wanted, alone = ds.monaural(s, l)[0], ss.ambisonic_rir(replace(ds[s, l], low=None), RATE)[0]
            shape = _shape(signal, wanted)
            assert shape > 0.99 and shape > _shape(signal, alone)
    elif layout in ("wav", "soundspaces-v1"):
        ears = [soundfile.read(path)[0].T for path in sounds if re.search(r"0_1|1_0", path.name)]
        assert max(_shape(e[0], ds.binaural(0, 1)[0]) for e in ears) > 0.99


def _shape(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of spectra's magnitudes from 30 to 150 Hz."""
    band = slice(int(30 / RATE * 2**14), int(150 / RATE * 2**14))
    a, b = (np.abs(np.fft.rfft(x, 1 << 14))[band] for x in (one, other))
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def test_tables_take_waves(ds: ss.RirDataset, folder: Path, tmp_path: Path) -> None:
    run = partial(run_command, cwd=tmp_path)
    done = run("parameters", str(folder), "--names", "c80", "--waves", "--out", "parameters.csv")
    assert done.returncode == 0, done.stderr
    with (tmp_path / "parameters.csv").open() as file:
        first = next(csv.DictReader(file))
    direct = ds[0, 1].direct
    assert direct is not None
    own = low_measures(ds.low(0, 1), octaves_below(176.0), direct.delay)
    assert float(first["c80"]) == pytest.approx(own.c80[0])
    assert first["c80_error"] == "nan"
    assert run("table", str(folder), "--out", "pairs.csv").returncode == 0  # of echograms


@ci_slow
def test_verify_and_report_take_waves(ds: ss.RirDataset, folder: Path, tmp_path: Path) -> None:
    """A report has medians of the waves' measures beside those of echograms."""
    done = run_command("verify", str(folder), "--full", cwd=tmp_path)
    assert done.returncode == 0 and "are whole" in done.stdout
    assert write_report(folder, tmp_path / "report.html") == []
    page = (tmp_path / "report.html").read_text("utf-8")
    found = low_medians(ds, ds.table())
    assert found["bands"] == ["63 Hz", "125 Hz"]
    pairs = ds.table()[["source", "listener"]].tolist()
    c50 = ds.parameters("c50", pairs=pairs, waves=True)["c50"][:, 1]
    label, texts = found["medians"][2]
    assert label == "C50 (dB)" and texts[1].startswith(f"{np.median(c50):.1f}".replace("-", "−"))
    assert all(f'<td class="n">{text}</td>' in page for text in texts)


def test_pictures_take_waves(folder: Path, tmp_path: Path) -> None:
    """Maps of modes are drawn."""
    done = run_command(
        "plot", str(folder), "--what", "modes", "--frequency", "54", "--out", "m.png", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    for command in (("pack", str(folder)), ("cite", str(folder))):
        ended = run_command(*command, cwd=tmp_path)
        assert ended.returncode == 0, (command, ended.stderr)
