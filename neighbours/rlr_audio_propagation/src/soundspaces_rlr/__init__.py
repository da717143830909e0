"""The Python interface of Meta's RLRAudioPropagation (`rlr_audio_propagation` 0.0.1) over this engine.

    import soundspaces_rlr
    soundspaces_rlr.install()      # from here on `import rlr_audio_propagation` is this package
    from rlr_audio_propagation import Config, Context

`api` holds the names; README.md says what is different and why. `habitat` has the audio sensor of
habitat-sim over the same context.
"""

from __future__ import annotations

import logging
import sys

from soundspaces_rlr import api
from soundspaces_rlr.identity import NAME, VERSION, announce, genuine_version

_log = logging.getLogger(__name__)


def install(*, shadow: bool = False) -> None:
    """Put `soundspaces_rlr.api` under the module name `rlr_audio_propagation` in this process.

    `importlib.metadata.version("rlr_audio_propagation")` then says `0.0.1+soundspaces`. Call it before anything
    imports that name. Raises `RlrError` (a RuntimeError) if another module of the name has been imported already:
    its classes would live on in the modules that hold them; and if the genuine package is installed, unless
    `shadow` says that it is to be hidden in this process, which is logged.
    """
    present = sys.modules.get(NAME)
    if present is not None and getattr(present, "Context", None) is not api.Context:
        raise api.RlrError(
            f"{NAME} has been imported already, from {getattr(present, '__file__', 'elsewhere')}; call "
            "soundspaces_rlr.install() before the first import of it"
        )
    if present is not None:
        announce()
        return
    genuine = genuine_version()
    if genuine is not None and not shadow:
        raise api.RlrError(
            f"{NAME} {genuine} is installed and would be hidden; uninstall it, or call "
            "soundspaces_rlr.install(shadow=True) to have this engine answer in its place"
        )
    if genuine is not None:
        _log.warning("%s %s is installed; in this process %s answers", NAME, genuine, VERSION)
    announce()
    sys.modules[NAME] = sys.modules[f"{NAME}.core"] = api
    vars(api)["core"] = api  # the original keeps its Python half in a module of that name
