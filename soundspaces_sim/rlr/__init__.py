"""The Python interface of Meta's RLRAudioPropagation (`rlr_audio_propagation` 0.0.1) over this engine.

    import soundspaces_sim.rlr
    soundspaces_sim.rlr.install()      # from here on `import rlr_audio_propagation` is this package
    from rlr_audio_propagation import Config, Context

`api` holds the names; docs/rlr.md says what is different and why. `habitat` has the audio sensor of
habitat-sim over the same context.
"""

from __future__ import annotations

import sys

NAME = "rlr_audio_propagation"


def install() -> None:
    """Put `soundspaces_sim.rlr.api` under the module name `rlr_audio_propagation` in this process.

    Call it before anything imports that name. Raises `RlrError` (a RuntimeError) if another module of the
    name has been imported already: its classes would live on in the modules that hold them.
    """
    from soundspaces_sim.rlr import api

    present = sys.modules.get(NAME)
    if present is not None and getattr(present, "Context", None) is not api.Context:
        raise api.RlrError(
            f"{NAME} has been imported already, from {getattr(present, '__file__', 'elsewhere')}; call "
            "soundspaces_sim.rlr.install() before the first import of it"
        )
    sys.modules[NAME] = api
