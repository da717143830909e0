"""`inspect`: what a scene is made of and how it will sound, before hours are spent on it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np

from soundspaces_sim.core.config import GridConfig, SimulationConfig
from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS, center_frequencies
from soundspaces_sim.core.numerics.rng import point_keys
from soundspaces_sim.core.simulation_config import (
    ConnectionsConfig,
    DiffractionConfig,
    MaterialsConfig,
    RadianceTransferConfig,
)
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.material_spread import measure_spread
from soundspaces_sim.echogram.measures import echograms_measures, reverberation_times, why_undefined
from soundspaces_sim.layout.grid import is_sparse, make_grid, pruning_text
from soundspaces_sim.layout.records import KEPT, Grid
from soundspaces_sim.scene.enclosure import closedness
from soundspaces_sim.scene.frame import DOUBT
from soundspaces_sim.scene.labels import DEFAULT, WITHOUT
from soundspaces_sim.scene.rays.diffuse_walk import diffuse_walks
from soundspaces_sim.scene.scene import Scene, check_scene
from soundspaces_sim.scene.storeys import Storeys, above_no_floor, find_storeys
from soundspaces_sim.scene.triangles import pieces_of, welded_faces
from soundspaces_sim.transport.arrivals.find_wedges import find_and_tell
from soundspaces_sim.transport.element_depths import ElementAreas, element_areas
from soundspaces_sim.transport.simulate import simulate

_SOURCES, _LISTENERS, WALKS = 3, 4, 4000
PAIRS = _SOURCES * _LISTENERS
_OF_T30 = SimulationConfig(
    walks=WALKS,
    radiance_transfer=RadianceTransferConfig(enabled=False),
    connections=ConnectionsConfig(subpaths=2),
    diffraction=DiffractionConfig(enabled=False),
    materials=MaterialsConfig(enabled=True),
)


def simulated_t30(
    scene: Scene, grid: Grid | None
) -> tuple[np.ndarray, np.ndarray, int, tuple[str, ...]]:
    """(B,) s, median over pairs of points spread over a grid, of a few thousand subpaths; its spread by absorption;
    their number; and why bands have none."""
    none = np.full(len(DEFAULT_BANDS) - 1, np.nan)
    if grid is None or len(grid) < 2:
        return none, none, 0, ()
    rows = np.unique(np.linspace(0, len(grid) - 1, _SOURCES + _LISTENERS).astype(int))
    sources, listeners = grid.points[rows[1::2]], grid.points[rows[::2]]
    echoes = simulate(scene, sources, listeners, _OF_T30)
    times = echograms_measures(echoes)["t30"].reshape(-1, len(none))
    why = tuple(
        f"T30 of {low:g} to {high:g} Hz is not defined: {why_undefined(echoes[0, 0], 't30', band)}"
        for band, (low, high) in enumerate(pairwise(DEFAULT_BANDS))
        if np.isnan(times[:, band]).all()
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bands without a single time are NaN
        return np.nanmedian(times, axis=0), np.nanmedian(_spreads(echoes), axis=0), len(times), why


def _spreads(echoes: Echograms) -> np.ndarray:
    """(pairs, B) s, of T30 by absorption, of one pair of each source; NaN if no material's reflections count."""
    none = np.full((1, len(DEFAULT_BANDS) - 1), np.nan)
    if echoes.counts is None or not echoes.counts.groups.names:
        return none
    pairs = [(s, s % echoes.shape[1]) for s in range(echoes.shape[0])]
    return np.array([measure_spread(echoes[pair], names=("t30",))[0] for pair in pairs])


_POINTS, _RAYS, _BOUNCES = 64, 500, 20
_MOST_CANDIDATES = 4000  # of the grid that is looked at: 1000 m² at 0.5 m
_VOLUME_SAMPLES = 4000
Progress = Callable[[str], None]  # told of each step
_IN_AIR = 0.1  # share of a storey's points above voids from which on the report says so
_NOWHERE = Storeys(np.empty(0), np.empty(0, bool), np.empty(0))
_SHORTEST, _LONGEST = 1e-6, 1e6  # m that sound travels
_QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)


