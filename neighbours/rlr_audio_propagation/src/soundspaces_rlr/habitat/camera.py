"""`CameraSensor`: depth, semantics and plain colours of a scene by a ray through the centre of each pixel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from soundspaces_rlr.arguments import length
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.magnum import Deg
from soundspaces_rlr.habitat.node import Node
from soundspaces_rlr.habitat.records import SensorSpec, SensorSubType, SensorType, from_habitat
from soundspaces_rlr.kernels import cast_pixels

_MOST_PIXELS = 2**26
_KINDS = (SensorType.COLOR, SensorType.DEPTH, SensorType.SEMANTIC)


@dataclass
class CameraSensorSpec(SensorSpec):
    """A camera to be. `resolution`: rows and columns; `hfov`: horizontal angle of view, degrees or Magnum's `Deg`
    or `Rad`; `position` (3,) m and `orientation`, angles about x, y and z in rad, in the agent's frame; `near` and
    `far`, m: what is nearer or farther is not seen. Fields beyond these concern habitat's renderer and do
    nothing."""

    uuid: str = "rgba_camera"
    sensor_type: SensorType = SensorType.COLOR
    sensor_subtype: SensorSubType = SensorSubType.PINHOLE
    resolution: Sequence[int] = (128, 128)
    position: Sequence[float] = field(default_factory=lambda: [0.0, 1.5, 0.0])
    orientation: Sequence[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    hfov: Any = 90.0
    near: float = 0.01
    far: float = 1000.0
    channels: int = 4
    ortho_scale: float = 0.1
    noise_model: str = "None"
    noise_model_kwargs: dict[str, Any] = field(default_factory=dict)
    gpu2gpu_transfer: bool = False

    def size(self) -> tuple[int, int]:
        """Rows and columns. Raises `RlrError` for a picture that cannot be drawn."""
        try:
            rows, columns = (int(n) for n in self.resolution)
        except (TypeError, ValueError):
            rows = columns = 0
        if not (rows >= 1 and columns >= 1 and rows * columns <= _MOST_PIXELS):
            raise RlrError(
                f"CameraSensorSpec '{self.uuid}': resolution: expected rows and columns, {_MOST_PIXELS} pixels at "
                f"most, got {self.resolution!r}"
            )
        return rows, columns

    def half_width(self) -> float:
        """Half the width of the view at a distance of 1. Raises `RlrError`."""
        degrees = float(Deg(self.hfov))
        if not 0.0 < degrees < 180.0:
            raise RlrError(
                f"CameraSensorSpec '{self.uuid}': hfov: expected degrees between 0 and 180, got {self.hfov!r}"
            )
        return math.tan(math.radians(0.5 * degrees))


class CameraSensor:
    """A pinhole camera. Depth (rows, columns) float32 m, along the axis of view, 0 where nothing is seen;
    semantics (rows, columns) uint32, rows of `sim.semantic_scene.objects`; colour (rows, columns, 4) uint8: the
    mesh's vertex colours, or where the file has none one colour a label, darker where a surface is seen from its
    side, and black where nothing is."""

    def __init__(self, spec: CameraSensorSpec) -> None:
        self._spec = spec
        self.node = Node()
        if spec.sensor_type not in _KINDS or spec.sensor_subtype is not SensorSubType.PINHOLE:
            raise RlrError(
                f"CameraSensorSpec '{spec.uuid}': expected COLOR, DEPTH or SEMANTIC and PINHOLE, got "
                f"{getattr(spec.sensor_type, 'name', spec.sensor_type)} and "
                f"{getattr(spec.sensor_subtype, 'name', spec.sensor_subtype)}; there is no renderer"
            )
        if spec.noise_model not in ("None", ""):
            raise RlrError(f"CameraSensorSpec '{spec.uuid}': noise_model: there are none here")
        spec.size(), spec.half_width()

    @property
    def uuid(self) -> str:
        """Its name."""
        return self._spec.uuid

    def specification(self) -> CameraSensorSpec:
        """What it was made of."""
        return self._spec

    def reset(self) -> None:
        """Nothing is kept."""

    def get_observation(self, sim: Any) -> np.ndarray:
        """What it sees of `sim` from where its node is."""
        distance, triangle, rays = self._cast(sim)
        if self._spec.sensor_type is SensorType.DEPTH:
            return distance.astype(np.float32)
        if self._spec.sensor_type is SensorType.SEMANTIC:
            ids = np.append(sim.semantic_scene.face_object, 0).astype(np.uint32)
            return np.asarray(ids[triangle])
        return _paint(sim, self.node, distance, triangle, rays)

    def _cast(self, sim: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth (rows, columns), triangle (rows, columns) or -1, rays (rows, columns, 3) of depth 1, scene axes."""
        rows, columns = self._spec.size()
        near, far = length(self._spec.near, "near"), length(self._spec.far, "far")
        half = self._spec.half_width()
        across = half * ((2.0 * np.arange(columns) + 1.0) / columns - 1.0)
        up = half * rows / columns * (1.0 - (2.0 * np.arange(rows) + 1.0) / rows)
        local = np.empty((rows, columns, 3))
        local[..., 0], local[..., 1], local[..., 2] = across, up[:, None], -1.0
        rays = from_habitat(local @ self.node.axes.T)
        origin = from_habitat(np.asarray(self.node.absolute_translation, float)) - sim.scene.center
        distance = np.empty((rows, columns))
        triangle = np.empty((rows, columns), np.int64)
        cast_pixels(sim.scene.geometry, origin, rays, near, far, distance, triangle)
        return distance, triangle, rays


