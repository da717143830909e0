"""Random numbers belong to a subpath's events: where its work is cut, and what else is traced meanwhile, changes
nothing."""

from typing import Any

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import event_uniforms
from soundspaces_sim.core.numerics.vec3 import row
from soundspaces_sim.transport.paths import specular
from soundspaces_sim.transport.paths.guide import set_density
from soundspaces_sim.transport.paths.path_state import PATH, Paths, empty_paths
from soundspaces_sim.transport.paths.population import resample
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.radiance_transfer.first_reflections import room_for
from soundspaces_sim.transport.state import Emitters, Receivers, Settings, Tables, emitters_of
from soundspaces_sim.transport.tile import make_side, make_sums, make_tile
from tests.marks import ci_slow
from tests.rooms import box, plain, table

LENGTH = 64.0  # m
POINTS = np.array([[1.0, 1.0, 1.0], [3.0, 2.0, 1.5]])


@kernel
def _numbers(first: int, last: int, stream: int, out: np.ndarray) -> None:
    for k in range(first, last):
        out[k, 0], out[k, 1], out[k, 2] = event_uniforms(np.uint64(stream), k + 1)


def test_numbers_of_events_are_those_of_splitmix64() -> None:
    """Output of seed 1234567 as https://rosettacode.org/wiki/Pseudo-random_numbers/Splitmix64 has it."""
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423,
                 4593380528125082431, 16408922859458223821]  # fmt: skip
    out = np.empty((2, 3))
    over_rows(_numbers, 2, 1234567, out)
    np.testing.assert_array_equal(out.ravel()[:5], [(x >> 11) / 2**53 for x in published])


@kernel
def _follow(first: int, last: int, scene: Any, emitters: Emitters, receivers: Receivers, block: Any, out: Tables, work: Any, step: float) -> None:  # fmt: skip
    """`specular._trace` of one batch without roulette, `step` m of all subpaths at a time."""
    for batch in range(first, last):
        context = specular._Context(scene.world, receivers, work.scratch, out, block, 0, batch)
        work.guide.density[:] = 1.0
        set_density(work.guide)
        specular._start(
            work, row(emitters.points, 0), emitters.keys[0], batch, block.direction[0, batch]
        )
        active, limit = len(work.paths.state), 0.0
        while limit < LENGTH:
            limit += step
            active = specular._advance_all(context, work, active, limit)


def _followed(step: float) -> tuple[np.ndarray, np.ndarray]:
    """The states of specular subpaths at `LENGTH`, and what they left at both points on their way."""
    some = table([[0.1], [0.3]], 0.2, [[0.0], [0.3]])
    scene = box((4.0, 3.0, 2.5), some, [0, 1, 0, 1, 0, 0])
    config = plain(duration=0.3, walks=1024, radiance_transfer=False)
    model = make_model(scene, POINTS, config)
    side = make_side(model, POINTS)
    sums = make_sums(make_tile(side, side), both_ways=False)
    emitters = emitters_of(side.ends, slice(1))
    tallies: list[np.ndarray] = []
    work = specular._make_work(model.world, side.ends.detectors, tallies)
    over_rows(
        _follow, 1, specular._Scene(model.world, np.zeros(model.world.air.shape[1])), emitters,
        Receivers(side.ends.detectors, emitters.section[0]), room_for(1, 0, model.world),
        Tables(sums.to_b[0], sums.to_b[0, :, :0], sums.batches[0]), work, step,
    )  # fmt: skip
    return work.paths.state.copy(), sums.to_b[0]


@ci_slow
def test_subpaths_go_on_alike_wherever_they_are_cut() -> None:
    """All 64 m of one subpath after the other, and 4 m of all in turn: the same places and directions to the bit,
    and the same energy at detectors but for the order of its sums."""
    (whole, left), (cut, left_by_parts) = _followed(LENGTH), _followed(4.0)
    assert len(whole) > 16 and (whole["events"] > 10).sum() > 16
    for name in PATH.names or ():
        if name not in ("d_vcm", "a", "b", "index", "proposal", "material", "next"):
            np.testing.assert_array_equal(cut[name], whole[name], name)
    assert (left > 0.0).any()
    np.testing.assert_allclose(left_by_parts, left, rtol=1e-5, atol=1e-6 * np.abs(left).max())


@kernel
def _resample(first: int, last: int, paths: Paths, settings: Settings) -> None:
    for stage in range(first, last):
        resample(paths, settings, 6.0 * (stage + 1), stage + 1, 0.5, len(paths.alive))


@ci_slow
def test_copies_of_one_subpath_have_different_numbers() -> None:
    """Made at two stages between which it met nothing, as in a hall."""
    model = make_model(box((4.0, 3.0, 2.5), table([0.1], 0.4), 0), POINTS, plain(walks=64, duration=0.1))
    paths = empty_paths(4, 1, 1)
    paths.state[:] = np.zeros(4, PATH)
    paths.state["stream"] = 10 + np.arange(4)
    paths.retired[:], paths.mixture[:], paths.first[:] = False, 1.0, 0.0
    # First of four alike the first is heavy, then of its copies again the first alone.
    beta = np.array([[1.0, 1e-9, 1e-9, 0.5], [1.0, 1e-9, 1e-9, 1e-9]])
    settings = model.world.settings._replace(connected=0)
    streams = []
    for stage in range(2):
        paths.alive[:], paths.beta[:, 0] = True, beta[stage]
        _resample(stage, stage + 1, paths, settings)
        streams += paths.state["stream"].tolist()
    assert streams.count(10) == 2
    copies = [s for s in streams if s not in (10, 11, 12, 13)]
    assert len(copies) >= 4 and len(set(copies)) == len(copies)
