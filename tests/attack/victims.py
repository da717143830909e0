"""Small whole files of every kind that is read, and what reads them: victims of `harness`."""

from __future__ import annotations

import base64
import hashlib
import json
import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import h5py
import networkx
import numpy as np
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.build.job_file import NAME, _read, open_job
from soundspaces_sim.dataset.exporters.plan import choose_pairs
from soundspaces_sim.dataset.exporters.points import read_points
from soundspaces_sim.dataset.format.floorplan import read_floorplan
from soundspaces_sim.dataset.format.manifest import _ZEROS, _tail
from soundspaces_sim.rendering.directivity import _load
from soundspaces_sim.rendering.hrtf import load_hrtf
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.labels import load_labels
from soundspaces_sim.scene.materials import load_materials
from tests.attack.old_layout import old_layout
from tests.rooms import box, table
from tests.scene.test_formats import _QUADS, _house, _matterport, _ply, _replica

# The neighbours' readers are attacked with the core's, installed or not.
sys.path.append(str(Path(__file__).parents[2] / "neighbours" / "room_programs" / "src"))
sys.path.append(str(Path(__file__).parents[2] / "neighbours" / "exports" / "src"))
sys.path.append(str(Path(__file__).parents[2] / "neighbours" / "scene_formats" / "src"))
from soundspaces_exports.pickled import read_graph
from soundspaces_exports.soundspaces1 import plan_soundspaces1 as plan_soundspaces1
from soundspaces_room_programs.catt import read_catt
from soundspaces_room_programs.gmsh import read_gmsh
from soundspaces_room_programs.isimpa import read_project
from soundspaces_room_programs.odeon import read_odeon
from soundspaces_scene_formats import dae, gibson as gibson_format, hm3d as hm3d_format, ifc

from neighbours.room_programs.tests.test_isimpa import project
from neighbours.room_programs.tests.test_room_programs import catt, gmsh, odeon
from neighbours.scene_formats.tests.test_building_files import _ifc
from neighbours.scene_formats.tests.test_habitat_layouts import gibson, hm3d


@dataclass(frozen=True)
class Victim:
    """A file, and a function that reads it and returns what was read. `sealed`: damage must not go unseen.

    `resign`: makes the digests of damaged bytes fit again, as a stranger would.
    """

    path: Path
    read: Callable[[], bytes]
    sealed: bool = False
    resign: Callable[[bytes], bytes] | None = None


def make_whole(folder: Path) -> None:
    """A dataset of both forms, and the record of its job, in `folder`: what `make_victims` needs."""
    kept: list[bytes] = []
    build_whole(folder, lambda _: kept.append((folder / "whole" / NAME).read_bytes()))
    (folder / NAME).write_bytes(kept[0])


def build_whole(folder: Path, announce: Callable[[object], None] | None = None) -> None:
    """A dataset of both forms in a folder of `folder`."""
    config = ss.JobConfig(
        grid=ss.GridConfig(spacing=2.9, rays=50),
        simulation=ss.SimulationConfig(walks=16, connections=ss.ConnectionsConfig(subpaths=2), duration=0.05, bands=(0.0, 1000.0, 20000.0)),
        dataset=type(ss.JobConfig().dataset)(rate=8000, store="both", headings=(0.0,), tile=3),
    )  # fmt: skip
    scene = ss.shoebox((4.0, 3.0, 2.5), 0.3, name="whole")
    points = np.array([[1.0, 1.0, 1.5], [3.0, 2.0, 1.5]])
    ss.build_dataset(scene, folder, config, points=points, announce=announce)


def make_victims(folder: Path, whole: Path) -> dict[str, Victim]:
    """One of every kind, in `folder`; `whole`: the folder of `make_whole`."""
    out: dict[str, Victim] = {}
    _of_datasets(folder, whole, out)
    _of_graphs(folder, out)
    _of_sofa(folder, out)
    _of_scenes(folder, out)
    _of_settings(folder, whole / "whole", out)
    return out


