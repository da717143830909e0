"""The part of `Context` that holds objects and materials, and makes a scene of them."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from soundspaces_rlr import output
from soundspaces_rlr.arguments import pick, rotation, vector3
from soundspaces_rlr.errors import RlrError, as_runtime_errors
from soundspaces_rlr.materials import Database, load_database
from soundspaces_rlr.objects import (
    SceneObject,
    box_mesh,
    build_scene,
    flat_faces,
    flat_vertices,
    read_mesh,
)
from soundspaces_rlr.preparation import Kept
from soundspaces_rlr.propagation import Propagation
from soundspaces_rlr.records import BoxMaterialCategories, Config, Ray
from soundspaces_rlr.trace import first_hit


class SceneBuilder:
    """Objects with meshes of material categories, the database that gives these coefficients, and the scene
    of all that, which is made again only after something in it has changed."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self._forget_scene()

    def _forget_scene(self) -> None:
        self._objects: list[SceneObject] = []
        self._database = Database()
        self._propagation: Propagation | None = None
        self._kept = Kept()
        self._made_for: tuple[float, bool] | None = None

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
        thing = pick(self._objects, object_index, "object")
        if not np.array_equal(place, thing.position):
            thing.position = place
            self._changed(thing)

    def set_object_orientation_quaternion(self, object_index: int, orientation: Sequence[float]) -> None:
        """Turn an object about the origin of its mesh by [w, x, y, z], local to world."""
        turn = rotation(orientation, "set_object_orientation_quaternion")
        thing = pick(self._objects, object_index, "object")
        if not np.array_equal(turn, thing.turn):
            thing.turn = turn
            self._changed(thing)

    def set_object_mesh_obj(
        self, object_index: int, obj_file_path: str, material_category_name: str
    ) -> None:
        """Take an object's mesh from a Wavefront OBJ file, all of one material category."""
        thing = pick(self._objects, object_index, "object")
        thing.mesh = read_mesh(obj_file_path, str(material_category_name), "obj")
        self._changed(thing)

    def set_object_mesh_ply(
        self, object_index: int, ply_file_path: str, material_category_name: str
    ) -> None:
        """Take an object's mesh from a PLY file, all of one material category."""
        thing = pick(self._objects, object_index, "object")
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
        thing = pick(self._objects, object_index, "object")
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
        faces = flat_faces(index_data, operator.index(vertices_per_face))
        last = self._last_object("add_mesh_indices")
        last.parts.append((faces, str(material_category_name)))

    def finalize_object_mesh(self, object_index: int) -> None:
        """Make an object's mesh of the vertices and indices it was given."""
        thing = pick(self._objects, object_index, "object")
        thing.finalize(operator.index(object_index))
        self._changed(thing)

    def set_material_database_json(self, json_path: str) -> None:
        """Read the material database that gives categories their coefficients."""
        self._database = load_database(json_path)
        self._propagation = None

    def write_scene_mesh_obj(self, output_path: str) -> None:
        """Write the scene, in metres, as an OBJ file with one group per material category."""
        output.write_scene(self._scene().scene, Path(output_path))

    def trace_ray_any_hit(self, ray: Ray) -> None:
        """Set `ray.hit`: whether anything lies on the ray."""
        ray.hit = first_hit(self._scene().scene, ray, self.config.unit_scale) is not None

    def trace_ray_first_hit(self, ray: Ray) -> None:
        """Set `ray.hit` and, where it hits, `ray.t_max` and the unit `ray.normal` that faces it."""
        found = first_hit(self._scene().scene, ray, self.config.unit_scale)
        ray.hit = found is not None
        if found is not None:
            ray.t_max, ray.normal = found

    def _changed(self, thing: SceneObject) -> None:
        if thing.mesh is not None:
            self._propagation = None

    def _last_object(self, what: str) -> SceneObject:
        if not self._objects:
            raise RlrError(f"{what}: there is no object; call add_object first")
        return self._objects[-1]

    def _scene(self) -> Propagation:
        """The scene of the objects as they are now. After one has changed, what is near it is made anew."""
        made_for = (self.config.unit_scale, bool(self.config.transmission))
        if self._propagation is None or made_for != self._made_for:
            with as_runtime_errors():
                scene, owner = build_scene(self._objects, self._database, *made_for)
            self._propagation = Propagation(scene, owner, self._kept)
            self._made_for = made_for
        return self._propagation
