"""Archives of datasets, and the page of fields."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest
import yaml
from soundspaces_exports.pack import pack_dataset
from typer.testing import CliRunner

import soundspaces_sim as ss
from docs.fields_page import field_tables
from soundspaces_sim.cli.app import app
from soundspaces_sim.dataset.format.card import CARDS, write_cards
from soundspaces_sim.dataset.format.manifest import read_manifest, write_manifest
from soundspaces_sim.dataset.format.schema import CURRENT, schema

ROOT = Path(__file__).resolve().parents[3]


def test_unpacked_it_is_the_dataset(dataset_folder: Path, tmp_path: Path) -> None:
    packed = pack_dataset(dataset_folder, tmp_path / "x.zip")
    with zipfile.ZipFile(packed) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path / "there")
    name = dataset_folder.name
    assert ss.verify_dataset(tmp_path / "there" / name, full=True)[1] == []
    with ss.open_dataset(tmp_path / "there" / name) as there, ss.open_dataset(dataset_folder) as here:
        np.testing.assert_array_equal(there.binaural(0, 3), here.binaural(0, 3))
    digest, named = (tmp_path / "x.zip.sha256").read_text().split()
    assert named == "x.zip" and digest == hashlib.sha256(packed.read_bytes()).hexdigest()


def test_the_same_bytes_whoever_packs(dataset_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "other" / dataset_folder.name
    shutil.copytree(dataset_folder, copy)
    for k, path in enumerate(sorted(copy.iterdir(), reverse=True)):
        os.utime(path, (1e9 + k, 1e9 + k))
        path.chmod(0o600)
    first, second = (
        pack_dataset(dataset_folder, tmp_path / "a.zip"),
        pack_dataset(copy, tmp_path / "b.zip"),
    )
    assert first.read_bytes() == second.read_bytes()


def test_a_damaged_dataset_is_not_packed(dataset_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / dataset_folder.name
    shutil.copytree(dataset_folder, copy)
    shard = next(copy.glob("s*.h5"))
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    with pytest.raises(ss.DatasetError, match=r"1 files are not as the manifest says"):
        pack_dataset(copy)
    assert not list(tmp_path.glob("*.zip*")) and not list(tmp_path.glob(".*partial"))
    result = CliRunner().invoke(app, ["pack", str(dataset_folder), "--out", str(tmp_path / "c.zip")])
    assert result.exit_code == 0 and "c.zip" in result.output


def test_what_is_there_is_replaced_only_if_asked_for(dataset_folder: Path, tmp_path: Path) -> None:
    for name in ("x.zip", "x.zip.sha256"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(ss.DatasetError, match=rf"{name}: there is such a file already.*--replace"):
            pack_dataset(dataset_folder, tmp_path / "x.zip")
        assert (tmp_path / name).read_text() == "mine"
        run = CliRunner().invoke(app, ["pack", str(dataset_folder), "--out", str(tmp_path / "x.zip")])
        assert run.exit_code == 2 and (tmp_path / name).read_text() == "mine"
        (tmp_path / name).unlink()
    (tmp_path / "x.zip").write_text("mine")
    arguments = ["pack", str(dataset_folder), "--out", str(tmp_path / "x.zip"), "--replace"]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert zipfile.is_zipfile(tmp_path / "x.zip")


def test_never_onto_the_dataset_nor_into_its_folder(dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(dataset_folder, folder)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    (tmp_path / "link").symlink_to(folder)
    for out in (folder / "manifest.json", folder / "new.zip", tmp_path / "link" / "manifest.json"):
        for replace in (False, True):
            with pytest.raises(ss.DatasetError, match="lies in the dataset's own folder"):
                pack_dataset(folder, out, replace=replace)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


def test_devices_and_links_are_not_replaced(dataset_folder: Path, tmp_path: Path) -> None:
    """A FIFO stands for /dev/full, which a test must not put at risk."""
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "target").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    (tmp_path / "d.zip.sha256").symlink_to(tmp_path / "target")
    for name in ("fifo", "link", "d.zip"):
        with pytest.raises(ss.DatasetError, match=r"no regular file|a symbolic link"):
            pack_dataset(dataset_folder, tmp_path / name, replace=True)
    assert (tmp_path / "fifo").is_fifo() and (tmp_path / "target").read_text() == "mine"
    run = CliRunner().invoke(app, ["table", str(dataset_folder), "--out", str(tmp_path / "pairs.csv")])
    assert run.exit_code == 0
    os.mkfifo(tmp_path / "fifo.csv")
    run = CliRunner().invoke(
        app, ["table", str(dataset_folder), "--replace", "--out", str(tmp_path / "fifo.csv")]
    )
    assert isinstance(run.exception, ss.DatasetError) and (tmp_path / "fifo.csv").is_fifo()


def test_a_name_that_is_laid_in_wait_is_not_followed(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "victim").write_text("mine")
    (tmp_path / ".x.zip.partial").symlink_to(tmp_path / "victim")  # the name of earlier versions
    monkeypatch.setattr("secrets.token_hex", lambda _: "guessed")
    (tmp_path / ".x.zip.guessed.partial").symlink_to(tmp_path / "victim")
    with pytest.raises(ss.DatasetError, match="cannot write this archive"):
        pack_dataset(dataset_folder, tmp_path / "x.zip")
    assert (tmp_path / "victim").read_text() == "mine"


def test_cards_beside_a_dataset(dataset_folder: Path, tmp_path: Path) -> None:
    """README.md with the front matter that Hugging Face reads, datasheet.md, CITATION.cff: from the manifest, once."""
    copy = tmp_path / "d"
    shutil.copytree(dataset_folder, copy)
    manifest = read_manifest(copy)
    odd = 'a "b"\n---\n<script>: x'.replace("\n", " ")
    write_manifest(copy, msgspec.structs.replace(manifest, scene=odd))
    assert [p.name for p in write_cards(copy)] == list(CARDS)
    front, body = (copy / "README.md").read_text("utf-8").split("---\n")[1:3]
    card = yaml.safe_load(front)
    assert card["pretty_name"].endswith("a _b_ --- _script__ x") and card["size_categories"] == ["n<1K"]
    assert manifest.key in body and f"{len(manifest.points) ** 2:,}, between all pairs" in body
    citation = yaml.safe_load((copy / "CITATION.cff").read_text("utf-8"))
    assert citation["type"] == "dataset" and citation["identifiers"][0]["value"] == manifest.key
    (copy / "datasheet.md").write_text("mine")
    (copy / "README.md").unlink()
    assert [p.name for p in write_cards(copy)] == ["README.md"]
    assert (copy / "datasheet.md").read_text() == "mine"
    assert ss.verify_dataset(copy, full=True)[1] == []
    with zipfile.ZipFile(pack_dataset(copy, tmp_path / "x.zip")) as archive:
        assert {f"d/{name}" for name in CARDS} < set(archive.namelist())


@pytest.mark.parametrize(
    ("diffraction", "words"),
    [
        (
            True,
            "Diffraction is that of the uniform theory, for rigid edges: one, two, or a way round many",
        ),
        (False, "was turned off"),
    ],
)
def test_a_datasheet_says_what_was_simulated(
    dataset_folder: Path, tmp_path: Path, diffraction: bool, words: str
) -> None:
    copy = tmp_path / "d"
    shutil.copytree(dataset_folder, copy)
    manifest = read_manifest(copy)
    simulation = msgspec.structs.replace(
        manifest.config.simulation, diffraction=ss.DiffractionConfig(enabled=diffraction)
    )
    config = msgspec.structs.replace(manifest.config, simulation=simulation)
    write_manifest(copy, msgspec.structs.replace(manifest, config=config))
    write_cards(copy)
    text = " ".join((copy / "datasheet.md").read_text("utf-8").split())
    assert words in text
    assert "Not simulated: waves below the transition frequency (modes). " in text


def test_no_text_of_a_manifest_is_more_than_text(dataset_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "d"
    shutil.copytree(dataset_folder, copy)
    evil = 'x"\n  - type: other\n    value: "`y` | <script> [z](http://a) \\ ' + "é" * 1000
    names = ("key", "code_version", "target", "scene_digest", "command")
    write_manifest(copy, msgspec.structs.replace(read_manifest(copy), **dict.fromkeys(names, evil)))
    write_cards(copy)
    citation = yaml.safe_load((copy / "CITATION.cff").read_text("utf-8"))
    assert [set(x) for x in citation["identifiers"]] == [{"type", "value", "description"}]
    assert (
        citation["identifiers"][0]["value"].startswith("x__  - type: other")
        and len(citation["references"]) == 1
    )
    assert citation["references"][0]["version"].startswith("x__")
    for name in CARDS:
        text = (copy / name).read_text("utf-8")
        assert "<script>" not in text and "](http" not in text and "`y`" not in text


FIELDS = (ROOT / "docs" / "fields.md").read_text("utf-8")


def test_the_page_of_fields_has_every_field() -> None:
    """Its tables are made with the site, from the schemas."""
    assert "<!-- fields -->" in FIELDS
    text = field_tables()
    for form in CURRENT:
        found = schema(form)
        for name in (*found["datasets"], *found["attributes"]):
            assert f"| `{name}` |" in text


def test_plain_h5py_reads_what_the_reader_reads(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page's fifteen lines, and its MATLAB by the same numbers in reversed dimensions."""
    import h5py

    (tmp_path / "out").mkdir()
    shutil.copytree(dataset_folder, tmp_path / "out" / "demo")
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    exec(FIELDS.split("```python\n")[1].split("```")[0], scope)
    with ss.open_dataset(dataset_folder) as ds:
        echogram = ds[3, 0]
    energy, moments = np.asarray(scope["energy"]), np.asarray(scope["moments"])
    np.testing.assert_allclose(energy, echogram.energy[:, 0], rtol=1e-5)
    np.testing.assert_allclose(moments, echogram.energy[:, 1:].transpose(0, 2, 1), rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(np.asarray(scope["total"]), echogram.histogram().sum(axis=1), rtol=1e-4)
    with h5py.File(dataset_folder / "s00000_l00000.h5", locking=False) as file:
        low = h5py.h5d.open(file.id, b"energy")
        steps = np.empty(low.shape, np.uint8)
        low.read(h5py.h5s.ALL, h5py.h5s.ALL, steps)
        matlab = steps.T.astype(float)  # what h5read gives, (B, T, L, S)
        q = matlab[:, :, 0, 3]
        step_db = float(file.attrs["energy_step_db"])
        peak = float(file["energy_peak"][()].T[0, 3])
    np.testing.assert_allclose(peak * 10 ** ((q - 255) * step_db / 10) * (q > 0), energy.T, rtol=1e-5)


OCTAVE = shutil.which("octave-cli")


@pytest.mark.skipif(OCTAVE is None, reason="there is no octave-cli on the path")
def test_octave_reads_what_the_reader_reads(dataset_folder: Path, tmp_path: Path) -> None:
    """The page's MATLAB as it stands, in Octave, whose `load` takes the place of h5read; h5readatt, which it lacks,
    gives the attribute that h5py reads."""
    import h5py

    (tmp_path / "out").mkdir()
    shutil.copytree(dataset_folder, tmp_path / "out" / "demo")
    with h5py.File(dataset_folder / "s00000_l00000.h5", locking=False) as file:
        step = float(file.attrs["energy_step_db"])
    (tmp_path / "h5read.m").write_text(
        "function out = h5read(file, name)\n  out = getfield(load('-hdf5', file), name(2:end));\nend\n"
    )
    (tmp_path / "h5readatt.m").write_text(
        "function out = h5readatt(file, where, name)\n"
        f"  assert(strcmp(name, 'energy_step_db'));\n  out = {step!r};\nend\n"
    )
    matlab = FIELDS.split("```matlab\n")[1].split("```")[0]
    (tmp_path / "page.m").write_text(
        matlab + "dlmwrite('energy.txt', energy, 'precision', '%.9g');\n"
        "dlmwrite('edges.txt', time_edges(:), 'precision', '%.9g');\n"
    )
    done = subprocess.run(
        [str(OCTAVE), "--norc", "page.m"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (tmp_path / "edges.txt").is_file(), done.stderr
    with ss.open_dataset(dataset_folder) as ds:
        echogram = ds[3, 0]
    energy = np.loadtxt(tmp_path / "energy.txt", delimiter=",")
    np.testing.assert_allclose(energy, echogram.energy[:, 0].T, rtol=1e-5)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "edges.txt"), echogram.time_edges, rtol=1e-7)
