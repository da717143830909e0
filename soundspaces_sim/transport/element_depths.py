"""How deep the elements behind the faces of a scene are, and which faces are single sheets."""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.vec3 import negate, row
from soundspaces_sim.scene.rays.box_tree import in_place_order
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.bsdf import TRANSMISSION
from soundspaces_sim.transport.bsdf.surface import Surfaces
from soundspaces_sim.transport.elements import WHOLE, way_through
from soundspaces_sim.transport.scene_surfaces import element_sides, scene_surfaces

_PER_AREA = 4.0  # places per m² …
_FEWEST, _MOST = 4, 64  # … of a face
_TURN, _SKIP = 0.7548776662466927, 0.5698402909980532  # of the plastic number: places spread evenly


@kernel
def _find_depths(
    first: int,
    last: int,
    scene: tuple[Geometry, Surfaces],
    corners: np.ndarray,
    area: np.ndarray,
    order: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill `out` (F, 2), in this order: greatest depth behind each of the (F, 3, 3) faces, m, and the share
    that is a sheet."""
    geometry, surfaces = scene
    for place in range(first, last):
        i = order[place]
        out[i, 0], out[i, 1] = 0.0, 1.0
        if geometry.outward[i] == 0:
            continue
        normal = row(geometry.normal, i)
        inwards = negate(normal) if geometry.outward[i] > 0 else normal
        places = min(max(int(math.ceil(_PER_AREA * area[i])), _FEWEST), _MOST)
        deepest, sheets = 0.0, 0
        for k in range(places):
            root = math.sqrt((0.5 + k * _TURN) % 1.0)
            v = (0.5 + k * _SKIP) % 1.0
            s, t = root * (1.0 - v), root * v
            a, b, c = row(corners[i], 0), row(corners[i], 1), row(corners[i], 2)
            r = 1.0 - s - t
            start = (
                r * a[0] + s * b[0] + t * c[0],
                r * a[1] + s * b[1] + t * c[1],
                r * a[2] + s * b[2] + t * c[2],
            )
            none = surfaces.energy[0, 0, :0]
            way = way_through(geometry, surfaces, i, start, inwards, math.inf, True, none)
            if way.triangle < 0:
                sheets += 1
            else:
                deepest = max(deepest, way.distance)
        out[i, 0], out[i, 1] = deepest, sheets / places


def element_depths(
    geometry: Geometry, surfaces: Surfaces, corners: np.ndarray, area: np.ndarray
) -> np.ndarray:
    """(F, 2) greatest depth that is found behind each of (F, 3, 3) faces, m, and the share of it that is a sheet.
    `corners` relative to the scene's centre, `area` (F,) m²."""
    out = np.empty((len(corners), 2))
    # Rays that begin near each other find what they meet in a cache.
    order = in_place_order(corners)
    corners = np.ascontiguousarray(corners)
    over_rows(_find_depths, len(corners), (geometry, surfaces), corners, area, order, out)
    return out


def air_on_sides(
    geometry: Geometry, surfaces: Surfaces, corners: np.ndarray, area: np.ndarray, thin: np.ndarray
) -> np.ndarray:
    """(F, 2) whether there may be sound in front of and behind the stored normals: not within elements that nothing
    is missing of, and `thin` (F,) bodies that are closed."""
    air = np.ones((len(corners), 2), bool)
    if geometry.outward.any():
        deepest, sheet = element_depths(geometry, surfaces, corners, area).T
        passes = np.asarray(surfaces.energy[geometry.material[:, 0], TRANSMISSION].max(axis=1) > 0.0)
        within = ((deepest <= WHOLE) & (sheet == 0.0)) | (thin & passes)
        air[within & (geometry.outward > 0), 1] = False
        air[within & (geometry.outward < 0), 0] = False
    return air


class ElementAreas(NamedTuple):
    """What faces that let sound pass were taken for, m² of one side."""

    whole: float  # of elements that are passed once
    deep: float  # of those deeper than `elements.WHOLE`: the deeper, the more they are two sheets
    sheets: float  # of single ones
    turned: int  # faces that count the other way round than they are wound


def element_areas(scene: Scene) -> ElementAreas:
    """How a scene's faces let sound pass."""
    config = SimulationConfig(scattering="table")
    surfaces, material = scene_surfaces(scene, config, np.empty((len(scene.faces), 0)))
    geometry = scene.geometry._replace(material=material, outward=element_sides(scene).outward)
    deepest, sheet = element_depths(geometry, surfaces, scene.corners - scene.center, scene.areas).T
    passes = scene.materials.transmission.max(axis=1)[scene.face_material] > 0.0
    area = np.where(passes, scene.areas, 0.0)
    in_elements, whole = area * (1.0 - sheet), deepest <= WHOLE
    return ElementAreas(
        float(in_elements[whole].sum()),
        float(in_elements[~whole].sum()),
        float((area * sheet).sum()),
        int((passes & (geometry.outward < 0)).sum()),
    )
