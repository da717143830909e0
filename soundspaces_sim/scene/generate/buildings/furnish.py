"""Where furniture stands in one room: at walls or in the middle, never in a door's way, never cutting the floor.

After every piece, whoever is 0.4 m wide still gets from every door to every other, and no gap is left behind pieces
in which somebody could stand who cannot get there. A raster of 0.1 m decides, as the navigation graph does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import scipy

from soundspaces_sim.scene.generate.buildings.data import (
    OPEN_HEAD,
    STEP,
    Piece,
    furniture,
    programmes,
)
from soundspaces_sim.scene.generate.buildings.shell import Room
from soundspaces_sim.scene.generate.buildings.solids import Solid, cross, moved, prism

_CELL = 0.1  # m
_WIDE, _SLIM = 0.2, 0.13  # m: half the width of who gets through every room, and to every place
_NARROW, _BESIDE = 0.06, 0.15  # m: half the width of who must not get stuck, and how far from such a way
_TRIES = 40  # places at walls that are looked at for a piece
_GAP = 0.02  # m between pieces, and off walls
_OFF_WALL = 0.012  # m


def rectangle(at: np.ndarray, along: np.ndarray, size: Sequence[float]) -> np.ndarray:
    """(4, 2) corners of a rectangle from `at`, `size` m along the unit vector `along` and to its left."""
    left = np.array([-along[1], along[0]])
    return np.array(
        [at, at + size[0] * along, at + size[0] * along + size[1] * left, at + size[1] * left]
    )


def overlap(a: np.ndarray, b: np.ndarray, gap: float = 0.0) -> bool:
    """Whether two convex polygons come nearer than `gap` m (by separating axes, so at corners up to 1.4 times)."""
    for one, other in ((a, b), (b, a)):
        edge = np.roll(one, -1, axis=0) - one
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
        reach = (one[:, None] * normal[None]).sum(axis=2).max(axis=0)
        if ((other[:, None] * normal[None]).sum(axis=2).min(axis=0) >= reach + gap).any():
            return False
    return True


def inside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 2) lie in a simple polygon, by crossings."""
    a, b = outline, np.roll(outline, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    above = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return np.asarray((above & (x < at)).sum(axis=1) % 2 == 1)


class Floor:
    """The floor of a room: what stands on it, and whether one can still walk.

    `ways` (n, 2): places that must stay connected, before doors; `keep`: polygons there that stay free;
    `windows`: polygons in front of windows, where nothing tall stands.
    """

    def __init__(
        self,
        room: Room,
        ways: Sequence[np.ndarray],
        keep: Sequence[np.ndarray],
        windows: Sequence[np.ndarray] = (),
    ) -> None:
        self.room, self.ways, self.keep, self.windows = room, list(ways), list(keep), list(windows)
        self.inner = room.inner
        self.solids: list[Solid] = []
        self.stands: list[np.ndarray] = []  # outlines on the floor
        self.hangs: list[np.ndarray] = []
        self.rugs: list[np.ndarray] = []
        low, high = self.inner.min(axis=0) - _CELL, self.inner.max(axis=0) + _CELL
        self._low = low
        n = np.ceil((high - low) / _CELL).astype(int)
        x, y = np.meshgrid(*(low[i] + _CELL * (np.arange(n[i]) + 0.5) for i in (0, 1)), indexing="ij")
        self._centres = np.stack([x.ravel(), y.ravel()], axis=1)
        self._shape = x.shape
        self._free = inside(self._centres, self.inner).reshape(self._shape)

    @staticmethod
    def _front(piece: Piece, at: np.ndarray, along: np.ndarray, width: float) -> list[np.ndarray]:
        """The area before a piece that stays free, and behind one in the middle."""
        if not piece.front:
            return []
        left = np.array([-along[1], along[0]])
        back = 0.0 if not piece.middle else piece.front
        deep = piece.size[1] + piece.front + back
        return [rectangle(at - back * left, along, (width * piece.size[0], deep))]

    def fits(self, outline: np.ndarray, piece: Piece) -> bool:
        """Whether a piece's outline lies in the room and keeps off what is there."""
        edge = np.concatenate([np.linspace(outline[k - 1], outline[k], 12) for k in range(4)])
        if not inside(edge, self.inner).all() or inside(self.inner, outline).any():
            return False
        if piece.under:
            return not any(overlap(outline, other, _GAP) for other in self.rugs)
        blocked = [*self.hangs, *self.stands] if piece.high else [*self.stands, *self.keep, *self.hangs]
        if any(overlap(outline, other, _GAP) for other in blocked):
            return False
        return not (piece.tall and any(overlap(outline, w) for w in self.windows))

    def walkable_with(self, outlines: Iterable[np.ndarray]) -> bool:
        """Whether all ways stay connected, and no place becomes one that cannot be reached."""
        free = self._free.copy()
        for outline in outlines:
            free &= ~self._covered(outline)
        far = scipy.ndimage.distance_transform_edt(free) * _CELL - 0.5 * _CELL
        parts, count = scipy.ndimage.label(far > _WIDE, np.ones((3, 3)))
        if count == 0:
            return False
        main = int(np.bincount(parts.ravel())[1:].argmax()) + 1
        if any(self._near(parts, way) != main for way in self.ways):
            return False
        # Wherever somebody may stand is next to where everybody gets to who is not wide.
        slim = scipy.ndimage.label(far > _SLIM, np.ones((3, 3)))[0]
        reached = slim == slim[np.unravel_index(int((far * (parts == main)).argmax()), far.shape)]
        away = scipy.ndimage.distance_transform_edt(~reached) * _CELL
        return not bool((away[far > _NARROW] > _BESIDE).any())

    def _covered(self, outline: np.ndarray) -> np.ndarray:
        edge = np.roll(outline, -1, axis=0) - outline
        out = np.ones(len(self._centres), bool)
        for k in range(len(outline)):
            out &= cross(edge[k], self._centres - outline[k]) > -0.5 * _CELL * np.linalg.norm(edge[k])
        return out.reshape(self._shape)

    def _near(self, parts: np.ndarray, way: np.ndarray) -> int:
        """The part at a place, or at the nearest cell within 0.3 m that has one."""
        rows = np.argwhere(parts > 0)
        if len(rows) == 0:
            return 0
        distance = np.linalg.norm(self._low + _CELL * (rows + 0.5) - way, axis=1)
        k = int(distance.argmin())
        return int(parts[tuple(rows[k])]) if distance[k] < 0.3 else 0

    def put(self, piece: Piece, at: np.ndarray, along: np.ndarray, width: float) -> bool:
        """Put a piece with its back's left end at `at` if it fits; `width`: factor. Whether it did."""
        size = (width * piece.size[0], piece.size[1])
        outline = rectangle(at, along, size)
        front = self._front(piece, at, along, width)
        if not self.fits(outline, piece) or any(overlap(f, s) for f in front for s in self.stands):
            return False
        solids = [moved(s, at, along, self.room.floor) for s in piece.solids(width, self.room.finishes)]
        if max(float(self.room.height_at(s.outline).min() - s.high.max()) for s in solids) < 0.0 or any(
            float((self.room.height_at(s.outline) - s.high).min()) < 0.02 for s in solids
        ):
            return False
        stands = not (piece.under or piece.high)
        if stands and not self.walkable_with([*self.stands, outline]):
            return False
        self.solids += solids
        self.keep += front
        (self.stands if stands else self.rugs if piece.under else self.hangs).append(outline)
        return True

    def block(self, solids: Sequence[Solid]) -> None:
        """Add solids that are there already, such as columns; no check."""
        self.solids += solids
        floor = self.room.floor
        self.stands += [
            s.outline
            for s in solids
            if s.high.max() > floor + STEP and s.low.min() < floor + OPEN_HEAD and len(s.outline) < 20
        ]

    def place(self, name: str, rng: np.random.Generator) -> bool:
        """Find a place for a piece by name, at walls in corners first. Whether there was one."""
        piece = furniture()[name]
        width = float(rng.uniform(*piece.stretch))
        size = (width * piece.size[0], piece.size[1])
        spots = self._in_the_middle(size, rng) if piece.middle else self._at_walls(size, rng)
        return any(self.put(piece, at, along, width) for at, along in spots)

    def _edges(self) -> list[tuple[np.ndarray, np.ndarray, float]]:
        out = []
        for k in range(len(self.inner)):
            a, b = self.inner[k], self.inner[(k + 1) % len(self.inner)]
            length = float(np.linalg.norm(b - a))
            out.append((a, (b - a) / length, length))
        return out

    def _at_walls(
        self, size: tuple[float, float], rng: np.random.Generator
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        spots = []
        for a, along, length in self._edges():
            spare = length - size[0] - 2 * _OFF_WALL
            if spare < 0.0:
                continue
            left = np.array([-along[1], along[0]])
            beside = [u for u in self._beside(a, along, left, size[0]) if 0.0 <= u <= spare]
            chance = (spare * rng.random(3)).tolist()
            for k, u in enumerate([0.0, spare, *beside, *chance]):
                # Corners, and places beside other pieces, come first more often.
                rank = rng.random() * (0.5 if k < 2 + len(beside) else 1.0)
                spots.append((rank, a + along * (u + _OFF_WALL) + left * _OFF_WALL, along))
        spots.sort(key=lambda spot: spot[0])
        return [(at, along) for _, at, along in spots[:_TRIES]]

    def _beside(self, a: np.ndarray, along: np.ndarray, left: np.ndarray, width: float) -> list[float]:
        """Where a piece of this width would stand next to those that stand at a wall from `a` along `along`."""
        out = []
        for outline in self.stands:
            v = (outline - a) @ left
            if -0.05 < v.min() < 0.1:
                u = (outline - a) @ along
                out += [float(u.max()) + 0.025 - _OFF_WALL, float(u.min()) - width - 0.025 - _OFF_WALL]
        return out

    def _in_the_middle(
        self, size: tuple[float, float], rng: np.random.Generator
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        edges = self._edges()
        low, high = self.inner.min(axis=0), self.inner.max(axis=0)
        spots = []
        for _ in range(_TRIES // 2):
            _, along, _ = edges[int(rng.integers(len(edges)))]
            left = np.array([-along[1], along[0]])
            centre = low + (high - low) * np.clip(0.5 + 0.18 * rng.standard_normal(2), 0.1, 0.9)
            spots.append((centre - 0.5 * size[0] * along - 0.5 * size[1] * left, along))
        return spots


def furnish(floor: Floor, rng: np.random.Generator, density: float) -> bool:
    """Furnish a room by its programme; `density` 0 (bare) to 1 (crowded). Whether what it needs fits."""
    programme = programmes()[floor.room.kind]
    for group in programme.need if density > 0.0 else ():
        if not any(floor.place(name, rng) for name in group):
            return False
    for k, group in enumerate(programme.likes):
        # The first of the list stand in most rooms, the last in crowded ones.
        wanted = density > 0.0 and rng.random() < np.clip(
            1.6 * density + 0.5 - 0.8 * k / len(programme.likes), 0.0, 1.0
        )
        if wanted:
            for name in group:
                if floor.place(name, rng):
                    break
    for name in programme.walls if density > 0.0 else ():
        if rng.random() < 0.3 + 0.6 * density:
            floor.place(name, rng)
    return True


def column(at: np.ndarray, radius: float, low: float, high: float, label_: str) -> Solid:
    """A column of eight sides."""
    angle = np.pi * (np.arange(8) + 0.5) / 4
    return prism(label_, at + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), low, high)
