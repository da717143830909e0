"""`Context`: objects, sources and listeners in, impulse responses out."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.base.rng import combine, point_keys
from soundspaces_sim.rlr import output
from soundspaces_sim.rlr.errors import RlrError, as_runtime_errors
from soundspaces_sim.rlr.materials import Database, load_database
from soundspaces_sim.rlr.objects import (
    SceneObject,
    box_mesh,
    build_scene,
    flat_faces,
    flat_vertices,
    read_mesh,
)
from soundspaces_sim.rlr.propagation import Group, Propagation, group_listeners, threads
from soundspaces_sim.rlr.records import (
    BoxMaterialCategories,
    ChannelLayout,
    Config,
    Ray,
    rotation,
    vector3,
)
from soundspaces_sim.rlr.render import Ears, render_group
from soundspaces_sim.rlr.trace import first_hit
from soundspaces_sim.sound.hrtf import load_hrtf

_DEFAULT_RADIUS = 0.1  # m


@dataclass
class _Source:
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    radius: float = _DEFAULT_RADIUS


@dataclass
class _Listener:
    layout: ChannelLayout
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))  # local to world
    radius: float = _DEFAULT_RADIUS
    hrtf: str | None = None


class Context:
    """A simulation of sound from sources to listeners among objects, with the methods of
    `rlr_audio_propagation.Context`.

    Positions are in units of `config.unit_scale` m, in any right-handed axes; a head without orientation
    has the axes `config.hrtf_right`, `hrtf_up` and `hrtf_back`. `simulate` traces; the `get_…` methods
    give what it left: 1-D float64 responses whose direct sound is sqrt(1 / (4 pi)) / r. The same calls
    give the same bits. Methods raise `RlrError` (a RuntimeError) that says what is wrong, TypeError for
    arguments of a wrong kind.
    """

    def __init__(self, config: Config) -> None:
        if not isinstance(config, Config):
            raise TypeError(f"Context: expected a Config, got {type(config).__name__}")
        self.config = config
        self._clear()

    def _clear(self) -> None:
        self._objects: list[SceneObject] = []
        self._sources: list[_Source] = []
        self._listeners: list[_Listener] = []
        self._database = Database()
        self._propagation: Propagation | None = None
        self._made_for: tuple[float, bool] | None = None
        self._responses: list[list[np.ndarray]] = []  # [listener][source] (C, n)
        self._efficiency = 0.0

    def reset(self, config: Config | None = None) -> None:
        """Forget objects, materials, sources, listeners and results; take another config if one is given."""
        if config is not None:
            if not isinstance(config, Config):
                raise TypeError(f"reset: expected a Config, got {type(config).__name__}")
            self.config = config
        self._clear()

    @property
    def sr(self) -> float:
        """Sample rate of the responses, Hz."""
        return self.config.sample_rate

    # --- sources -------------------------------------------------------------------------------------

    def add_source(self) -> None:
        """Add a source at the origin; its index is the number of those before it."""
        self._sources.append(_Source())

    def clear_sources(self) -> None:
        """Remove all sources, and what was simulated."""
        self._sources, self._responses = [], []

    def get_source_count(self) -> int:
        """Number of sources."""
        return len(self._sources)

    def set_source_position(self, source_index: int, position: Sequence[float]) -> None:
        """Put a source at a position (3,)."""
        source = _pick(self._sources, source_index, "source")
        source.position = np.array(vector3(position, "set_source_position"))

    def set_source_radius(self, source_index: int, radius: float) -> None:
        """Radius of a source; kept, without effect: sources are points."""
        _pick(self._sources, source_index, "source").radius = _length(radius, "set_source_radius")

    # --- listeners -----------------------------------------------------------------------------------

    def add_listener(self, channel_layout: ChannelLayout) -> None:
        """Add a listener at the origin."""
        if not isinstance(channel_layout, ChannelLayout):
            raise TypeError(
                f"add_listener: expected a ChannelLayout, got {type(channel_layout).__name__}"
            )
        layout = ChannelLayout(channel_layout.type, channel_layout.channel_count)
        _ = layout.channels  # a layout that cannot be heard with is refused here
        self._listeners.append(_Listener(layout))

    def clear_listeners(self) -> None:
        """Remove all listeners, and what was simulated."""
        self._listeners, self._responses = [], []

    def get_listener_count(self) -> int:
        """Number of listeners."""
        return len(self._listeners)

    def set_listener_position(self, listener_index: int, position: Sequence[float]) -> None:
        """Put a listener at a position (3,)."""
        listener = _pick(self._listeners, listener_index, "listener")
        listener.position = np.array(vector3(position, "set_listener_position"))

    def set_listener_orientation_quaternion(
        self, listener_index: int, orientation: Sequence[float]
    ) -> None:
        """Turn a listener's head by [w, x, y, z], local to world. Ambisonics stay in world axes."""
        listener = _pick(self._listeners, listener_index, "listener")
        listener.turn = rotation(orientation, "set_listener_orientation_quaternion")

    def set_listener_radius(self, listener_index: int, radius: float) -> None:
        """Radius of a listener; kept, without effect: listeners are points."""
        _pick(self._listeners, listener_index, "listener").radius = _length(
            radius, "set_listener_radius"
        )

    def set_listener_hrtf(self, listener_index: int, hrtf_file_path: str) -> None:
        """HRTF of a binaural listener, a SOFA file (SimpleFreeFieldHRIR); the default is MIT's KEMAR."""
        listener = _pick(self._listeners, listener_index, "listener")
        with as_runtime_errors():
            load_hrtf(str(hrtf_file_path))
        listener.hrtf = str(hrtf_file_path)

    # --- objects -------------------------------------------------------------------------------------

    def add_object(self) -> None:
        """Add an object without a mesh; add_mesh_… calls that follow fill it."""
        self._objects.append(SceneObject())

    def clear_objects(self) -> None:
        """Remove all objects."""
        self._objects, self._propagation = [], None

    def get_object_count(self) -> int:
        """Number of objects."""
        return len(self._objects)

    def set_object_position(self, object_index: int, position: Sequence[float]) -> None:
        """Where the origin of an object's mesh is in the world; (3,)."""
        place = np.array(vector3(position, "set_object_position"))
        thing = _pick(self._objects, object_index, "object")
        if not np.array_equal(place, thing.position):
            thing.position = place
            self._changed(thing)

    def set_object_orientation_quaternion(self, object_index: int, orientation: Sequence[float]) -> None:
        """Turn an object about the origin of its mesh by [w, x, y, z], local to world."""
        turn = rotation(orientation, "set_object_orientation_quaternion")
        thing = _pick(self._objects, object_index, "object")
        if not np.array_equal(turn, thing.turn):
            thing.turn = turn
            self._changed(thing)

    def set_object_mesh_obj(
        self, object_index: int, obj_file_path: str, material_category_name: str
    ) -> None:
        """Take an object's mesh from a Wavefront OBJ file, all of one material category."""
        thing = _pick(self._objects, object_index, "object")
        thing.mesh = read_mesh(obj_file_path, str(material_category_name), "obj")
        self._changed(thing)

    def set_object_mesh_ply(
        self, object_index: int, ply_file_path: str, material_category_name: str
    ) -> None:
        """Take an object's mesh from a PLY file, all of one material category."""
        thing = _pick(self._objects, object_index, "object")
        thing.mesh = read_mesh(ply_file_path, str(material_category_name), "ply")
        self._changed(thing)

    def set_object_box(
        self,
        object_index: int,
        box_min: Sequence[float],
        box_max: Sequence[float],
        materials: BoxMaterialCategories,
    ) -> None:
        """Make an object a box between two corners (3,), with a material category per side."""
        if not isinstance(materials, BoxMaterialCategories):
            raise TypeError(
                f"set_object_box: expected BoxMaterialCategories, got {type(materials).__name__}"
            )
        thing = _pick(self._objects, object_index, "object")
        low = np.array(vector3(box_min, "set_object_box: box_min"))
        thing.mesh = box_mesh(low, np.array(vector3(box_max, "set_object_box: box_max")), materials)
        self._changed(thing)

    def add_mesh_vertices(self, vertex_data: Sequence[float]) -> None:
        """Add vertices x, y, z, x, … to the object that was added last."""
        self._last_object("add_mesh_vertices").vertices.append(flat_vertices(vertex_data))

    def add_mesh_indices(
        self, index_data: Sequence[int], vertices_per_face: int, material_category_name: str
    ) -> None:
        """Add faces of one material category to the object that was added last."""
        faces = flat_faces(index_data, int(vertices_per_face))
        last = self._last_object("add_mesh_indices")
        last.parts.append((faces, str(material_category_name)))

    def finalize_object_mesh(self, object_index: int) -> None:
        """Make an object's mesh of the vertices and indices it was given."""
        thing = _pick(self._objects, object_index, "object")
        thing.finalize(int(object_index))
        self._changed(thing)

    def set_material_database_json(self, json_path: str) -> None:
        """Read the material database that gives categories their coefficients."""
        self._database = load_database(json_path)
        self._propagation = None

    def write_scene_mesh_obj(self, output_path: str) -> None:
        """Write the scene, in metres, as an OBJ file with one group per material category."""
        output.write_scene(self._scene().scene, Path(output_path))

    # --- simulation ----------------------------------------------------------------------------------

    def simulate(self) -> None:
        """Simulate every source at every listener. Without either there is nothing to do."""
        self._responses, self._efficiency = [], 0.0
        if not self._sources or not self._listeners:
            return
        unit = self.config.unit_scale
        sources = unit * np.array([s.position for s in self._sources]) + 0.0
        listeners = unit * np.array([l.position for l in self._listeners]) + 0.0
        groups = group_listeners(listeners)
        with as_runtime_errors(), threads(self.config.thread_count) as workers:
            propagation = self._scene()
            places = np.ascontiguousarray(listeners[[g.place for g in groups]])
            table = propagation.echograms(sources, places, self.config)
            if self.config.indirect:
                self._efficiency = propagation.efficiency(np.unique(places, axis=0))
            jobs = [(s, g) for s in range(len(sources)) for g in range(len(groups))]
            seeds = self._seeds(sources, places)

            def render(job: tuple[int, int]) -> list[np.ndarray]:
                s, g = job
                ears = [self._ears(i, listeners[i] - places[g]) for i in groups[g].members]
                distance = np.linalg.norm(listeners[list(groups[g].members)] - sources[s], axis=1)
                return render_group(table[s][g], ears, distance.tolist(), self.config, int(seeds[s, g]))

            with ThreadPoolExecutor(workers) as pool:
                rendered = list(pool.map(render, jobs))
        self._responses = _by_listener(jobs, rendered, groups, len(sources), len(listeners))

    def _seeds(self, sources: np.ndarray, places: np.ndarray) -> np.ndarray:
        """(S, G) of the noise: of the points, so that a pair sounds the same whatever else is simulated;
        with temporal coherence of their numbers, so that noise does not change as they move."""
        if self.config.temporal_coherence:
            keys = [np.arange(len(points), dtype=np.uint64) for points in (sources, places)]
        else:
            keys = [point_keys(np.ascontiguousarray(points), 0) for points in (sources, places)]
        return np.array([[int(combine(a, b)) for b in keys[1]] for a in keys[0]], np.uint64)

    def _ears(self, index: int, offset: np.ndarray) -> Ears:
        listener, config = self._listeners[index], self.config
        axes = np.array(
            [
                np.negative(config.hrtf_back), np.negative(config.hrtf_right), np.asarray(config.hrtf_up)
            ]
        ).T  # fmt: skip
        return Ears(offset, listener.layout, listener.turn @ _orthonormal(axes), listener.hrtf)

    def get_indirect_ray_efficiency(self) -> float:
        """Share of rays from the listeners that do not escape from the scene, 0 to 1."""
        return self._efficiency

    def trace_ray_any_hit(self, ray: Ray) -> None:
        """Set `ray.hit`: whether anything lies on the ray."""
        ray.hit = first_hit(self._scene().scene, ray, self.config.unit_scale) is not None

    def trace_ray_first_hit(self, ray: Ray) -> None:
        """Set `ray.hit` and, where it hits, `ray.t_max` and the unit `ray.normal` that faces it."""
        found = first_hit(self._scene().scene, ray, self.config.unit_scale)
        ray.hit = found is not None
        if found is not None:
            ray.t_max, ray.normal = found

    # --- results -------------------------------------------------------------------------------------

    def get_ir_count(self) -> int:
        """Number of pairs that were simulated."""
        return sum(len(row) for row in self._responses)

    def get_ir_channel_count(self, listener_index: int, source_index: int) -> int:
        """Channels of a pair's response; 0 if it was not simulated."""
        pair = self._find(listener_index, source_index)
        return 0 if pair is None else len(pair)

    def get_ir_sample_count(self, listener_index: int, source_index: int) -> int:
        """Samples of a pair's response; 0 if it was not simulated."""
        pair = self._find(listener_index, source_index)
        return 0 if pair is None else pair.shape[1]

    def get_ir_channel(self, listener_index: int, source_index: int, channel_index: int) -> np.ndarray:
        """(n,) float64 of one channel."""
        pair = self._pair(listener_index, source_index)
        channel = int(channel_index)
        if not 0 <= channel < len(pair):
            raise RlrError(f"channel {channel} is not among the {len(pair)} of this response")
        return np.array(pair[channel])

    def get_listener_source_channel_audio(
        self, listener_index: int, source_index: int, channel_index: int
    ) -> np.ndarray:
        """(n,) float64 of one channel."""
        return self.get_ir_channel(listener_index, source_index, channel_index)

    def get_listener_source_audio(self, listener_index: int, source_index: int) -> np.ndarray:
        """(C, n) float64 of one pair."""
        return np.array(self._pair(listener_index, source_index))

    def get_listener_audio(self, listener_index: int) -> np.ndarray:
        """(S, C, n) float64 of one listener, padded with zeros."""
        self._pair(listener_index, 0)
        return output.stack(self._responses[listener_index])

    def get_source_audio(self, source_index: int) -> np.ndarray:
        """(L, C, n) float64 of one source, padded with zeros; all listeners need as many channels."""
        self._pair(0, source_index)
        return output.stack([row[source_index] for row in self._responses])

    def get_audio(self) -> np.ndarray:
        """(L, S, C, n) float64, padded with zeros; all listeners need as many channels."""
        self._pair(0, 0)
        flat = output.stack([pair for row in self._responses for pair in row])
        return flat.reshape(len(self._responses), -1, *flat.shape[1:])

    def get_channel_counts(self) -> list[list[int]]:
        """Channels of every pair, [listener][source]."""
        return [[len(pair) for pair in row] for row in self._responses]

    def write_ir_wave(self, listener_index: int, source_index: int, output_file_path: str) -> None:
        """Write a response as a float32 WAV file."""
        pair = self._pair(listener_index, source_index)
        output.write_wave(pair, round(self.config.sample_rate), Path(output_file_path))

    def write_ir_metrics(self, listener_index: int, source_index: int, output_file_path: str) -> None:
        """Write the level of each band in steps of 5 ms, dB, as a text table per channel, to
        `output_file_path` + " ch0 etc.txt" and so on."""
        pair = self._pair(listener_index, source_index)
        output.write_metrics(pair, self.config, output_file_path)

    # --- within --------------------------------------------------------------------------------------

    def _changed(self, thing: SceneObject) -> None:
        if thing.mesh is not None:
            self._propagation = None

    def _last_object(self, what: str) -> SceneObject:
        if not self._objects:
            raise RlrError(f"{what}: there is no object; call add_object first")
        return self._objects[-1]

    def _scene(self) -> Propagation:
        """The scene of the objects as they are now; made anew only after one has changed."""
        made_for = (self.config.unit_scale, bool(self.config.transmission))
        if self._propagation is None or made_for != self._made_for:
            with as_runtime_errors():
                scene = build_scene(self._objects, self._database, *made_for)
            self._propagation, self._made_for = Propagation(scene), made_for
        return self._propagation

    def _find(self, listener: int, source: int) -> np.ndarray | None:
        inside = 0 <= listener < len(self._responses) and 0 <= source < len(self._responses[listener])
        return self._responses[listener][source] if inside else None

    def _pair(self, listener: int, source: int) -> np.ndarray:
        pair = self._find(int(listener), int(source))
        if pair is None:
            sources = len(self._responses[0]) if self._responses else 0
            raise RlrError(
                f"no response for listener {listener} and source {source}: {len(self._responses)} listeners "
                f"and {sources} sources have been simulated; call simulate()"
            )
        return pair


