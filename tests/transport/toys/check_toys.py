"""What `test_toys` runs on a copy of the package that has the toy lobe and the toy law."""

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.radiance_transfer.prepared import late_technique
from tests.rooms import box, plain, plane, table


def test_lobe_is_there_and_keeps_its_late_energy() -> None:
    """1 J in a room without losses makes a fluence of c t / V; patches, which need Lambert's law, are not
    taken."""
    assert [lobe.name for lobe in bsdf.LOBES] == ["diffuse", "specular", "transmission", "sheen"]
    size = (4.0, 3.0, 2.5)
    scene, config = (
        box(size, table(0.0, 1.0)),
        plain(walks=1000, duration=0.4, max_bounces=1000, radiance_transfer=True),
    )
    source, listener = [1.0, 1.0, 1.0], [3.0, 2.0, 1.5]
    assert "sheen" in late_technique(make_model(scene, np.array([source]), config))
    late = [ss.simulate(scene, [source], [listener], config, seed)[0, 0] for seed in range(4)]
    energies = np.array([e.histogram(0.1)[0, 2:4] for e in late])
    expected, mean = 343.0 * 0.1 / np.prod(size), energies.mean(axis=0)
    error = energies.std(axis=0, ddof=1) / np.sqrt(len(late))
    assert np.all(error < 0.05 * expected) and np.all(np.abs(mean - expected) < 4.0 * error + 1e-3)


@pytest.mark.parametrize(("of_material", "of_job"), [("linear", "random"), ("", "linear")])
def test_law_of_a_material_and_of_a_job(of_material: str, of_job: str) -> None:
    """One specular reflection off a plane: 1.5 cos (1 - absorption) / (4 pi r²)."""
    scene = plane(200.0, replace(table(0.4, 0.0), reflection=(of_material,)))
    p, q = np.array([0.0, 0.0, 1.0]), np.array([3.0, 0.0, 1.0])
    echoes = ss.simulate(scene, [p], [q], plain(walks=16, duration=0.1, reflection=of_job))
    length = np.sqrt(9.0 + 4.0)
    expected = 1.5 * (2.0 / length) * 0.6 / (4.0 * np.pi * length**2)
    np.testing.assert_allclose(echoes[0, 0].arrivals[1].energy, expected, rtol=1e-6)
    with pytest.raises(ss.MaterialError, match="'angle' or 'linear' or 'random'"):
        replace(table(0.4, 0.0), reflection=("oblique",))
    with pytest.raises(ss.ConfigError, match="reflection"):
        plain(reflection="oblique")
