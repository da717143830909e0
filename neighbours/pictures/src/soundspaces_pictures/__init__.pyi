"""The public names and where they live."""

from .decay import draw_decay
from .field import draw_error, draw_field, interpolate
from .listen import listening_folder
from .lobes import draw_lobes, lobe
from .plan import draw_map, draw_plan
from .plot_data import dataset_subject, default_source
from .printed import as_printed, save_printed
from .report import write_report
from .response import draw_spectrogram, draw_waveform

__all__ = [
    "as_printed",
    "dataset_subject",
    "default_source",
    "draw_decay",
    "draw_error",
    "draw_field",
    "draw_lobes",
    "draw_map",
    "draw_plan",
    "draw_spectrogram",
    "draw_waveform",
    "interpolate",
    "listening_folder",
    "lobe",
    "save_printed",
    "write_report",
]
