"""`make validate`: docs/validation.md, its tables made anew.

    .venv/bin/python -m benchmarks.validate [walks] [wedges] [studio] [pairs] [experiments] [rooms] [sizes] [laws]
        [soundspaces_sim] [rlr_audio_propagation] [pyroomacoustics] [acoustic_spaces]

Names of parts: these alone. The page is written when a part is done, so that what is broken off goes on with
those that are left. A part whose data or programs are absent is skipped, with a line that says so, and the page
keeps its table. Between a pair of marks in the page stands what a function here computes; all else is text and
stays.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy import other_programs, ptb_experiments, ptb_studio, public_rooms
from benchmarks.tools import reflection_laws
from tests.transport import exact_wedge, test_diffraction

_WALKS = 4000  # subpaths per point
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


def studio(walks: int = _WALKS) -> str:
    """PTB's studio: by measure, and by band of the final settings."""
    names = {"T30": "T30", "EDT": "EDT", "C": "C80", "D": "D50"}
    rows: list[tuple[object, ...]] = []
    by_band: list[tuple[object, ...]] = []
    random: dict[str, Any] = {"reflection": "random"}
    bare = random | {"diffraction": False, "scattering": "table"}
    for label, settings in (
        ("neither", {**bare, "porous_layers": False}),
        ("porous layers", bare),
        ("porous layers and diffraction", random | {"scattering": "table"}),
        ("porous layers, diffraction, scattering by size", random),
        ("reflection by angle, scattering of the table", {"scattering": "table"}),
        ("reflection by angle, scattering by size (default)", {}),
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
            f"Mean absolute errors in JND, pair by pair, 6 pairs × 6 octaves, {walks:,} subpaths per point, "
            "one seed:",
            _table(("", *names.values()), rows),
            "By octave, with the default settings:",
            _table(("", *(f"{f:g} Hz" for f in octaves)), by_band),
        ]
    )


NAMES = {"T20": "T20", "T30": "T30", "EDT": "EDT", "C": "C80", "D": "D50"}
TITLES = {"bras_cr2": "seminar room (BRAS CR2)", "elmia": "Elmia hall"}


