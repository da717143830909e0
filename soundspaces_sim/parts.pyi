"""The parts and where they live: read by type checkers, and by `parts.py` when it is imported."""

from .build.engines import (
    ENGINES,
    Engine,
)
from .build.engines import (
    Options as EngineOptions,
)
from .build.engines import (
    Task as TileTask,
)
from .build.engines import (
    Watch as TaskWatch,
)
from .build.engines import (
    refuse as refuse_task,
)
from .build.engines.capacity import (
    choose_shape,
)
from .build.forecast import (
    forecast,
)
from .build.rooms import (
    ROOM_CONFIG,
    in_processes,
    room_named,
)
from .build.warm_up import (
    WarmUp,
)
from .build.warm_up import (
    start as compile_ahead,
)
from .build.worker import (
    Done as TaskDone,
)
from .build.worker import (
    work as work_tile,
)
from .cli.console import (
    DAMAGED,
    INTERRUPTED,
    Meter,
    run_app,
    size_text,
)
from .cli.options import (
    HrtfOption,
    ProfileOption,
    Read,
    RendererOption,
    ReplaceOption,
    check_folder,
    check_renderer_option,
    need_matplotlib,
    open_found,
    output_folder,
    read_settings,
    reported,
    shares,
    takes_scene,
)
from .core.config import (
    DatasetConfig,
    check_rate,
)
from .core.errors import (
    EpisodeError,
)
from .core.extras import (
    install_hint,
)
from .core.extras import (
    need as need_extras,
)
from .core.interrupts import (
    check as check_interrupts,
)
from .core.io.files import (
    cache_root,
    file_sha256,
    make_folder,
)
from .core.io.files import (
    publish as publish_file,
)
from .core.io.hdf5 import (
    attribute,
    create_hdf5,
    in_our_words,
    open_hdf5,
    plain_dataset,
    read_numbers,
)
from .core.io.hdf5 import (
    written as written_hdf5,
)
from .core.io.resources import (
    resource as packaged_file,
)
from .core.io.sofa import (
    data_delay,
    delayed,
)
from .core.io.sound import (
    mono,
    read_sound,
)
from .core.io.untrusted import (
    MOST_JSON,
    read_bytes,
    read_json,
    read_text,
)
from .core.keywords import (
    check_keywords,
)
from .core.keywords import (
    nearest as nearest_name,
)
from .core.limits import (
    LEAST_DISTANCE,
    require_within,
)
from .core.limits import (
    LONGEST as LONGEST_RESPONSE,
)
from .core.memory import (
    check_memory,
    free_memory,
)
from .core.numerics.air import (
    Air,
)
from .core.numerics.axes import (
    CHANNELS as SECOND_ORDER_CHANNELS,
)
from .core.numerics.axes import (
    check_degrees,
    head_matrix,
    rotation_matrices,
    rotation_matrix,
    spherical_harmonics,
)
from .core.numerics.bands import (
    DEFAULT_BANDS,
    MOST_BANDS,
    band_means,
    center_frequencies,
    check_edges,
    fractional_octaves,
    nominal,
)
from .core.numerics.kernel import (
    core_count,
    kernel,
    over_rows,
    set_thread_count,
    thread_count,
)
from .core.numerics.kernel import (
    part as kernel_part,
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
from .core.numerics.target import (
    code_target,
)
from .core.numerics.threads import (
    share_out,
)
from .core.numerics.vec3 import (
    Vec3,
)
from .core.numerics.vec3 import (
    distance as point_distance,
)
from .core.numerics.vec3 import (
    dot as dot_product,
)
from .core.numerics.vec3 import (
    length as vector_length,
)
from .core.numerics.vec3 import (
    row as vector_row,
)
from .core.numerics.vec3 import (
    subtract as subtract_vectors,
)
from .core.platforms import (
    exclusive as exclusive_file,
)
from .core.platforms import (
    rename_open,
)
from .core.processes import (
    end_with,
    isolated_children,
    worker_pool,
)
from .core.profile import (
    adopt as adopt_profile,
)
from .core.profile import (
    here as profile_here,
)
from .core.profile import (
    stage as profile_stage,
)
from .core.registry import (
    Entry as TableEntry,
)
from .core.registry import (
    check_name as check_entry_name,
)
from .core.registry import (
    find as find_entry,
)
from .core.registry import (
    names as entry_names,
)
from .core.simulation_config import (
    number_text,
    of_simulation,
)
from .dataset.exporters.plan import (
    ExportPlan,
    check_headings,
    choose_pairs,
)
from .dataset.exporters.plan import (
    Progress as ExportProgress,
)
from .dataset.exporters.plan import (
    samples_of as response_samples_of,
)
from .dataset.exporters.points import (
    HABITAT_HEIGHT,
    habitat_graph,
    points_text,
)
from .dataset.exporters.wav import (
    HEADER as WAV_HEADER,
)
from .dataset.exporters.wav import (
    wav_bytes,
)
from .dataset.format.card import (
    MAKER,
)
from .dataset.format.collection_manifest import (
    CollectionManifest,
    write_collection,
)
from .dataset.format.collection_manifest import (
    Failure as CollectionFailure,
)
from .dataset.format.collection_manifest import (
    beside as files_beside,
)
from .dataset.format.collection_manifest import (
    collected as collected_dataset,
)
from .dataset.format.echogram_shard import (
    EchogramShard,
)
from .dataset.format.floorplan import (
    read_floorplan,
)
from .dataset.format.manifest import (
    NAME as MANIFEST_NAME,
)
from .dataset.format.manifest import (
    FileEntry,
    ShardEntry,
    read_manifest,
)
from .dataset.format.shard import (
    FAILED as FAILED_PAIR,
)
from .dataset.format.shard import (
    Shard,
)
from .dataset.format.shard import (
    is_valid as is_valid_shard,
)
from .dataset.format.splits import (
    SPLITS,
    read_splits,
    write_splits,
)
from .dataset.format.writing import (
    encode_echograms,
)
from .dataset.labels import (
    source_direction,
)
from .dataset.room_parameters.registry import (
    PARAMETERS,
    check_parameters,
)
from .dataset.room_parameters.table import (
    ParameterTable,
)
from .dataset.sampling import (
    as_pairs,
    check_pairs,
    pairs_of_two,
)
from .dataset.sampling import (
    for_each as for_each_pair,
)
from .echogram.closure import (
    MOST_GAIN,
)
from .echogram.directed import (
    directed_table,
)
from .echogram.displaced import (
    displaced,
)
from .echogram.echogram import (
    EDGE as KIND_EDGE,
)
from .echogram.echogram import (
    EDGE_MIRROR as KIND_EDGE_MIRROR,
)
from .echogram.echogram import (
    KINDS as ARRIVAL_KINDS,
)
from .echogram.echogram import (
    MIRRORS as KIND_MIRRORS,
)
from .echogram.echogram import (
    MIRRORS_AND_BACK as KIND_MIRRORS_AND_BACK,
)
from .echogram.echogram import (
    direct_arrival,
    without_arrivals,
)
from .echogram.filters import (
    FLOOR as FILTER_FLOOR,
)
from .echogram.filters import (
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
from .echogram.low_measures import (
    LOW_MEASURES,
    has_octave,
    low_levels,
    low_measures,
    octaves_below,
)
from .echogram.low_response import (
    CHANNELS as LOW_CHANNELS,
)
from .echogram.low_response import (
    LEAD_S,
    LowResponse,
    lead_samples,
    response_rate,
    response_samples,
)
from .echogram.low_response import (
    band_gain as low_band_gain,
)
from .echogram.low_response import (
    sphere as direction_grid,
)
from .echogram.material_spread import (
    logit_reproducibility,
    logits,
    measure_jacobian,
    variety,
)
from .echogram.material_spread import (
    shares as absorption_shares,
)
from .echogram.measure_errors import (
    DIRECT_S,
)
from .echogram.measure_names import (
    MEASURES,
)
from .echogram.measures import (
    BIN_S,
    RANGES,
    band_energies,
    decay_curve,
    echograms_measures,
    energy_measures,
    first_loud,
    levels_of,
)
from .echogram.reflection_counts import (
    MOST_RATIO,
    MaterialGroups,
    between_windows,
)
from .echogram.refurnish import (
    MOST_DB,
    Materials,
    closure_error_db,
    window_strength,
)
from .layout.records import (
    storeys_of,
)
from .nav.agents import (
    BASELINES,
    Agent,
    Observation,
    oracle_action,
)
from .nav.audio_sensor import (
    RMS_AT_1_M,
    seconds_of,
)
from .nav.audio_sensor import (
    intensity as sound_intensity,
)
from .nav.cache import (
    BlockCache,
    LastUsed,
)
from .nav.depth import (
    check_scene,
    scene_of_dataset,
)
from .nav.env import (
    Setting as EnvSetting,
)
from .nav.env import (
    box as sensor_box,
)
from .nav.env import (
    check_rates,
    open_sounds,
    state_info,
    wanted_episode,
)
from .nav.env_options import (
    env_options,
)
from .nav.episode_state import (
    EpisodeState,
)
from .nav.episodes import (
    FOLDER as EPISODES_FOLDER,
)
from .nav.episodes import (
    split_file,
)
from .nav.episodes import (
    unpacked as unpacked_episodes,
)
from .nav.evaluate import (
    Interval,
    load_result,
)
from .nav.evaluate import (
    merge as merge_results,
)
from .nav.generate import (
    EpisodeMaker,
)
from .nav.generate import (
    Rules as EpisodeRules,
)
from .nav.map_page import (
    MapPage,
    draw_trail,
)
from .nav.navigation_graph import (
    FORWARD,
    HEADINGS,
    LEFT,
    RIGHT,
    STOP,
    heading_index,
)
from .nav.sensor_table import (
    POINTGOAL,
)
from .nav.sensor_table import (
    pointgoal as pointgoal_reading,
)
from .nav.sensors import (
    SensorSuite,
)
from .nav.sounds import (
    DEFAULT as DEFAULT_SOUND,
)
from .nav.synthetic_sounds import (
    synthesise,
)
from .nav.task import (
    SLACK as SLACK_REWARD,
)
from .nav.task import (
    SUCCESS as SUCCESS_REWARD,
)
from .nav.task import (
    EarMode,
    TaskName,
    as_sensors,
)
from .nav.views import (
    CAMERA_HEIGHT,
    drawn_size,
)
from .nav.views import (
    check_size as check_picture_size,
)
from .nav.views import (
    normalise as normalise_depth,
)
from .nav.views import (
    shrink as shrink_views,
)
from .rendering.air import (
    hop_and_ring,
    hop_filters,
)
from .rendering.ambisonics import (
    band_plans,
    pair_seed,
    response_length,
    transform_size,
)
from .rendering.binaural import (
    decoder_transform,
)
from .rendering.decoder import (
    Equalisation,
    Method,
    decoder_filters,
    direction_filters,
)
from .rendering.dry import (
    hand_clap,
    music,
    syllables,
)
from .rendering.ears import (
    NEAR_M,
    as_ears,
    near_field_gains,
)
from .rendering.harmonics import (
    harmonics_n3d,
    harmonics_sn3d,
    n3d_gains,
)
from .rendering.higher_orders import (
    WAVES as HIGH_ORDER_WAVES,
)
from .rendering.higher_orders import (
    check_order,
)
from .rendering.hrtf import (
    Hrtf,
)
from .rendering.low_band import (
    at_microphones as waves_at_microphones,
)
from .rendering.low_band import (
    below as waves_below,
)
from .rendering.low_band import (
    gain_above,
)
from .rendering.seed_paper import (
    band_noise,
)
from .rendering.smooth import (
    LANES as SMOOTH_LANES,
)
from .rendering.smooth import (
    continued as continued_decay,
)
from .rendering.smooth import (
    energies as smooth_energies,
)
from .rendering.smooth import (
    step_plans,
)
from .rendering.soundfield import (
    Convention,
)
from .rendering.soundfield import (
    convert as convert_ambisonics,
)
from .rendering.synthesis import (
    cut_frames,
    join_frames,
    make_scratch,
)
from .rendering.synthesis import (
    modulate as modulate_noise,
)
from .rendering.synthesis import (
    place as place_responses,
)
from .rendering.waves import (
    LANES as WAVE_LANES,
)
from .rendering.waves import (
    WAVES as PLANE_WAVES,
)
from .rendering.waves import (
    WaveField,
    shared_energy,
    turned_lattice,
)
from .scene.enclosure import (
    check_ends,
    check_inside,
    closedness,
)
from .scene.formats.limits import (
    check_ply,
    open_mesh,
    parse_xml,
    ply_header,
)
from .scene.formats.limits import (
    unpacked as unpacked_archive,
)
from .scene.formats.matterport import (
    find_matterport,
)
from .scene.formats.octave_material import (
    OCTAVES as MATERIAL_OCTAVES,
)
from .scene.formats.octave_material import (
    SCATTERING as MATERIAL_SCATTERING,
)
from .scene.formats.octave_material import (
    octave_material,
)
from .scene.formats.ply import (
    Elements as PlyElements,
)
from .scene.formats.ply import (
    Lists as PlyLists,
)
from .scene.formats.ply import (
    read_labelled_ply,
)
from .scene.frame import (
    UNITS as LENGTH_UNITS,
)
from .scene.labelled import (
    LabelledMesh,
    SceneFormat,
)
from .scene.materials import (
    FREE,
    load_materials,
)
from .scene.materials import (
    limit as limit_transmission,
)
from .scene.materials import (
    overlay as overlay_tables,
)
from .scene.porous_layers import (
    mounted as mounted_layers,
)
from .scene.rays.directions import (
    INV_4PI,
)
from .scene.rays.geometry import (
    Geometry,
    cast_ray,
    unoccluded,
)
from .scene.section import (
    section,
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
from .transport.arrivals.images import (
    beside_edge,
    image_of,
    reflection_point,
)
from .transport.arrivals.images import (
    bounce as mirror_bounce,
)
from .transport.arrivals.prepared import (
    prepare_planes,
    prepare_wedges,
)
from .transport.arrivals.specular_planes import (
    SpecularPlanes,
    group_planes,
)
from .transport.arrivals.technique import (
    DIRECT as DIRECT_SOUND,
)
from .transport.arrivals.wedges import (
    Wedges,
)
from .transport.bsdf.impedance import (
    flow_resistance,
)
from .transport.bsdf.impedance import (
    impedance as surface_impedance,
)
from .transport.discrete_paths import (
    SimulatedPaths,
)
from .transport.integrator import (
    simulate_tile,
)
from .transport.model import (
    Model,
    PreparedScene,
    air_transmission,
)
from .transport.preparation import (
    at_points,
    prepare_scene,
)
from .transport.simulate import (
    as_points,
    model_between,
    simulate_between,
    simulate_pairs,
    with_notes,
)
from .transport.techniques import (
    TECHNIQUES,
)
from .viz.html_page import (
    write_page,
)
from .viz.plan import (
    BLUE as PLOT_BLUE,
)
from .viz.plan import (
    VERMILION as PLOT_RED,
)
from .viz.report import (
    png,
)

__all__ = [
    "ARRIVAL_KINDS",
    "BASELINES",
    "BIN_S",
    "CAMERA_HEIGHT",
    "DAMAGED",
    "DEFAULT_BANDS",
    "DEFAULT_SOUND",
    "DIRECT_S",
    "DIRECT_SOUND",
    "ENGINES",
    "EPISODES_FOLDER",
    "FAILED_PAIR",
    "FILTER_FLOOR",
    "FORWARD",
    "FREE",
    "HABITAT_HEIGHT",
    "HEADINGS",
    "HIGH_ORDER_WAVES",
    "INTERRUPTED",
    "INV_4PI",
    "KIND_EDGE",
    "KIND_EDGE_MIRROR",
    "KIND_MIRRORS",
    "KIND_MIRRORS_AND_BACK",
    "LEAD_S",
    "LEAST_DISTANCE",
    "LEFT",
    "LENGTH_UNITS",
    "LONGEST_RESPONSE",
    "LOW_CHANNELS",
    "LOW_MEASURES",
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
    "NEAR_M",
    "PARAMETERS",
    "PLANE_WAVES",
    "PLOT_BLUE",
    "PLOT_RED",
    "POINTGOAL",
    "RANGES",
    "RIGHT",
    "RMS_AT_1_M",
    "ROOM_CONFIG",
    "SECOND_ORDER_CHANNELS",
    "SLACK_REWARD",
    "SMOOTH_LANES",
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
    "Geometry",
    "Hrtf",
    "HrtfOption",
    "Interval",
    "LabelledMesh",
    "LastUsed",
    "LowResponse",
    "MapPage",
    "MaterialGroups",
    "Materials",
    "Meter",
    "Method",
    "Model",
    "Observation",
    "ParameterTable",
    "PlyElements",
    "PlyLists",
    "PreparedScene",
    "ProfileOption",
    "Read",
    "RendererOption",
    "ReplaceOption",
    "SceneFormat",
    "SensorSuite",
    "Shard",
    "ShardEntry",
    "SimulatedPaths",
    "SpecularPlanes",
    "TableEntry",
    "TaskDone",
    "TaskName",
    "TaskWatch",
    "TileTask",
    "Vec3",
    "WarmUp",
    "WaveField",
    "Wedges",
    "absorption_shares",
    "adopt_profile",
    "air_left",
    "air_spectrum",
    "air_transmission",
    "arrival_filters",
    "as_ears",
    "as_pairs",
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
    "check_degrees",
    "check_edges",
    "check_ends",
    "check_entry_name",
    "check_folder",
    "check_headings",
    "check_inside",
    "check_interrupts",
    "check_keywords",
    "check_memory",
    "check_order",
    "check_pairs",
    "check_parameters",
    "check_picture_size",
    "check_ply",
    "check_rate",
    "check_rates",
    "check_renderer_option",
    "check_scene",
    "choose_pairs",
    "choose_shape",
    "closedness",
    "closure_error_db",
    "code_target",
    "collected_dataset",
    "combine_keys",
    "compile_ahead",
    "continued_decay",
    "convert_ambisonics",
    "core_count",
    "create_hdf5",
    "cut_frames",
    "data_delay",
    "decay_curve",
    "decoder_filters",
    "decoder_transform",
    "delayed",
    "direct_arrival",
    "directed_table",
    "direction_filters",
    "direction_grid",
    "displaced",
    "dot_product",
    "draw_trail",
    "drawn_size",
    "echograms_measures",
    "encode_echograms",
    "end_with",
    "energy_measures",
    "entry_names",
    "env_options",
    "exclusive_file",
    "file_sha256",
    "files_beside",
    "find_entry",
    "find_floors",
    "find_matterport",
    "first_loud",
    "floor_heights",
    "flow_resistance",
    "for_each_pair",
    "forecast",
    "fractional_octaves",
    "free_memory",
    "gain_above",
    "group_planes",
    "habitat_graph",
    "hand_clap",
    "harmonics_n3d",
    "harmonics_sn3d",
    "has_octave",
    "head_matrix",
    "heading_index",
    "hop_and_ring",
    "hop_filters",
    "image_of",
    "in_our_words",
    "in_processes",
    "install_hint",
    "is_valid_shard",
    "isolated_children",
    "join_frames",
    "kernel",
    "kernel_part",
    "lead_samples",
    "left_after",
    "levels_of",
    "limit_transmission",
    "load_materials",
    "load_result",
    "log_steps",
    "logit_reproducibility",
    "logits",
    "low_band_gain",
    "low_levels",
    "low_measures",
    "make_folder",
    "make_scratch",
    "measure_jacobian",
    "merge_results",
    "minimum_phase",
    "mirror_bounce",
    "model_between",
    "modulate_noise",
    "mono",
    "mounted_layers",
    "music",
    "n3d_gains",
    "near_field_gains",
    "nearest_name",
    "need_extras",
    "need_matplotlib",
    "neighbouring_cells",
    "nominal",
    "normalise_depth",
    "number_text",
    "octave_material",
    "octaves_below",
    "of_simulation",
    "open_found",
    "open_hdf5",
    "open_mesh",
    "open_sounds",
    "oracle_action",
    "output_folder",
    "over_rows",
    "overlay_tables",
    "packaged_file",
    "pair_seed",
    "pairs_of_two",
    "parse_xml",
    "place_responses",
    "plain_dataset",
    "ply_header",
    "png",
    "point_distance",
    "point_keys",
    "pointgoal_reading",
    "points_text",
    "prepare_planes",
    "prepare_scene",
    "prepare_wedges",
    "profile_here",
    "profile_stage",
    "publish_file",
    "read_bytes",
    "read_floorplan",
    "read_json",
    "read_labelled_ply",
    "read_manifest",
    "read_numbers",
    "read_settings",
    "read_sound",
    "read_splits",
    "read_text",
    "reflection_point",
    "refuse_task",
    "rename_open",
    "reported",
    "require_within",
    "response_length",
    "response_rate",
    "response_samples",
    "response_samples_of",
    "room_named",
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
    "smooth_energies",
    "sound_intensity",
    "source_direction",
    "spherical_harmonics",
    "split_file",
    "state_info",
    "step_plans",
    "storeys_of",
    "subtract_vectors",
    "surface_impedance",
    "syllables",
    "synthesise",
    "takes_scene",
    "thread_count",
    "transform_size",
    "turned_lattice",
    "unique_rows",
    "unoccluded",
    "unpacked_archive",
    "unpacked_episodes",
    "variety",
    "vector_length",
    "vector_row",
    "walk_straight",
    "wanted_episode",
    "wav_bytes",
    "waves_at_microphones",
    "waves_below",
    "white_noise",
    "window_strength",
    "with_notes",
    "without_arrivals",
    "work_tile",
    "worker_pool",
    "write_collection",
    "write_page",
    "write_splits",
    "written_hdf5",
]