def _arrays(*values: object) -> bytes:
    sha = hashlib.sha256()
    for value in values:
        sha.update(
            np.ascontiguousarray(value).tobytes()
            if isinstance(value, np.ndarray)
            else repr(value).encode()
        )
    return sha.digest()


def read_dataset(folder: Path) -> bytes:
    """All echograms, stored responses and rows of the table."""
    with ss.open_dataset(folder) as ds:
        found: list[object] = [ds.points, ds.scene, ds.rate, ds.manifest.edges, ds.manifest.nodes]
        for s, l in ds:
            if ds._stored.shards.has("echogram"):
                e = ds.echogram(s, l)
                parts = (
                    e.energy,
                    e.time_edges,
                    e.early.delay,
                    e.early.energy,
                    e.early.direction,
                )
                assert all(np.isfinite(x).all() for x in parts) and (e.energy[:, 0] >= 0.0).all()
                assert (e.relative_error >= 0.0).all()  # infinite where it is not known
                found += [*parts, e.relative_error, e.direct]
            if ds._stored.shards.has("waveform"):
                found += [ds.ambisonic(s, l), ds.binaural(s, l)]
                assert all(np.isfinite(x).all() for x in found[-2:] if isinstance(x, np.ndarray))
        found.append(ds.table(collocated=True))
    return _arrays(*found)


def _copy(source: Path, target: Path) -> Path:
    target.mkdir(parents=True)
    for path in source.iterdir():
        (target / path.name).write_bytes(path.read_bytes())
    return target


def _of_datasets(folder: Path, whole: Path, out: dict[str, Victim]) -> None:
    mine, old = _copy(whole / "whole", folder / "dataset"), old_layout(folder / "old")

    def whole_one() -> bytes:
        return read_dataset(mine)

    def old_one() -> bytes:
        return read_dataset(old)

    forms = {e.form: mine / e.file for e in ss.open_dataset(mine).manifest.shards}
    for form, path in forms.items():
        out[f"shard-{form}"] = Victim(path, whole_one, sealed=True)
    manifest = mine / "manifest.json"
    out["manifest"] = Victim(manifest, whole_one, sealed=True)
    out["manifest-resigned"] = Victim(manifest, whole_one, resign=resigned)

    def plan() -> bytes:
        found = read_floorplan(mine)
        return _arrays(*found.walls, found.furniture, found.labels, found.origin, found.cell)

    out["floorplan"] = Victim(mine / "floorplan.hdf5", plan, sealed=True)
    out["shard-old"] = Victim(next(old.glob("s*.h5")), old_one)
    record = folder / "job" / NAME
    record.parent.mkdir()
    record.write_bytes((whole / NAME).read_bytes())

    def job() -> bytes:
        _read.cache_clear()
        found = open_job(record.parent)
        return _arrays(found.points, found.geodesic, found.scene.vertices, found.plan.draft.key)

    out["job"] = Victim(record, job, sealed=True)


def resigned(data: bytes) -> bytes:
    text = data.decode("utf-8", "replace")
    head, mark, _ = text.rpartition('"sha256": "')
    if not mark:
        return data
    zeros = head + _tail(_ZEROS)
    return (head + _tail(hashlib.sha256(zeros.encode()).hexdigest())).encode()


def _of_graphs(folder: Path, out: dict[str, Victim]) -> None:
    graph = networkx.Graph()
    for n in range(6):
        graph.add_node(n, point=(0.5 * n, 0.0, -1.0))
    graph.add_edges_from((n, (n + 1) % 6) for n in range(6))
    numpy_graph = networkx.Graph(graph)
    for n in numpy_graph.nodes:
        numpy_graph.nodes[n]["point"] = np.array(numpy_graph.nodes[n]["point"])
    for name, content in {
        "graph-2": pickle.dumps(graph, 2), "graph-4": pickle.dumps(graph, 4), "graph-0": pickle.dumps(graph, 0),
        "graph-numpy": pickle.dumps(numpy_graph, 3), "graph-numpy-5": pickle.dumps(numpy_graph, 5),
    }.items():  # fmt: skip
        path = folder / f"{name}.pkl"
        path.write_bytes(content)

        def read(path: Path = path) -> bytes:
            return _arrays(read_points(path), sorted(read_graph(path).edges))

        out[name] = Victim(path, read)
    path = folder / "points.txt"
    path.write_text("".join(f"{i}\t{0.5 * i:.6f}\t1.000000\t1.500000\n" for i in range(8)))
    out["points"] = Victim(path, lambda: _arrays(read_points(path)))