@dataclass(frozen=True)
class SceneReport:
    """Areas in m², one side of each face; volumes in m³; bands are the simulation's.

    `escape`: share of reflections after which sound leaves through an opening. `free_path`: mean distance
    between reflections, m. `eyring` (B,) s: reverberation time from the mean free path l and the mean
    absorption a of what diffuse walks meet, 6 ln 10 l / (c (-ln(1 - a) + m l)), where all that is not reflected
    counts as absorbed: what escapes, and what walls let through, which other rooms may give back in part
    (Eyring 1930; Kuttruff, Room Acoustics, ch. 5). It takes the sound field as diffuse. Of a band, in which m
    differs, T30 of the sum of such decays over its frequencies. `t30` (B,) s: median of `t30_pairs` simulated
    pairs of points (ISO 3382-1), NaN where the decay is too short; it does not. `t30_spread` (B,) s: the standard
    deviation of T30 that comes of what laboratories differ by that measure absorption (ISO 12999-2), independent
    between the eight materials that sound meets most, median of some of the pairs. `default_area`: of faces that
    got the default material, by name in `default_labels`, '' for faces without a label. `elements`: what faces
    that let sound pass were taken for. `warnings`: what looks wrong, and what to do about it.
    """

    name: str
    notes: tuple[str, ...]  # the scene's, what was looked at instead of all, and its edges
    triangles: int
    components: int
    size: np.ndarray  # (3,) m
    storeys: Storeys
    storey_points: np.ndarray  # (K,) of the grid
    floor_low: np.ndarray  # (K,) m, of the floors under these; a storey's own where it has none
    floor_high: np.ndarray  # (K,) m
    in_air: np.ndarray  # (K,) of them, below which there is no floor of their storey
    spacing: float  # m, of the grid that was looked at
    points: int  # of the grid
    candidates: int
    area: float
    elements: ElementAreas
    volume: float
    closedness: np.ndarray  # at the quantiles 0, .1, .5, .9, 1 of the grid's points
    escape: float
    free_path: float
    unlabelled_area: float
    default_area: float
    default_labels: dict[str, float]  # m²
    material_areas: dict[str, float]
    material_share: dict[str, float]  # of reflections
    bands: tuple[float, ...]
    absorption: np.ndarray  # (B,) mean share that what is met does not reflect
    eyring: np.ndarray
    t30: np.ndarray
    t30_spread: np.ndarray
    t30_pairs: int
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        times = ", ".join(f"{t:.2f}" for t in self.eyring)
        return (
            f"SceneReport of '{self.name}': {self.triangles:,} triangles, {self.volume:.0f} m³, {self.points:,} "
            f"points, expected T30 {times} s\n  {len(self.warnings)} warnings; `report_text` shows all"
        )


def inspect_scene(
    scene: Scene, config: GridConfig | None = None, progress: Progress | None = None
) -> SceneReport:
    """Survey a scene. A scene on which no grid point survives is reported, not refused.

    The work is bounded: a grid of more than 4,000 candidates is looked at with a wider spacing, and T30 is that
    of 12 pairs of points, by subpaths alone: radiance transfer and diffraction cost minutes to prepare in large
    halls, and change the median by less than its spread over pairs.
    """
    check_scene(scene)
    tell = progress or (lambda _: None)
    tell("Placing points")
    sample = _sample_grid(scene, config or GridConfig())
    tell("Following rays")
    rays = _follow_rays(scene, sample.points)
    tell("Finding edges")
    _, edges = find_and_tell(scene)
    tell(f"Simulating {PAIRS} pairs")
    t30, spread, pairs, why = simulated_t30(scene, sample.grid)
    grid = sample.grid
    storey_points, in_air = _points_per_storey(scene, grid)
    default = _default_areas(scene)
    names = scene.materials.names
    areas = np.bincount(scene.face_material, scene.areas, len(names))
    report = SceneReport(
        scene.name,
        tuple(
            dict.fromkeys(
                (*scene.notes, *scene.overlap_notes, *scene.close_notes(), *sample.notes, edges)
            )
        ),
        len(scene.faces),
        _components(scene),
        scene.bounds[1] - scene.bounds[0],
        grid.storeys if grid is not None and grid.storeys is not None else _NOWHERE,
        storey_points,
        *_floor_spread(grid),
        in_air,
        sample.spacing,
        len(grid) if grid is not None else 0,
        len(grid.candidates) if grid is not None else 0,
        float(scene.areas.sum()),
        element_areas(scene),
        _volume(scene),
        np.quantile(
            grid.closedness[grid.status == KEPT] if grid is not None else np.zeros(1), _QUANTILES
        ),
        rays.escape,
        rays.free_path,
        float(scene.areas[scene.face_label < 0].sum()),
        sum(default.values()),
        default,
        {n: float(a) for n, a in zip(names, areas, strict=True) if a > 0.0},
        {n: float(h / max(rays.hits.sum(), 1)) for n, h in zip(names, rays.hits, strict=True) if h},
        DEFAULT_BANDS,
        rays.absorption,
        rays.eyring,
        t30,
        spread,
        pairs,
        (),
    )
    return replace(report, warnings=(*sample.warnings, *why, *_judge(report)))


