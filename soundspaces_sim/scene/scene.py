"""Scene: triangles, a material for each, and where they came from.

Conventions: metres, right-handed, Z up. Surfaces are two-sided.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.io.disk_cache import cached_on_disk
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.core.svg import BLACK, Lines, html, svg
from soundspaces_sim.scene.arrays import faces_of_arrays, faces_of_trimesh
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.rays.caster import RayScene
from soundspaces_sim.scene.rays.geometry import Covers, Geometry
from soundspaces_sim.scene.rays.overlaps import (
    Overlaps,
    are_pairs,
    close_notes,
    covers_of,
    find_close,
    find_overlaps,
    overlap_notes,
)
from soundspaces_sim.scene.section import section
from soundspaces_sim.scene.triangles import (
    areas,
    check_mesh,
    corners_of,
    cross_products,
    longest_edges,
    used_rows,
)


def check_scene(scene: object) -> None:
    """Raise `SceneError` for what is no scene."""
    if not isinstance(scene, Scene):
        raise SceneError(
            f"expected a Scene, got {type(scene).__name__}; load_scene makes one of a name, a path or a mesh"
        )


def scene_key(scene: Scene) -> tuple[object, ...]:
    """What decides what is made of a scene, for caches."""
    return scene.digest, scene.corners.shape, scene.materials.absorption.shape


_LARGE = 100_000  # triangles, of which it takes seconds to find out what the disk cache may keep
_FARTHEST, _WIDEST = 1e9, 2e4  # m, from the origin, and across
_HASH = np.uint64(0x9E3779B97F4A7C15)  # odd, of no pattern


def is_large(faces: np.ndarray) -> bool:
    """Whether what is found of so many triangles is kept on disk."""
    return len(faces) >= _LARGE


@kernel
def _hash(corners: np.ndarray, bits: np.ndarray, material: np.ndarray, key: np.ndarray) -> None:
    """Fill `key` (F,) with numbers, alike where `material` (F,) and the boxes about `corners` (F, 3, 3) are; `bits`
    of these floats."""
    for i in range(len(key)):
        h = np.uint64(material[i])
        for k in range(3):
            low = high = 0
            for c in range(1, 3):
                low = c if corners[i, c, k] < corners[i, low, k] else low
                high = c if corners[i, c, k] > corners[i, high, k] else high
            for c in (low, high):
                if corners[i, c, k] != 0.0:  # -0 is 0
                    h ^= bits[i, c, k]
                h *= _HASH
                h ^= h >> np.uint64(32)
        key[i] = h


def _first_of_its_place(corners: np.ndarray, material: np.ndarray) -> np.ndarray:
    """(F,) False for a face whose (3, 3) corners, in any order, and material another one before it has."""
    unique = np.ones(len(corners), bool)
    # Only those in the same box can be alike, and in most meshes none are.
    key = np.empty(len(corners), np.uint64)
    _hash(corners, corners.view(np.uint64), material.astype(np.int64), key)
    ordered = np.sort(key)
    again = ordered[1:][ordered[1:] == ordered[:-1]]
    if len(again) > 0:
        leading = np.zeros(2**16, bool)  # bits of those, which few others have
        leading[again >> 48] = True
        some = np.flatnonzero(leading[key >> 48])
        some = some[np.isin(key[some], again)]
        own = corners[some]
        order = np.lexsort(own.transpose(2, 0, 1)[::-1], axis=1)
        rows = np.take_along_axis(own, order[:, :, None], axis=1).reshape(len(some), 9)
        unique[some] = False
        unique[some[unique_rows(np.column_stack([rows, material[some]]))[0]]] = True
    return unique


@dataclass(frozen=True)
class Scene:
    """A triangle mesh with acoustic materials.

    Faces without area and repetitions of a face of one material are dropped. Raises `SceneError` on a mesh that has
    no faces, values that are not finite, or indices out of range.

    Parameters
    ----------
    vertices
        (V, 3) float, m, Z up
    faces
        (F, 3) int, rows of `vertices`
    face_material
        (F,) int, rows of `materials`
    materials
        the table
    labels, face_label
        names and (F,) row of each face's name, -1 for none; may be empty
    name
        for messages and file names
    notes
        what a loader assumed (up axis, unit, defaults), one sentence each
    """

    vertices: np.ndarray
    faces: np.ndarray
    face_material: np.ndarray
    materials: MaterialTable
    labels: tuple[str, ...] = ()
    face_label: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    name: str = "scene"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.materials, MaterialTable):
            raise SceneError(
                f"{self.name}: materials: expected a MaterialTable, got {type(self.materials).__name__}; "
                "Scene.from_arrays takes absorption or names of materials"
            )
        try:
            vertices = np.array(self.vertices, float, order="C")
            faces = np.array(self.faces, order="C")
            material = np.array(self.face_material)
            label = np.array(self.face_label)
        except (ValueError, TypeError) as error:
            raise SceneError(f"{self.name}: expected arrays of numbers ({error})") from error
        self._check(vertices, faces, material, label)
        if len(label) == 0:
            label = np.full(len(faces), -1)
        corners = corners_of(vertices, faces)
        # Embree works in float32: a face thinner than its rounding has no usable normal.
        keep = 2.0 * areas(corners) > 1e-7 * longest_edges(corners)
        keep &= _first_of_its_place(corners, material)
        if not keep.any():
            raise SceneError(f"{self.name}: the mesh has no face with an area; check the file")
        if not keep.all():
            corners, faces, material, label = (a[keep] for a in (corners, faces, material, label))
        put(self, "corners", corners)
        put(self, "vertices", vertices)
        put(self, "faces", faces.astype(np.int64, copy=False))
        put(self, "face_material", material.astype(np.int64, copy=False))
        put(self, "face_label", label.astype(np.int64, copy=False))
        put(self, "labels", tuple(self.labels))
        for array in (self.vertices, self.faces, self.face_material, self.face_label):
            array.setflags(write=False)

    def __repr__(self) -> str:
        size = " × ".join(f"{x:.1f}" for x in self.bounds[1] - self.bounds[0])
        used = len(np.unique(self.face_material))
        return (
            f"Scene('{self.name}'): {len(self.faces):,} triangles, {size} m, {used} materials, "
            f"{len(self.labels)} labels, {len(self.notes)} notes"
        )

    def __getstate__(self) -> dict[str, Any]:
        """What is given; rays and their geometry are of one process, and made anew in another."""
        return {k: v for k, v in vars(self).items() if k not in ("rays", "plain_geometry", "geometry")}

    def _repr_html_(self) -> str:
        low, high = self.bounds[:, 2]
        return html(
            repr(self), svg([Lines(section(self.corners, min(low + 1.5, 0.5 * (low + high))), BLACK)])
        )

    @classmethod
    def from_arrays(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        absorption: float | str | Sequence[float | str] | np.ndarray = 0.1,
        scattering: ArrayLike = 0.5,
        transmission: ArrayLike = 0.0,
        *,
        materials: MaterialTable | str | Path | None = None,
        name: str = "scene",
    ) -> Scene:
        """A scene of `vertices` (V, 3) m, Z up, and `faces` (F, 3).

        `absorption`: a number in [0, 1], the same in all bands, or a material's name; for all faces, or (F,) one
        for each. `scattering` and `transmission`: numbers or (F,), of faces whose absorption is a number.
        `materials`: a table or TOML file, put on top of the built-in database that names refer to. Raises
        `SceneError` and `MaterialError`.
        """
        made = faces_of_arrays(
            vertices, faces, absorption, scattering, transmission, materials=materials, name=name
        )
        return cls(*made, name=name)

    @classmethod
    def from_trimesh(
        cls,
        mesh: Any,
        materials: MaterialTable | str | Path | Sequence[str] | None = None,
        labels: Mapping[str, str] | str | Path | None = None,
        *,
        absorption: float | str | Sequence[float | str] | np.ndarray | None = None,
        scattering: ArrayLike = 0.5,
        transmission: ArrayLike = 0.0,
        name: str = "mesh",
    ) -> Scene:
        """A scene of a `trimesh.Trimesh`, or of all meshes of a `trimesh.Scene` in place. Metres, Z up.

        Names of the meshes' materials (in a scene, else of its nodes) are labels, and `labels` says which
        material each gets, as in `load_scene`. `materials`: a table or TOML file on top of the built-in database;
        or a material's name for all faces, or one name per face. `absorption`, `scattering`, `transmission`:
        as in `from_arrays`, instead of labels. Raises `SceneError` and `MaterialError`.
        """
        values: dict[str, Any] = {"scattering": scattering, "transmission": transmission, "name": name}
        made = faces_of_trimesh(mesh, materials, labels, absorption=absorption, **values)
        return cls(*made, name=name)

    def _check(
        self, vertices: np.ndarray, faces: np.ndarray, material: np.ndarray, label: np.ndarray
    ) -> None:
        if faces.size == 0:
            raise SceneError(f"{self.name}: the mesh has no faces (a point cloud?); need triangles")
        check_mesh(vertices, faces, self.name)
        used = vertices[used_rows(faces, len(vertices))]
        if not np.isfinite(used).all():
            bad = int((~np.isfinite(vertices[faces])).any(axis=(1, 2)).sum())
            raise SceneError(f"{self.name}: {bad} faces have coordinates that are not finite")
        if np.abs(used).max() > _FARTHEST or np.ptp(used, axis=0).max() > _WIDEST:
            raise SceneError(
                f"{self.name}: coordinates reach {np.abs(used).max():.3g} m and span "
                f"{np.ptp(used, axis=0).max():.3g} m, where {_WIDEST:,.0f} m is the most that is "
                "simulated; check the unit, and for vertices that are astray"
            )
        if material.shape != (len(faces),) or material.dtype.kind not in "iu":
            raise SceneError(
                f"{self.name}: face_material needs {len(faces)} integers, got {material.shape} "
                f"{material.dtype}"
            )
        if material.min() < 0 or material.max() >= len(self.materials.names):
            raise SceneError(
                f"{self.name}: face_material reaches {material.min()}..{material.max()}, but the "
                f"table has {len(self.materials.names)} materials"
            )
        if (
            label.ndim != 1
            or len(label) not in (0, len(faces))
            or (len(label) and (label.min() < -1 or label.max() >= len(self.labels)))
        ):
            raise SceneError(f"{self.name}: face_label does not fit the faces and labels")

    @cached_property
    def corners(self) -> np.ndarray:
        """(F, 3, 3) coordinates of each face's corners, m."""
        return corners_of(self.vertices, self.faces)

    @cached_property
    def areas(self) -> np.ndarray:
        """(F,) m²."""
        return np.asarray(0.5 * np.linalg.norm(cross_products(self.corners), axis=1))

    @cached_property
    def normals(self) -> np.ndarray:
        """(F, 3) unit normals, orientation as in the file."""
        normals = cross_products(self.corners)
        normals /= (2.0 * self.areas)[:, None]
        return normals

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) lowest and highest corner of the faces, m."""
        used = self.vertices[used_rows(self.faces, len(self.vertices))]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @cached_property
    def center(self) -> np.ndarray:
        """(3,) middle of the bounds; kernels work relative to it, to keep float32 precise."""
        return np.asarray(self.bounds.mean(axis=0))

    @cached_property
    def diagonal(self) -> float:
        """Of the bounds, m."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @cached_property
    def rays(self) -> Any:
        """The mesh for whoever casts rays, relative to `center`."""
        return RayScene(self.vertices - self.center, self.faces)

    @cached_property
    def geometry(self) -> Geometry:
        """The triangles as kernels see them, relative to `center`; no plane mirrors early sound."""
        covers = covers_of(self.corners, self.center, self.normals, self.overlaps)
        return self.plain_geometry._replace(covers=covers)

    @cached_property
    def plain_geometry(self) -> Geometry:
        """`geometry`, where of faces in one place any may count: for who asks where something is, and not of which
        material. Overlaps take as long to find as all else of it."""
        return Geometry(
            self.rays.handle,
            self.rays.tied(np.ascontiguousarray(self.corners[:, 0] - self.center)),
            np.ascontiguousarray(self.normals),
            np.column_stack([self.face_material, self.face_material]),
            np.zeros(len(self.faces), np.int8),
            np.full(len(self.faces), -1),
            self._offset,
            Covers(
                np.zeros(len(self.faces) + 1, np.int64),
                np.empty(0, np.int64),
                np.empty((0, 3, 3)),
                np.empty((0, 3)),
            ),
        )

    @property
    def _offset(self) -> float:
        """Of ray origins from the surface that they leave, m."""
        return max(1e-5, 5e-6 * self.diagonal)

    @cached_property
    def overlaps(self) -> Overlaps:
        """Faces that lie on others in one plane; those count (`rays.overlaps`)."""

        def find() -> Overlaps:
            return find_overlaps(*self._for_overlaps)

        if not is_large(self.faces):
            return find()
        key = scene_key(self), self.materials.names
        return cached_on_disk(Overlaps, key, find, lambda found: are_pairs(found, len(self.faces)))

    @property
    def _for_overlaps(self) -> tuple[Any, ...]:
        about = self.corners, self.center, self.normals, self._offset
        return *about, self.face_material, self.materials

    @property
    def overlap_notes(self) -> tuple[str, ...]:
        """One sentence for each two materials of which faces lie in one place."""
        if (self.face_material == self.face_material[0]).all():
            return ()
        return overlap_notes(self.overlaps, self.face_material, self.materials)

    def close_notes(self) -> tuple[str, ...]:
        """The same of two materials of which faces lie a millimetre apart or less. It is searched for anew."""
        return close_notes(find_close(*self._for_overlaps), self.face_material, self.materials)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of geometry and materials: what decides the sound (`MaterialTable.content`)."""
        sha = hashlib.sha256()
        for array in (self.corners, self.face_material):
            sha.update(np.ascontiguousarray(array, "<f8").data)
        sha.update(self.materials.content())
        return sha.hexdigest()
