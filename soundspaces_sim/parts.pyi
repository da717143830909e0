"""The parts and where they live: read by type checkers, and by `parts.py` when it is imported."""

from .build.cores import use_cores
from .build.engines import (
    ENGINES,
    Engine,
    Options as EngineOptions,
    Task as TileTask,
    Watch as TaskWatch,
    refuse as refuse_task,
)
from .build.engines.capacity import choose_shape
from .build.forecast import forecast
from .build.warm_up import WarmUp, start as compile_ahead
from .build.worker import Done as TaskDone, work as work_tile
from .cli.console import DAMAGED, INTERRUPTED, Meter, run_app, size_text
from .cli.datasets import print_doubts
from .cli.options import (
    HrtfOption,
    ProfileOption,
    Read,
    RendererOption,
    ReplaceOption,
    check_file as check_file_option,
    check_folder,
    check_renderer_option,
    open_found,
    output_file,
    output_folder,
    read_settings,
    reported,
    shares,
    takes_scene,
)
from .core.config import DatasetConfig, check_rate, differences as config_differences
from .core.errors import EpisodeError
from .core.extras import install_hint, need as need_extras
from .core.interrupts import check as check_interrupts
from .core.io.files import cache_root, check_target, file_sha256, make_folder, publish as publish_file
from .core.io.hdf5 import (
    attribute,
    create_hdf5,
    in_our_words,
    open_hdf5,
    plain_dataset,
    read_numbers,
    written as written_hdf5,
)
from .core.io.resources import resource as packaged_file
from .core.io.sofa import data_delay, delayed
from .core.io.sound import mono, read_sound
from .core.io.untrusted import MOST_JSON, read_bytes, read_json, read_text, size_of as file_size
from .core.keywords import check_keywords, did_you_mean, nearest as nearest_name
from .core.limits import LEAST_DISTANCE, LONGEST as LONGEST_RESPONSE, require_within
from .core.memory import check_memory, free_memory
from .core.numerics.air import Air
from .core.numerics.axes import (
    CHANNELS as SECOND_ORDER_CHANNELS,
    DEGREE as HARMONIC_DEGREE,
    check_degrees,
    head_matrix,
    rotation_matrices,
    rotation_matrix,
    spherical_harmonics,
)
from .core.numerics.bands import (
    DEFAULT_BANDS,
    HIGHEST_OCTAVE,
    LOWEST as LOWEST_BAND,
    MOST_BANDS,
    PER_OCTAVE as BANDS_PER_OCTAVE,
    band_means,
    center_frequencies,
    check_edges,
    fractional_octaves,
    log_edges,
    nominal,
)
from .core.numerics.kernel import (
    kernel,
    over_rows,
    part as kernel_part,
    set_thread_count,
    thread_count,
)
from .core.numerics.rng import combine as combine_keys, point_keys
from .core.numerics.rows import unique_rows
from .core.numerics.target import code_target
from .core.numerics.threads import core_count, share_out
from .core.numerics.vec3 import (
    Vec3,
    distance as point_distance,
    dot as dot_product,
    length as vector_length,
    row as vector_row,
    subtract as subtract_vectors,
)
from .core.platforms import exclusive as exclusive_file, rename_open, reserve as reserve_file
from .core.processes import end_with, isolated_children, start_worker, worker_pool
from .core.profile import adopt as adopt_profile, here as profile_here, stage as profile_stage
from .core.registry import (
    Entry as TableEntry,
    check_name as check_entry_name,
    find as find_entry,
    names as entry_names,
    of_neighbour,
)
from .core.simulation_config import DEFAULT_WALKS, number_text, of_simulation
from .core.version import version_text
from .dataset.exporters.plan import (
    ExportPlan,
    Progress as ExportProgress,
    check_headings,
    choose_pairs,
    samples_of as response_samples_of,
)
from .dataset.exporters.points import HABITAT_HEIGHT, habitat_graph, points_text
from .dataset.exporters.wav import HEADER as WAV_HEADER, wav_bytes
from .dataset.format.card import CARDS, MAKER
from .dataset.format.collection_manifest import (
    CollectionManifest,
    Failure as CollectionFailure,
    beside as files_beside,
    collected as collected_dataset,
    write_collection,
)
from .dataset.format.echogram_shard import EchogramShard
from .dataset.format.floorplan import read_floorplan
from .dataset.format.manifest import (
    NAME as MANIFEST_NAME,
    FileEntry,
    Manifest,
    ShardEntry,
    read_manifest,
    rebuild_command,
)
from .dataset.format.shard import FAILED as FAILED_PAIR, Shard, is_valid as is_valid_shard
from .dataset.format.splits import SPLITS, read_splits, write_splits
from .dataset.format.table import Metadata as ColumnMetadata, as_frame as as_data_frame, write_table
from .dataset.format.writing import encode_echograms
from .dataset.labels import source_direction
from .dataset.sampling import (
    as_pairs,
    as_points as as_point_rows,
    check_pairs,
    for_each as for_each_pair,
    pairs_of_two,
)
from .dataset.stored import StoredResponses
from .dataset.undefined import undefined_times
from .echogram.closure import MOST_GAIN
from .echogram.directed import (
    aim as aim_directivity,
    departures as departure_directions,
    directed_table,
    gains as directivity_gains,
)
from .echogram.displaced import displaced
from .echogram.echogram import (
    EDGE as KIND_EDGE,
    EDGE_MIRROR as KIND_EDGE_MIRROR,
    KINDS as ARRIVAL_KINDS,
    MIRRORS as KIND_MIRRORS,
    MIRRORS_AND_BACK as KIND_MIRRORS_AND_BACK,
    direct_arrival,
    without_arrivals,
)
from .echogram.endpoints import Points as PointsLike
from .echogram.filters import (
    FLOOR as FILTER_FLOOR,
    air_left,
    air_spectrum,
    arrival_filters,
    band_shares,
    band_windows,
    left_after,
    log_steps,
    minimum_phase,
    sinc_table,
    white_noise,
)
from .echogram.low_response import (
    CHANNELS as LOW_CHANNELS,
    LEAD_S,
    LowResponse,
    band_gain as low_band_gain,
    lead_samples,
    response_rate,
    response_samples,
    sphere as direction_grid,
)
from .echogram.material_spread import (
    logit_reproducibility,
    logits,
    measure_jacobian,
    shares as absorption_shares,
    variety,
)
from .echogram.measure_errors import DIRECT_S
from .echogram.measure_names import MEASURES
from .echogram.measures import (
    BIN_S,
    LARGEST_ERROR as LARGEST_TIME_ERROR,
    RANGES,
    RoomMeasures,
    band_energies,
    decay_curve,
    echograms_measures,
    energy_measures,
    energy_ratios,
    first_loud,
    levels_of,
    reverberation_times,
    up_to as energy_up_to,
)
from .echogram.reflection_counts import MOST_RATIO, MaterialGroups, between_windows
from .echogram.refurnish import MOST_DB, Materials, closure_error_db, window_strength
from .layout.floor_plan import make_floorplan
from .layout.records import (
    KEPT as POINT_KEPT,
    NO_STANDING as POINT_NO_STANDING,
    OUTSIDE as POINT_OUTSIDE,
    TOO_CLOSE as POINT_TOO_CLOSE,
    UNREACHABLE as POINT_UNREACHABLE,
    FloorPlan,
    storeys_of,
)
from .nav.agents import BASELINES, Agent, Observation, oracle_action
from .nav.audio_sensor import RMS_AT_1_M, intensity as sound_intensity, seconds_of
from .nav.cache import BlockCache
from .nav.depth import check_scene, scene_of_dataset
from .nav.env import (
    Setting as EnvSetting,
    box as sensor_box,
    check_rates,
    open_sounds,
    state_info,
    wanted_episode,
)
from .nav.env_options import env_options
from .nav.episode_state import EpisodeState
from .nav.episodes import FOLDER as EPISODES_FOLDER, split_file, unpacked as unpacked_episodes
from .nav.evaluate import Interval, load_result, merge as merge_results
from .nav.generate import EpisodeMaker, Rules as EpisodeRules
from .nav.navigation_graph import FORWARD, HEADINGS, LEFT, RIGHT, STOP, heading_index
from .nav.sensor_table import POINTGOAL, pointgoal as pointgoal_reading
from .nav.sensors import SensorSuite
from .nav.sounds import DEFAULT as DEFAULT_SOUND
from .nav.synthetic_sounds import synthesise
from .nav.task import SLACK as SLACK_REWARD, SUCCESS as SUCCESS_REWARD, EarMode, TaskName, as_sensors
from .nav.views import (
    CAMERA_HEIGHT,
    check_size as check_picture_size,
    drawn_size,
    normalise as normalise_depth,
    shrink as shrink_views,
)
from .rendering.air import (
    hop_and_ring,
    hop_filters,
    through_air as response_through_air,
    without_air as response_without_air,
)
from .rendering.ambisonics import band_plans, pair_seed, response_length, transform_size, with_arrivals
from .rendering.auralise import as_mono, convolve as convolve_sound
from .rendering.binaural import decoder_transform
from .rendering.decoder import Equalisation, Method, decoder_filters, direction_filters
from .rendering.directivity import as_directivity
from .rendering.ears import NEAR_M, as_ears, near_field_gains
from .rendering.harmonics import harmonics_n3d, harmonics_sn3d, n3d_gains
from .rendering.higher_orders import WAVES as HIGH_ORDER_WAVES, check_order
from .rendering.hrtf import Hrtf
from .rendering.low_band import (
    above as above_edge,
    at_microphones as waves_at_microphones,
    below as waves_below,
    gain_above,
)
from .rendering.rendering import Rendering
from .rendering.seed_paper import band_noise
from .rendering.soundfield import Convention, convert as convert_ambisonics
from .rendering.synthesis import make_scratch, modulate as modulate_noise, place as place_responses
from .rendering.waves import (
    LANES as WAVE_LANES,
    WAVES as PLANE_WAVES,
    WaveField,
    shared_energy,
    turned_lattice,
)
from .scene.adopt import concatenate_parts
from .scene.enclosure import check_ends, check_inside, closedness
from .scene.formats.elsewhere import find_gibson, find_hm3d
from .scene.formats.gltf import (
    PLACES as GLTF_PLACES,
    Buffers as GltfBuffers,
    Tree as GltfTree,
    base_color as gltf_base_color,
    open_gltf,
    plain_gltf,
    read_uri as gltf_uri,
    view_of as gltf_view,
)
from .scene.formats.limits import (
    MOST_BYTES as MOST_SCENE_BYTES,
    check_corners,
    check_ply,
    open_mesh,
    parse_xml,
    ply_header,
    total_in_place,
    unpacked as unpacked_archive,
    xml_elements,
)
from .scene.formats.matterport import find_matterport
from .scene.formats.mesh import in_our_words as mesh_in_our_words, open_with_trimesh, read_mesh
from .scene.formats.obj import read_obj
from .scene.formats.octave_material import (
    OCTAVES as MATERIAL_OCTAVES,
    SCATTERING as MATERIAL_SCATTERING,
    octave_material,
)
from .scene.formats.ply import Elements as PlyElements, Lists as PlyLists, read_labelled_ply
from .scene.frame import UNITS as LENGTH_UNITS
from .scene.labelled import LabelledMesh, SceneFormat, label_rows
from .scene.materials import FREE, limit as limit_transmission, load_materials, overlay as overlay_tables
from .scene.porous_layers import mounted as mounted_layers
from .scene.rays.directions import INV_4PI
from .scene.rays.geometry import Geometry, cast_ray, unoccluded
from .scene.section import section
from .scene.storeys import floor_heights
from .scene.triangles import areas as triangle_areas
from .scene.walkable import (
    Columns as FloorColumns,
    find_floors,
    neighbours as neighbouring_cells,
    walk_straight,
)
from .transport.arrivals.images import beside_edge, bounce as mirror_bounce, image_of, reflection_point
from .transport.arrivals.prepared import prepare_planes, prepare_wedges
from .transport.arrivals.specular_planes import SpecularPlanes, group_planes
from .transport.arrivals.technique import DIRECT as DIRECT_SOUND
from .transport.arrivals.wedges import Wedges
from .transport.bsdf.impedance import flow_resistance, impedance as surface_impedance
from .transport.discrete_paths import SimulatedPaths
from .transport.integrator import simulate_tile
from .transport.low_method import installed as installed_low_method
from .transport.model import Model, PreparedScene, air_transmission
from .transport.preparation import at_points, prepare_scene
from .transport.simulate import as_points, model_between, simulate_between, simulate_pairs, with_notes
from .transport.tables import harmonics as harmonics_of_direction
from .transport.techniques import TECHNIQUES

