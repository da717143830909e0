"""What to install for what is optional."""

from __future__ import annotations


def install_hint(extra: str) -> str:
    """The command that installs an extra: of a clone, since the package is on no index."""
    return f"`pip install -e '.[{extra}]'` in a clone of soundspaces_sim"
