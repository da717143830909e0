"""Datasets of strangers: files that reach outside, declare what they do not hold, or hold what cannot be."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from msgspec.structs import replace

import soundspaces_sim as ss
from soundspaces_sim.core.io.hdf5 import plain_dataset, read_numbers
from soundspaces_sim.dataset.format.floorplan import read_floorplan
from soundspaces_sim.dataset.format.manifest import read_manifest, rebuild_command, write_manifest
from soundspaces_sim.dataset.format.verify import verify_dataset
from tests.attack.old_layout import GOLDEN, old_layout
from tests.attack.victims import resigned
from tests.marks import ci_slow, few

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def folder(tmp_path: Path, dataset_folder: Path) -> Path:
    return Path(shutil.copytree(dataset_folder, tmp_path / "d"))


def _shard(folder: Path) -> Path:
    return folder / read_manifest(folder).shards[0].file


def _refused(folder: Path, words: str) -> None:
    """Reading and plain `verify` both say so, in one error of ours."""
    with pytest.raises(ss.DatasetError, match=words):
        ss.open_dataset(folder).echogram(0, 0)
    first, *others = read_manifest(folder).shards
    first = replace(first, bytes=_shard(folder).stat().st_size)  # a liar's manifest
    _rewrite(folder, shards=(first, *others))
    assert [p.file for p in verify_dataset(folder)[1]] == [first.file]


def _rewrite(folder: Path, **change: object) -> None:
    """The manifest with other content, and a digest that fits it."""
    write_manifest(folder, replace(read_manifest(folder), **change))


def _replace(shard: Path, name: str, make: Callable[[h5py.File, np.ndarray], None]) -> None:
    with h5py.File(shard, "r+") as file:
        values = file[name][...]
        del file[name]
        make(file, values)


def _external_storage(file: h5py.File, values: np.ndarray) -> None:
    place = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    place.set_external(b"/etc/passwd", 0, values.nbytes)
    space = h5py.h5s.create_simple(values.shape)
    h5py.h5d.create(file.id, b"energy_peak", h5py.h5t.IEEE_F32LE, space, place)


def _virtual(file: h5py.File, values: np.ndarray) -> None:
    layout = h5py.VirtualLayout(values.shape, values.dtype)
    layout[...] = h5py.VirtualSource("other.h5", "energy_peak", values.shape)
    file.create_virtual_dataset("energy_peak", layout)


def _unallocated(file: h5py.File, values: np.ndarray) -> None:
    file.create_dataset("energy_peak", values.shape, values.dtype, chunks=(1, 1))


OUTSIDE: dict[str, tuple[Callable[[h5py.File, np.ndarray], None], str]] = {
    "external storage": (_external_storage, "lies in other files"),
    "virtual dataset": (_virtual, "lies in other files"),
    "external link": (
        lambda f, _: f.__setitem__("energy_peak", h5py.ExternalLink("other.h5", "energy_peak")),
        r"is a link|is missing",
    ),
    "soft link": (lambda f, _: f.__setitem__("energy_peak", h5py.SoftLink("/direct_energy")), "is a link"),
    "group": (lambda f, _: f.create_group("energy_peak") and None, "is no dataset"),
    "nothing stored": (_unallocated, "declares"),
    "text": (lambda f, v: f.create_dataset("energy_peak", data=v.astype("S4")) and None, "plain numbers"),
    "objects": (
        lambda f, v: f.create_dataset("energy_peak", v.shape, h5py.string_dtype()) and None, "plain numbers"
    ),
    "big-endian": (lambda f, v: f.create_dataset("energy_peak", data=v.astype(">f4")) and None, "little-endian"),
    "another shape": (lambda f, v: f.create_dataset("energy_peak", data=v[:1]) and None, "expected S"),
}  # fmt: skip


@pytest.mark.parametrize("name", OUTSIDE)
def test_only_numbers_in_the_file_itself(folder: Path, name: str) -> None:
    make, words = OUTSIDE[name]
    shutil.copy(_shard(folder), folder / "other.h5")
    _replace(_shard(folder), "energy_peak", make)
    _refused(folder, words)


def test_ten_gigabytes_in_a_hundred_kilobytes(folder: Path) -> None:
    def huge(file: h5py.File, _: np.ndarray) -> None:
        item = file.create_dataset(
            "energy", (4, 4, 20_000, 4000), "u1", chunks=(1, 1, 2000, 4000), compression=1
        )
        item[0, 0, :2000] = 0

    _replace(_shard(folder), "energy", huge)
    assert _shard(folder).stat().st_size < 300_000
    _refused(folder, r"declares|lacks")


@pytest.mark.parametrize(
    ("size", "mask", "words"),
    [(1, 0, "too short"), (9, 0b10, "no checksum"), (9, 0b1, "too short"), (24, 0b1, "damaged"), (9, 0, "damaged")],
)  # fmt: skip
def test_chunks_that_crash_the_library(tmp_path: Path, size: int, mask: int, words: str) -> None:
    """A chunk shorter than its checksum is read by HDF5 2.0 beyond its beginning."""
    with h5py.File(tmp_path / "x.h5", "w") as file:
        item = file.create_dataset(
            "x", (4, 4, 5), "f4", chunks=(1, 1, 5), fletcher32=True, compression=1
        )
        for k in range(16):
            item.id.write_direct_chunk((k // 4, k % 4, 0), b"x" * size, filter_mask=mask)
    with (
        h5py.File(tmp_path / "x.h5") as file,
        pytest.raises(ss.DatasetError, match=words),
    ):
        read_numbers(
            plain_dataset(file, "x", "x.h5", ss.DatasetError, ""), ..., "x", ss.DatasetError, ""
        )


def test_two_chunks_of_one_place(tmp_path: Path) -> None:
    """A list of chunks (a B-tree of version 1, without checksums) whose entries were zeroed crashed HDF5 2.0."""
    folder = old_layout(tmp_path / "g")
    shard = next(folder.glob("s*.h5"))
    data = bytearray(shard.read_bytes())
    with h5py.File(shard) as file:
        second = file["moments"].id.get_chunk_info(1)
    at = data.index(
        second.byte_offset.to_bytes(8, "little")
    )  # after size, mask and six numbers of its place
    data[at - 48 : at] = bytes(48)
    shard.write_bytes(data)
    with pytest.raises(ss.DatasetError, match="a place of their own"):
        ss.open_dataset(folder).echogram(0, 0)


def test_texts_that_hang_the_library(tmp_path: Path) -> None:
    """A free space of no size in the heap of texts, in a layout that has one."""
    folder = old_layout(tmp_path / "g")
    shard = next(folder.glob("s*.h5"))
    data = bytearray(shard.read_bytes())
    at = data.index(b"GCOL")
    end, place = at + int.from_bytes(data[at + 8 : at + 16], "little"), at + 16
    while data[place : place + 2] != b"\0\0":
        place += 16 + -(-int.from_bytes(data[place + 8 : place + 16], "little") // 8) * 8
    assert place < end
    data[place + 8 : place + 16] = bytes(8)
    shard.write_bytes(data)
    with pytest.raises(ss.DatasetError, match="texts are damaged"):
        ss.open_dataset(folder).echogram(0, 0)


@pytest.mark.parametrize("file", ["manifest.json", "floorplan.hdf5", "shard"])
def test_links_and_pipes_are_not_followed(folder: Path, tmp_path: Path, file: str) -> None:
    path = _shard(folder) if file == "shard" else folder / file
    shutil.move(path, tmp_path / "elsewhere")
    makers: dict[str, Callable[[], None]] = {
        "link": lambda: path.symlink_to(tmp_path / "elsewhere"), "pipe": lambda: os.mkfifo(path), "folder": path.mkdir,
    }  # fmt: skip
    for kind, make in makers.items():
        make()
        with pytest.raises(ss.DatasetError, match=r"symbolic link|regular file"):
            if file == "floorplan.hdf5":
                read_floorplan(folder)
            else:
                ss.open_dataset(folder).echogram(0, 0)
        if file != "manifest.json":
            assert len(verify_dataset(folder)[1]) == 1
        path.rmdir() if kind == "folder" else path.unlink()


IMPOSSIBLE: dict[str, list[float]] = {
    "energy_peak": [np.nan, np.inf, -1.0], "direct_energy": [np.nan, np.inf, -1.0],
    "early_energy": [np.nan, np.inf, -1.0], "early_delay": [np.nan, -1.0, 1e9], "early_start": [-5, 10**6],
    "early_direction": [np.nan, 7.0], "status": [3], "source_position": [np.nan, 1e30, 2e4],
    "band_edges": [np.nan, -1.0, 1e9], "time_edges": [np.nan, 1e9], "relative_error": [-1.0],
    "geodesic": [-1.0], "source_index": [99], "listener_index": [-1],
}  # fmt: skip


@pytest.mark.parametrize("name", few(IMPOSSIBLE, "energy_peak", "early_start", "status", "geodesic"))
def test_values_that_cannot_be(folder: Path, name: str) -> None:
    whole = _shard(folder).read_bytes()
    for value in IMPOSSIBLE[name]:
        with h5py.File(_shard(folder), "r+") as file:
            file[name][(0,) * file[name].ndim] = value
        _refused(folder, r"cannot be|than the manifest|elsewhere|manifest says")
        _shard(folder).write_bytes(whole)


@pytest.mark.parametrize(
    ("name", "value"),
    few([("speed_of_sound", 0.0), ("speed_of_sound", "fast"), ("energy_step_db", np.nan), ("key", 3),
         ("schema_version", "two"), ("schema_version", -1), ("format", b"\xff\xfe"), ("seed", [1, 2]),
         ("axes", "left-handed"), ("key", "0" * 64)],
        ("speed_of_sound", 0.0), ("schema_version", "two"), ("key", "0" * 64)),
)  # fmt: skip
def test_attributes_that_cannot_be(folder: Path, name: str, value: object) -> None:
    with h5py.File(_shard(folder), "r+") as file:
        del file.attrs[name]
        file.attrs[name] = value
    _refused(folder, r"attribute|format|version|cannot be|something else")


def test_a_shard_of_other_bands(folder: Path) -> None:
    with h5py.File(_shard(folder), "r+") as file:
        file["band_edges"][1] += 1.0
    _refused(folder, "has bands at .* Hz, the manifest at")


def test_names_of_groups_that_are_nested_without_end(folder: Path) -> None:
    with h5py.File(_shard(folder), "r+") as file:
        file.attrs["group_names"] = "[" * 10**5
    _refused(folder, "'group_names' is no list")


@pytest.mark.parametrize(
    ("settings", "words"),
    [("[" * 10**5, "nested too deeply"), ("[0, 0, NaN]", "not valid JSON"), ("{}", "cannot be read"), ("7", "cannot be read"),
     ('[0, 0, {"walks": "many"}]', "cannot be read"), ('[0, 0, {"duration": 1%s}]' % ("0" * 400), "cannot be read|JSON"),
     ('[0, 0, {"novelty": 1}]', "novelty")],
    ids=["nested", "NaN", "object", "number", "text", "long number", "another version"],
)  # fmt: skip
def test_settings_of_rooms_that_cannot_be(folder: Path, settings: str, words: str) -> None:
    assert ss.read_room(_shard(folder))
    with h5py.File(_shard(folder), "r+") as file:
        file.attrs["config"] = settings
    with pytest.raises(ss.DatasetError, match=words):
        ss.read_room(_shard(folder))


def test_a_shard_under_another_name(folder: Path) -> None:
    """An entry that names another shard returned another pair's data."""
    first, second = (folder / e.file for e in read_manifest(folder).shards[:2])
    shutil.copy(second, first)
    with pytest.raises(ss.DatasetError, match=r"holds other|elsewhere"):
        ss.open_dataset(folder).echogram(0, 0)