class _Sample(NamedTuple):
    """The points that a scene is judged by."""

    grid: Grid | None  # None where no point survives
    points: np.ndarray  # (N, 3) m; then the middle of the scene
    spacing: float  # m
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def _sample_grid(scene: Scene, config: GridConfig) -> _Sample:
    """The grid of a scene, of a wider spacing where that has too many candidates."""
    notes: tuple[str, ...] = ()
    try:
        spacing = _spacing_of_sample(scene, config)
        if spacing > config.spacing:
            notes = (
                f"a grid of {config.spacing:g} m has more than {_MOST_CANDIDATES:,} candidates here: one of "
                f"{spacing:g} m is looked at instead",
            )
        config = msgspec.structs.replace(config, spacing=spacing)
        grid = make_grid(scene, config=config)
    except SceneError as error:
        return _Sample(None, scene.center[None], config.spacing, notes, (str(error),))
    sparse = (f"only {len(grid)} {pruning_text(grid, config)}",) if is_sparse(grid) else ()
    return _Sample(grid, grid.points, spacing, notes, sparse)


class _Rays(NamedTuple):
    """Diffuse walks from points of a scene."""

    hits: np.ndarray  # (materials,)
    escape: float  # share of rays that leave the scene
    free_path: float  # m, mean
    absorption: np.ndarray  # (bands,) mean over hits, what passes through a wall and escapes included
    eyring: np.ndarray  # (bands,) T30 by Eyring's formula, s


def _follow_rays(scene: Scene, points: np.ndarray) -> _Rays:
    chosen = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS)).astype(int)]
    count = len(scene.materials.names)
    keys = point_keys(chosen, 0)
    walks = diffuse_walks(scene.geometry, chosen - scene.center, keys, _RAYS, _BOUNCES, count)
    hits, escaped = walks.hits.sum(axis=0), walks.escaped.sum()
    rays = hits.sum() + escaped
    free_path = float(walks.length.sum() / max(walks.count.sum(), 1))
    absorbed, _, let_through = scene.materials.in_bands(DEFAULT_BANDS)
    mean_alpha = (hits @ (absorbed + let_through) + escaped) / rays
    with np.errstate(divide="ignore"):
        per_m = -np.log(np.maximum(1.0 - mean_alpha, 1e-12)) / max(free_path, _SHORTEST)
        eyring = _t30(per_m, SimulationConfig())
    return _Rays(hits, float(escaped / rays), free_path, mean_alpha, eyring)


def _points_per_storey(scene: Scene, grid: Grid | None) -> tuple[np.ndarray, np.ndarray]:
    """Of each storey the number of points, and of those that stand above no floor."""
    if grid is None:
        return np.empty(0, int), np.empty(0, int)
    count = len(grid.floors)
    floating = above_no_floor(scene, grid.points, grid.points[:, 2] - grid.height)
    return np.bincount(grid.storey, minlength=count), np.bincount(grid.storey[floating], minlength=count)


def _floor_spread(grid: Grid | None) -> tuple[np.ndarray, np.ndarray]:
    """Of each storey the lowest and the highest floor, m, above which a point stands."""
    if grid is None:
        return np.empty(0), np.empty(0)
    low, high = grid.floors.astype(float), grid.floors.astype(float)
    floor = grid.points[:, 2] - grid.height
    for s in np.unique(grid.storey):
        here = floor[grid.storey == s]
        low[s], high[s] = here.min(), here.max()
    return low, high


