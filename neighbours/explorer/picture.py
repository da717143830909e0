"""docs/figures/explorer.png: the explorer on a dataset, as Chromium shows it.

    make rirs && .venv/bin/python neighbours/explorer/picture.py out/demo docs/figures/explorer.png

To be made anew whenever the engine's numbers change; needs Chromium.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
from pathlib import Path

from PIL import Image
from soundspaces_explorer.server import ExplorerServer

import soundspaces_sim as ss

_SIZE = 1280, 920


def main(dataset: str, out: str) -> None:
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("Chromium is not installed: no picture is made")
    with ss.open_dataset(dataset, 16000) as ds, ExplorerServer({ds.scene: ds}) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        size = f"--window-size={_SIZE[0]},{_SIZE[1]}"
        command = [
            browser,
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            size,
            "--virtual-time-budget=20000",
        ]
        target = Path(out).resolve()
        subprocess.run([*command, f"--screenshot={target}", server.url], check=True, timeout=120)
        server.shutdown()
    picture = Image.open(target).convert("P", palette=Image.Palette.ADAPTIVE, colors=128)
    picture.save(target, optimize=True)  # a third of the size


if __name__ == "__main__":
    main(*sys.argv[1:])
