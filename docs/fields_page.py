"""The tables of the page docs/fields.md: what every field of a shard means, from the schemas.

The site has them (`site_hooks.py`); `python -m docs.fields_page` prints them.
"""

from __future__ import annotations

from soundspaces_sim.dataset.format.schema import CURRENT, Form, schema


def field_tables() -> str:
    """Markdown: a heading and two tables for each form of shard."""
    return "\n".join(_form(form) for form in CURRENT)


def _form(form: Form) -> str:
    found = schema(form)
    lines = [f"## {form.capitalize()} shards, version {CURRENT[form]}", "", found["description"], ""]
    lines += ["| dataset | type | shape | unit | meaning |", "|---|---|---|---|---|"]
    for name, spec in found["datasets"].items():
        shape = " × ".join(str(n) for n in spec["shape"])
        lines.append(
            f"| `{name}` | {spec['dtype']} | {shape} | {spec.get('unit', '')} | {_cell(spec)} |"
        )
    lines += ["", "| attribute | type | meaning |", "|---|---|---|"]
    for name, spec in found["attributes"].items():
        lines.append(f"| `{name}` | {spec['type']} | {_cell(spec)} |")
    return "\n".join(lines) + "\n"


def _cell(spec: dict[str, object]) -> str:
    text = str(spec.get("description", ""))
    if "value" in spec:
        text += f"; always `{spec['value']}`"
    return text.replace("|", "\\|")


if __name__ == "__main__":
    print(field_tables(), end="")
