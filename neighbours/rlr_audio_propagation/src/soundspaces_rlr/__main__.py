"""`python -m soundspaces_rlr SCRIPT [ARGUMENT …]`: run a client's script as it is.

`rlr_audio_propagation`, `habitat_sim` and, where it is not installed, `magnum` are those of this package in it.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from soundspaces_rlr import habitat, install
from soundspaces_rlr.errors import RlrError


def main() -> int:
    """Run the script that the command line names; 2 if there is none or a genuine package is in the way."""
    if len(sys.argv) < 2 or not Path(sys.argv[1]).is_file():
        found = f"no file {sys.argv[1]!r}" if len(sys.argv) > 1 else "no script given"
        print(f"{found}; usage: python -m soundspaces_rlr SCRIPT [ARGUMENT …]", file=sys.stderr)
        return 2
    try:
        install()
        habitat.install()
    except RlrError as error:
        print(error, file=sys.stderr)
        return 2
    del sys.argv[0]
    sys.path[0] = str(Path(sys.argv[0]).resolve().parent)  # as the interpreter has it for a script
    runpy.run_path(sys.argv[0], run_name="__main__")
    return 0


if __name__ == "__main__":
    sys.exit(main())
