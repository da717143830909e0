"""Every sampling routine against its density: chi-square over cells of the sphere."""

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import chi2

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.rng import combine, mix64, uniform
from soundspaces_sim.scene.rays import directions as sampling
from soundspaces_sim.transport.bsdf import COUNT, LOBES, TRANSMISSION
from soundspaces_sim.transport.bsdf.sampling import (
    choose_lobe,
    choose_proposal,
    sample_split,
    update_throughput,
)
from soundspaces_sim.transport.bsdf.surface import make_surfaces
from soundspaces_sim.transport.paths.emission import emit

N, ROWS, COLUMNS = 200_000, 8, 12


def chi_square(directions: np.ndarray, expected: np.ndarray) -> float:
    """p-value of the counts in equal-area cells; cells below 5 expected are pooled."""
    row = np.minimum(((directions[:, 2] + 1.0) * 0.5 * ROWS).astype(int), ROWS - 1)
    phi = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) + 0.5
    column = np.minimum((phi * COLUMNS).astype(int), COLUMNS - 1)
    counts = np.bincount(row * COLUMNS + column, minlength=ROWS * COLUMNS)
    expected = expected * len(directions)
    big = expected >= 5.0
    observed = np.append(counts[big], counts[~big].sum())
    wanted = np.append(expected[big], expected[~big].sum())
    keep = wanted > 0.0
    statistic = ((observed[keep] - wanted[keep]) ** 2 / wanted[keep]).sum()
    assert counts[expected == 0.0].sum() == 0
    return float(chi2.sf(statistic, keep.sum() - 1))


def integrate(pdf) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Probability of each cell, by quadrature of the density over z and azimuth."""
    cells = np.empty(ROWS * COLUMNS)
    for i in range(ROWS):
        for j in range(COLUMNS):
            z0, z1 = -1 + 2 * i / ROWS, -1 + 2 * (i + 1) / ROWS
            p0, p1 = 2 * np.pi * (j / COLUMNS - 0.5), 2 * np.pi * ((j + 1) / COLUMNS - 0.5)
            cells[i * COLUMNS + j] = dblquad(
                lambda phi, z: pdf(np.array([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])),
                z0, z1, p0, p1, epsabs=1e-4,
            )[0]  # fmt: skip
    return cells


@kernel(_nrt=True)  # it allocates
def _spheres(n):  # type: ignore[no-untyped-def]
    out = np.empty((n, 3))
    state = mix64(np.uint64(7))
    for i in range(n):
        state, u = uniform(state)
        state, v = uniform(state)
        out[i] = sampling.sample_sphere(u, v)
    return out


@kernel(_nrt=True)  # it allocates
def _cosines(n, nx, ny, nz):  # type: ignore[no-untyped-def]
    out = np.empty((n, 3))
    state = mix64(np.uint64(8))
    for i in range(n):
        state, u = uniform(state)
        state, v = uniform(state)
        out[i] = sampling.sample_cosine_hemisphere((nx, ny, nz), u, v)
    return out


@kernel(_nrt=True)  # it allocates
def _first_directions(n):  # type: ignore[no-untyped-def]
    out = np.empty((n, 3))
    for i in range(
        n
    ):  # one walk of many independent points: a stratified set is too even for chi-square
        out[i] = emit(combine(np.uint64(3), i), i % 64)
    return out


def test_sphere() -> None:
    p = chi_square(_spheres(N), integrate(lambda _: 1.0 / (4.0 * np.pi)))
    assert p > 1e-4


def test_emission() -> None:
    p = chi_square(_first_directions(N), np.full(ROWS * COLUMNS, 1.0 / (ROWS * COLUMNS)))
    assert p > 1e-4


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.6, -0.48, 0.64)])
def test_cosine(normal: tuple[float, float, float]) -> None:
    directions = _cosines(N, *normal)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    assert np.all(directions @ normal >= -1e-12)
    expected = integrate(lambda d: sampling.pdf_cosine.py_func(float(d @ np.array(normal))))
    assert expected.sum() == pytest.approx(1.0, abs=2e-3)
    assert chi_square(directions, expected / expected.sum()) > 1e-4


@kernel(_nrt=True)  # it allocates
def _events(surfaces, n):  # type: ignore[no-untyped-def]
    """Sums of band weights per lobe and counts per (proposal, lobe) after one event."""
    proposals, bands = surfaces.proposal.shape[1], surfaces.energy.shape[2]
    sums, counts = np.zeros((COUNT, bands)), np.zeros((proposals, COUNT))
    state = mix64(np.uint64(9))
    for _ in range(n):
        state, u = uniform(state)
        proposal = choose_proposal(surfaces, u)
        state, u = uniform(state)
        lobe = choose_lobe(surfaces, 0, proposal, 1, u)
        beta, mixture = np.ones(bands), np.ones(proposals)
        update_throughput(surfaces, 0, lobe, 1.0, 1, beta, mixture)
        sums[lobe] += beta
        counts[proposal, lobe] += 1
    return sums / n, counts


def test_events_follow_their_probabilities_and_weigh_to_their_energy() -> None:
    a, s, t = (np.array([x]) for x in ([0.1, 0.4], [0.2, 0.9], [0.02, 0.3]))
    surfaces = make_surfaces(a, s, t)
    n = 300_000
    mean, counts = _events(surfaces, n)
    expected = surfaces.proposal[0] * counts.sum(axis=1, keepdims=True)
    statistic = ((counts - expected) ** 2 / expected).sum()
    assert chi2.sf(statistic, 2 * len(counts)) > 1e-4
    share = counts.sum(axis=1) / n
    np.testing.assert_allclose(share, surfaces.chance, atol=4.0 * 0.5 / np.sqrt(n))
    # E[weight] of a lobe is its energy.
    rho = 1.0 - a[0] - t[0]
    energies = {"diffuse": rho * s[0], "specular": rho * (1 - s[0]), "transmission": t[0]}
    for lobe, energy in ((k, energies[one.name]) for k, one in enumerate(LOBES)):
        error = 3.0 * np.sqrt(energy * 3.0 / n)
        assert np.all(np.abs(mean[lobe] - energy) < 4.0 * error)


def test_weights_stay_bounded_over_many_bounces() -> None:
    """Scattering .1 under a mean of .4: a band's weight never exceeds 1 / share of its own proposal."""
    surfaces = make_surfaces(np.zeros((1, 4)), np.array([[0.1, 0.2, 0.4, 0.9]]), np.zeros((1, 4)))
    largest = _largest_weight(surfaces, 400, 100)
    assert 1.0 < largest <= (1 + 1e-9) / surfaces.chance[0]


