"""PyTorch without CUDA: prints the arguments with which pip installs it, `--extra-index-url URL torch==VERSION`.

    python3 pipelines/torch_cpu.py [--index URL]

The newest CPU build (torch …+cpu; on macOS the plain one) is taken from the indexes that pip is configured
with, and from `--index` where that answers. A build with CUDA brings several GB that a machine without a GPU
cannot use. Where no index has a CPU build, one line says so, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import urllib.error
import urllib.request

INDEX = "https://download.pytorch.org/whl/cpu"
_WAIT_S = 10.0


def cpu_version(listing: str, platform: str = sys.platform) -> str:
    """The newest CPU build in the output of ``pip index versions torch``; newest first there.

    Raises `LookupError` where it has none.
    """
    found = re.search(r"^Available versions: (.+)$", listing, re.MULTILINE)
    versions = [v.strip() for v in found.group(1).split(",")] if found else []
    wanted = versions if platform == "darwin" else [v for v in versions if v.endswith("+cpu")]
    if not wanted:
        raise LookupError(f"no CPU build of PyTorch on any index ({len(versions)} other versions)")
    return wanted[0]


def reachable(url: str) -> bool:
    """Whether a server answers, in whatever way, within some seconds."""
    try:
        with urllib.request.urlopen(urllib.request.Request(url, method="HEAD"), timeout=_WAIT_S):
            return True
    except urllib.error.HTTPError:
        return True
    except (urllib.error.URLError, OSError):
        return False


def arguments(python: str = sys.executable, index: str = INDEX) -> list[str]:
    """Arguments of ``pip install`` for the CPU build, as the pip of `python` finds it.

    Raises `LookupError` where no index has one.
    """
    more = ["--extra-index-url", index] if reachable(index) else []
    command = [
        python,
        "-P",
        "-m",
        "pip",
        "--disable-pip-version-check",
        "index",
        "versions",
        "torch",
        *more,
    ]
    listing = subprocess.run(command, text=True, capture_output=True).stdout
    return [*more, f"torch=={cpu_version(listing)}"]


def main() -> int:
    """Print the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--index", default=INDEX)
    try:
        print(*arguments(index=parser.parse_args().index))
    except LookupError as why:
        print(f"{why}; make nav TORCH=default takes the build that pip prefers", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