def _paint(
    sim: Any, node: Node, distance: np.ndarray, triangle: np.ndarray, rays: np.ndarray
) -> np.ndarray:
    """(rows, columns, 4) uint8."""
    out = np.zeros((*triangle.shape, 4), np.uint8)
    out[..., 3] = 255
    seen = triangle >= 0
    face = triangle[seen]
    scene, ray = sim.scene, rays[seen]
    if sim.vertex_colors is not None:
        point = from_habitat(np.asarray(node.absolute_translation, float)) + distance[seen, None] * ray
        weights = _barycentric(scene.corners[face], point)
        mixed = (sim.vertex_colors[scene.faces[face]] * weights[..., None]).sum(axis=1)
        out[seen, :3] = np.round(np.clip(mixed, 0.0, 255.0)).astype(np.uint8)
        return out
    facing = np.abs((scene.normals[face] * ray).sum(axis=1)) / np.linalg.norm(ray, axis=1)
    out[seen, :3] = (_palette(sim)[face] * (0.4 + 0.6 * facing)[:, None]).astype(np.uint8)
    return out


def _palette(sim: Any) -> np.ndarray:
    """(F, 3) 0 to 255: a colour for each label, and where there is none for each material, hues apart by the golden
    section."""
    scene = sim.scene
    row = np.where(scene.face_label >= 0, scene.face_label, len(scene.labels) + scene.face_material)
    hue = 6.0 * np.mod(0.1 + row * 0.618033988749895, 1.0)
    wheel = np.clip(np.abs(np.mod(hue[:, None] + [0.0, 4.0, 2.0], 6.0) - 3.0) - 1.0, 0.0, 1.0)
    return np.asarray(255.0 * (0.45 + 0.5 * wheel))


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 3) weights of the corners (n, 3, 3) of triangles at points (n, 3) on them."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = points - corners[:, 0]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    pa, pb = (p * a).sum(axis=1), (p * b).sum(axis=1)
    det = aa * bb - ab * ab
    v, w = (bb * pa - ab * pb) / det, (aa * pb - ab * pa) / det
    return np.clip(np.column_stack([1.0 - v - w, v, w]), 0.0, 1.0)
