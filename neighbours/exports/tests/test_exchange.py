"""Exports read as their clients read them; points and graphs of strangers."""

from __future__ import annotations

import logging
import os
import pickle
import shutil
from functools import partial
from pathlib import Path

import networkx
import numpy as np
import pytest
import soundfile
from msgspec.structs import replace
from scipy.io import wavfile
from scipy.signal import fftconvolve
from soundspaces_exports.ambisonics import plan_ambisonics
from soundspaces_exports.pickled import read_graph
from soundspaces_exports.soundspaces1 import ONSET, plan_soundspaces1
from soundspaces_parameters.iso3382 import plan_iso3382

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError, PointError
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.dataset.exporters.points import points_text, read_points
from soundspaces_sim.dataset.exporters.wav import plan_wav
from soundspaces_sim.dataset.format.manifest import read_manifest, write_manifest
from soundspaces_sim.rendering.soundfield import convert
from tests.command_line import run_command


@pytest.fixture(scope="module")
def exported(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("v1")
    with ss.open_dataset(dataset_folder) as ds:
        assert carry_out(plan_soundspaces1(ds, out)) == 5 * len(ds)
    return out


def test_metadata_as_the_public_client_reads_it(exported: Path, dataset_folder: Path) -> None:
    """habitat_sim's SoundSpacesSim: loadtxt-like points, graph nodes keyed by positions to two decimals."""
    ds = ss.open_dataset(dataset_folder)
    folder = exported / "metadata" / "replica" / "two_rooms"
    points: list[list[float]] = []
    for line in (folder / "points.txt").read_text().splitlines():
        fields = line.split("\t")
        assert len(fields) == 4 and fields[0] == str(len(points))
        points.append([float(x) for x in fields[1:]])
    raised = ds.points + [0.0, 0.0, 0.0528907]  # from the grid's 1.5 m to Replica's 1.5528907 m
    np.testing.assert_allclose(points, raised, atol=1e-6)
    graph = pickle.loads((folder / "graph.pkl").read_bytes())
    assert isinstance(graph, networkx.Graph) and not graph.is_directed()
    keys = {}
    for node in graph.nodes:
        assert type(node) is int
        x, y, z = graph.nodes[node]["point"]
        keys[f"{x:.2f}_{y:.2f}_{z:.2f}"] = node
        np.testing.assert_allclose([x, -z, y + 1.5528907], raised[node], atol=1e-6)
        assert abs(y) < 1e-6  # on the floor
    assert len(keys) == len(graph.nodes) and not any("-0.00" in key for key in keys)
    assert all(not data for *_, data in graph.edges(data=True))


def test_binaural_files_as_the_public_client_reads_them(exported: Path, dataset_folder: Path) -> None:
    ds = ss.open_dataset(dataset_folder)
    n = len(ds.points)
    for azimuth in (0, 90, 180, 270):
        folder = exported / "binaural_rirs" / "replica" / "two_rooms" / str(azimuth)
        assert {p.name for p in folder.iterdir()} == {f"{r}_{s}.wav" for r in range(n) for s in range(n)}
    path = exported / "binaural_rirs" / "replica" / "two_rooms" / "0" / "2_1.wav"
    rate, rir = wavfile.read(path)
    assert rate == 16000 and rir.dtype == np.float32 and rir.shape[1] == 2
    assert path.read_bytes()[36:40] == b"data"  # a 44-byte header
    sound = np.random.default_rng(0).standard_normal(rate)
    ears = np.array([fftconvolve(sound, rir[:, ear])[:rate] for ear in (0, 1)])
    assert ss.spectrogram(ears, rate).shape == (65, 26, 2)
    # source 1, listener 2; azimuth 0 faces +Y: heading 90 degrees
    heading = ds.binaural(1, 2, 90.0)
    delay = np.linalg.norm(ds.points[1] - ds.points[2]) / 343.0
    shift = ONSET - round(delay * rate)
    np.testing.assert_array_equal(rir[max(shift, 0) :][:1000], heading.T[max(-shift, 0) :][:1000])
    assert abs(int(np.abs(rir).max(axis=1).argmax()) - ONSET) < 16  # the direct sound, without its delay


def test_azimuth_of_a_source_to_the_east(exported: Path, dataset_folder: Path) -> None:
    """Azimuth 0 faces +Y: a source towards +X is on the right; azimuth 180 has it on the left."""
    ds = ss.open_dataset(dataset_folder)
    listener = 0
    level = np.isclose(ds.points[:, 1:], ds.points[0, 1:]).all(axis=1)
    east = int(np.flatnonzero(level & (ds.points[:, 0] > ds.points[0, 0]))[0])
    for azimuth, louder in ((0, 1), (180, 0)):
        path = exported / "binaural_rirs/replica/two_rooms" / str(azimuth) / f"{listener}_{east}.wav"
        _, rir = wavfile.read(path)
        early = (rir[ONSET - 40 : ONSET + 60].astype(float) ** 2).sum(axis=0)
        assert early[louder] > 1.5 * early[1 - louder]


def test_ambisonic_files(exported: Path, dataset_folder: Path) -> None:
    ds = ss.open_dataset(dataset_folder)
    rate, rir = wavfile.read(exported / "ambisonic_rirs" / "replica" / "two_rooms" / "irs" / "3_0.wav")
    assert rate == 16000 and rir.shape[1] == 9 and rir.dtype == np.float32
    field = convert(ds.ambisonic(0, 3), "soundspaces1")
    shift = ONSET - round(float(np.linalg.norm(ds.points[0] - ds.points[3])) / 343.0 * rate)
    np.testing.assert_array_equal(rir[max(shift, 0) :][:1000], field.T[max(-shift, 0) :][:1000])


def test_points_and_graphs_come_back(exported: Path, dataset_folder: Path) -> None:
    ds = ss.open_dataset(dataset_folder)
    folder = exported / "metadata" / "replica" / "two_rooms"
    raised = ds.points + [0.0, 0.0, 0.0528907]
    np.testing.assert_allclose(read_points(folder / "points.txt"), raised, atol=1e-6)
    on_floor = read_points(folder / "graph.pkl")
    np.testing.assert_allclose(
        on_floor[:, :2], ds.points[sorted(read_graph(folder / "graph.pkl").nodes)][:, :2]
    )
    assert "-0.0" not in points_text(np.array([[-0.0, -1e-9, 1.0]]))


def test_export_and_table_commands(dataset_folder: Path, tmp_path: Path) -> None:
    """The command line exports one dataset, or every one in a folder."""
    run = partial(run_command, cwd=tmp_path)
    done = run(
        "export", "soundspaces-v1", str(dataset_folder.parent), "--out", "v1", "--rate", "8000", "--name", "mp3d"
    )  # fmt: skip
    assert done.returncode == 0 and "two_rooms" in done.stdout, done.stderr
    rate, _ = wavfile.read(tmp_path / "v1" / "binaural_rirs" / "mp3d" / "two_rooms" / "90" / "0_1.wav")
    assert rate == 8000
    assert run("table", str(dataset_folder), "--out", "pairs.csv").returncode == 0
    assert (tmp_path / "pairs.csv").read_text().startswith("source,listener,source_x")
    bad = run("export", "mp3", str(dataset_folder))
    assert bad.returncode == 2 and "soundspaces-v1, sofa, huggingface" in bad.stderr


class _Evil:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch /tmp/soundspaces_sim_was_here",)


def test_pickles_of_strangers_are_data(tmp_path: Path) -> None:
    path = tmp_path / "graph.pkl"
    for content in (pickle.dumps(_Evil()), b"", b"garbage", pickle.dumps({"a": 1}), pickle.dumps(_Evil)):
        path.write_bytes(content)
        with pytest.raises(PointError):
            read_graph(path)
    assert not Path("/tmp/soundspaces_sim_was_here").exists()


@pytest.fixture
def fewer_nodes(dataset_folder: Path, tmp_path: Path) -> Path:
    """A dataset two of whose points are no nodes of the navigation graph."""
    folder = tmp_path / "few" / dataset_folder.name
    shutil.copytree(dataset_folder, folder)
    manifest = read_manifest(folder)
    nodes = manifest.nodes[:-2]
    edges = tuple(e for e in manifest.edges if max(e) <= nodes[-1])
    write_manifest(folder, replace(manifest, nodes=nodes, edges=edges))
    return folder


def test_export_says_its_size_before_it_writes(fewer_nodes: Path, tmp_path: Path) -> None:
    """WAV: within 3 %. Pairs of graph nodes by default; others on request; all known before the first file."""
    with ss.open_dataset(fewer_nodes) as ds:
        nodes, n = len(ds.manifest.nodes), len(ds.points)
        assert nodes == n - 2
        plan = plan_soundspaces1(ds, tmp_path / "v1")
        assert plan.files == 5 * nodes**2 and not (tmp_path / "v1").exists()
        assert carry_out(plan) == plan.files
        written = list((tmp_path / "v1").rglob("*.wav"))
        assert len(written) == plan.files
        assert sum(p.stat().st_size for p in written) == pytest.approx(plan.bytes, rel=0.03)

        chosen = tmp_path / "pairs.txt"
        chosen.write_text("0 1\n3 2\n")
        few = plan_soundspaces1(ds, tmp_path / "few-v1", "mp3d", False, (90.0, 45.0), chosen)
        assert carry_out(few) == 4
        names = {str(p.relative_to(tmp_path / "few-v1")) for p in (tmp_path / "few-v1").rglob("*.wav")}
        folder = "binaural_rirs/mp3d/two_rooms"
        assert names == {f"{folder}/{a}/{r}.wav" for a in (45, 90) for r in ("1_0", "2_3")}

        assert plan_wav(ds, tmp_path, (0.0,), False, "all").files == n * n
        assert plan_wav(ds, tmp_path, (0.0,), False, "nodes").files == nodes**2
        for text, message in (
            ("0 99\n", "not among points"),
            ("a b\n", "two integers"),
            ("", "at least one"),
        ):
            chosen.write_text(text)
            with pytest.raises(ss.ConfigError, match=message):
                plan_wav(ds, tmp_path, pairs=chosen)
        with pytest.raises(ss.ConfigError, match="nodes, all or a file of pairs"):
            plan_wav(ds, tmp_path, pairs="some")
        with pytest.raises(ss.ConfigError, match="different degrees"):
            plan_wav(ds, tmp_path, (0.0, 360.0))
        with pytest.raises(ss.ConfigError, match="name: expected replica or mp3d, got 'foo'"):
            plan_soundspaces1(ds, tmp_path, "foo")


def test_rates_and_heights_that_clients_do_not_expect(
    dataset_folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """mp3d is read at 16 kHz: a dataset of another rate is refused, unless that rate was asked for."""
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    manifest = read_manifest(folder)
    config = replace(manifest.config, dataset=replace(manifest.config.dataset, rate=44100))
    write_manifest(folder, replace(manifest, config=config))
    with (
        ss.open_dataset(folder) as ds,
        pytest.raises(ss.ConfigError, match=r"mp3d at 16000 Hz.*44100 Hz; say --rate 16000"),
    ):
        plan_soundspaces1(ds, tmp_path / "v1", "mp3d")
    with ss.open_dataset(folder, 16000) as ds:
        plan_soundspaces1(ds, tmp_path / "v1", "mp3d")
        assert not caplog.records
        plan_soundspaces1(ds, tmp_path / "v1", "replica")
        assert "clients read replica at 44100 Hz; this export has 16000 Hz" in caplog.text
    caplog.clear()
    few = tmp_path / "pairs.txt"
    few.write_text("0 1\n")
    with ss.open_dataset(folder) as ds, caplog.at_level(logging.WARNING):
        carry_out(plan_soundspaces1(ds, tmp_path / "v1", pairs=few))
        assert "points are written +0.0529 m higher than they were simulated" in caplog.text


def test_higher_orders_are_what_the_reader_gives(dataset_folder: Path, tmp_path: Path) -> None:
    """16 channels; the first nine have the energy that order 2 has; N3D is sqrt(2 n + 1) times as loud."""
    ds = ss.open_dataset(dataset_folder)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("0 1\n")
    for convention in ("sn3d", "n3d"):
        plan = plan_ambisonics(ds, tmp_path / convention, 3, convention, pairs)
        assert carry_out(plan) == 2
    made = [
        soundfile.read(tmp_path / c / ds.scene / "0_1.wav", dtype="float32") for c in ("sn3d", "n3d")
    ]
    (sn3d, rate), (n3d, _) = made
    np.testing.assert_array_equal(sn3d.T, ds.ambisonic(0, 1, order=3))
    assert rate == ds.rate and sn3d.shape[1] == 16
    degree = np.repeat([0, 1, 2, 3], [1, 3, 5, 7])
    np.testing.assert_allclose(n3d, sn3d * np.sqrt(2.0 * degree + 1.0), rtol=1e-6)
    second = ds.ambisonic(0, 1)
    ratio = (sn3d[:, 0] ** 2).sum() / (second[0] ** 2).sum()
    assert abs(10.0 * np.log10(ratio)) < 1.0  # other noise, the same energies
    for options in ({"order": 2}, {"convention": "fuma"}):
        with pytest.raises(ConfigError, match="expected"):
            plan_ambisonics(ds, tmp_path, **options)


def test_tables_for_programs_that_measure_rooms(dataset_folder: Path, tmp_path: Path) -> None:
    """PCM files are the responses but for the gain in the table, to half a step of 32 bits; parameters are the
    reader's."""
    ds = ss.open_dataset(dataset_folder)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("0 1\n1 1\n2 0\n")
    assert carry_out(plan_iso3382(ds, tmp_path, pairs, ("t30", "c80"))) == 3
    folder = tmp_path / ds.scene
    head, *lines = (folder / "parameters.tsv").read_text().splitlines()
    names = head.split("\t")
    assert names[3:] == ["gain_dB", "octave_Hz", "T30/s", "u(T30/s)", "C80/dB", "u(C80/dB)"]
    rows = [dict(zip(names, line.split("\t"), strict=True)) for line in lines]
    expected = ds.parameters(["t30", "c80"], pairs=[(0, 1), (2, 0)])
    for p, (s, l) in enumerate(((0, 1), (2, 0))):
        own = [row for row in rows if (row["source"], row["listener"]) == (str(s), str(l))]
        assert [float(row["octave_Hz"]) for row in own] == list(expected.bands.centre)
        got = np.array([[float(row[n] or "nan") for n in ("T30/s", "C80/dB")] for row in own])
        wanted = np.column_stack([expected["t30"][p], expected["c80"][p]])
        np.testing.assert_allclose(got, wanted, rtol=1e-4)
        rate, samples = wavfile.read(folder / own[0]["file"])
        assert rate == ds.rate and samples.dtype == np.int32
        response = ds.monaural(s, l)[0].astype(float)
        gain = 10.0 ** (float(own[0]["gain_dB"]) / 20.0)
        assert gain * np.abs(response).max() == pytest.approx(0.5, rel=1e-5)
        np.testing.assert_allclose(samples / 2.0**31 / gain, response, rtol=1e-5, atol=2e-9 / gain)


def test_rirs_at_the_nodes_of_a_published_graph(tmp_path: Path) -> None:
    """`make rirs POINTS=graph.pkl`."""
    (tmp_path / "quick.toml").write_text(
        "[simulation]\nwalks = 16\nconnections.subpaths = 2\nduration = 0.1\nradiance_transfer = false\ndiffraction = false\n"
        "[dataset]\nrate = 8000\n"
    )
    command = ["rirs", "demo", "--points", "graph.pkl", "--config", "quick.toml", "--store", "both"]
    graph = networkx.Graph()
    graph.add_node(0, point=(1.0, 0.0, -2.5))  # Habitat's axes, on the floor
    graph.add_node(1, point=(4.0, 0.0, -3.0))
    (tmp_path / "graph.pkl").write_bytes(pickle.dumps(graph))
    result = run_command(*command, "--out", "o3", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    with ss.open_dataset(tmp_path / "o3" / "demo") as ds:
        np.testing.assert_allclose(ds.points, [[1, 2.5, 1.5], [4, 3, 1.5]])
