"""Reflection by angle: what the law gives, that BSDFs keep to it, and closed forms through the engine."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.transport.bsdf import LAW_NAMES, SPECULAR, TRANSMISSION
from soundspaces_sim.transport.bsdf.impedance import (
    factor,
    flow_resistance,
    impedance,
    parameters,
    random_incidence,
)
from soundspaces_sim.transport.bsdf.sampling import update_throughput
from soundspaces_sim.transport.bsdf.surface import (
    apply_departure_factor,
    attenuate,
    evaluate,
    is_delta,
    make_surfaces,
)
from soundspaces_sim.transport.paths import detector
from tests.marks import CI_SLOW, ci_slow
from tests.rooms import box, plain, plane, sphere, table
from tests.stats import assert_mean, repeat

# absorption, scattering, transmission, whether it hangs free
MATERIALS = [
    (0.02, 0.3, 0.0, False), (0.3, 0.2, 0.0, False), (0.6, 0.7, 0.2, False), (0.94, 0.5, 0.0, False),
    (0.98, 0.5, 0.01, False), (0.2, 0.4, 0.7, True), (0.3, 0.4, 0.1, True), (0.3, 0.4, 0.69, True),
    (0.7, 0.6, 0.2, True), (0.0, 0.2, 0.5, True), (0.0, 0.3, 0.0, False), (1.0, 0.3, 0.0, False),
]  # fmt: skip
COLUMNS = [np.array(c) for c in zip(*MATERIALS, strict=True)]
SURFACES = make_surfaces(
    COLUMNS[0][:, None], COLUMNS[1][:, None], COLUMNS[2][:, None],
    np.full(len(MATERIALS), LAW_NAMES.index("angle")), COLUMNS[3],
)  # fmt: skip


def _wall(c: Any, zeta: float) -> Any:
    return 4.0 * zeta * c / (1.0 + zeta * c) ** 2


def _porous(c: float, r: float) -> tuple[float, float, float]:
    """(Absorbed, passed, returned) by a sheet of flow resistance r over air's impedance, from Ohm's law."""
    pressure_ratio = r * c / (2.0 + r * c)  # reflection factor
    passed = 1.0 - pressure_ratio  # velocity is the same on both sides
    return 1.0 - pressure_ratio**2 - passed**2, passed**2, pressure_ratio**2


@kernel(_nrt=True)  # it allocates
def _delta(surfaces, material, lobe, cos):  # type: ignore[no-untyped-def]
    energy = np.ones(1)
    attenuate(surfaces, material, lobe, cos, energy, 1.0)
    return energy[0]


@kernel(_nrt=True)  # it allocates
def _scatter(surfaces, material, d_in, d_out):  # type: ignore[no-untyped-def]
    energy = np.ones(1)
    evaluate(surfaces, material, d_in, (0.0, 0.0, 1.0), d_out, energy)
    return energy[0]


@kernel(_nrt=True)  # it allocates
def _carried(surfaces, material, cos_in, cos_out):  # type: ignore[no-untyped-def]
    """A path's throughput after a diffuse event that had probability one."""
    beta, mixture = np.ones(1), np.ones(surfaces.proposal.shape[1])
    lobe = 0
    while is_delta(lobe):
        lobe += 1
    update_throughput(surfaces, material, lobe, cos_in, 1, beta, mixture)
    chance = (surfaces.chance * surfaces.proposal[material, :, lobe]).sum()
    apply_departure_factor(surfaces, material, lobe, cos_out, beta)
    return beta[0] * chance


def _directions(c: float, phi: float, sign: float) -> tuple[float, float, float]:
    s = np.sqrt(1.0 - c * c)
    return float(s * np.cos(phi)), float(s * np.sin(phi)), sign * c


@pytest.mark.parametrize("zeta", [1e-3, 0.05, 0.3, 1.567, 4.0, 60.0, 400.0])
def test_random_incidence_is_the_mean_over_angles(zeta: float) -> None:
    mean = quad(lambda c: 2.0 * c * _wall(c, zeta), 0.0, 1.0, points=[min(1.0 / zeta, 0.5)])[0]
    assert float(random_incidence(np.array(zeta))) == pytest.approx(mean, rel=1e-9)


