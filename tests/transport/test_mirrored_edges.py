"""Bodies that stand on a plane: mirror images of their edges, and the body of twice the height in free air."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import log_edges
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport import tile
from soundspaces_sim.transport.diffraction import coherence
from soundspaces_sim.transport.diffraction.ends import End, View, point_end
from soundspaces_sim.transport.diffraction.mirrored_edges import real_wedges, sees_mirrored
from soundspaces_sim.transport.diffraction.passed_edges import EdgesOfScene
from soundspaces_sim.transport.diffraction.points import edges_of_scene
from soundspaces_sim.transport.diffraction.spectrum import wave_points
from soundspaces_sim.transport.diffraction.technique import SHADOW_BOUND
from soundspaces_sim.transport.arrivals.wedges import Wedges, edge_point
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.techniques import TECHNIQUES
from soundspaces_sim.transport.tile import Tile
from tests.rooms import plain, table
from tests.transport.boundary_elements import box
from tests.transport.edge_sweep import random_walk
from tests.transport.edge_walks import BANDS, SPEED, Walk
from tests.transport.test_edge_walks import CONFIG, scene_of

_BOX = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
_SIDES = np.array(
    [
        [0, 1, 5],
        [0, 5, 4],
        [1, 3, 7],
        [1, 7, 5],
        [3, 2, 6],
        [3, 6, 7],
        [2, 0, 4],
        [2, 4, 6],
        [4, 5, 7],
        [4, 7, 6],
    ]
)
_BOTTOM = np.array([[0, 3, 1], [0, 2, 3]])


def _on_a_floor(size: np.ndarray, at: np.ndarray, absorption: float = 0.1) -> ss.Scene:
    """A rigid box of `size` m with its least corner `at` m, open below if that is on the floor, 6 m square."""
    floor = np.array([[-3.0, -3.0, 0.0], [3.0, -3.0, 0.0], [3.0, 3.0, 0.0], [-3.0, 3.0, 0.0]])
    body = _SIDES if at[2] == 0.0 else np.concatenate([_SIDES, _BOTTOM])
    faces = np.concatenate([[[0, 1, 2], [0, 2, 3]], body + 4])
    vertices = np.concatenate([floor, at + size * _BOX])
    return ss.Scene(vertices, faces, np.zeros(len(faces), int), table(absorption, 0.0), name="box")


def _edges(scene: ss.Scene) -> EdgesOfScene:
    found = edges_of_scene(make_model(scene, np.array([[2.0, 2.0, 1.0]]), plain(diffraction=True)))
    assert found is not None
    return found


def _images(found: EdgesOfScene) -> tuple[Wedges, Wedges]:
    """(Edges that have images, their images)."""
    mirrored, count = found.mirrored, len(found.mirrored.start) - 1
    own = np.repeat(np.arange(count), np.diff(mirrored.start))
    return Wedges(*(c[own] for c in found.wedges)), Wedges(*(c[count:] for c in found.wedges))


def test_the_upper_edges_of_a_box_have_images_in_the_floor() -> None:
    """Those below and those that stand have none, nor has a box that hangs, be it 4 cm above the floor."""
    size = np.array([0.5, 0.4, 0.7])
    found = _edges(_on_a_floor(size, np.array([0.2, -0.1, 0.0])))
    edges, images = _images(found)
    assert len(edges.length) == 4
    assert len(real_wedges(found.wedges, found.mirrored).length) == len(found.wedges.length) - 4
    height = (
        found.sight.planes.offset[found.mirrored.plane]
        * found.sight.planes.normal[found.mirrored.plane][:, 2]
    )
    np.testing.assert_allclose(edges.start[:, 2] - height, 0.7, atol=1e-9)
    np.testing.assert_allclose(images.start[:, 2] - height, -0.7, atol=1e-9)
    np.testing.assert_allclose(images.start[:, :2], edges.start[:, :2], atol=1e-9)
    np.testing.assert_allclose(images.along, edges.along, atol=1e-9)
    np.testing.assert_array_equal(images.n, edges.n)
    hung = _edges(_on_a_floor(size, np.array([0.2, -0.1, 0.04])))
    assert len(hung.mirrored.plane) == 0
    for made in (found, hung):  # kernels have one version
        assert all(x.flags.c_contiguous for x in (*made.mirrored, *made.wedges))


def test_more_triangles_have_the_same_images() -> None:
    """Every triangle in four."""
    scene = _on_a_floor(np.array([0.5, 0.4, 0.7]), np.array([0.2, -0.1, 0.0]))
    corners = scene.vertices[scene.faces]
    middle = 0.5 * (corners + np.roll(corners, -1, axis=1))
    parts = [np.stack([corners[:, k], middle[:, k], middle[:, k - 1]], axis=1) for k in range(3)]
    finer = np.concatenate([*parts, middle])
    faces = np.arange(3 * len(finer)).reshape(-1, 3)
    fine = ss.Scene(finer.reshape(-1, 3), faces, np.zeros(len(faces), int), table(0.1, 0.0), name="fine")
    for a, b in zip(_images(_edges(scene))[1], _images(_edges(fine))[1], strict=True):
        np.testing.assert_array_equal(a, b)


@kernel
def _see(
    view: View, wedges: Wedges, mirrored: tuple[int, int], end: End, phi: float, share: np.ndarray
) -> bool:
    middle = 0.5 * wedges.length[mirrored[0]]
    seen: bool = sees_mirrored(view, wedges, mirrored, end, (middle, middle), phi, share)
    return seen


def test_what_the_plane_takes() -> None:
    """Of the way by the image from a point, two reflections; from the point's image, one, as of the way to the edge."""
    found = _edges(_on_a_floor(np.array([0.5, 0.4, 0.7]), np.array([0.2, -0.1, 0.0]), absorption=0.36))
    e = int(np.flatnonzero(np.diff(found.mirrored.start))[0])
    plane = int(found.mirrored.plane[found.mirrored.start[e]])
    at = np.array(edge_point.py_func(found.wedges, e, 0.5 * found.wedges.length[e]))
    normal = found.sight.planes.normal[plane]
    down = -normal * np.sign(at @ normal - found.sight.planes.offset[plane])
    first = found.wedges.face[e] @ down > 0.99
    phi = 0.0 if first else np.pi * found.wedges.n[e]
    second = found.wedges.normal[e], found.wedges.face[e]
    out = second[0] if first else -second[1]
    share = np.empty((2, 4))
    point = tuple(at + 1.2 * out + 0.3 * down)
    assert _see(found.sight, found.wedges, (e, plane), point_end.py_func(point), phi, share)
    np.testing.assert_allclose(share[0], 0.64**2, rtol=1e-6)
    image = _image(found.sight, plane, point)
    assert _see(found.sight, found.wedges, (e, plane), image, phi, share)
    np.testing.assert_allclose(share[0], 1.0, rtol=1e-6)
    behind = tuple(at - 1.2 * out + 0.3 * down)
    assert not _see(found.sight, found.wedges, (e, plane), point_end.py_func(behind), phi, share)


