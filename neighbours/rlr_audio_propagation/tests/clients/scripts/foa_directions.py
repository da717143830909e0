"""The calls of the Python bindings' own test: six sources around a first-order listener in a box, which way each is.

Its box stands about the origin, so that the listener is exactly in a corner and three sources are outside. In a corner
direct and reflected sound come at once from opposite ways, and outside nobody hears what is inside; here the box
stands about the listener.
"""

import numpy as np
import trimesh
from rlr_audio_propagation import AMBISONICS_XYZ_INDEX, ChannelLayout, ChannelLayoutType, Config, Context

extent = np.array([6.0, 6.0, 6.0])
mesh = trimesh.creation.box(extents=extent)
mesh.invert()
ctx = Context(Config())
ctx.add_object()
ctx.add_mesh_vertices((mesh.vertices + extent / 2).flatten().tolist())
ctx.add_mesh_indices(mesh.faces.flatten().tolist(), 3, "default")
ctx.finalize_object_mesh(0)
ctx.add_listener(ChannelLayout(ChannelLayoutType.Ambisonics, 4))
ctx.set_listener_position(0, extent / 2)
sources = np.concatenate([np.eye(3), -np.eye(3)])
for i, source in enumerate(sources):
    ctx.add_source()
    ctx.set_source_position(i, source + extent / 2)
assert ctx.get_audio().shape == (1, 6, 0)
ctx.simulate()
audio = ctx.get_audio()
assert audio.shape[:-1] == (1, 6, 4) and ctx.get_channel_counts() == [[4] * 6]
for i, source in enumerate(sources):
    peaks = audio[0, i][np.arange(4), np.abs(audio[0, i]).argmax(axis=1)]
    found = np.zeros(4)
    found[np.abs(peaks).argmax()] = np.sign(peaks[np.abs(peaks).argmax()])
    assert (found[AMBISONICS_XYZ_INDEX] == source).all(), (source, peaks)
