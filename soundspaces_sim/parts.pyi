"""The parts and where they live: read by type checkers, and by `parts.py` when it is imported."""

from .core.config import (
    check_rate,
)
from .core.io.files import (
    publish as publish_file,
)
from .core.io.untrusted import (
    open_regular,
    read_json,
)
from .core.limits import (
    LONGEST as LONGEST_RESPONSE,
)
from .core.memory import (
    free_memory,
)
from .core.numerics.axes import (
    rotation_matrix,
    spherical_harmonics,
)
from .core.numerics.bands import (
    DEFAULT_BANDS,
    MOST_BANDS,
    center_frequencies,
)
from .core.numerics.kernel import (
    core_count,
    kernel,
    set_thread_count,
    thread_count,
)
from .core.numerics.rng import (
    combine as combine_keys,
)
from .core.numerics.rng import (
    point_keys,
)
from .core.numerics.rows import (
    unique_rows,
)
from .echogram.echogram import (
    direct_arrival,
)
from .echogram.filters import (
    arrival_filters,
    band_shares,
    band_windows,
)
from .rendering.ambisonics import (
    pair_seed,
    response_length,
)
from .rendering.decoder import (
    direction_filters,
)
from .rendering.harmonics import (
    harmonics_n3d,
)
from .rendering.soundfield import (
    convert as convert_ambisonics,
)
from .rendering.synthesis import (
    place as place_responses,
)
from .rendering.waves import (
    WAVES as PLANE_WAVES,
)
from .rendering.waves import (
    WaveField,
)
from .scene.enclosure import (
    check_inside,
    closedness,
)
from .scene.formats.limits import (
    check_ply,
    open_mesh,
)
from .scene.formats.matterport import (
    find_matterport,
)
from .scene.formats.ply import (
    Elements as PlyElements,
)
from .scene.formats.ply import (
    read_labelled_ply,
)
from .scene.frame import (
    UNITS as LENGTH_UNITS,
)
from .scene.materials import (
    limit as limit_transmission,
)
from .scene.materials import (
    overlay as overlay_tables,
)
from .scene.rays.directions import (
    INV_4PI,
)
from .scene.rays.geometry import (
    Geometry,
    cast_ray,
)
from .scene.storeys import (
    floor_heights,
)
from .scene.walkable import (
    Columns as FloorColumns,
)
from .scene.walkable import (
    find_floors,
    walk_straight,
)
from .scene.walkable import (
    neighbours as neighbouring_cells,
)
from .transport.arrivals.prepared import (
    prepare_planes,
)
from .transport.arrivals.specular_planes import (
    SpecularPlanes,
    group_planes,
)
from .transport.arrivals.technique import (
    DIRECT as DIRECT_SOUND,
)
from .transport.integrator import (
    simulate_tile,
)
from .transport.model import (
    PreparedScene,
    air_transmission,
)
from .transport.preparation import (
    at_points,
    prepare_scene,
)
from .transport.simulate import (
    simulate_pairs,
)

__all__ = [
    "DEFAULT_BANDS",
    "DIRECT_SOUND",
    "INV_4PI",
    "LENGTH_UNITS",
    "LONGEST_RESPONSE",
    "MOST_BANDS",
    "PLANE_WAVES",
    "FloorColumns",
    "Geometry",
    "PlyElements",
    "PreparedScene",
    "SpecularPlanes",
    "WaveField",
    "air_transmission",
    "arrival_filters",
    "at_points",
    "band_shares",
    "band_windows",
    "cast_ray",
    "center_frequencies",
    "check_inside",
    "check_ply",
    "check_rate",
    "closedness",
    "combine_keys",
    "convert_ambisonics",
    "core_count",
    "direct_arrival",
    "direction_filters",
    "find_floors",
    "find_matterport",
    "floor_heights",
    "free_memory",
    "group_planes",
    "harmonics_n3d",
    "kernel",
    "limit_transmission",
    "neighbouring_cells",
    "open_mesh",
    "open_regular",
    "overlay_tables",
    "pair_seed",
    "place_responses",
    "point_keys",
    "prepare_planes",
    "prepare_scene",
    "publish_file",
    "read_json",
    "read_labelled_ply",
    "response_length",
    "rotation_matrix",
    "set_thread_count",
    "simulate_pairs",
    "simulate_tile",
    "spherical_harmonics",
    "thread_count",
    "unique_rows",
    "walk_straight",
]