def _pick(things: list[Any], index: int, what: str) -> Any:
    """The thing at an index. Raises `RlrError`."""
    number = int(index)
    if not 0 <= number < len(things):
        raise RlrError(f"{what} {number} is not among the {len(things)} that were added")
    return things[number]


def _length(value: float, what: str) -> float:
    if not 0.0 <= float(value) < np.inf:
        raise RlrError(f"{what}: expected 0 or more, got {value!r}")
    return float(value)


def _orthonormal(axes: np.ndarray) -> np.ndarray:
    """(3, 3) columns made orthogonal unit vectors. Raises `RlrError` unless they are right-handed."""
    u, s, vh = np.linalg.svd(axes)
    turned = u @ vh
    if s.min() < 0.1 * s.max() or np.linalg.det(turned) < 0.0:
        raise RlrError(
            "Config: hrtf_right, hrtf_up and hrtf_back must be right-handed axes, at right angles; got front, "
            f"left, up as columns {axes.tolist()}"
        )
    return np.asarray(turned)


def _by_listener(
    jobs: list[tuple[int, int]],
    rendered: list[list[np.ndarray]],
    groups: list[Group],
    sources: int,
    listeners: int,
) -> list[list[np.ndarray]]:
    """Responses [listener][source] from those of (source, group) jobs."""
    out: list[list[np.ndarray]] = [[np.empty((0, 0))] * sources for _ in range(listeners)]
    for (s, g), responses in zip(jobs, rendered, strict=True):
        for i, response in zip(groups[g].members, responses, strict=True):
            out[i][s] = response
    return out