def _default_areas(scene: Scene) -> dict[str, float]:
    """m² of the default material by label, '' for faces without one; the largest first."""
    names = scene.materials.names
    if DEFAULT not in names:
        return {}
    fell = scene.face_material == names.index(DEFAULT)
    found = {}
    for row in np.unique(scene.face_label[fell]):
        area = float(scene.areas[fell & (scene.face_label == row)].sum())
        found[scene.labels[row] if row >= 0 else ""] = area
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _t30(per_m: np.ndarray, simulation: SimulationConfig) -> np.ndarray:
    """(B,) s T30 of a diffuse field of which walls take `per_m` (B,) nepers of energy, and air what it does; inf
    where neither takes any."""
    low, high = np.zeros(len(per_m)), np.full(len(per_m), _LONGEST)
    for _ in range(60):  # how far sound travels until 60 dB are gone
        middle = 0.5 * (low + high)
        gone = _left(per_m, middle, simulation) <= 1e-6
        low, high = np.where(gone, low, middle), np.where(gone, middle, high)
    lengths = np.linspace(0.0, high, 2000)
    left = _left(per_m, lengths, simulation).T
    times = [reverberation_times(x, 1.0, -5.0, -35.0)[0] for x in left]  # in steps
    return np.where(high < _LONGEST, np.array(times) * lengths[1] / simulation.c, np.inf)


def _left(per_m: np.ndarray, lengths: np.ndarray, simulation: SimulationConfig) -> np.ndarray:
    """(…, B) share of a band's energy that walls and air leave after `lengths` (…, B) m."""
    walls = np.exp(-per_m * lengths)
    if simulation.air is None:
        return walls
    columns = [
        simulation.air.transmission(band, lengths[..., b])
        for b, band in enumerate(pairwise(DEFAULT_BANDS))
    ]
    return walls * np.concatenate(columns, axis=-1)


def _spacing_of_sample(scene: Scene, config: GridConfig) -> float:
    """The spacing of the config, or a wider one with which a grid has about as many candidates as are looked
    at."""
    storeys = len(find_storeys(scene, config.height).floors)
    size = np.maximum((scene.bounds[1] - scene.bounds[0])[:2], config.spacing)
    candidates = float(np.prod(size / config.spacing)) * storeys
    return round(config.spacing * max(candidates / _MOST_CANDIDATES, 1.0) ** 0.5, 2)


def _judge(r: SceneReport) -> list[str]:
    out = [note.removeprefix(DOUBT) for note in r.notes if note.startswith(DOUBT)]
    if r.escape > 0.02:
        out.append(
            f"{100 * r.escape:.1f} % of reflections lead out of the mesh: it has holes or no ceiling, and will "
            "sound too dry. `--ceiling` covers a missing one; holes in walls need mending in the mesh"
        )
    if r.default_area > 0.2 * r.area and r.unlabelled_area < r.area:
        out.append(
            f"{100 * r.default_area / r.area:.0f} % of the area fell to the default material: "
            "name materials for its labels (--labels)"
        )
    if r.unlabelled_area >= r.area:
        out.append("no face has a label: everything is of the default material (--labels, --materials)")
    for k, floor in enumerate(r.storeys.floors):
        if not r.storeys.walked[k] and r.storey_points[k]:
            out.append(
                f"{r.storey_points[k]} of {r.points} points are on a storey at {floor:.2f} m that cannot be walked "
                "onto from the others: if it is no storey but a ceiling or furniture, cut it from the mesh, or "
                "give the points (--points)"
            )
        if r.in_air[k] > _IN_AIR * r.storey_points[k]:
            out.append(
                f"{r.in_air[k]} of the {r.storey_points[k]} points on the storey at {floor:.2f} m are in mid-air, "
                "above a lower floor (a gallery in a hall?): give the points (--points) if these are not meant"
            )
    if r.components > 1000:
        out.append(
            f"the mesh is in {r.components:,} pieces: a scan? Small floating pieces scatter sound"
        )
    if not np.all((r.eyring > 0.1) & (r.eyring < 8.0)):
        out.append("the reverberation time is unusual for a room: check unit, materials and openings")
    if r.size[2] > 60.0 or r.size[2] < 1.8:
        out.append(f"the scene is {r.size[2]:.2f} m high: check --unit and --up")
    return out


def _volume(scene: Scene) -> float:
    """Of what is enclosed (closed-ness at least 1/2), by points spread over the bounding box."""
    low, high = scene.bounds
    n = np.arange(_VOLUME_SAMPLES) + 0.5
    # A lattice of rank one (Korobov) covers the box evenly.
    unit = np.stack(
        [n / _VOLUME_SAMPLES, n * 0.7548776662466927 % 1.0, n * 0.5698402909980532 % 1.0], axis=1
    )
    inside = closedness(scene, low + unit * (high - low), 32, 10)[0] >= 0.5
    return float(inside.mean() * np.prod(high - low))


