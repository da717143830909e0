"""Every lobe of `bsdf.LOBES`: its samples follow its density, its value conserves energy and is reciprocal."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.rng import mix64, uniform
from soundspaces_sim.transport import bsdf
from tests.transport.test_sampling import N, chi_square, integrate

NORMAL = (0.6, -0.48, 0.64)
NAMES = [lobe.name for lobe in bsdf.LOBES]
SCATTERING = [name for name, delta in zip(NAMES, bsdf.DELTA, strict=True) if not delta]


@kernel(_nrt=True)  # it allocates
def _samples(lobe, d_in, normal, n):  # type: ignore[no-untyped-def]
    out = np.empty((n, 3))
    state = mix64(np.uint64(11))
    for i in range(n):
        state, u = uniform(state)
        state, v = uniform(state)
        out[i] = bsdf.sample(lobe, d_in, normal, (u, v))
    return out


@kernel
def _pdf(lobe, d_in, normal, d_out):  # type: ignore[no-untyped-def]
    return bsdf.pdf(lobe, d_in, normal, (d_out[0], d_out[1], d_out[2]))


@kernel
def _value(lobe, d_in, normal, d_out):  # type: ignore[no-untyped-def]
    return bsdf.value(lobe, d_in, normal, d_out)


def _incoming(seed: int) -> tuple[float, float, float]:
    d = np.random.default_rng(seed).normal(size=3)
    d /= np.linalg.norm(d)
    x, y, z = d if d @ NORMAL < 0.0 else -d
    return float(x), float(y), float(z)


@pytest.mark.parametrize("name", SCATTERING)
def test_samples_follow_the_density(name: str) -> None:
    lobe = NAMES.index(name)
    d_in = _incoming(1)
    directions = _samples(lobe, d_in, NORMAL, N)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    assert np.all(directions @ NORMAL >= -1e-12)
    expected = integrate(lambda d: _pdf(lobe, d_in, NORMAL, d))
    assert expected.sum() == pytest.approx(1.0, abs=2e-3)
    assert chi_square(directions, expected / expected.sum()) > 1e-4


@pytest.mark.parametrize("name", SCATTERING)
def test_all_that_is_reflected_leaves(name: str) -> None:
    """The value times the cosine integrates to one over the hemisphere, from any direction."""
    lobe = NAMES.index(name)
    for seed in range(3):
        d_in = _incoming(seed)
        z = (0.0, 0.0, 1.0)
        turned = (d_in[0], d_in[1], -abs(d_in[2]))

        def scattered(
            phi: float, mu: float, d_in: tuple[float, ...] = turned, z: tuple[float, ...] = z
        ) -> float:
            s = np.sqrt(1.0 - mu * mu)
            return float(_value(lobe, d_in, z, (s * np.cos(phi), s * np.sin(phi), mu)) * mu)

        total, _ = dblquad(scattered, 0.0, 1.0, 0.0, 2.0 * np.pi, epsabs=1e-6)
        assert total == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", SCATTERING)
def test_reciprocity(name: str) -> None:
    lobe = NAMES.index(name)
    for seed in range(20):
        d_in, back = _incoming(seed), _incoming(seed + 100)
        d_out = (-back[0], -back[1], -back[2])
        reverse = (-d_in[0], -d_in[1], -d_in[2])
        assert _value(lobe, d_in, NORMAL, d_out) == pytest.approx(
            _value(lobe, back, NORMAL, reverse), rel=1e-12
        )


def test_delta_lobes_have_no_density() -> None:
    d_in = _incoming(5)
    for lobe in np.flatnonzero(bsdf.DELTA):
        (d_out,) = _samples(lobe, d_in, NORMAL, 1)
        assert _pdf(lobe, d_in, NORMAL, d_out) == 0.0
        crosses = (d_out @ NORMAL) < 0.0
        assert crosses == bsdf.TRANSMITS[lobe]