def _image(view: View, plane: int, point: Vec3) -> End:
    n = view.planes.normal[plane]
    x, y, z = np.array(point) - 2.0 * (np.array(point) @ n - view.planes.offset[plane]) * n
    return End((x, y, z), point, plane)


def _levels(
    walk: Walk, sources: list[tuple[float, float]], monkeypatch: pytest.MonkeyPatch
) -> np.ndarray:
    """(n, 4) dB of all sources together: of arrivals with their waves, before they are bounded, and scaled for a
    renderer."""
    places, f = walk.places(), walk.frequencies()
    listeners = np.column_stack([places[:, 0], np.zeros(len(places)), places[:, 1]])
    total = np.zeros((len(places), *f.shape), complex)
    edges, at = np.log(log_edges(BANDS)), wave_points()[0]
    edges[0] = edges[1] - np.log(2.0)
    found: list[coherence.TileArrivals] = []
    whole = coherence.tile_arrivals

    def keep(tile: Tile) -> coherence.TileArrivals:
        out = whole(tile)
        found.append(coherence.TileArrivals(*(column.copy() for column in out)))
        return out

    monkeypatch.setattr(coherence, "tile_arrivals", keep)
    for x, z in sources:
        source = np.array([[x, 0.0, z]])
        model = make_model(scene_of(walk), np.concatenate([source, listeners]), CONFIG)
        techniques = [t for t in TECHNIQUES if t is not SHADOW_BOUND]
        simulate_tile(model, source, listeners, techniques=techniques)
        pair, length, energy, wave = found.pop()
        for b in range(4):
            u = (2.0 * np.log(f[b]) - edges[b] - edges[b + 1]) / (edges[b + 1] - edges[b])
            parabolas = [
                np.prod([(u - at[m]) / (at[n] - at[m]) for m in range(3) if m != n], axis=0)
                for n in range(3)
            ]
            phase = np.exp(-2j * np.pi / SPEED * length[:, None] * f[b])
            size = np.sqrt(4.0 * np.pi * energy[:, b] * length)[:, None]
            np.add.at(total[:, b], pair, size * (wave[:, b] @ parabolas) * phase)
    return np.asarray(10.0 * np.log10((np.abs(total) ** 2).mean(axis=2)))