def _sphere(count: int) -> np.ndarray:
    k = np.arange(count) + 0.5
    elevation = np.rad2deg(np.arcsin(1.0 - 2.0 * k / count))
    return np.stack([(k * 137.508) % 360.0, elevation, np.ones(count)], axis=1)


def _of_sofa(folder: Path, out: dict[str, Victim]) -> None:
    rng = np.random.default_rng(0)
    path = folder / "head.sofa"
    with h5py.File(path, "w", libver=("v108", "v108")) as sofa:
        sofa["Data.IR"] = rng.normal(size=(24, 2, 6))
        sofa["SourcePosition"] = _sphere(24)
        sofa["SourcePosition"].attrs["Type"] = b"spherical"
        sofa["Data.SamplingRate"] = np.array([44100.0])
        sofa.attrs["Title"] = "a head"

    def head() -> bytes:
        found = load_hrtf.__wrapped__(path)
        assert np.isfinite(found.ir).all() and np.isfinite(found.weights).all()
        return _arrays(found.ir, found.directions, found.rate, found.weights)

    out["hrtf"] = Victim(path, head)
    voice = folder / "voice.sofa"
    with h5py.File(voice, "w", libver=("v108", "v108")) as sofa:
        sofa.attrs["SOFAConventions"] = "FreeFieldDirectivityTF"
        sofa["Data.Real"], sofa["Data.Imag"] = rng.normal(size=(2, 1, 24, 3))
        sofa["N"] = np.array([100.0, 1000.0, 5000.0])
        sofa["ReceiverPosition"] = _sphere(24)
        sofa["ReceiverPosition"].attrs["Type"] = "spherical"

    def pattern() -> bytes:
        found = _load.__wrapped__(str(voice), 0)
        assert np.isfinite(found.energy).all() and np.isfinite(found.inverse).all()
        return _arrays(found.frequency, found.energy, found.directions)

    out["directivity"] = Victim(voice, pattern)


