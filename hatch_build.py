"""Puts the commit that a wheel or a source archive is built from into it: soundspaces_sim/core/commit.txt."""

import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_PLACE = "soundspaces_sim/core/commit.txt"


class CommitHook(BuildHookInterface):  # type: ignore[type-arg, misc]
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Of a checkout git's words; a source archive has the file already. An editable install asks git anew."""
        if version == "editable" or (Path(self.root) / _PLACE).is_file():
            return
        command = [
            "git",
            "-C",
            self.root,
            "describe",
            "--always",
            "--dirty",
            "--abbrev=12",
            "--exclude=*",
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True)
        except OSError:
            return
        if done.returncode == 0:
            file = Path(self.directory) / "commit.txt"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(done.stdout)
            build_data["force_include"][str(file)] = _PLACE
