"""Plans of storeys: rooms on both sides of a corridor, widths from the areas that a programme draws.

Conventions: before a home is turned, x runs along the corridor, which lies at y = `south` to `south + hall`.
Outlines are cells, in the middle of walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from soundspaces_sim.scene.generate.buildings.data import draw_area, programmes
from soundspaces_sim.scene.generate.buildings.shell import HALF

_SLACK = 1.45  # how far an area may lie beyond its programme's bounds


@dataclass(frozen=True)
class Cell:
    """A room of a plan: `strip` is south, north, hall or end (over the full depth); x0 to x1 along the corridor.
    `hook`: an L that takes the end of the corridor from there on, m; 0 is none."""

    kind: str
    strip: str
    x0: float
    x1: float
    hook: float = 0.0


@dataclass(frozen=True)
class Plan:
    """The storey's cells; `width` along the corridor, m; depths of both strips and of the corridor."""

    cells: tuple[Cell, ...]
    width: float
    south: float
    hall: float
    north: float

    @property
    def depth(self) -> float:
        return self.south + self.hall + self.north

    def outline(self, cell: Cell) -> np.ndarray:
        """(n, 2) of a cell."""
        s, t = self.south, self.south + self.hall
        y0, y1 = {
            "south": (0.0, s),
            "north": (t, self.depth),
            "hall": (s, t),
            "end": (0.0, self.depth),
        }[cell.strip]
        points = [(cell.x0, y0), (cell.x1, y0), (cell.x1, y1), (cell.x0, y1)]
        if cell.hook:
            points = [
                (cell.x0, y0),
                (cell.x1, y0),
                (cell.x1, t),
                (cell.hook, t),
                (cell.hook, y1),
                (cell.x0, y1),
            ]
        return np.array(points)


def draw_kinds(rng: np.random.Generator, storeys: int) -> list[list[str]]:
    """Rooms of each storey, living room first: one to four bedrooms, a bathroom on every storey."""
    bedrooms = int(rng.choice([1, 2, 3, 4], p=[0.2, 0.35, 0.33, 0.12]))
    rest = [
        kind
        for kind, chance in (("study", 0.3), ("dining", 0.2), ("storage", 0.45))
        if rng.random() < chance
    ]
    if storeys == 1:
        return [["living", "kitchen", "bathroom", *["bedroom"] * bedrooms, *rest]]
    below = ["living", "kitchen", *rest, *(["bathroom"] if rng.random() < 0.5 else [])]
    return [below, ["bathroom", *["bedroom"] * max(bedrooms, 2)]]


def draw_plan(
    kinds: Sequence[str],
    rng: np.random.Generator,
    hall: float,
    fixed: tuple[float, float, float] | None = None,
    void: tuple[float, float] | None = None,
) -> Plan | None:
    """A plan for these rooms, or None if they do not fit. `fixed`: width and depths of the strips, of a storey
    above another; `void`: x0 and x1 of a part of the southern strip that stays empty."""
    areas = [draw_area(programmes()[kind], rng) for kind in kinds]
    # The depth of a strip makes a bedroom of 12 m² 2.7 to 4 m wide.
    south, north = (float(v) for v in rng.uniform(3.0, 4.5, 2)) if fixed is None else fixed[1:]
    order = rng.permutation(len(kinds))
    strips: dict[str, list[int]] = {"south": [], "north": []}
    used = {"south": void[1] - void[0] if void else 0.0, "north": 0.0}
    for k in sorted(order.tolist(), key=lambda k: -areas[k]):
        strip = min(used, key=lambda s: (used[s], s))
        strips[strip].append(k)
        used[strip] += areas[k] / (south if strip == "south" else north) + 2 * HALF
    width = max(used.values()) if fixed is None else fixed[0]
    cells = []
    for strip, rows in strips.items():
        start = void[1] if void and strip == "south" else 0.0
        if not rows:
            return None
        rows = [rows[i] for i in rng.permutation(len(rows))]
        deep = south if strip == "south" else north
        wanted = np.array([areas[k] / (deep - 2 * HALF) + 2 * HALF for k in rows])
        edges = start + (width - start) * np.concatenate([[0.0], np.cumsum(wanted) / wanted.sum()])
        for k, x0, x1 in zip(rows, edges[:-1], edges[1:], strict=True):
            if not _fits(kinds[k], x1 - x0 - 2 * HALF, deep - 2 * HALF):
                return None
            cells.append(Cell(kinds[k], strip, float(x0), float(x1)))
    return Plan((Cell("hall", "hall", 0.0, width), *cells), width, south, hall, north)


def _fits(kind: str, width: float, deep: float) -> bool:
    programme = programmes()[kind]
    low, _, high = programme.area
    return (
        min(width, deep) >= programme.narrow
        and low / _SLACK <= width * deep <= high * _SLACK
        and max(width, deep) <= 3.2 * min(width, deep)
    )


def with_variation(plan: Plan, rng: np.random.Generator) -> Plan:
    """Some plans change: the living room takes the end of the corridor as an L, or a new end of the house."""
    living = next((c for c in plan.cells if c.kind == "living"), None)
    draw = rng.random()
    if living is None or draw > 0.5:
        return plan
    cells = [c for c in plan.cells if c.kind not in ("hall", "living")]
    if draw < 0.25 and living.strip == "south" and abs(living.x1 - plan.width) < 1e-9:
        hook = max(living.x0 + 1.3, living.x1 - 3.2)
        # Doors of the northern rooms stay on what is left of the corridor.
        if all(c.x0 < hook - 1.5 for c in cells if c.strip == "north"):
            hall = Cell("hall", "hall", 0.0, hook)
            return Plan(
                (hall, *cells, Cell("living", "south", living.x0, living.x1, hook)),
                plan.width,
                plan.south,
                plan.hall,
                plan.north,
            )
    if draw >= 0.25 and any(c.strip == living.strip for c in cells):
        # The rest of its strip is stretched over the gap that it leaves; it becomes the house's end.
        rest = [c for c in cells if c.strip == living.strip]
        scale = plan.width / (plan.width - (living.x1 - living.x0))
        if scale > 1.5 or any(c.strip == "end" for c in cells):
            return plan
        moved_cells, x = [c for c in cells if c.strip != living.strip], 0.0
        for c in sorted(rest, key=lambda c: c.x0):
            moved_cells.append(Cell(c.kind, c.strip, x, x + scale * (c.x1 - c.x0)))
            x += scale * (c.x1 - c.x0)
        wide = max((living.x1 - living.x0) * plan.south / plan.depth, 3.0)
        end = Cell("living", "end", plan.width, plan.width + wide)
        hall = Cell("hall", "hall", 0.0, plan.width)
        return Plan((hall, *moved_cells, end), plan.width + wide, plan.south, plan.hall, plan.north)
    return plan