@kernel(_nrt=True)  # it allocates
def _largest_weight(surfaces, paths, bounces):  # type: ignore[no-untyped-def]
    proposals, bands = surfaces.proposal.shape[1], surfaces.energy.shape[2]
    state, largest = mix64(np.uint64(10)), 0.0
    for i in range(paths):
        beta, mixture = np.ones(bands), np.ones(proposals)
        for event in range(1, bounces + 1):
            state, u = uniform(state)
            lobe = choose_lobe(surfaces, 0, i % proposals, event, u)
            update_throughput(surfaces, 0, lobe, 1.0, event, beta, mixture)
            largest = max(largest, beta.max())
    return largest


@kernel(_nrt=True)  # it allocates
def _stay_in_a_room(surfaces, paths, bounces):  # type: ignore[no-untyped-def]
    """How many paths stay in a room, and what these, and those that leave it, carry in the mean."""
    state, staying = mix64(np.uint64(11)), 0
    kept, gone = np.zeros((2, surfaces.energy.shape[2]))
    for _ in range(paths):
        beta, lobe = np.ones(len(kept)), -1
        for event in range(1, bounces + 1):
            state, u = uniform(state)
            lobe = sample_split(surfaces, 0, 1.0, False, beta, event, u)
            if lobe == TRANSMISSION:
                break
        if lobe == TRANSMISSION:
            gone += beta
        else:
            kept += beta
            staying += 1
    return staying, kept / paths, gone / paths


def test_specular_subpaths_stay_where_their_energy_stays() -> None:
    """Of walls that let 1e-4 pass: after 100 reflections a fifth of the subpaths is still within, and either side has
    its energy in the mean."""
    passed, mirrored, bounces, n = 1e-4, 0.95, 100, 100_000
    surfaces = make_surfaces(
        np.full((1, 2), 1 - mirrored - passed), np.zeros((1, 2)), np.full((1, 2), passed)
    )
    staying, kept, gone = _stay_in_a_room(surfaces, n, bounces)
    assert staying > 0.2 * n
    np.testing.assert_allclose(kept, mirrored**bounces, rtol=0.04)  # 4 standard errors are 2.4 %
    np.testing.assert_allclose(gone, passed * (1 - mirrored**bounces) / (1 - mirrored), rtol=0.03)