def test_impedance_of_an_absorption() -> None:
    """And back; .951 is the most, at 1.567 (Kuttruff, Room Acoustics, 2.5)."""
    a = np.array([0.001, 0.02, 0.3, 0.7, 0.95])
    np.testing.assert_allclose(random_incidence(impedance(a)), a, rtol=1e-9)
    assert impedance(np.array(0.99)) == pytest.approx(1.567, abs=1e-3)
    assert random_incidence(impedance(np.array(0.99))) == pytest.approx(0.951, abs=5e-4)
    assert impedance(np.array(0.0)) == np.inf
    a = np.array([0.0, 0.05, 0.3, 0.47])
    np.testing.assert_allclose(0.5 * random_incidence(flow_resistance(a)), a, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("row", range(len(MATERIALS)))
def test_means_over_random_incidence_are_the_table(row: int) -> None:
    a, s, t, _ = MATERIALS[row]
    knee = 1.0 / max(float(SURFACES.parameters[row, 0, 0, 3]), 2.0)
    for lobe, mean in ((SPECULAR, (1.0 - a - t) * (1.0 - s)), (TRANSMISSION, t)):
        got = quad(lambda c, k=lobe: 2.0 * c * _delta(SURFACES, row, k, c), 0.0, 1.0, points=[knee])[0]
        assert got == pytest.approx(mean, abs=1e-9)


@pytest.mark.parametrize("row", range(len(MATERIALS)))
def test_energy_balance_at_every_angle(row: int) -> None:
    """What is scattered in all is its share of what returns, which with what passes never exceeds one."""
    a, s, *_ = MATERIALS[row]
    for c in (1e-3, 0.1, 0.5, 0.9, 1.0):
        returned = _delta(SURFACES, row, SPECULAR, c) / (1.0 - s)
        d_in = _directions(c, 0.3, -1.0)
        albedo = dblquad(
            lambda phi, mu, d=d_in: _scatter(SURFACES, row, d, _directions(mu, phi, 1.0)) * mu,
            0.0, 1.0, 0.0, 2.0 * np.pi, epsabs=1e-7,
        )[0]  # fmt: skip
        assert albedo == pytest.approx(s * returned, abs=1e-5)
        absorbed = 1.0 - returned - _delta(SURFACES, row, TRANSMISSION, c)
        assert -1e-12 < absorbed < 1.0 + 1e-12
        if a == 0.0:
            assert absorbed == pytest.approx(0.0, abs=1e-12)


def test_walls_keep_what_their_impedance_says() -> None:
    """Absorption and transmission together, in the table's proportion."""
    for row, (a, s, t, sheet) in enumerate(MATERIALS):
        if sheet or not 0.0 < a + t <= 0.95:
            continue
        zeta = float(impedance(np.array(a + t)))
        for c in (1e-3, 0.2, 0.7, 1.0):
            returned = _delta(SURFACES, row, SPECULAR, c) / (1.0 - s)
            assert returned == pytest.approx(1.0 - _wall(c, zeta), abs=1e-9)
            assert _delta(SURFACES, row, TRANSMISSION, c) == pytest.approx(
                t / (a + t) * _wall(c, zeta), abs=1e-9
            )


@pytest.mark.parametrize("r", [0.1, 0.8, 2.0, 3.0])
def test_porous_sheets_keep_to_ohms_law(r: float) -> None:
    """A sheet whose table has the law's means has the law."""
    mean = [quad(lambda c, k=k: 2.0 * c * _porous(c, r)[k], 0.0, 1.0)[0] for k in range(3)]
    assert float(flow_resistance(np.array(mean[0]))) == pytest.approx(0.5 * r, rel=1e-6)
    of_law = parameters(np.array([[mean[0]]]), np.array([[mean[1]]]), np.array([True]))
    for c in (1e-3, 0.3, 0.8, 1.0):
        _, passed, returned = _porous(c, r)
        got = [factor.py_func(of_law[0, k, 0], c) for k in (0, 1)]
        assert got[0] * mean[2] == pytest.approx(returned, rel=1e-5, abs=1e-9)
        assert got[1] * mean[1] == pytest.approx(passed, rel=1e-5)


@pytest.mark.parametrize("row", range(len(MATERIALS)))
def test_scattering_is_reciprocal_and_paths_carry_it(row: int) -> None:
    if MATERIALS[row][0] == 1.0:
        return  # no path goes on
    rng = np.random.default_rng(row)
    for _ in range(20):
        (c, d), phi = rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, 6.0)
        there = _scatter(SURFACES, row, _directions(c, 0.0, -1.0), _directions(d, phi, 1.0))
        back = _scatter(SURFACES, row, _directions(d, phi + np.pi, -1.0), _directions(c, np.pi, 1.0))
        assert there == pytest.approx(back, rel=1e-12)
        assert _carried(SURFACES, row, c, d) == pytest.approx(there * np.pi, rel=1e-12)


