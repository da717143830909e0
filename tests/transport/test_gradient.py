"""Derivatives by absorption and by scattering against differences of the very walks, for every technique alone and
all together."""

from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.transport.gradient import Gradient, bin_by_bin, gradient_of
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.radiance_transfer import pair_transfer, shared_and_own
from soundspaces_sim.transport.radiance_transfer.decay_compensation import fit_decay
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.techniques import TECHNIQUES
from tests.marks import CI_SLOW
from tests.rooms import box, plain

A, B = np.array([[1.0, 1.2, 1.1], [1.4, 2.9, 1.8]]), np.array([[3.9, 1.1, 1.6], [3.2, 3.1, 0.9]])
H, MOST = 0.2, 6  # step of the reflected or scattered energy, in units of it; reflections of a path
AT = np.array([0.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
BY = (
    np.array([0.0, -1 / 60, 3 / 20, -3 / 4, 3 / 4, -3 / 20, 1 / 60]) / H
)  # exact for polynomials of degree 6
CHANGED, REFLECTED = (0, 3), 0.5  # materials, and what they reflect: it can nearly double
SCATTERED = np.array([0.5, 0.6, 0.2, 0.5, 0.9, 0.4])
BANDS = 1 + 6 * len(CHANGED)
EDGES = 1000.0 * (1.0 + 1e-8 * np.arange(BANDS + 1))  # alike to diffraction


def _room(mixed: bool = False, parted: bool = False, by: str = "absorption") -> ss.Scene:
    """Six materials, some of which mirror, with a screen; each band has the same, but that one reflects H more, or
    scatters H more.
    `mixed`: half of the floor is of the first one's, up to a diagonal, which patches lie across. `parted`: the screen
    is a wall that passes sound on, with a doorway."""
    alone = np.array([0.5, 0.2, 0.25, 0.5, 0.3, 0.22])[:, None]
    absorption = np.repeat(alone, BANDS, axis=1)
    scattering = np.repeat(SCATTERED[:, None], BANDS, axis=1)
    for k, m in enumerate(CHANGED):
        steps = slice(1 + 6 * k, 7 + 6 * k)
        if by == "absorption":
            absorption[m, steps] = 1.0 - REFLECTED * (1.0 + H * AT[1:])
        else:
            scattering[m, steps] *= 1.0 + H * AT[1:]
    names = tuple(f"m{i}" for i in range(6))
    middles = np.sqrt(EDGES[1:] * EDGES[:-1])
    passed = (0.1 if parted else 0.0) * (np.arange(6) == 4)[:, None] * np.ones(BANDS)
    table = ss.MaterialTable(names, middles, absorption, scattering, passed)
    room = box((5.0, 4.0, 3.0), table, range(6))
    width, height, of = (3.1, 3.0, 4) if parted else (2.0, 1.4, 3)
    screen = [[2.4, 0.0, 0.0], [2.4, width, 0.0], [2.4, width, height], [2.4, 0.0, height]]
    n = len(room.vertices)
    faces = np.concatenate([room.faces, [[n, n + 1, n + 2], [n, n + 2, n + 3]]])
    material = np.concatenate([room.face_material, [of, of]])
    material[9] = 0 if mixed else material[9]
    vertices = np.concatenate([room.vertices, np.array(screen)])
    return ss.Scene(vertices, faces, material, table, name="screened")


def _check(found: Gradient, weight: np.ndarray, by: str, rounding: float = 0.0) -> None:
    """Derivatives, in the first band, against differences over bands, to 1e-6 of the largest one and to what a
    relative `rounding` of losses makes of their differences."""
    losses, own = _losses(found, weight), getattr(found, by)[:, 0]
    largest = np.abs(own).max()
    assert largest > 0.0
    for k, m in enumerate(CHANGED):
        of_bands = np.concatenate([losses[:1], losses[1 + 6 * k : 7 + 6 * k]])
        step = -REFLECTED if by == "absorption" else SCATTERED[m]
        off = 1e-6 * largest + rounding * np.abs(BY) @ of_bands / abs(step)
        assert own[found.names.index(f"m{m}")] == pytest.approx(BY @ of_bands / step, abs=off)


def _named(*names: str) -> tuple[Technique, ...]:
    return tuple(t for t in TECHNIQUES if t.name in names)


def _losses(found: Gradient, weight: np.ndarray) -> np.ndarray:
    """(b,) weighted energy of bins and of discrete arrivals in them."""
    echoes = found.echograms
    out: np.ndarray = np.einsum("sltb,sltb->b", weight, echoes.energy[:, :, :, 0].astype(float))
    for s in range(echoes.shape[0]):
        for l in range(echoes.shape[1]):
            for arrival in echoes[s, l].arrivals:
                t = int(np.searchsorted(echoes.time_edges, arrival.delay, "right")) - 1
                if t < weight.shape[2]:
                    out += weight[s, l, t] * arrival.energy
    return out


ALONE = {
    "arrivals": _named("arrivals"),
    "specular": _named("specular"),
    "receiver_volumes": _named("receiver_volumes"),
    "connections": _named("receiver_volumes", "connections"),
    "all": TECHNIQUES,
}


@pytest.mark.parametrize("by", ["absorption", "scattering", "scattering by size"])
@pytest.mark.parametrize("name", ALONE)
def test_derivatives_are_differences_of_the_same_walks(name: str, by: str) -> None:
    """Derivatives of paths of up to six reflections, whose energy is a polynomial of degree six in what a wall reflects
    and scatters: by differences over bands that the same subpaths carry. To 1e-6 of the largest derivative of this
    technique."""
    by, _, size = by.partition(" by ")
    settings = {"diffraction": {"enabled": False}, "max_bounces": MOST}
    config = plain(
        walks=64, duration=0.06, bands=tuple(EDGES), radiance_transfer={"enabled": False},
        materials={"enabled": True, "groups": 12}, **settings,
        scattering=size or "table",
    )  # fmt: skip
    model = bin_by_bin(make_model(_room(by=by), np.concatenate([A, B]), config))
    shape = len(A), len(B), len(model.time_edges) - 1, 1
    weight = np.repeat(np.random.default_rng(1).random(shape), BANDS, axis=3)
    found = gradient_of(model, A, B, weight, ALONE[name], scattering=by == "scattering")
    _check(found, weight, by)
    assert (found.absorption[:, 0] < 0.0).all()  # none is silently zero
    if found.scattering is not None:
        assert np.abs(found.scattering).min() > 0.0


def _one_decay(length: np.ndarray, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of all bands that of the first, since the derivative takes it for a constant."""
    decay, reach = fit_decay(length, energy)
    return np.full_like(decay, decay[0]), np.full_like(reach, reach.max())


@pytest.mark.parametrize(
    ("name", "subpaths", "parted", "by"),
    [
        ("alone", "shared", False, "absorption"),
        ("alone", "own", True, "absorption"),
        pytest.param("alone", "own", False, "absorption", marks=CI_SLOW),
        ("all", "shared", True, "absorption"),
        pytest.param("all", "shared", False, "absorption", marks=CI_SLOW),
        pytest.param("all", "own", True, "absorption", marks=CI_SLOW),
        ("alone", "shared", False, "scattering by size"),
        ("all", "own", True, "scattering"),
        pytest.param("all", "shared", True, "scattering", marks=CI_SLOW),
    ],
)
def test_derivatives_of_radiance_transfer(
    name: str, subpaths: str, parted: bool, by: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As above. Single precision carries the histograms, so that losses are rounded by 6e-8. The first
    source is heard at its own place too."""
    by, _, size = by.partition(" by ")
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path))
    monkeypatch.setattr(shared_and_own, "fit_decay", _one_decay)
    monkeypatch.setattr(pair_transfer, "ROUNDING", 0.0)  # a step: what is below it is left out
    config = plain(
        walks=64, duration=0.06, bands=tuple(EDGES), max_bounces=MOST, diffraction={"enabled": False},
        radiance_transfer={"enabled": True, "subpaths": subpaths}, connections={"window": 0.008},
        materials={"enabled": True, "groups": 12}, scattering=size or "table",
    )  # fmt: skip
    listeners = np.concatenate([B, A[:1]])
    model = bin_by_bin(make_model(_room(True, parted, by), np.concatenate([A, B]), config))
    techniques = {"alone": _named("specular", "radiance_transfer"), **ALONE}[name]
    shape = len(A), len(listeners), len(model.time_edges) - 1, 1
    weight = np.repeat(np.random.default_rng(1).random(shape), BANDS, axis=3)
    found = gradient_of(model, A, listeners, weight, techniques, scattering=by == "scattering")
    _check(found, weight, by, 6e-8)
    largest = np.abs(found.absorption[:, 0]).max()
    assert (found.absorption[:, 0] < -0.01 * largest).all()  # none is silently zero


def test_as_the_package_shows_it() -> None:
    """A loss of the echograms: half of the squared distance to a target, whose derivative is theirs times it."""
    room = box((5.0, 4.0, 3.0), ss.shoebox((5.0, 4.0, 3.0), absorption=0.2, scattering=0.5).materials)
    config = plain(walks=16, duration=0.05)
    found = ss.gradient(room, A, B, lambda echoes: echoes.energy[:, :, :, 0], config)
    (name,) = found.names
    assert name in room.materials.names and found.absorption.shape == (1, 4)
    assert (found.absorption < 0.0).all()


@pytest.mark.parametrize(("size", "known"), [("table", {"mixed"}), ("size", {"mixed", "mirror"})])
def test_scattering_of_zero_and_one_is_not_known(size: str, known: set[str]) -> None:
    """Where nothing is scattered, or nothing mirrored, walks do not tell what the other kind of path would add. A
    mirror that ends scatters by its size."""
    names, third = ("mixed", "mirror", "rough"), np.ones((3, 1)) / 3.0
    scattering = np.array([[0.4], [0.0], [1.0]])
    table = ss.MaterialTable(names, np.array([1000.0]), third, scattering, 0.0 * third)
    walls = box((5.0, 4.0, 3.0), table, [0, 0, 0, 0, 2, 2])
    mirror = [[2.4, 1.0, 1.0], [2.4, 2.0, 1.0], [2.4, 2.0, 1.6], [2.4, 1.0, 1.6]]
    faces = np.concatenate([walls.faces, [[8, 9, 10], [8, 10, 11]]])
    material = np.concatenate([walls.face_material, [1, 1]])
    room = ss.Scene(
        np.concatenate([walls.vertices, mirror]), faces, material, table, name="with a mirror"
    )
    config = plain(walks=64, duration=0.05, scattering=size, bands=(700.0, 1400.0))
    found = ss.gradient(
        room, A, B, lambda e: np.ones_like(e.energy[:, :, :, 0]), config, scattering=True
    )
    assert found.scattering is not None and set(found.names) == set(names)
    finite = np.isfinite(found.scattering).all(axis=1)
    assert {n for n, there in zip(found.names, finite, strict=True) if there} == known
    assert np.isfinite(found.absorption).all()


def test_what_is_refused() -> None:
    room = box((5.0, 4.0, 3.0), ss.shoebox((5.0, 4.0, 3.0), absorption=0.2).materials)
    without = {"walks": 16, "duration": 0.05, "radiance_transfer": {"enabled": False}}
    weights = np.zeros((2, 2, 1, 4))
    for config, words in (
        (plain(**without, target_error=0.1), "expected no simulation.target_error"),
        (plain(**without, reflection="angle"), "reflects by a law of angles"),
        (plain(**without), r"weights must be finite numbers of shape \(2, 2, \d+, 4\)"),
    ):
        with pytest.raises(ConfigError, match=words):
            ss.gradient(room, A, B, weights, config)
    with pytest.raises(ConfigError, match="finite numbers"):
        ss.gradient(room, A, B, lambda e: np.nan * e.energy[:, :, :, 0], plain(**without))