@pytest.mark.parametrize("seed", [2, 3])
def test_a_box_on_a_floor_is_one_of_twice_the_height(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In free air, with the source's image as a second source: along a walk from the shadow into the light no level is
    off by more than 0.1 dB, which is what paths below 30 dB may be. Without images of edges it was 2.0 dB."""
    walk = random_walk("cupboard", seed)
    (x, z), corners = walk.source, walk.bodies[0].corners
    (low, _), (high, top) = corners.min(axis=0), corners.max(axis=0)
    twice = walk._replace(bodies=[box(low, high, -top, top)], floor=False)
    own = _levels(walk, [(x, z)], monkeypatch)
    free = _levels(twice, [(x, z), (x, -z)], monkeypatch)
    assert np.abs(own - free).max() < 0.1, np.abs(own - free).max(axis=0)


def test_both_ways_are_the_same_to_the_bit() -> None:
    """Behind a box on a floor, where images of edges count."""
    scene = _on_a_floor(np.array([0.2, 5.0, 0.3]), np.array([0.0, -2.5, 0.0]))
    assert len(_edges(scene).mirrored.plane) == 2  # its ends are too short for edges
    z = np.array([0.1, 0.25, 0.6])
    before = np.column_stack([np.full(3, -1.0), [0.1, -0.4, 0.2], z])
    behind = np.column_stack([np.full(3, 0.9), [-0.1, 0.3, 0.0], z])
    points = np.concatenate([before, behind])
    echoes = ss.simulate(scene, points, points, plain(walks=16, diffraction=True))
    for s in range(6):
        for l in range(s):
            there, back = (
                sorted(e.arrivals, key=lambda a: (a.delay, a.energy.tolist()))
                for e in (echoes[s, l], echoes[l, s])
            )
            for a, b in zip(there, back, strict=True):
                assert a.delay == b.delay and (a.energy == b.energy).all()


def test_a_wall_does_what_a_floor_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same box, floor and points, turned so that the floor stands; points where they are, and not moved by their
    coordinates."""
    monkeypatch.setattr(tile, "in_general_position", lambda model, points: points - model.scene.center)
    scene = _on_a_floor(np.array([0.2, 5.0, 0.3]), np.array([0.0, -2.5, 0.0]))
    points = np.array([[-1.0, 0.1, 0.25], [0.9, -0.1, 0.2]])
    turned = ss.Scene(
        scene.vertices[:, [2, 0, 1]], scene.faces, scene.face_material, scene.materials, name="turned"
    )
    config = plain(walks=16, diffraction=True)
    own = ss.simulate(scene, points[:1], points[1:], config)[0, 0].early
    other = ss.simulate(turned, points[:1, [2, 0, 1]], points[1:, [2, 0, 1]], config)[0, 0].early
    assert len(own) == len(other) > 3
    for a, b in zip(own, other, strict=True):
        np.testing.assert_allclose(b.delay, a.delay, rtol=1e-9)
        np.testing.assert_allclose(b.energy, a.energy, rtol=1e-6)
