"""The calls of makers of sets for localisation: a repaired mesh, four capsules 6 cm about a point, several sources."""

import numpy as np
import trimesh
from rlr_audio_propagation import ChannelLayout, ChannelLayoutType, Config, Context

mesh = trimesh.load("data/scene_datasets/gibson/Oyens.glb", force="mesh")
mesh = trimesh.Trimesh(vertices=mesh.vertices.copy(), faces=mesh.faces.copy())
trimesh.repair.fix_normals(mesh)
cfg = Config()
ctx = Context(cfg)
ctx.add_object()
ctx.add_mesh_vertices(mesh.vertices.flatten().tolist())
ctx.add_mesh_indices(mesh.faces.flatten().tolist(), 3, "default")
ctx.finalize_object_mesh(0)
center, angles = np.array([2.0, 1.4, 1.0]), np.radians([(55, 45), (125, 315), (125, 135), (55, 225)])
around = 0.06 * np.array([[np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)] for t, p in angles])
for i, mic in enumerate(center + around):
    ctx.add_listener(ChannelLayout(ChannelLayoutType.Mono, 1))
    ctx.set_listener_position(i, mic.tolist())
places = [np.array([-1.0, 1.2, -2.0]), np.array([6.0, 1.6, 3.0])]
for i, place in enumerate(places):
    ctx.add_source()
    ctx.set_source_position(i, place.tolist())
ctx.simulate()
assert ctx.get_indirect_ray_efficiency() > 0.95
responses = []
for source in range(2):
    channels = [np.array(ctx.get_ir_channel(l, source, 0)) for l in range(4)]
    assert all(len(c) == ctx.get_ir_sample_count(l, source) for l, c in enumerate(channels))
    longest = max(map(len, channels))
    responses.append(np.array([np.pad(c, (0, longest - len(c))) for c in channels]))
    onsets = [np.flatnonzero(c)[0] for c in channels]
    exact = np.linalg.norm(center + around - places[source], axis=1) / 343 * cfg.sample_rate
    assert np.abs(np.array(onsets) - exact).max() < 12
