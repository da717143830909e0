"""Waves below an edge as datasets hold them: bytes, errors of quantising, tiles, readers, refusals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import soundspaces_parameters
import soundspaces_waves as sw
from soundspaces_parameters.of_waves import low_measures, octaves_below

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.core.errors import ConfigError, DatasetError, PointError
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.writing import encode_echograms

SIZE = (3.2, 2.7, 2.4)
POINTS = np.random.default_rng(1).uniform(0.1, 0.9, (6, 3)) * SIZE
CONFIG = ss.SimulationConfig(
    walks=32, duration=0.3, low=ss.LowConfig(method="waves", cells_per_wavelength=8.0)
)


def _room() -> ss.Scene:
    return ss.shoebox(SIZE, absorption=0.3, scattering=0.2)


def _build(folder: Path, tile: int | None, store: str = "echogram") -> Path:
    dataset = DatasetConfig(store=store, rate=8000, headings=(0.0,), tile=tile)  # type: ignore[arg-type]
    job = ss.JobConfig(simulation=CONFIG, dataset=dataset)
    return ss.build_dataset(_room(), folder, job, points=POINTS).folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _build(tmp_path_factory.mktemp("low"), 4, "both")


@pytest.fixture
def ds(folder: Path) -> Iterator[ss.RirDataset]:
    with ss.open_dataset(folder) as opened:
        yield opened


@pytest.fixture(scope="module")
def alone() -> sw.LowResponses:
    return sw.simulate_low(_room(), POINTS, POINTS, 0.3, CONFIG, cells_per_wavelength=8.0)


def test_quantising_is_40_db_below_the_sound(ds: ss.RirDataset, alone: sw.LowResponses) -> None:
    """In the whole, and in every 40 ms: it decays with the sound. Pressures are means of both ways."""
    for s, l in np.ndindex(6, 6):
        found, there, back = ds.low(s, l), alone[s, l], alone[l, s]
        assert found.edge == there.edge
        assert found.signal.shape == there.signal.shape
        pressure = 0.5 * (there.signal[:1] + back.signal[:1])
        for a, b in ((found.signal[:1], pressure), (found.signal[1:], there.signal[1:])):
            assert np.linalg.norm(a - b) < 0.01 * np.linalg.norm(b)
            for first in range(0, a.shape[1], 16):
                off = np.linalg.norm((a - b)[:, first : first + 16])
                assert off < 0.02 * np.linalg.norm(b[:, first : first + 16])


def test_pressures_are_the_same_both_ways(ds: ss.RirDataset) -> None:
    for s, l in np.ndindex(6, 6):
        np.testing.assert_array_equal(ds.low(s, l).signal[0], ds.low(l, s).signal[0])


def test_a_pair_takes_at_most_2_kb_a_second(folder: Path) -> None:
    """Beyond what the same shard takes without waves, of .35 s with the lead."""
    model_free = ss.simulate(_room(), POINTS, POINTS, ss.SimulationConfig(walks=32, duration=0.3))
    rows = np.arange(6)
    with EchogramShard(folder / "s00000_l00000.h5").file as file:
        head = {
            name: file.attrs[name] for name in ("key", "scene", "scene_digest", "config", "code_version")
        }
        attributes = {k: v.decode() for k, v in head.items()}
        attributes |= {"seed": 0, "speed_of_sound": 343.0, "licence": "", "citation": ""}
    low = ss.simulate(_room(), POINTS, POINTS, CONFIG)
    sizes = [len(encode_echograms(e, rows, rows, attributes)) for e in (low, model_free)]
    assert 300.0 < (sizes[0] - sizes[1]) / 36 < 2000.0 * 0.35


def test_every_way_of_reading_follows(ds: ss.RirDataset, folder: Path) -> None:
    """Echograms, stored and rendered waveforms, ears, arrays, a source with a directivity, one that moves."""
    found = ds.echogram(0, 1).low
    assert found is not None
    np.testing.assert_array_equal(found.signal, ds.low(0, 1).signal)
    stored, rendered = ds.ambisonic(0, 1), ss.ambisonic_rir(ds[0, 1], 16000)
    spectra = [np.fft.rfft(r[:4], 1 << 15 >> k)[:, :500] for k, r in ((1, stored), (0, rendered))]
    band = slice(60, 300)  # 30 to 146 Hz: waves alone, so that the rate, and its noise, do not matter
    np.testing.assert_allclose(
        spectra[0][:, band], spectra[1][:, band], atol=0.01 * np.abs(spectra[1]).max()
    )
    frequency, transfer = ds.low(0, 1).transfer()
    at = int(np.abs(frequency - 53.0).argmin())  # the first mode along x
    bin_ = frequency[at] * (1 << 14) / 8000
    near = np.abs(np.fft.rfft(stored[0], 1 << 14)[int(bin_) : int(bin_) + 2]).mean()
    assert near == pytest.approx(abs(transfer[0, at]), rel=0.1)
    assert ds.binaural(0, 1, 30.0, source="talker").shape[0] == 2
    array = ss.MicrophoneArray([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    assert np.isfinite(ds.microphones(0, 1, array)).all()
    click = np.zeros(800, np.float32)
    click[0] = 1.0
    way = np.array([[0.0, *POINTS[0]], [0.1, *(0.9 * POINTS[0] + 0.1 * POINTS[1])]])
    heard = ds.render_path(click, way, 1)
    still = ds.render(click, 0, 1)
    n = min(heard.shape[1], still.shape[1])
    lows = [np.abs(np.fft.rfft(x[:, :n], 1 << 14))[:, 60:300] for x in (heard, still)]
    assert 20.0 * np.log10(np.linalg.norm(lows[0]) / np.linalg.norm(lows[1])) == pytest.approx(
        0.0, abs=1.0
    )
    assert ss.verify_dataset(folder, full=True)[1] == []


def test_measures_of_waves_are_beside_those_of_echograms(ds: ss.RirDataset) -> None:
    """Opt-in, in octaves below the edge; all else as without."""
    names, pairs = ("t20", "c80", "g"), [(0, 1), (3, 2)]
    plain, waves = (ds.parameters(names, pairs=pairs, waves=w) for w in (False, True))
    for row, (s, l) in enumerate(pairs):
        direct = ds.echogram(s, l).direct
        assert direct is not None
        own = low_measures(ds.low(s, l), octaves_below(176.0), direct.delay)
        np.testing.assert_allclose(waves["c80"][row, :2], own.c80)
        np.testing.assert_allclose(waves["t20"][row, :2], own.t20)
    assert np.abs(waves["c80"] - plain["c80"])[:, :2].min() > 0.01
    assert np.isnan(waves.values["c80"][:, :2, 1:]).all()
    for name in names:
        np.testing.assert_array_equal(waves.values[name][:, 2:], plain.values[name][:, 2:])
    np.testing.assert_array_equal(waves.values["g"], plain.values["g"])
    echogram = ds.echogram(0, 1)
    alone = soundspaces_parameters.room_parameters(echogram, "c80", waves=True)
    np.testing.assert_array_equal(alone["c80"], waves["c80"][:1])
    with pytest.raises(ConfigError, match="there are none"):
        soundspaces_parameters.room_parameters(replace(echogram, low=None), "c80", waves=True)
    with pytest.raises(ConfigError, match="edges up to 176 Hz"):
        low_measures(ds.low(0, 1), (50.0, 400.0), None)


def test_bytes_are_the_same_for_any_tiles_and_after_a_crash(folder: Path, tmp_path: Path) -> None:
    """Keys of shards hold the tiles' spans; what is in them is compared."""
    other = _build(tmp_path / "other", 6)
    with ss.open_dataset(other) as a, ss.open_dataset(folder) as b:
        for s, l in np.ndindex(6, 6):
            np.testing.assert_array_equal(a.low(s, l).signal, b.low(s, l).signal)
    first = _build(tmp_path / "first", 2)
    before = {path.name: path.read_bytes() for path in first.glob("*.h5")}
    (first / "s00002_l00000.h5").unlink()
    (first / "manifest.json").unlink()
    again = _build(tmp_path / "first", 2)
    assert {path.name: path.read_bytes() for path in again.glob("*.h5")} == before