def test_nothing_changes_at_random_incidence() -> None:
    surfaces = make_surfaces(*(c[:, None].astype(float) for c in COLUMNS[:3]))
    for row, (a, s, t, _) in enumerate(MATERIALS):
        for c in (0.0, 0.4, 1.0):
            assert _delta(surfaces, row, SPECULAR, c) == pytest.approx(
                (1.0 - a - t) * (1.0 - s), abs=1e-15
            )
            assert _delta(surfaces, row, TRANSMISSION, c) == t


@pytest.mark.parametrize("absorption", [0.05, 0.4, 0.9])
def test_one_mirror_reflection_off_an_impedance_plane(absorption: float) -> None:
    """Through `simulate`, at angles from almost normal to almost grazing: |R|² = ((zeta c - 1) / (zeta c +
    1))²."""
    zeta = float(impedance(np.array(absorption)))
    scene, p = plane(200.0, table(absorption, 0.0)), np.array([0.0, 0.0, 1.0])
    listeners = np.array([[0.01, 0.0, 1.3], [1.0, 0.5, 0.8], [4.0, 2.0, 2.0], [20.0, 0.0, 0.4]])
    echoes = ss.simulate(scene, [p], listeners, plain(walks=16, duration=0.1, reflection="angle"))
    for i, q in enumerate(listeners):
        arrival = echoes[0, i].arrivals[1]
        length = np.linalg.norm(q - [0.0, 0.0, -1.0])
        c = (q[2] + 1.0) / length
        expected = ((zeta * c - 1.0) / (zeta * c + 1.0)) ** 2 / (4.0 * np.pi * length**2)
        np.testing.assert_allclose(arrival.energy, expected, rtol=1e-7, atol=1e-12)


def test_a_material_may_decide_for_itself() -> None:
    """Its own word goes before the job's, in scenes and in files, and is part of what a scene is."""
    own, p, q = table(0.4, 0.0), [0.0, 0.0, 1.0], [4.0, 0.0, 1.0]
    angle, random = (replace(own, reflection=(word,)) for word in ("angle", "random"))

    def level(materials: ss.MaterialTable, job: str | None, counted: bool = False) -> float:
        config = plain(walks=16, duration=0.1, reflection=job, materials=counted)
        return float(ss.simulate(plane(200.0, materials), [p], [q], config)[0, 0].arrivals[1].energy[0])

    assert level(own, "random") == level(random, "angle") == level(random, "random")
    assert level(own, "angle") == level(angle, "random") != level(own, "random")
    assert level(own, None) == level(own, "angle") == level(angle, None, counted=True)
    assert level(own, None, counted=True) == level(own, "random", counted=True) == level(own, "random")
    assert plane(1.0, own).digest != plane(1.0, angle).digest != plane(1.0, random).digest
    with pytest.raises(ss.MaterialError, match=r"'m0'.*'angle' or 'random'.*'oblique'"):
        replace(own, reflection=("oblique",))