__all__ = [
    "ARRIVAL_KINDS",
    "BANDS_PER_OCTAVE",
    "BASELINES",
    "BIN_S",
    "CAMERA_HEIGHT",
    "CARDS",
    "DAMAGED",
    "DEFAULT_BANDS",
    "DEFAULT_SOUND",
    "DEFAULT_WALKS",
    "DIRECT_S",
    "DIRECT_SOUND",
    "ENGINES",
    "EPISODES_FOLDER",
    "FAILED_PAIR",
    "FILTER_FLOOR",
    "FORWARD",
    "FREE",
    "GLTF_PLACES",
    "HABITAT_HEIGHT",
    "HARMONIC_DEGREE",
    "HEADINGS",
    "HIGHEST_OCTAVE",
    "HIGH_ORDER_WAVES",
    "INTERRUPTED",
    "INV_4PI",
    "KIND_EDGE",
    "KIND_EDGE_MIRROR",
    "KIND_MIRRORS",
    "KIND_MIRRORS_AND_BACK",
    "LARGEST_TIME_ERROR",
    "LEAD_S",
    "LEAST_DISTANCE",
    "LEFT",
    "LENGTH_UNITS",
    "LONGEST_RESPONSE",
    "LOWEST_BAND",
    "LOW_CHANNELS",
    "MAKER",
    "MANIFEST_NAME",
    "MATERIAL_OCTAVES",
    "MATERIAL_SCATTERING",
    "MEASURES",
    "MOST_BANDS",
    "MOST_DB",
    "MOST_GAIN",
    "MOST_JSON",
    "MOST_RATIO",
    "MOST_SCENE_BYTES",
    "NEAR_M",
    "PLANE_WAVES",
    "POINTGOAL",
    "POINT_KEPT",
    "POINT_NO_STANDING",
    "POINT_OUTSIDE",
    "POINT_TOO_CLOSE",
    "POINT_UNREACHABLE",
    "RANGES",
    "RIGHT",
    "RMS_AT_1_M",
    "SECOND_ORDER_CHANNELS",
    "SLACK_REWARD",
    "SPLITS",
    "STOP",
    "SUCCESS_REWARD",
    "TECHNIQUES",
    "WAVE_LANES",
    "WAV_HEADER",
    "Agent",
    "Air",
    "BlockCache",
    "CollectionFailure",
    "CollectionManifest",
    "ColumnMetadata",
    "Convention",
    "DatasetConfig",
    "EarMode",
    "EchogramShard",
    "Engine",
    "EngineOptions",
    "EnvSetting",
    "EpisodeError",
    "EpisodeMaker",
    "EpisodeRules",
    "EpisodeState",
    "Equalisation",
    "ExportPlan",
    "ExportProgress",
    "FileEntry",
    "FloorColumns",
    "FloorPlan",
    "Geometry",
    "GltfBuffers",
    "GltfTree",
    "Hrtf",
    "HrtfOption",
    "Interval",
    "LabelledMesh",
    "LowResponse",
    "Manifest",
    "MaterialGroups",
    "Materials",
    "Meter",
    "Method",
    "Model",
    "Observation",
    "PlyElements",
    "PlyLists",
    "PointsLike",
    "PreparedScene",
    "ProfileOption",
    "Read",
    "RendererOption",
    "Rendering",
    "ReplaceOption",
    "RoomMeasures",
    "SceneFormat",
    "SensorSuite",
    "Shard",
    "ShardEntry",
    "SimulatedPaths",
    "SpecularPlanes",
    "StoredResponses",
    "TableEntry",
    "TaskDone",
    "TaskName",
    "TaskWatch",
    "TileTask",
    "Vec3",
    "WarmUp",
    "WaveField",
    "Wedges",
    "above_edge",
    "absorption_shares",
    "adopt_profile",
    "aim_directivity",
    "air_left",
    "air_spectrum",
    "air_transmission",
    "arrival_filters",
    "as_data_frame",
    "as_directivity",
    "as_ears",
    "as_mono",
    "as_pairs",
    "as_point_rows",
    "as_points",
    "as_sensors",
    "at_points",
    "attribute",
    "band_energies",
    "band_means",
    "band_noise",
    "band_plans",
    "band_shares",
    "band_windows",
    "beside_edge",
    "between_windows",
    "cache_root",
    "cast_ray",
    "center_frequencies",
    "check_corners",
    "check_degrees",
    "check_edges",
    "check_ends",
    "check_entry_name",
    "check_file_option",
    "check_folder",
    "check_headings",
    "check_inside",
    "check_interrupts",
    "check_keywords",
    "check_memory",
    "check_order",
    "check_pairs",
    "check_picture_size",
    "check_ply",
    "check_rate",
    "check_rates",
    "check_renderer_option",
    "check_scene",
    "check_target",
    "choose_pairs",
    "choose_shape",
    "closedness",
    "closure_error_db",
    "code_target",
    "collected_dataset",
    "combine_keys",
    "compile_ahead",
    "concatenate_parts",
    "config_differences",
    "convert_ambisonics",
    "convolve_sound",
    "core_count",
    "create_hdf5",
    "data_delay",
    "decay_curve",
    "decoder_filters",
    "decoder_transform",
    "delayed",
    "departure_directions",
    "did_you_mean",
    "direct_arrival",
    "directed_table",
    "direction_filters",
    "direction_grid",
    "directivity_gains",
    "displaced",
    "dot_product",
    "drawn_size",
    "echograms_measures",
    "encode_echograms",
    "end_with",
    "energy_measures",
    "energy_ratios",
    "energy_up_to",
    "entry_names",
    "env_options",
    "exclusive_file",
    "file_sha256",
    "file_size",
    "files_beside",
    "find_entry",
    "find_floors",
    "find_gibson",
    "find_hm3d",
    "find_matterport",
    "first_loud",
    "floor_heights",
    "flow_resistance",
    "for_each_pair",
    "forecast",
    "fractional_octaves",
    "free_memory",
    "gain_above",
    "gltf_base_color",
    "gltf_uri",
    "gltf_view",
    "group_planes",
    "habitat_graph",
    "harmonics_n3d",
    "harmonics_of_direction",
    "harmonics_sn3d",
    "head_matrix",
    "heading_index",
    "hop_and_ring",
    "hop_filters",
    "image_of",
    "in_our_words",
    "install_hint",
    "installed_low_method",
    "is_valid_shard",
    "isolated_children",
    "kernel",
    "kernel_part",
    "label_rows",
    "lead_samples",
    "left_after",
    "levels_of",
    "limit_transmission",
    "load_materials",
    "load_result",
    "log_edges",
    "log_steps",
    "logit_reproducibility",
    "logits",
    "low_band_gain",
    "make_floorplan",
    "make_folder",
    "make_scratch",
    "measure_jacobian",
    "merge_results",
    "mesh_in_our_words",
    "minimum_phase",
    "mirror_bounce",
    "model_between",
    "modulate_noise",
    "mono",
    "mounted_layers",
    "n3d_gains",
    "near_field_gains",
    "nearest_name",
    "need_extras",
    "neighbouring_cells",
    "nominal",
    "normalise_depth",
    "number_text",
    "octave_material",
    "of_neighbour",
    "of_simulation",
    "open_found",
    "open_gltf",
    "open_hdf5",
    "open_mesh",
    "open_sounds",
    "open_with_trimesh",
    "oracle_action",
    "output_file",
    "output_folder",
    "over_rows",
    "overlay_tables",
    "packaged_file",
    "pair_seed",
    "pairs_of_two",
    "parse_xml",
    "place_responses",
    "plain_dataset",
    "plain_gltf",
    "ply_header",
    "point_distance",
    "point_keys",
    "pointgoal_reading",
    "points_text",
    "prepare_planes",
    "prepare_scene",
    "prepare_wedges",
    "print_doubts",
    "profile_here",
    "profile_stage",
    "publish_file",
    "read_bytes",
    "read_floorplan",
    "read_json",
    "read_labelled_ply",
    "read_manifest",
    "read_mesh",
    "read_numbers",
    "read_obj",
    "read_settings",
    "read_sound",
    "read_splits",
    "read_text",
    "rebuild_command",
    "reflection_point",
    "refuse_task",
    "rename_open",
    "reported",
    "require_within",
    "reserve_file",
    "response_length",
    "response_rate",
    "response_samples",
    "response_samples_of",
    "response_through_air",
    "response_without_air",
    "reverberation_times",
    "rotation_matrices",
    "rotation_matrix",
    "run_app",
    "scene_of_dataset",
    "seconds_of",
    "section",
    "sensor_box",
    "set_thread_count",
    "share_out",
    "shared_energy",
    "shares",
    "shrink_views",
    "simulate_between",
    "simulate_pairs",
    "simulate_tile",
    "sinc_table",
    "size_text",
    "sound_intensity",
    "source_direction",
    "spherical_harmonics",
    "split_file",
    "start_worker",
    "state_info",
    "storeys_of",
    "subtract_vectors",
    "surface_impedance",
    "synthesise",
    "takes_scene",
    "thread_count",
    "total_in_place",
    "transform_size",
    "triangle_areas",
    "turned_lattice",
    "undefined_times",
    "unique_rows",
    "unoccluded",
    "unpacked_archive",
    "unpacked_episodes",
    "use_cores",
    "variety",
    "vector_length",
    "vector_row",
    "version_text",
    "walk_straight",
    "wanted_episode",
    "wav_bytes",
    "waves_at_microphones",
    "waves_below",
    "white_noise",
    "window_strength",
    "with_arrivals",
    "with_notes",
    "without_arrivals",
    "work_tile",
    "worker_pool",
    "write_collection",
    "write_splits",
    "write_table",
    "written_hdf5",
    "xml_elements",
]
