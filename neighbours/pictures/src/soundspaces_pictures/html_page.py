"""HTML pages of templates: one file that loads nothing and runs no script."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from soundspaces_sim.parts import publish_file as publish


def write_page(template: Path, context: Mapping[str, Any], out: str | Path) -> None:
    """Write a template to the file `out`, whole or not at all.

    A name of the template that `context` lacks is an error of jinja2."""
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template.parent),
        autoescape=True,  # names come from files that others made
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    ).get_template(template.name)
    publish(Path(out), page.render(context).encode())
