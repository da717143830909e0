"""The calls of the Python bindings' scripts: a mesh from a file, a source that goes over a grid, files of each pair."""

import os

import numpy as np
import rlr_audio_propagation.core
import soundfile
from rlr_audio_propagation import ChannelLayout, ChannelLayoutType, Config, Context

assert rlr_audio_propagation.core.Context is Context and rlr_audio_propagation.__version__.startswith(
    "0.0.1"
)
cfg = Config()
cfg.sample_rate = 16000.0
ctx = Context(cfg)
ctx.add_source()
ctx.set_source_radius(0, 0.1)
ctx.add_listener(ChannelLayout(ChannelLayoutType.Ambisonics, 4))
ctx.set_listener_radius(0, 0.1)
ctx.add_object()
ctx.set_object_position(0, [0, 0, 0])
ctx.set_object_mesh_ply(0, "mp3d/17DRP5sb8fy/17DRP5sb8fy_semantic.ply", "")
os.makedirs("output", exist_ok=True)
xs, ys = np.linspace(-10, 6, 3), np.linspace(-4, 4, 2)
loudest, kept = np.zeros((3, 2, 4)), np.zeros((3, 2))
for i, x in enumerate(xs):
    for j, y in enumerate(ys):
        ctx.set_source_position(0, np.array([x, y, 1.5]))
        ctx.set_listener_position(0, np.array([0, 1, 1]))
        ctx.simulate()
        ctx.write_ir_wave(0, 0, f"output/{x:.2f}_{y:.2f}.wav")
        ctx.write_ir_metrics(0, 0, f"output/{x:.2f}_{y:.2f}")
        audio = soundfile.read(f"output/{x:.2f}_{y:.2f}.wav")[0].T
        loudest[i, j] = np.abs(audio).max(axis=1)
        kept[i, j] = ctx.get_indirect_ray_efficiency()
assert (kept > 0.95).all() and (loudest[..., 0] > 0).all()
assert loudest[1, 0, 0] > loudest[0, 0, 0]  # nearer, and in the same room