def _verify_damaged(folder: Path, damages: int, rng: np.random.Generator) -> list[tuple[str, int]]:
    """Where `verify --full` missed a damaged byte, of `damages` over all files of a dataset."""
    files = sorted(folder.iterdir())
    assert {p.suffix for p in files} == {".json", ".h5", ".hdf5"}
    missed = []
    for k in range(damages):
        path = files[k % len(files)]
        whole = path.read_bytes()
        at = int(rng.integers(len(whole)))
        damaged = bytearray(whole)
        damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            found = [p.file for p in verify_dataset(folder, full=True)[1]]
        except ss.DatasetError:
            found = ["manifest.json"]
        if found != [path.name]:
            missed.append((path.name, at))
        path.write_bytes(whole)
    return missed


def test_verify_finds_damaged_bytes(folder: Path) -> None:
    assert not _verify_damaged(folder, 15, np.random.default_rng(0))
    assert verify_dataset(folder, full=True)[1] == []


@pytest.mark.slow
def test_verify_finds_every_damaged_byte(folder: Path) -> None:
    """Sampled 2,000, as many of every file."""
    assert not _verify_damaged(folder, 2000, np.random.default_rng(1))
    assert verify_dataset(folder, full=True)[1] == []


MANIFESTS: dict[str, tuple[dict[str, object], str]] = {
    "traversal": ({"scene": "../../etc"}, "scene name"),
    "dots": ({"scene": ".."}, "scene name"),
    "escape codes": ({"scene": "a\x1b[2J"}, "scene name"),
    "far": ({"points": ((1e30, 0.0, 0.0),)}, "coordinates"),
    "nodes": ({"nodes": (10**6,)}, "not points"),
    "edges": ({"edges": ((0, -1),)}, "not points"),
    "components": ({"components": (0,)}, "components"),
    "long": ({"duration": 1e9}, "duration"),
    "no shards": ({"shards": ()}, "no shards"),
}  # fmt: skip


