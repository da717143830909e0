"""`make validate`: docs/validation.md, its tables made anew.

Between a pair of marks in the page stands what a function here computes; all else is text and stays.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import ptb_studio
from tests.transport import exact_wedge, test_diffraction

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation.md"
BANDS = ("up to 176 Hz", "to 775 Hz", "to 3.4 kHz", "to 20 kHz")


def _row(*cells: object) -> str:
    return "| " + " | ".join(f"{c:.2f}" if isinstance(c, float) else str(c) for c in cells) + " |"


def _table(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    return "\n".join([_row(*head), _row(*("---" for _ in head)), *(_row(*r) for r in rows)])


def wedges() -> str:
    """400 random wedges against the exact solution, and what a screen takes."""
    cases = test_diffraction.random_shadows(400)
    k = exact_wedge.band_wave_numbers(21)
    exact = np.array(
        [
            exact_wedge.band_energies(
                np.stack([exact_wedge.diffracted(n, rs, ts, rr, tr, zr - zs, row) for row in k])
            )
            for n, _, zs, rs, ts, zr, rr, tr in cases
        ]
    )
    off = np.abs(10.0 * np.log10(test_diffraction.ours(cases) / exact))
    rows: list[tuple[object, ...]] = [
        (f"wedges, {name} error, dB", *(float(x) for x in np.percentile(off, p, axis=0)))
        for name, p in (("median", 50), ("95th percentile of the", 95), ("largest", 100))
    ]
    for h, expected in test_diffraction.HALF_PLANE.items():
        rows.append((f"screen, 2 m + 2 m, {h} m deep: exact, dB", *expected))
        rows.append(("— ours", *(float(x) for x in test_diffraction.screen_loss(h))))
    return _table(("", *BANDS), rows)


def studio(walks: int = 4000) -> str:
    """PTB's studio: by measure, and by band of the final settings."""
    names = {"T30": "T30", "EDT": "EDT", "C": "C80", "D": "D50"}
    rows: list[tuple[object, ...]] = []
    by_band: list[tuple[object, ...]] = []
    bare: dict[str, Any] = {"diffraction": False, "scattering": "table"}
    for label, settings in (
        ("neither", {**bare, "sheets": False}),
        ("sheets", bare),
        ("sheets and edges", {"scattering": "table"}),
        ("sheets, edges, scattering by size (default)", {}),
        ("reflection by angle, scattering of the table", {"scattering": "table", "reflection": "angle"}),
        ("reflection by angle, scattering by size", {"reflection": "angle"}),
    ):
        found = [ptb_studio.differences(state, walks, **settings) for state in ("open", "closed")]
        for state, one in zip(("open", "closed"), found, strict=True):
            rows.append((f"{label}, curtains {state}", *(float(one[p].mean()) for p in names)))
            if not settings:
                by_band += [
                    (f"{names[p]}, curtains {state}", *(float(x) for x in one[p].mean(axis=0)))
                    for p in names
                ]
        rows.append(
            (f"**{label}, mean**", *(float(np.mean([one[p].mean() for one in found])) for p in names))
        )
    rows.append(("round robin, median of 17 programs", 2.0, 2.6, 1.07, 1.18))
    rows.append(("round robin, best of 17 in each", 1.44, 2.18, 0.96, 0.97))
    octaves = ptb_studio.load_studio("open")[1]["frequency_hz"]
    return "\n\n".join(
        [
            f"Mean absolute errors in JND, 6 pairs × 6 octaves, {walks:,} walks per point, one seed:",
            _table(("", *names.values()), rows),
            "By octave, with the default settings:",
            _table(("", *(f"{f:g} Hz" for f in octaves)), by_band),
        ]
    )


def main(walks: int = 4000) -> None:
    text = PAGE.read_text("utf-8")
    parts = {"wedges": wedges()}
    if ptb_studio.FOLDER.is_dir():
        parts["studio"] = studio(walks)
    else:
        print(f"{ptb_studio.FOLDER} is absent: the studio's table stays as it is")
    for name, table in parts.items():
        marks = f"<!-- {name} -->", f"<!-- end of {name} -->"
        pattern = re.compile(re.escape(marks[0]) + ".*?" + re.escape(marks[1]), re.DOTALL)
        if len(pattern.findall(text)) != 1:
            raise SystemExit(f"{PAGE}: expected one pair of marks {marks[0]} … {marks[1]}")
        text = pattern.sub(lambda _, m=marks, t=table: f"{m[0]}\n{t}\n{m[1]}", text)
    PAGE.write_text(text, "utf-8")
    print(f"Wrote {PAGE}")


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:]))