def _components(scene: Scene) -> int:
    """Pieces that share no corner."""
    points, faces = welded_faces(scene.vertices, scene.faces, 5)
    return int(pieces_of(faces, len(points)).max()) + 1


def _list_areas(areas: dict[str, float]) -> str:
    listed = [f"{label or 'no label'} {area:.1f}" for label, area in list(areas.items())[:5]]
    return ", ".join(listed) + (", …" if len(areas) > 5 else "")


def _storey_lines(r: SceneReport) -> list[str]:
    """How many points are on each storey, and whether one can walk there; what is no storey."""
    lines = []
    for low, high, count, air, walked, area in zip(
        r.floor_low,
        r.floor_high,
        r.storey_points,
        r.in_air,
        r.storeys.walked,
        r.storeys.area,
        strict=True,
    ):
        floor = f"{low:.2f}" if high - low < 0.01 else f"{low:.2f} to {high:.2f}"
        free = f", {area:.1f} m² to stand on" if np.isfinite(area) else ""
        above = f", {air} of them in mid-air" if air else ""
        way = "" if walked else "; cannot be walked onto"
        lines.append(f"    floor at {floor} m: {count} points{above}{free}{way}")
    return lines + [f"    {reason}" for reason in r.storeys.left_out]


def report_text(r: SceneReport) -> str:
    """The report as a page."""
    bands = " ".join(f"{f:>8.0f}" for f in center_frequencies(r.bands))
    lines = [
        f"{r.name}",
        f"  {r.triangles:,} triangles in {r.components:,} pieces; {r.size[0]:.1f} × {r.size[1]:.1f} × "
        f"{r.size[2]:.1f} m; surface {r.area:.0f} m², enclosed volume about {r.volume:.0f} m³",
        # The table of materials has these.
        *(f"  note: {note}" for note in r.notes if WITHOUT not in note and not note.startswith(DOUBT)),
        "",
        "Where points stand",
        f"  {len(r.storeys.floors)} storey(s); of {r.candidates} points, {r.spacing:g} m apart, {r.points} survive",
        *_storey_lines(r),
        "  closed-ness of these, at 0, 10, 50, 90, 100 %: "
        + "  ".join(f"{c:.2f}" for c in r.closedness),
        f"  {100.0 * r.escape:.2f} % of reflections lead out of the mesh",
        "",
        "Materials                       area m²   share   met by sound",
    ]
    for name, area in sorted(r.material_areas.items(), key=lambda item: -item[1]):
        met = 100.0 * r.material_share.get(name, 0.0)
        lines.append(f"  {name:<28s}{area:>9.1f}  {100.0 * area / r.area:5.1f} %      {met:5.1f} %")
    lines += [
        f"  without a label             {r.unlabelled_area:>9.1f}  {100.0 * r.unlabelled_area / r.area:5.1f} %",
        f"  of the default material     {r.default_area:>9.1f}  {100.0 * r.default_area / r.area:5.1f} %"
        + (f"  ({_list_areas(r.default_labels)})" if r.default_labels else ""),
        f"  Sound passes {r.elements.whole:.1f} m² of faces of elements, once; {r.elements.deep:.1f} m² are of "
        f"deep ones, {r.elements.sheets:.1f} m²",
        f"  single sheets. {r.elements.turned} of these faces count the other way round than they are wound",
        "",
        f"Sound                    Hz {bands}",
        "  mean absorption           " + " ".join(f"{a:>8.2f}" for a in r.absorption),
        "  T30, simulated, s         " + " ".join(f"{t:>8.2f}" for t in r.t30),
        "  … known to, s             " + " ".join(f"{t:>8.3f}" for t in r.t30_spread),
        "  T60 after Eyring, s       " + " ".join(f"{t:>8.2f}" for t in r.eyring),
        f"  T30 is the median of {r.t30_pairs} pairs of points, {WALKS:,} subpaths each. It is known to as much as",
        "  laboratories differ that measure absorption (ISO 12999-2, one standard deviation). Eyring's formula",
        f"  assumes a diffuse field, with the measured mean free path of {r.free_path:.2f} m, and takes what walls",
        "  let through as absorbed; where the two disagree, the field is not diffuse, or rooms are coupled",
        "",
    ]
    lines += [f"warning: {w}" for w in r.warnings] or ["Nothing looks wrong."]
    return "\n".join(lines)
