"""Scenes `apartment-0`, `apartment-1`, …: flats as `flat-<n>` has them, but each with acoustics of its own.

Rooms are 2.5 to 4 m high, and finishes range from soft (carpet, mineral wool, curtains, beds that are made) to bare
(tiles, concrete, wooden frames), so that reverberation times of a few dozen of them span .3 to 1.9 s. How bare an
apartment is follows the golden section of its number: any run of numbers covers the range evenly.
"""

from __future__ import annotations

import numpy as np

from soundspaces_agents.flats.boxes import flat_boxes
from soundspaces_sim.parts import Box, LabelledMesh, boxes_mesh

_STREAM = 0xA9A7  # plans of their own
_FINISHING = 0xF121  # keeps finishes apart from plans
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
_SPREAD = 0.08  # by which a finish strays from how bare the apartment is
_HEIGHTS = (2.5, 4.0)  # m

#: Materials of materials/materials.toml by thing, from what absorbs most at 1 kHz to what absorbs least; "": the
#: thing is not there.
FINISHES: dict[str, tuple[str, ...]] = {
    "ceiling": (
        "mineral-wool-ceiling", "perforated-gypsum-ceiling", "acoustic-tile", "acoustic-plaster", "wood-lining",
        "plasterboard-ceiling", "plaster", "concrete",
    ),
    "floor": (
        "carpet-on-foam", "carpet-tufted", "carpet-thin", "needle-felt", "wood-floor", "parquet", "linoleum",
        "ceramic-tile",
    ),
    "wall": (
        "wood-lining", "wood-panel", "wood-panel", "plasterboard-double", "plasterboard-double", "gypsum-board",
        "plaster", "brick-painted",
    ),
    "sofa": ("upholstery-heavy", "upholstery", "upholstery-leather", "chair-wooden"),
    "bed": ("upholstery-heavy", "upholstery", "upholstery", "chair-wooden"),
    "curtain": ("curtain-light", "curtain-cotton", "curtain-velvet", "blinds-vertical", ""),
    "rug": ("carpet-on-foam", "carpet-heavy", "carpet-thin", "", ""),
    "mat": ("carpet-heavy", "carpet-thin", "carpet-thin", "", ""),
    "pillow": ("curtain", "curtain", "curtain", "curtain", ""),
    "blanket": ("curtain", "curtain", "curtain", "curtain", ""),
    "window": ("window-double", "window-double", "window-single"),
}  # fmt: skip


def bareness(seed: int) -> float:
    """From 0, soft, to 1, bare."""
    return (seed * _GOLDEN) % 1.0


def apartment_mesh(seed: int) -> LabelledMesh:
    """Apartment number `seed` as a labelled mesh; the same number gives the same mesh. Raises `SceneError`."""
    rng = np.random.default_rng((_FINISHING, abs(seed)))
    height = round(float(rng.uniform(*_HEIGHTS)), 2)
    boxes = flat_boxes(seed, height, _STREAM, "apartment")
    labels = {}
    for thing, materials in FINISHES.items():
        at = bareness(seed) + _SPREAD * float(rng.standard_normal())
        material = materials[int(np.clip(at * len(materials), 0, len(materials) - 1))]
        labels[thing] = f"{thing}-{material}" if material else ""
    return boxes_mesh(_finished(boxes, labels), f"apartment-{seed}")


def _finished(boxes: list[Box], labels: dict[str, str]) -> list[Box]:
    named = [(labels.get(label, label), *corners) for label, *corners in boxes]
    return [box for box in named if box[0]]  # type: ignore[misc]