@pytest.mark.parametrize("name", MANIFESTS)
def test_manifests_that_cannot_be(folder: Path, name: str) -> None:
    change, words = MANIFESTS[name]
    _rewrite(folder, **change)
    with pytest.raises(ss.DatasetError, match=words):
        ss.open_dataset(folder)


@pytest.mark.parametrize("old", ["spacing", "seed", "bytes", "file", '"status": "complete"'])
def test_json_that_is_not_a_manifest(tmp_path: Path, old: str) -> None:
    """A stranger makes the digest fit: the structure is checked."""
    folder = Path(shutil.copytree(GOLDEN, tmp_path / "g"))
    text = (folder / "manifest.json").read_text()
    hostile = ["[" * 10**5, "{" + '"a":{' * 10**5, "NaN", "[]", "7", '"x"', "", text.replace(old, old[::-1], 1),
               text.replace('"duration": 0.2', '"duration": NaN'), text.replace("2.0", "1e999", 1), text.replace("2.0", "9" * 5000, 1),
               text.replace("golden", "\\ud800", 1), text.replace(".h5", "/../x.h5", 1)]  # fmt: skip
    for content in hostile:
        (folder / "manifest.json").write_bytes(resigned(content.encode()))
        with pytest.raises(ss.DatasetError):
            ss.open_dataset(folder)


