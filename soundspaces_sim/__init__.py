"""Room-impulse-response datasets by bidirectional path tracing, from a mesh to a reader.

    import soundspaces_sim as ss
    scene = ss.load_scene("demo")
    echoes = ss.simulate(scene, sources, listeners)
    rir = ss.ambisonic_rir(echoes[0, 0], rate=44100)
    ears = ss.binaural_rir(rir, rate=44100, heading_deg=90.0)
    ds = ss.open_dataset("out/demo")

Conventions: SI units, right-handed axes, Z up; see docs/conventions.md. Names are loaded when they are
first used: reading a dataset imports neither the renderer nor the tracer.
"""

import lazy_loader

from soundspaces_sim.core.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