def experiments(walks: int = _WALKS, draws: int = 6) -> str:
    """What the studio's errors are due to; with an eighth of the subpaths, as noise is not what they look for."""
    few = max(walks // 8, 16)
    found, floor = ptb_experiments.runs(few, draws), ptb_experiments.floor(few)
    rows: list[tuple[object, ...]] = []
    for name, title in (("seeds", "other seeds"), ("absorption", "absorption ± 20 %")):
        values = found[name].values()
        rows.append((f"{title}: mean of {draws}", *(float(x.mean()) for x in values)))
        rows.append(("— standard deviation", *(float(x.std(ddof=1)) for x in values)))
        rows.append(("— least", *(float(x.min()) for x in values)))
    rows.append(
        ("floor: single responses of our own echograms", *(float(x.mean()) for x in floor.values()))
    )
    octaves = ptb_studio.load_studio("open")[1]["frequency_hz"]
    by_band = [(NAMES[p], *(float(v) for v in x)) for p, x in floor.items()]
    return "\n\n".join(
        [
            f"The studio's figure in JND, {few:,} subpaths per point:",
            _table(("", *(NAMES[p] for p in floor)), rows),
            "The floor by octave:",
            _table(("", *(f"{f:g} Hz" for f in octaves)), by_band),
        ]
    )


Errors = dict[str, np.ndarray]  # (…, octaves) in JND per parameter
SEEDS = 3
KINDS = ("pair by pair", "of the mean over pairs")


def _both(values: Errors, wanted: Errors) -> tuple[Errors, Errors]:
    """Errors pair by pair, and of the mean over pairs."""
    return ptb_studio.pair_by_pair(values, wanted), ptb_studio.of_means(values, wanted)


def _spread(values: list[float]) -> str:
    """Mean and standard deviation over seeds."""
    return f"{np.mean(values):.2f} ± {np.std(values, ddof=1):.2f}"


def rooms(walks: int = _WALKS) -> str:
    """The other public rooms: ours over seeds, and what the round robin's programs computed."""
    blocks = []
    for name in public_rooms.available():
        room = public_rooms.load(name)
        found = [_both(public_rooms.computed(room, walks, s), room.measured) for s in range(SEEDS)]
        head = ("", *(f"{f:g} Hz" for f in public_rooms.OCTAVES), "mean")
        rows: list[tuple[object, ...]] = []
        for p in found[0][0]:
            for k, kind in enumerate(KINDS):
                by_octave = np.mean([np.nanmean(off[k][p], axis=0) for off in found], axis=0)
                rows.append(
                    (
                        f"{NAMES[p]}, {kind}", *(float(x) for x in by_octave),
                        _spread([float(np.nanmean(off[k][p])) for off in found]),
                    )
                )  # fmt: skip
            entries = [public_rooms.differences(room, o) for o in room.others]
            others = np.array([np.nanmean(e[p], axis=0) for e in entries if p in e])
            if len(others):
                by_entry = others.mean(axis=1)
                best = others[by_entry.argmin()]
                middle = (*(float(x) for x in np.median(others, axis=0)), float(np.median(by_entry)))
                rows.append((f"— median of {len(others)} entries", *middle))
                rows.append(("— best of them", *(float(x) for x in best), float(by_entry.min())))
        blocks.append(
            f"**{TITLES[name]}**, {walks:,} subpaths per point, errors in JND, mean over {SEEDS} seeds (and their "
            f"standard deviation):\n\n{_table(head, rows)}"
        )
    return "\n\n".join(blocks)


COLUMNS = ("T30 (T20)", "EDT", "C80", "D50")


def _columns(off: dict[str, float]) -> list[float]:
    """Errors of a room for `COLUMNS`."""
    return [off[p] for p in ("T30" if "T30" in off else "T20", "EDT", "C", "D")]


def sizes(walks: int = _WALKS) -> str:
    """Every room with scattering as the table has it, and by size: mean and spread over seeds."""
    return _over_seeds(
        walks, (("scattering of the table, ", {"scattering": "table"}), ("scattering by size, ", {}))
    )


def laws(walks: int = _WALKS) -> str:
    """Every room by which materials absorb by angle: none, the porous ones, all."""
    return _over_seeds(
        walks,
        (
            ("at random incidence, ", {"reflection": "random"}),
            (
                "porous ones by angle, ",
                {"change": reflection_laws.with_local_reaction, "reflection": "random"},
            ),
            ("by angle (default), ", {}),
        ),
    )


def pairs(walks: int = _WALKS) -> str:
    """Default settings, pair by pair and of the mean over pairs, in the rooms that are there."""
    rooms_there = [TITLES[name] for name in public_rooms.available()]
    absent = [title for title in TITLES.values() if title not in rooms_there]
    left_out = "".join(
        f"\n\n*{title}: not made anew here, as its data were absent.*" for title in absent
    )
    return _over_seeds(walks, (("", {}),)) + left_out


def _over_seeds(walks: int, cases: tuple[tuple[str, dict[str, Any]], ...]) -> str:
    """The rooms that are there, with settings: pair by pair and of the mean over pairs, spread over seeds."""
    few = max(walks // 4, 16)
    rows: list[tuple[object, ...]] = []
    for name, off in _figures(few).items():
        for label, settings in cases:
            found = [off(seed, settings) for seed in range(SEEDS)]
            for k, kind in enumerate(KINDS):
                columns = zip(*(_columns(one[k]) for one in found), strict=True)
                rows.append((f"{name}, {label}{kind}", *(_spread(list(c)) for c in columns)))
    title = f"Errors in JND, {few:,} subpaths per point, mean and standard deviation over {SEEDS} seeds:"
    return f"{title}\n\n{_table(('', *COLUMNS), rows)}"


Figure = Callable[[int, dict[str, Any]], tuple[dict[str, float], ...]]


def _change(settings: dict[str, Any]) -> tuple[Callable[[ss.Scene], ss.Scene], dict[str, Any]]:
    """What a case makes of a scene, and its settings of the engine."""
    rest = {name: value for name, value in settings.items() if name != "change"}
    return settings.get("change", lambda scene: scene), rest


def _figures(walks: int) -> dict[str, Figure]:
    """Mean errors in JND per parameter, of each of `KINDS`, for a seed and settings, by room."""

    def in_studio(seed: int, settings: dict[str, Any]) -> tuple[dict[str, float], ...]:
        change, settings = _change(settings)
        found = []
        for state in ptb_experiments.STATES:
            scene = change(ptb_studio.load_studio(state)[0])
            values = ptb_studio.computed(scene, walks, seed, **settings)
            found.append(_both(values, ptb_studio.measured_pairs(state)))
        return tuple(
            {p: float(np.mean([np.nanmean(one[k][p]) for one in found])) for p in found[0][k]}
            for k in range(2)
        )

    def in_room(room: public_rooms.Room) -> Figure:
        def errors(seed: int, settings: dict[str, Any]) -> tuple[dict[str, float], ...]:
            change, settings = _change(settings)
            changed = replace(room, scene=change(room.scene))
            found = _both(public_rooms.computed(changed, walks, seed, **settings), room.measured)
            return tuple({p: float(np.nanmean(v)) for p, v in off.items()} for off in found)

        return errors

    return {
        "PTB studio": in_studio,
        **{TITLES[n]: in_room(public_rooms.load(n)) for n in public_rooms.available()},
    }


def others(program: str) -> str:
    """Another program in the same rooms; dashes, and why, where it came to no end."""
    rows: list[tuple[object, ...]] = []
    for room in other_programs.rooms():
        off = other_programs.errors_within(program, room)
        title = TITLES.get(room, f"studio, curtains {room}")
        if isinstance(off, str):
            rows.append((f"{title}: {off}", *5 * ("–",)))
        else:
            rows.append((title, *_columns(off), f"{off[other_programs.SECONDS]:.0f}"))
    return _table((program, *COLUMNS, "processor, s"), rows)


def _rooms_there() -> bool:
    return len(public_rooms.available()) == 2 and ptb_studio.FOLDER.is_dir()


_NO_ROOMS = f"{public_rooms.ROOMS} has not both rooms, or {ptb_studio.FOLDER} is absent"
PARTS: dict[str, tuple[Callable[[int], str], Callable[[], bool], str]] = {
    "wedges": (lambda _: wedges(), lambda: True, ""),
    "studio": (studio, ptb_studio.FOLDER.is_dir, f"{ptb_studio.FOLDER} is absent"),
    "pairs": (pairs, ptb_studio.FOLDER.is_dir, f"{ptb_studio.FOLDER} is absent"),
    "experiments": (experiments, ptb_studio.FOLDER.is_dir, f"{ptb_studio.FOLDER} is absent"),
    "rooms": (rooms, lambda: len(public_rooms.available()) == 2, f"{public_rooms.ROOMS} has not both rooms"),
    "sizes": (sizes, _rooms_there, _NO_ROOMS),
    "laws": (laws, _rooms_there, _NO_ROOMS),
    **{
        program: (
            lambda _, program=program: others(program),
            lambda program=program: program in other_programs.installed() and _rooms_there(),
            f"{program} is not installed, or: {_NO_ROOMS}",
        )
        for program in other_programs.PROGRAMS
    },
}  # fmt: skip


def main(walks: int = _WALKS, *wanted: str) -> None:
    text = PAGE.read_text("utf-8")
    for name, (make, there, why) in PARTS.items():
        if wanted and name not in wanted:
            continue
        if not there():
            print(f"{name}: {why}; its tables stay as they are")
            continue
        marks = f"<!-- {name} -->", f"<!-- end of {name} -->"
        pattern = re.compile(re.escape(marks[0]) + ".*?" + re.escape(marks[1]), re.DOTALL)
        if len(pattern.findall(text)) != 1:
            raise SystemExit(f"{PAGE}: expected one pair of marks {marks[0]} … {marks[1]}")
        table = make(walks)
        text = pattern.sub(lambda _, m=marks, t=table: f"{m[0]}\n{t}\n{m[1]}", text)
        PAGE.write_text(text, "utf-8")
        print(f"Wrote {name} to {PAGE}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else _WALKS, *sys.argv[2:])
