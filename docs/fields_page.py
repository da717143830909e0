"""The page docs/fields.md, made from the schemas: what every field of a shard means.

python -m docs.fields_page > docs/fields.md
"""

from __future__ import annotations

from soundspaces_sim.dataset.format.schema import CURRENT, Form, schema

_HEAD = """\
# Fields of a dataset

Made from [data_schema/](../data_schema) by `python -m docs.fields_page`. A dataset is
a folder with `manifest.json` (which shards there are, their bytes and SHA-256, points, navigation graph,
configuration) and shards, HDF5 files with the pairs of some sources (S) and some listeners (L). Pair (s, l) of a
shard is source `source_index[s]`, listener `listener_index[l]`. Versions that are written now are shown; older
ones are in data_schema/ and are read too.

## One pair with plain h5py

```python
import json, pathlib
import h5py, numpy as np

folder, source, listener = pathlib.Path("out/demo"), 3, 0
manifest = json.loads((folder / "manifest.json").read_text())
entry = next(
    e
    for e in manifest["shards"]
    if e["form"] == "echogram"
    and e["sources"][0] <= source < e["sources"][1]
    and e["listeners"][0] <= listener < e["listeners"][1]
)
with h5py.File(folder / entry["file"]) as f:
    s, l = source - entry["sources"][0], listener - entry["listeners"][0]
    steps = f["energy"][s, l].astype(float)  # (T, B)
    energy = (
        f["energy_peak"][s, l] * 10 ** ((steps - 255) * f.attrs["energy_step_db"] / 10) * (steps > 0)
    )
    moments = energy[:, :, None] * f["moments"][s, l] / 127  # (T, B, 8): ambisonic channels 1 to 8
    pair = s * f["listener_position"].shape[0] + l
    early = slice(*f["early_start"][pair : pair + 2])
    total = energy.sum(axis=0) + f["direct_energy"][s, l] + f["early_energy"][early].sum(axis=0)
    print(f["band_edges"][:], total, f["relative_error"][s, l])
```

Text attributes are UTF-8 of fixed length, which h5py gives as bytes: `f.attrs["scene"].decode()`.

## One pair in MATLAB

`h5read` reverses the order of dimensions and counts from one. GNU Octave gives the same arrays by
`x = load('-hdf5', file)` (`x.energy`); for attributes it needs its package hdf5oct.

```matlab
file = 'out/demo/s00000_l00000.h5'; s = 4; l = 1;            % source 3, listener 0 of the shard
steps = double(h5read(file, '/energy'));                     % (B, T, L, S)
peak = h5read(file, '/energy_peak');                         % (L, S)
step_db = h5readatt(file, '/', 'energy_step_db');
q = steps(:, :, l, s);
energy = peak(l, s) * 10 .^ ((q - 255) * step_db / 10) .* (q > 0);   % (B, T), J/m2
time_edges = h5read(file, '/time_edges');
```
"""


def fields_page() -> str:
    """The whole page, Markdown."""
    parts = [_HEAD]
    for form in CURRENT:
        parts.append(_form(form))
    return "\n".join(parts)


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
    print(fields_page(), end="")