def test_what_is_refused(folder: Path, dataset_folder: Path, tmp_path: Path) -> None:
    with ss.open_dataset(dataset_folder) as plain, pytest.raises(DatasetError, match="holds no waves"):
        plain.low(0, 1)
    name = "s00000_l00000.h5"
    for damage, message in (("edge", "waves up to"), ("peak", "low_peak"), ("short", "to a peak")):
        path = tmp_path / f"{damage}.h5"
        path.write_bytes((folder / name).read_bytes())
        with h5py.File(path, "r+") as file:
            if damage == "edge":
                file.attrs["low_edge"] = np.nan
            elif damage == "peak":
                file["low_peak"][0, 0, 0, 0] = np.nan
            else:
                peaks = file["low_peak"][:, :, :, 1:]
                del file["low_peak"]
                file["low_peak"] = peaks
        with pytest.raises(DatasetError, match=message):
            EchogramShard(path).echogram(0, 0)


def test_a_point_in_a_body_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    room = _room()
    lid = room.vertices.copy()
    lid[:, 2] = 2.35 + 0.01 * lid[:, 2]  # a body of 2.4 cm, between cells
    both = ss.Scene(
        np.concatenate([room.vertices, lid]),
        np.concatenate([room.faces, room.faces + len(lid)]),
        np.concatenate([room.face_material] * 2),
        room.materials,
    )
    points = np.concatenate([POINTS[:2], [[1.6, 1.3, 2.36]]])
    with pytest.raises(PointError, match="inside a body"):
        ss.build_dataset(both, tmp_path, ss.JobConfig(simulation=CONFIG), points=points)
    assert not list(tmp_path.rglob("*.h5"))
