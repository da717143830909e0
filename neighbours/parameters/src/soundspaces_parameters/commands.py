"""`soundspaces-sim parameters`: room-acoustic parameters of a dataset, in octaves or thirds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from soundspaces_parameters.registry import SUFFIXES
from soundspaces_parameters.speech import Speech
from soundspaces_sim import ConfigError, open_dataset
from soundspaces_sim.parts import HrtfOption, Meter, ReplaceOption, output_file, print_doubts

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

SpeechOption = Annotated[
    float, typer.Option(help="Speech transmission: A-weighted level of speech at 1 m, dB.")
]
NoiseOption = Annotated[
    str | None,
    typer.Option(
        help="Speech transmission: noise at the listener, dB, seven octaves from 125 Hz: a,b,c,d,e,f,g."
    ),
]


def speech_of(level_db: float, noise: str | None) -> Speech:
    """The `Speech` of both options. Raises `ConfigError`."""
    try:
        levels = None if noise is None else tuple(float(x) for x in noise.split(","))
    except ValueError:
        raise ConfigError(f"--noise {noise}: expected seven numbers with commas between them") from None
    return Speech(level_db, levels)


@app.command()
def parameters(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write, .csv, .xlsx or .parquet; by default in the dataset's folder."),
    ] = None,
    thirds: Annotated[
        bool, typer.Option("--thirds", help="Per third of an octave, not per octave.")
    ] = False,
    names: Annotated[
        str | None, typer.Option(help="Which ones, with commas, as in t30,c80,sti; by default all.")
    ] = None,
    source: Annotated[
        list[int] | None, typer.Option(help="Only of this source; may be repeated.")
    ] = None,
    listener: Annotated[
        list[int] | None, typer.Option(help="Only at this listener; may be repeated.")
    ] = None,
    speech_level: SpeechOption = 60.0,
    noise: NoiseOption = None,
    hrtf: HrtfOption = None,
    waves: Annotated[
        bool,
        typer.Option(
            "--waves", help="Below the edge of waves, those of the waves; their errors are NaN."
        ),
    ] = False,
    replace: ReplaceOption = False,
) -> None:
    """Write room-acoustic parameters of pairs (ISO 3382, IEC 60268-16), with error bars."""
    chosen = None if names is None else tuple(x.strip() for x in names.split(","))
    path = output_file(out, "parameters.csv", dataset, SUFFIXES, replace)
    speech = speech_of(speech_level, noise)
    with open_dataset(dataset, hrtf=hrtf) as ds:
        every = range(len(ds.points))
        sources, listeners = (every if ends is None else ends for ends in (source, listener))
        pairs = [(s, l) for s in sources for l in listeners if s != l]
        if not pairs:
            raise ConfigError("--source, --listener: expected at least one pair of two points")
        with Meter("Parameters") as meter:
            meter.stage(f"Parameters of {len(pairs):,} pairs")
            bands = "thirds" if thirds else "octaves"
            found = ds.parameters(
                chosen, bands, pairs, speech=speech, waves=waves, progress=meter.update
            )
    written = found.write(path)
    print(f"Wrote {' and '.join(str(path) for path in written)}: {len(pairs):,} pairs")
    print_doubts(ds.manifest)