@pytest.mark.parametrize("free", [False, True])
def test_straight_through_a_wall_at_an_angle(free: bool) -> None:
    a, t = 0.3, 0.4
    materials = table(a, 0.0, t)
    if free:
        materials = replace(materials, mounting=("free",))
    scene = plane(50.0, materials)
    p, q = np.array([0.0, 0.0, 1.0]), np.array([[0.0, 0.0, -1.0], [3.0, 0.0, -1.0], [20.0, 0.0, -1.0]])
    echoes = ss.simulate(scene, [p], q, plain(walks=16, duration=0.1, reflection="angle"))
    for i, end in enumerate(q):
        r = float(np.linalg.norm(end - p))
        c = 2.0 / r
        if free:  # this table passes less than the porous sheet that absorbs as much
            zeta = float(flow_resistance(np.array(a)))
            share = quad(lambda x, z=zeta: 2.0 * x / (1.0 + z * x) ** 2, 0.0, 1.0)[0]
            expected = t / share / (1.0 + zeta * c) ** 2
        else:
            expected = t / (a + t) * _wall(c, float(impedance(np.array(a + t))))
        direct = echoes[0, i].direct
        assert direct is not None
        np.testing.assert_allclose(direct.energy * 4.0 * np.pi * r**2, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("absorption", "offset"),
    [
        pytest.param(0.8, 1.0, marks=CI_SLOW),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0.3, 1.0), (0.8, 0.0))),
    ],
)
def test_sphere_that_scatters_by_angle(
    absorption: float, offset: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sound that leaves the wall of a sphere at an angle meets it again at the same one.

    From the centre all comes along the normal. With rho(c) = |R|², g = rho over its mean: rho(1) returns first,
    of that each further reflection returns k, the mean of g rho over random incidence; what has left, P in all,
    makes the fluence P / (pi R²) times the mean of g over the directions in which a listener sees the wall.
    """
    radius, zeta = 2.0, float(impedance(np.array(absorption)))

    def rho(c: float) -> float:
        return float(1.0 - _wall(c, zeta))

    knee = [1.0 / zeta]
    k = quad(lambda c: 2.0 * c * rho(c) ** 2, 0.0, 1.0, points=knee)[0] / (1.0 - absorption)
    left = rho(1.0) / (1.0 - k)
    seen = quad(lambda mu: rho(np.sqrt(1.0 - (offset / radius) ** 2 * (1.0 - mu**2))), 0.0, 1.0)[0]
    expected = left * seen / (1.0 - absorption) / (np.pi * radius**2)
    scene = sphere(radius, table(absorption, 1.0), 4)
    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.1, 0.01, 0.2))
    config = plain(
        walks=2000,
        specular={"ratio": 1},
        connections={"subpaths": 256},
        decay_range_db=100.0,
        reflection="angle",
    )

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [[0.0, 0.0, 0.0]], [[offset, 0.0, 0.0]], config, seed)[0, 0]
        return np.asarray(e.energy[:, 0].sum(axis=0)[:1])

    assert_mean(repeat(run, 12), expected, f"sphere {absorption}, {offset}", relative=0.03)


@ci_slow
def test_mirror_shoebox_by_angle_against_image_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every reflection of an image is off a wall across its axis: the angles of each are known."""
    size, p, q = np.array([6.0, 5.0, 2.7]), np.array([1.5, 2.0, 1.2]), np.array([4.3, 3.1, 1.6])
    absorption = 0.3
    zeta = float(impedance(np.array(absorption)))
    n = np.arange(-22, 23)
    axes = [
        (np.concatenate([s + 2 * n * l - r, -s + 2 * n * l - r]), np.concatenate([abs(2 * n), abs(2 * n - 1)]))
        for l, s, r in zip(size, p, q, strict=True)
    ]  # fmt: skip
    offset = np.stack(np.meshgrid(*(a for a, _ in axes), indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.stack(np.meshgrid(*(k for _, k in axes), indexing="ij"), axis=-1).reshape(-1, 3)
    length = np.linalg.norm(offset, axis=1)
    returned = 1.0 - _wall(np.abs(offset) / length[:, None], zeta)
    energy = (returned**order).prod(axis=1) / (4.0 * np.pi * length**2)
    edges = np.arange(0.0, 0.1001, 0.01)
    expected = np.histogram(length / 343.0, edges, weights=energy)[0]
    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.1, 0.01, 0.25))
    config = plain(walks=1600, specular={"ratio": 16}, duration=0.11, reflection="angle")

    def run(seed: int) -> np.ndarray:
        e = ss.simulate(box(tuple(size), table(absorption, 0.0)), [p], [q], config, seed)[0, 0]
        return e.histogram(0.01)[0, :10]

    assert_mean(repeat(run, 12)[:, 3:], expected[3:], "image sources", relative=0.05)


@ci_slow
def test_a_diffuse_field_sees_absorption_at_random_incidence() -> None:
    """A panel on the floor of a lossless Lambert room: energy falls as exp(-c a' S / (4 V) t), a' S the area of
    the panel times its tabulated absorption (Eyring: a' = -ln(1 - mean a)); along the normal it would take
    .70."""
    size, a, side = (3.0, 2.5, 2.0), 0.8, 0.8
    room = box(size, table([0.0, a], [1.0, 1.0]))
    x, y, z = 1.0, 0.8, 2e-4
    corners = [[x, y, z], [x + side, y, z], [x + side, y + side, z], [x, y + side, z]]
    faces = len(room.vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    scene = ss.Scene(
        np.concatenate([room.vertices, corners]), np.concatenate([room.faces, faces]),
        np.append(room.face_material, [1, 1]), room.materials,
    )  # fmt: skip
    mean = a * side**2 / 37.0
    expected = -np.log(1.0 - mean) * 343.0 * 37.0 / (4.0 * 15.0)
    config = plain(
        walks=400, connections={"subpaths": 0}, specular={"ratio": 8}, duration=0.7, reflection="angle"
    )
    listeners = [[2.3, 1.7, 0.9], [1.2, 2.0, 1.5], [2.6, 0.5, 1.6], [0.4, 1.9, 0.5]]

    def run(seed: int) -> np.ndarray:
        echoes = ss.simulate(scene, [[0.7, 0.6, 1.2]], listeners, config, seed)
        h = np.array([echoes[0, i].histogram(0.05)[0] for i in range(4)]).sum(axis=0)
        return np.array([np.log(h[2:6].sum() / h[9:13].sum()) / 0.35])

    assert_mean(repeat(run, 16), expected, "decay", relative=0.015)
