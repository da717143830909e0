"""What breaks, and what a user then sees: kills, full disks, races, flipped bytes, foreign files."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build import finish
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.dataset.format.card import write_cards
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.shard import FAILED, OK, SILENT
from soundspaces_sim.dataset.format.verify import failed_pairs
from soundspaces_sim.dataset.format.writing import encode_echograms
from soundspaces_sim.echogram.echogram import Arrivals
from tests.command_line import run_command
from tests.conftest import small_job
from tests.golden.make import values
from tests.marks import ci_slow
from tests.rooms import table as materials, two_rooms

ROOT = Path(__file__).resolve().parents[2]


def _bytes(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def _run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300
    )


_KILL_EVERYWHERE = """
import os, signal, sys, traceback
import soundspaces_sim as ss
from soundspaces_sim.core.io import files
from tests.conftest import small_job
from tests.rooms import table, two_rooms

class Counting:
    def __init__(self, limit):
        self.left = limit
    def step(self, half=None):
        self.left -= 1
        if self.left == 0:
            if half is not None:
                half()
            os.kill(os.getpid(), signal.SIGKILL)

def arm(limit):
    counter = Counting(limit)
    real_fsync, real_replace, real_open = os.fsync, os.replace, open
    def fsync(handle):
        counter.step()
        real_fsync(handle)
    def replace(a, b):
        counter.step()
        real_replace(a, b)
    class File:
        def __init__(self, *a, **k):
            self.file = real_open(*a, **k)
        def __enter__(self):
            return self
        def __exit__(self, *_):
            self.file.close()
        def fileno(self):
            return self.file.fileno()
        def write(self, data):
            counter.step(lambda: self.file.write(data[: len(data) // 2]))
            return self.file.write(data)
    os.fsync, os.replace, files.open = fsync, replace, lambda p, mode, **k: (File if mode == "xb" else real_open)(p, mode, **k)

k = 0
while True:
    k += 1
    child = os.fork()
    if child == 0:
        try:
            arm(k)
            ss.build_dataset(two_rooms(table(0.3, 0.4, 0.01), 0), f"{sys.argv[1]}/{k}", small_job(tile=7))
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code == 0:
        break
    if code != -signal.SIGKILL:
        sys.exit(code)
print(k - 1)
"""


@ci_slow
def test_killed_at_every_write_fsync_and_rename(tmp_path: Path, small_scene: ss.Scene) -> None:
    """Old state or new state, never a third; the same command then ends with the same bytes."""
    result = _run(_KILL_EVERYWHERE, str(tmp_path))
    assert result.returncode == 0, result.stderr
    kills = int(result.stdout)
    assert kills >= 12  # write, fsync, rename, fsync of the folder; for a draft, shards, and a manifest
    whole = _bytes(tmp_path / str(kills + 1) / "two_rooms")
    for k in range(1, kills + 1):
        folder = tmp_path / str(k) / "two_rooms"
        for path in folder.iterdir():
            if not path.name.startswith(".") and path.suffix == ".h5":
                assert path.read_bytes() == whole[path.name], (k, path.name)
        if (folder / "manifest.json").exists() and (folder / "manifest.json").read_bytes() == whole[
            "manifest.json"
        ]:
            assert ss.verify_dataset(folder, full=True)[1] == []
        else:
            with pytest.raises(ss.DatasetError, match=r"not finished|no dataset"):
                ss.open_dataset(folder)
    for k in (2, kills // 2, kills):
        ss.build_dataset(small_scene, tmp_path / str(k), small_job(tile=7))
        assert _bytes(tmp_path / str(k) / "two_rooms") == whole


_LIMITED = """
import resource, sys
import soundspaces_sim as ss
from tests.conftest import small_job
from tests.rooms import table, two_rooms
resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))
try:
    ss.build_dataset(two_rooms(table(0.3, 0.4, 0.01), 0), sys.argv[1], small_job(tile=7))
except ss.DatasetError as error:
    print(error)
    sys.exit(2)
"""


@ci_slow
def test_file_size_limit_is_an_error_and_leaves_nothing_half(tmp_path: Path) -> None:
    result = _run(_LIMITED, str(tmp_path))
    assert result.returncode == 2, result.stderr
    assert "cannot write this file" in result.stdout and "run the same command again" in result.stdout
    left = {p.name for p in (tmp_path / "two_rooms").iterdir()}
    assert left - {"s00000_l00007.h5", "s00007_l00000.h5"} == {
        "manifest.json",
        "floorplan.hdf5",
        "job.npz",
    }
    for name in ("s00000_l00007.h5", "s00007_l00000.h5"):  # of the longest tile, and small enough: whole
        EchogramShard(tmp_path / "two_rooms" / name).close()


def test_full_disk(tmp_path: Path) -> None:
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", tmp_path], capture_output=True
    ).returncode:
        pytest.skip("needs the right to mount a small tmpfs")
    try:
        publish(tmp_path / "fits", b"x" * 4096)
        with pytest.raises(ss.DatasetError, match="MB are free"):
            publish(tmp_path / "large", b"x" * 100_000)
        (tmp_path / "filler").write_bytes(b"x" * 40_000)
        with pytest.raises(ss.DatasetError, match="free some space"):
            publish(tmp_path / "second", b"x" * 30_000)
        assert {p.name for p in tmp_path.iterdir()} == {"fits", "filler"}
    finally:
        subprocess.run(["umount", tmp_path], check=True)


_BUILD = """
import sys
import soundspaces_sim as ss
from tests.conftest import small_job
from tests.rooms import table, two_rooms
ss.build_dataset(two_rooms(table(0.3, 0.4, 0.01), 0), sys.argv[1], small_job())
"""


@ci_slow
def test_two_builders_at_once(tmp_path: Path, dataset_folder: Path) -> None:
    children = [
        subprocess.Popen([sys.executable, "-c", _BUILD, str(tmp_path)], cwd=ROOT) for _ in range(2)
    ]
    assert [child.wait(timeout=300) for child in children] == [0, 0]
    assert _bytes(tmp_path / "two_rooms") == _bytes(dataset_folder)


def test_another_builder_finishes_between_two_looks(
    dataset_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder was not complete a moment ago, and now its job is gone because it is."""
    looks = iter([False, True])
    monkeypatch.setattr(finish, "is_finished", lambda _: next(looks))
    assert finish.finish_folder(dataset_folder).complete
    monkeypatch.setattr(finish, "is_finished", lambda _: False)
    with pytest.raises(ss.DatasetError, match="no job is under way"):
        finish.finish_folder(dataset_folder)


@ci_slow
def test_verify_finds_every_flipped_byte(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(ROOT / "tests" / "golden" / "echogram-8", folder)
    shard = next(folder.glob("s*.h5"))
    whole = shard.read_bytes()
    assert ss.verify_dataset(folder, full=True)[1] == []
    for i in [*range(0, 3000, 7), *range(3000, len(whole), 101)]:
        damaged = bytearray(whole)
        damaged[i] ^= 1 << (i % 8)
        shard.write_bytes(damaged)
        assert [p.file for p in ss.verify_dataset(folder, full=True)[1]] == [shard.name], i


@pytest.mark.parametrize("share", [0.0, 0.0001, 0.01, 0.3, 0.9, 0.999])
def test_truncated_shards_are_refused(tmp_path: Path, dataset_folder: Path, share: float) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    shard = folder / ss.open_dataset(folder).manifest.shards[0].file
    shard.write_bytes(shard.read_bytes()[: int(share * shard.stat().st_size)])
    with pytest.raises(ss.DatasetError, match=r"cannot open this shard|damaged"):
        ss.open_dataset(folder).ambisonic(0, 1)
    assert "bytes, expected" in ss.verify_dataset(folder)[1][0].what


def test_damaged_chunk_is_one_clear_error(tmp_path: Path, dataset_folder: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    shard = folder / ss.open_dataset(folder).manifest.shards[0].file
    with h5py.File(shard) as file:
        at = file["energy"].id.get_chunk_info_by_coord((0, 1, 0, 0)).byte_offset
    data = bytearray(shard.read_bytes())
    data[at + 20] ^= 255
    shard.write_bytes(data)
    ds = ss.open_dataset(folder)
    with pytest.raises(ss.DatasetError, match=r"'energy' is damaged.*delete the file"):
        ds.echogram(0, 1)
    ds.echogram(0, 0)  # other pairs are whole


def test_missing_filter_is_one_clear_error(tmp_path: Path, dataset_folder: Path) -> None:
    """A shard compressed by a filter that is not installed (blosc2, 32026) says which plugin to get."""
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    shard = folder / ss.open_dataset(folder).manifest.shards[0].file
    with h5py.File(shard) as file:
        shape = file["energy"].shape
    with h5py.File(shard, "r+") as file:
        del file["energy"]
        create = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        create.set_chunk((1, 1, *shape[2:]))
        create.set_filter(32026, h5py.h5z.FLAG_OPTIONAL, ())
        dataset = h5py.h5d.create(
            file.id, b"energy", h5py.h5t.STD_U8LE, h5py.h5s.create_simple(shape), create
        )
        dataset.write_direct_chunk((0,) * 4, b"\0" * 64)
    with pytest.raises(
        ss.DatasetError, match=r"'energy' needs an HDF5 filter .*\(32026\).*hdf5plugin"
    ) as caught:
        ss.open_dataset(folder).echogram(0, 0)
    assert "damaged" not in str(caught.value) and "delete" not in str(caught.value)


def test_pairs_are_stored_as_ok_or_silent_and_what_cannot_be_is_refused(dataset_folder: Path) -> None:
    echoes = ss.simulate(
        two_rooms(materials(0.3, 0.4, 0.01), 0), [[1.0, 1.0, 1.2]],
        [[2.0, 1.0, 1.2], [3.0, 3.0, 1.2], [7.0, 1.0, 1.2]],
        ss.SimulationConfig(walks=16, connections=ss.ConnectionsConfig(subpaths=0), duration=0.1),
    )  # fmt: skip
    energy, direct = echoes.energy.copy(), echoes.direct_energy.copy()
    energy[0, 2], direct[0, 2] = 0.0, 0.0
    none = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
    quiet = replace(
        echoes, energy=energy, direct_energy=direct, early=none, early_start=np.zeros(4, int)
    )
    with h5py.File(next(dataset_folder.glob("s*.h5")), locking=False) as file:
        attributes = dict(file.attrs)
    for table, expected in ((echoes, [OK, OK, OK]), (quiet, [OK, OK, SILENT])):
        shard = EchogramShard(encode_echograms(table, np.arange(1), np.arange(3), attributes))
        assert shard.pairs["status"].tolist() == [expected]
        assert shard.echogram(0, 0).energy[:, 0].sum() == pytest.approx(
            table.energy[0, 0, :, 0].sum(), rel=0.02
        )
        shard.close()
    for value in (np.nan, np.inf, -1e-9):
        energy = echoes.energy.copy()
        energy[0, 1, 5, 0, 2] = value
        with pytest.raises(ss.SimulationError, match="energy of source 0 and listener 1"):
            encode_echograms(replace(echoes, energy=energy), np.arange(1), np.arange(3), attributes)
        bad = np.full_like(echoes.direct_energy, 0.1)
        bad[0, 0, 1] = value
        with pytest.raises(ss.SimulationError, match="direct_energy of source 0 and listener 0"):
            encode_echograms(replace(echoes, direct_energy=bad), np.arange(1), np.arange(3), attributes)
        early = echoes.early.energy.copy()
        early[echoes.early_start[1], 0] = value
        with pytest.raises(ss.SimulationError, match="early_energy of source 0 and listener 1"):
            whole = replace(echoes, early=replace(echoes.early, energy=early))
            encode_echograms(whole, np.arange(1), np.arange(3), attributes)


def test_a_failed_pair_is_refused_and_its_neighbours_are_read(
    tmp_path: Path, dataset_folder: Path
) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    shard = folder / ss.open_dataset(folder).manifest.shards[0].file
    with h5py.File(shard, "r+") as file:
        file["status"][0, 1] = FAILED
    with ss.open_dataset(folder) as ds:
        with pytest.raises(ss.DatasetError, match=rf"{shard.name}.*pair \(0, 1\) failed"):
            ds.binaural(0, 1)
        assert np.isfinite(ds.binaural(0, 2)).all()
        table = ds.table()
        assert [(r["source"], r["listener"]) for r in table[table["status"] == FAILED]] == [(0, 1)]
        np.testing.assert_array_equal(ds.sample(5, 0, status=(FAILED, FAILED)), [[0, 1]] * 5)
    with closing(EchogramShard(shard)) as read:  # as versions before 0.2 wrote it
        what = failed_pairs(read)
    assert re.search(r"energies of 1 of \d+ pairs are not finite \(first: 0 to 1\)", what)


def test_newer_schema_and_foreign_files(tmp_path: Path, dataset_folder: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    shard = folder / ss.open_dataset(folder).manifest.shards[0].file
    with h5py.File(shard, "r+") as file:
        file.attrs["schema_version"] = 99
    with pytest.raises(ss.DatasetError, match=r"schema version 99.*install a newer one"):
        ss.open_dataset(folder).echogram(0, 0)
    (folder / "manifest.json").write_text('{"format": "something else"}')
    with pytest.raises(ss.DatasetError, match="not a manifest"):
        ss.open_dataset(folder)


def test_reading_needs_no_right_to_write(tmp_path: Path, dataset_folder: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    for path in folder.iterdir():
        path.chmod(stat.S_IRUSR)
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    before = sorted(os.listdir(folder))
    try:
        with ss.open_dataset(folder) as ds:
            ds.binaural(0, 1)
            ds.table()
        assert ss.verify_dataset(folder, full=True)[1] == []
        assert sorted(os.listdir(folder)) == before
    finally:
        folder.chmod(stat.S_IRWXU)


def test_verify_command_names_the_file_and_the_remedy(tmp_path: Path, dataset_folder: Path) -> None:
    folder = tmp_path / "two_rooms"
    shutil.copytree(dataset_folder, folder)
    verify = partial(run_command, "verify", str(folder), cwd=tmp_path)
    assert verify("--full").returncode == 0
    shard = sorted(folder.glob("*.h5"))[0]
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    result = verify("--full")
    assert result.returncode == 1 and shard.name in result.stderr and "rm -f" in result.stderr
    shard.unlink()
    assert "is missing" in verify().stderr


def test_verify_says_what_it_cannot_compare(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(ROOT / "tests" / "golden" / "echogram-7", folder)
    assert run_command("verify", str(folder), "--full", cwd=tmp_path).stdout.count("\n") == 1
    write_cards(folder)
    (folder / "more").mkdir()
    (folder / "more" / "a.txt").touch()
    said = run_command("verify", str(folder), "--full", cwd=tmp_path)
    assert said.returncode == 0
    expected = "Not compared, for no manifest names them: 4 files (CITATION.cff, README.md, datasheet.md, a.txt)."
    assert expected in " ".join(said.stdout.split())


@pytest.mark.parametrize("name", ["echogram-7", "echogram-8"])
def test_a_golden_dataset_is_read_as_it_was(name: str) -> None:
    """Manifest version 2, echogram shards of versions 7 and 8, waveform shards of version 2."""
    import json

    golden = ROOT / "tests" / "golden"
    expected, found = json.loads((golden / f"{name}.json").read_text()), values(golden / name)
    assert found.keys() == expected.keys()
    for what, value in expected.items():
        np.testing.assert_allclose(found[what], value, rtol=1e-6, atol=1e-12, err_msg=what)
    assert ss.verify_dataset(golden / name, full=True)[1] == []