def _of_scenes(folder: Path, out: dict[str, Victim]) -> None:
    def scene(name: str, victim: Path, source: Path) -> None:
        def read() -> bytes:
            found = ss.load_scene(source)
            assert np.isfinite(found.vertices).all()
            return _arrays(found.vertices, found.faces, found.face_material)

        out[name] = Victim(victim, read)

    def of_neighbour(
        name: str, victim: Path, reader: Callable[[str], LabelledMesh], source: Path | None = None
    ) -> None:
        def read() -> bytes:
            found = reader(str(source or victim))
            assert np.isfinite(found.vertices).all()
            return _arrays(found.vertices, found.faces, found.face_label)

        out[name] = Victim(victim, read)

    replica = _replica(folder / "replica", True)
    for end in ("mesh_semantic.ply", "info_semantic.json"):
        scene(f"replica-{end[-4:].strip('.')}", replica / "habitat" / end, replica)
    house = _matterport(folder / "mp3d", _house())
    scene("mp3d-house", house / "s.house", house)
    scene("mp3d-ply", house / "s_semantic.ply", house)
    painted, glb = hm3d(folder / "hm3d"), gibson(folder / "gibson")
    for name in ("Room.semantic.glb", "Room.semantic.txt"):
        of_neighbour(f"hm3d-{name[-3:]}", painted / name, hm3d_format.FORMAT.read, painted)
    for name in ("Room.scn", "Room_semantic.ply"):
        of_neighbour(f"gibson-{name[-3:]}", glb.with_name(name), gibson_format.FORMAT.read, glb)
    room = box((6.0, 4.0, 2.5), table(0.1, 0.1))
    mesh = trimesh.Trimesh(room.vertices, room.faces, process=False)
    for kind in ("obj", "glb", "stl", "stl_ascii", "off", "ply", "dae", "gltf"):
        path = folder / f"room-{kind}.{kind}"
        if kind == "gltf":
            _gltf(path, np.asarray(room.vertices, "<f4"), np.asarray(room.faces, "<u4"))
        else:
            mesh.export(path, file_type=kind)
        if kind == "dae":
            of_neighbour(kind, path, dae.read_dae)
        else:
            scene(kind, path, path)
    ascii_ply = folder / "room-ascii.ply"
    mesh.export(ascii_ply, encoding="ascii")
    scene("ply-ascii", ascii_ply, ascii_ply)
    polygons = folder / "polygons" / "room.ply"
    _ply(polygons, list(_QUADS.values()), {})
    scene("ply-polygons", polygons, polygons)
    named = folder / "named.obj"
    named.write_text("".join(
        [f"v {x} {y} {z}\n" for x, y, z in room.vertices] + [f"usemtl m{i}\nf {a + 1} {b + 1} {c + 1}\n" for i, (a, b, c) in enumerate(room.faces)]
    ))  # fmt: skip
    scene("obj-named", named, named)
    of_neighbour("catt", catt(folder / "catt.geo"), read_catt)
    of_neighbour("odeon", odeon(folder / "odeon.par"), read_odeon)
    of_neighbour("gmsh", gmsh(folder / "gmsh.geo"), read_gmsh)
    of_neighbour("isimpa-project", project(folder / "room.proj"), read_project)
    if find_spec("ifcopenshell") is not None:
        model = _ifc(folder / "house.ifc")
        of_neighbour("ifc", model, ifc.read_ifc)


def _gltf(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    data = vertices.tobytes() + faces.tobytes()
    at = vertices.nbytes
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1]}, {"mesh": 0, "translation": [1, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "brick"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": at}, {"buffer": 0, "byteOffset": at, "byteLength": len(data) - at},
        ],
        "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}],
    }  # fmt: skip
    path.write_text(json.dumps(tree))


def _of_settings(folder: Path, whole: Path, out: dict[str, Victim]) -> None:
    materials = folder / "materials.toml"
    materials.write_text(
        "frequency_hz = [125, 500, 2000]\n[materials.felt]\nabsorption = [0.1, 0.4, 0.7]\nscattering = [0.1, 0.2, 0.3]\n"
        'transmission = [0.0, 0.0, 0.1]\nsource = "made up"\n[materials."thin felt"]\nabsorption = [0.1, 0.2, 0.4]\n'
        "scattering = [0.1, 0.2, 0.3]\ntransmission = [0.2, 0.1, 0.1]\n"
    )

    def stuffs() -> bytes:
        found = load_materials(materials)
        return _arrays(
            found.names,
            found.frequency_hz,
            found.absorption,
            *found.in_bands((0.0, 176.0, 775.0, 20000.0)),
        )

    out["materials"] = Victim(materials, stuffs)
    labels = folder / "labels.toml"
    labels.write_text(
        'default = "brick"\n[labels]\nsofa = "carpet"\n"wall clock" = "glass"\n[words]\nwool = "carpet"\n'
    )
    out["labels"] = Victim(labels, lambda: _arrays(sorted(load_labels(labels).labels.items())))
    config = folder / "config.toml"
    config.write_text(
        "[grid]\nspacing = 0.5\nheight = 1.5\n[simulation]\nwalks = 100\nbands = [0, 176, 775, 20000]\nduration = 0.5\n"
        '[dataset]\nseed = 3\nrate = 16000\nheadings = [0.0, 90.0]\nstore = "both"\n'
    )
    out["config"] = Victim(config, lambda: _arrays(ss.load_config(config)))
    pairs = folder / "pairs.txt"
    pairs.write_text("0 1\n1 0\n1 1\n")
    dataset = ss.open_dataset(whole)
    out["pairs"] = Victim(pairs, lambda: _arrays(choose_pairs(dataset, pairs)))
