"""Where furniture stands in one room: at walls or in the middle, never in a door's way, never cutting the floor.

After every piece one still walks from every door to every other (`walkway`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from soundspaces_buildings.data import OPEN_HEAD, STEP, Piece, furniture, programmes
from soundspaces_buildings.shell import Room
from soundspaces_buildings.solids import Solid, moved, prism
from soundspaces_buildings.walkway import Walkway, inside

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
        self.holes: list[np.ndarray] = []  # where not even a rug lies
        self.walkway = Walkway(room.inner, ways)

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
            return not any(overlap(outline, other, _GAP) for other in (*self.rugs, *self.holes))
        blocked = [*self.hangs, *self.stands] if piece.high else [*self.stands, *self.keep, *self.hangs]
        if any(overlap(outline, other, _GAP) for other in blocked):
            return False
        return not (piece.tall and any(overlap(outline, w) for w in self.windows))

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
        in_the_way = [s.outline for s in solids if self._in_the_way(s)]
        if stands and not self.walkway.is_open_with(in_the_way):
            return False
        self.solids += solids
        self.walkway.narrow(in_the_way)
        self.keep += front
        (self.stands if stands else self.rugs if piece.under else self.hangs).append(outline)
        return True

    def block(self, solids: Sequence[Solid]) -> None:
        """Add solids that are there already, such as columns; no check."""
        self.solids += solids
        self.keep_off([s.outline for s in solids if self._in_the_way(s) and len(s.outline) < 20])

    def keep_off(self, outlines: Sequence[np.ndarray]) -> None:
        """Let nothing stand, and nobody walk, in polygons."""
        self.stands += outlines
        self.walkway.narrow(outlines)

    def hang(self, solids: Sequence[Solid]) -> None:
        """Let nobody walk through solids of others, such as curtains, in which low pieces may stand."""
        self.walkway.narrow([s.outline for s in solids if self._in_the_way(s)])

    def _in_the_way(self, solid: Solid) -> bool:
        floor = self.room.floor
        return bool(solid.high.max() > floor + STEP and solid.low.min() < floor + OPEN_HEAD)

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
