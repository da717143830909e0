"""The dataset on disk: resuming, atomicity, reading, and clear errors."""

import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.target import code_target
from soundspaces_sim.dataset.format.schema import schema
from soundspaces_sim.rendering.ambisonics import ambisonic_rir
from tests.command_line import run_command
from tests.conftest import small_job
from tests.dataset.other_process import read_one
from tests.marks import ci_slow

#: Settings for the demo that do not matter to what a command says.
QUICK = (
    "[grid]\nrays = 100\n[simulation]\nwalks = 16\nconnections.subpaths = 2\nduration = 0.1\nradiance_transfer = false\n"
    "diffraction = false\n"
)


def _bytes(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def test_reader_serves_every_pair(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        n = len(ds.points)
        assert len(ds) == n * n and ds.rate == 16000
        for s, l in ((0, 0), (0, n - 1), (n - 1, 0)):
            rir = ds.ambisonic(s, l)
            assert rir.shape[0] == 9 and rir.dtype == np.float32 and np.isfinite(rir).all()
            assert ds.binaural(s, l, heading_deg=30.0).shape == (2, rir.shape[1])
            assert np.abs(rir).max() > 0.0
        out = ds.render(np.ones(100), 0, 1, 90.0)
        assert out.shape == (2, 99 + ds.binaural(0, 1).shape[1])


def test_stored_echograms_are_what_was_simulated(dataset_folder: Path, small_scene: ss.Scene) -> None:
    """Quantisation: energy within half a step, moments within half a 127th; arrivals to float32."""
    ds = ss.open_dataset(dataset_folder)
    exact = ss.simulate(small_scene, ds.points[[1]], ds.points[[4]], small_job().simulation)[0, 0]
    stored = ds.echogram(1, 4)
    a, b = exact.energy[:, 0], stored.energy[:, 0]
    loud = a > a.max() * 1e-9
    assert np.abs(10 * np.log10(b[loud] / a[loud])).max() < 0.21
    ratio = exact.energy[:, 1:] / np.maximum(a[:, None], 1e-30)
    kept = stored.energy[:, 1:] / np.maximum(b[:, None], 1e-30)
    assert np.abs(ratio - kept)[np.broadcast_to(loud[:, None], ratio.shape)].max() < 0.6 / 127
    assert [x.planes for x in stored.early] == [x.planes for x in exact.early]
    np.testing.assert_array_equal(stored.early.delay, exact.early.delay)
    np.testing.assert_allclose(stored.early.energy, exact.early.energy, rtol=1e-6)


def test_noise_hangs_on_the_pair(dataset_folder: Path) -> None:
    ds, again = ss.open_dataset(dataset_folder), ss.open_dataset(dataset_folder)
    np.testing.assert_array_equal(ds.ambisonic(2, 3), again.ambisonic(2, 3))
    assert not np.array_equal(ambisonic_rir(ds.echogram(2, 3), 16000, 0), ds.ambisonic(2, 3))


def test_second_build_does_nothing(dataset_folder: Path, small_scene: ss.Scene) -> None:
    before = _bytes(dataset_folder)
    result = ss.build_dataset(small_scene, dataset_folder.parent, small_job())
    assert result.built == 0
    assert _bytes(dataset_folder) == before


def test_missing_and_damaged_shards_are_rebuilt_to_the_same_bytes(
    dataset_folder: Path, small_scene: ss.Scene, tmp_path: Path
) -> None:
    folder = tmp_path / dataset_folder.name
    shutil.copytree(dataset_folder, folder)
    shards = sorted(folder.glob("*.h5"))
    shards[0].unlink()
    shards[1].write_bytes(shards[1].read_bytes()[:-100])
    result = ss.build_dataset(small_scene, tmp_path, small_job())
    assert result.built == 2
    assert _bytes(folder) == _bytes(dataset_folder)


_BUILD = """
import sys
import soundspaces_sim as ss
from tests.conftest import small_job
from tests.rooms import table, two_rooms
ss.build_dataset(two_rooms(table(0.3, 0.4, 0.01), 0), sys.argv[1], small_job())
"""


@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGINT])
@ci_slow
def test_interrupted_build_goes_on_and_ends_the_same(
    dataset_folder: Path, small_scene: ss.Scene, tmp_path: Path, kind: signal.Signals
) -> None:
    folder = tmp_path / dataset_folder.name
    root = Path(__file__).resolve().parents[2]
    child = subprocess.Popen(
        [sys.executable, "-c", _BUILD, str(tmp_path)], cwd=root, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 120.0
    while len(list(folder.glob("s*.h5"))) < 2 and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    child.send_signal(kind)
    child.wait()
    done = {p.name: p.read_bytes() for p in folder.glob("s*.h5")}
    assert done, "no shard was finished before the signal"
    whole = _bytes(dataset_folder)
    assert all(whole[name] == data for name, data in done.items())
    if (folder / "manifest.json").read_bytes() != whole["manifest.json"]:
        with pytest.raises(ss.DatasetError, match="not finished"):
            ss.open_dataset(folder)
    ss.build_dataset(small_scene, tmp_path, small_job())
    assert _bytes(folder) == whole


def test_other_settings_are_refused(dataset_folder: Path, small_scene: ss.Scene) -> None:
    with pytest.raises(ss.DatasetError, match=r"another setting \(dataset\.seed 0, now 1\)"):
        ss.build_dataset(small_scene, dataset_folder.parent, small_job(seed=1))


def test_another_machine_is_refused(
    dataset_folder: Path, small_scene: ss.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels give other last digits elsewhere, so their target is part of the key, and of the message."""
    from soundspaces_sim.build import plan

    monkeypatch.setattr(plan, "code_target", lambda: "x86_64 generic")
    with pytest.raises(
        ss.DatasetError, match=r"another machine \(code for .*, now for x86_64 generic\)"
    ):
        ss.build_dataset(small_scene, dataset_folder.parent, small_job())


def test_the_target_is_the_one_that_numba_compiles_for() -> None:
    script = "from soundspaces_sim.core.numerics.target import code_target; print(code_target())"
    found = [
        subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True,
            env={**os.environ, **more}, cwd=Path(__file__).resolve().parents[2],
        ).stdout.strip()
        for more in ({"NUMBA_CPU_NAME": "generic"}, {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "-fma"})
    ]  # fmt: skip
    assert len({code_target(), *found}) == 3


def test_missing_dataset(tmp_path: Path) -> None:
    with pytest.raises(ss.DatasetError, match="no dataset"):
        ss.open_dataset(tmp_path)


@pytest.mark.parametrize("pair", [(-1, 0), (0, 99), (10**9, 0)])
def test_index_out_of_range(dataset_folder: Path, pair: tuple[int, int]) -> None:
    with pytest.raises(ss.PairIndexError, match="out of range"):
        ss.open_dataset(dataset_folder).echogram(*pair)


def test_missing_foreign_and_truncated_shards(dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    shard = folder / ss.open_dataset(folder).manifest.shards[0].file
    data = shard.read_bytes()
    shard.unlink()
    with pytest.raises(ss.DatasetError, match="cannot open this shard"):
        ss.open_dataset(folder).echogram(0, 0)
    shard.write_bytes(data[: len(data) // 2])
    with pytest.raises(ss.DatasetError, match="cannot open this shard"):
        ss.open_dataset(folder).echogram(0, 0)
    shard.unlink()
    with h5py.File(shard, "w") as file:
        file["x"] = 1
    with pytest.raises(ss.DatasetError, match="not a shard"):
        ss.open_dataset(folder).echogram(0, 0)


def test_manifest_cannot_point_elsewhere(dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    manifest = folder / "manifest.json"
    manifest.write_text(manifest.read_text().replace("s00000_l00000.h5", "../secret.h5"))
    with pytest.raises(ss.DatasetError, match="plain file name"):
        ss.open_dataset(folder)


def test_shards_follow_the_schema_and_read_with_plain_h5py(dataset_folder: Path) -> None:
    with h5py.File(dataset_folder / "s00000_l00000.h5", locking=False) as file:
        assert set(file) == set(schema("echogram")["datasets"])
        assert set(schema("echogram")["attributes"]) == set(file.attrs)
        for name in file:
            assert file[name].fletcher32
        assert file["energy"].chunks[:2] == (1, 1)


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_works_in_other_processes(dataset_folder: Path, method: str) -> None:
    ds = ss.open_dataset(dataset_folder)
    expected = ds.binaural(0, 1)  # opens the file before the fork
    with multiprocessing.get_context(method).Pool(1) as pool:
        np.testing.assert_array_equal(pool.apply(read_one, (ds,)), expected)
    assert pickle.loads(pickle.dumps(ds)).rate == ds.rate


def test_command_line(tmp_path: Path) -> None:
    (tmp_path / "quick.toml").write_text(QUICK + "[dataset]\ntile = 8\n")
    arguments = ("rirs", "demo", "--spacing", "3", "--config", "quick.toml", "--rate", "16000")
    first = run_command(*arguments, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert "Wrote out/demo" in first.stdout and "MB" in first.stdout and "Next:" in first.stdout
    assert ss.open_dataset(tmp_path / "out" / "demo").rate == 16000
    second = run_command(*arguments, cwd=tmp_path)
    assert second.returncode == 0 and "Nothing to do" in second.stdout


def test_interrupted_command_line(tmp_path: Path) -> None:
    """Ctrl-C: exit code 130 and a word about what is safe; the same command finishes the job."""
    (tmp_path / "quick.toml").write_text(QUICK + "[dataset]\ntile = 1\n")  # a tile for every pair
    arguments = ("rirs", "demo", "--spacing", "4", "--config", "quick.toml")
    command = [sys.executable, "-m", "soundspaces_sim.cli", *arguments]
    child = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    folder = tmp_path / "out" / "demo"
    deadline = time.monotonic() + 120.0
    while not list(folder.glob("s*.h5")) and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=60)
    assert child.returncode == 130 and "finished shards are safe" in errors and "Traceback" not in errors
    with pytest.raises(ss.DatasetError, match="not finished"):
        ss.open_dataset(folder)
    assert run_command(*arguments, cwd=tmp_path).returncode == 0
    ss.open_dataset(folder)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere",), "SceneError: unknown scene 'nowhere'"),
        (("demo", "--spacing", "-1"), "ConfigError"),
        (("demo", "--rate", "7"), "ConfigError"),
        (("demo", "--jobs", "0"), "ConfigError: jobs"),
        (("demo", "--config", "missing.toml"), "ConfigError: missing.toml"),
        (("demo", "--spacing", "4", "--out", "/dev/null/x"), "ConfigError: --out /dev/null/x"),
        (("demo", "--up", "x"), "SceneError: up"),
        (
            ("demo", "--unit", "furlong"),
            "SceneError: unit: expected one of m, cm, mm, in, ft, got 'furlong'",
        ),
        (("demo", "--materials", "missing.toml"), "MaterialError: missing.toml"),
    ],
)
def test_command_line_errors(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    result = run_command("rirs", *arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert message in result.stderr and "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[grid]\nspacing = 'wide'\n", "grid"),
        ("[grid]\nspicing = 1\n", "spicing"),
        ("[simulation]\nwalks = 0\n", r"simulation\.walks"),
        ("[simulation]\nbands = [5, 2]\n", "bands"),
        (
            "[simulation]\nconnections.subpaths = 1\n",
            r"simulation\.connections\.subpaths.*0, or 2 and more.*1",
        ),
        ("[simulation]\nconnections.subpaths = -1\n", r"simulation\.connections\.subpaths"),
        ("[dataset]\nheadings = [0, 90, 0]\n", r"dataset\.headings.*different"),
        ("[dataset]\nheadings = [360]\n", r"dataset\.headings.*below 360"),
        ("[dataset]\nheadings = [-90]\n", r"dataset\.headings"),
        ("[dataset]\nstore = 'everything'\n", "everything"),
        ("[simulation\n", "TOML"),
    ],
)
def test_bad_config_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(ss.ConfigError, match=message):
        ss.load_config(path)


def test_presets_load() -> None:
    folder = Path(__file__).resolve().parents[2] / "pipelines"
    presets = {path.stem: ss.load_config(path) for path in folder.glob("*.toml")}
    assert set(presets) == {"collection", "default", "paper", "patio"}
    assert presets["default"] == ss.JobConfig()  # the file shows the defaults
    assert presets["patio"].grid.min_closedness == 0.1
    paper = presets["paper"]
    assert paper.dataset.renderer == "paper" and paper.simulation.time_grid == ((0.0, 1 / 44100),)


def test_shards_of_other_versions_are_refused(dataset_folder: Path, tmp_path: Path) -> None:
    from soundspaces_sim.dataset.format.echogram_shard import EchogramShard

    source = sorted(dataset_folder.glob("s*.h5"))[0]
    for version, remedy in ((6, "build the dataset anew"), (9, "install a newer one")):
        path = Path(shutil.copy(source, tmp_path / source.name))
        with h5py.File(path, "r+") as file:
            file.attrs["schema_version"] = version
        with pytest.raises(
            ss.DatasetError, match=f"schema version {version}, .* reads 7 to 8; {remedy}"
        ):
            EchogramShard(path)