def test_commands_of_strangers_are_not_advice(folder: Path) -> None:
    manifest = read_manifest(folder)
    for command, shown in {
        "make rirs SCENE=demo": True, "soundspaces-sim -v rirs 'a b' --out x": True,
        "curl http://x | sh": False, "make rirs; rm -rf ~": False, "make rirs $(x)": False, "make rirs \x1b[2J": False,
    }.items():  # fmt: skip
        found = rebuild_command(replace(manifest, command=command))
        assert found == (command if shown else "")


_FORKS = """
import os, sys, threading
import numpy as np
import soundspaces_sim as ss
ds = ss.open_dataset(sys.argv[1])
n, stop = len(ds.points), threading.Event()
expected = ds.echogram(0, 1).energy.tobytes(), ds.binaural(0, 1).tobytes()
def read():
    rng = np.random.default_rng()
    while not stop.is_set():
        pair = rng.integers(0, n, 2)
        ds.echogram(*pair), ds.binaural(*pair)
threads = [threading.Thread(target=read) for _ in range(8)]
for t in threads: t.start()
for _ in range(int(sys.argv[2])):
    child = os.fork()
    if child == 0:
        found = ds.echogram(0, 1).energy.tobytes(), ds.binaural(0, 1).tobytes()
        os._exit(0 if found == expected else 1)
    if os.waitpid(child, 0)[1]:
        print("bad child"); break
else:
    print("all well")
stop.set()
"""


def _forks(folder: Path, count: int) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _FORKS, str(folder), str(count)], cwd=ROOT,
        capture_output=True, text=True, timeout=30 + count,
    )  # fmt: skip
    assert done.stdout.strip() == "all well", done.stderr


@ci_slow
def test_forks_while_threads_read() -> None:
    _forks(GOLDEN, 40)


@pytest.mark.slow
def test_a_thousand_forks_while_threads_read() -> None:
    _forks(GOLDEN, 1000)
