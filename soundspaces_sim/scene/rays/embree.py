"""Ray casting: Embree scenes, and `intersect` / `occluded` that Numba kernels call directly.

`core.embree_library` finds Embree 4; its C entry points are looked up in the loaded library and registered with
LLVM, so that compiled kernels call Embree in parallel, without the GIL, and survive Numba's on-disk cache. The
Python classes of embreex are not used: their batch call returns arrays and does not scale with threads.

Conventions: metres, float32 inside Embree (RTCRay: 48 bytes, RTCHit: 32 bytes, see `rtcore_ray.h`);
a miss is `(inf, -1)`. Ray directions are unit vectors, so ray parameters are distances.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from soundspaces_sim.core.embree_library import load_embree
from soundspaces_sim.core.errors import SceneError

_INTERSECT_SYMBOL = "soundspaces_sim_rtcIntersect1"
_OCCLUDED_SYMBOL = "soundspaces_sim_rtcOccluded1"

# Values of Embree 4's public enums (rtcore_geometry.h, rtcore_buffer.h, rtcore_scene.h).
_GEOMETRY_TYPE_TRIANGLE = 0
_BUFFER_TYPE_INDEX = 0
_BUFFER_TYPE_VERTEX = 1
_FORMAT_UINT3 = 0x5003
_FORMAT_FLOAT3 = 0x9003
_SCENE_FLAG_ROBUST = 1 << 2
_BUILD_QUALITY_HIGH = 2


@cache
def _library() -> ctypes.CDLL:
    """Embree's C interface, with signatures."""
    library, _ = load_embree()
    pointer, unsigned, size = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "rtcNewDevice": (pointer, [ctypes.c_char_p]),
        "rtcReleaseDevice": (None, [pointer]),
        "rtcGetDeviceError": (ctypes.c_int, [pointer]),
        "rtcNewScene": (pointer, [pointer]),
        "rtcReleaseScene": (None, [pointer]),
        "rtcSetSceneFlags": (None, [pointer, ctypes.c_int]),
        "rtcSetSceneBuildQuality": (None, [pointer, ctypes.c_int]),
        "rtcNewGeometry": (pointer, [pointer, ctypes.c_int]),
        "rtcReleaseGeometry": (None, [pointer]),
        "rtcSetNewGeometryBuffer": (
            pointer,
            [pointer, ctypes.c_int, unsigned, ctypes.c_int, size, size],
        ),
        "rtcCommitGeometry": (None, [pointer]),
        "rtcAttachGeometry": (unsigned, [pointer, pointer]),
        "rtcCommitScene": (None, [pointer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _register(symbol: str, name: str) -> None:
    address = ctypes.cast(getattr(_library(), name), ctypes.c_void_p).value
    llvmlite.binding.add_symbol(symbol, address)


# Kernels loaded from Numba's cache refer to these names, so they must exist before any kernel does.
_register(_INTERSECT_SYMBOL, "rtcIntersect1")
_register(_OCCLUDED_SYMBOL, "rtcOccluded1")


@cache
def _device() -> int:
    # One build thread: the order of a parallel build must not decide which of two coplanar faces wins.
    device = _library().rtcNewDevice(b"threads=1,set_affinity=0")
    if not device:
        raise SceneError("Embree could not open a device on this machine")
    return int(device)


class RayScene:
    """A committed Embree scene of one triangle mesh: a resource, released when collected.

    Parameters
    ----------
    vertices : (V, 3) float, metres
    faces : (F, 3) int, rows of `vertices`

    `handle` is what kernels pass to `intersect` and `occluded`; it is valid while this object lives, or an
    array that it was `tied` to.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        library = _library()
        geometry = library.rtcNewGeometry(_device(), _GEOMETRY_TYPE_TRIANGLE)
        for kind, fmt, rows in (
            (_BUFFER_TYPE_VERTEX, _FORMAT_FLOAT3, np.ascontiguousarray(vertices, np.float32)),
            (_BUFFER_TYPE_INDEX, _FORMAT_UINT3, np.ascontiguousarray(faces, np.uint32)),
        ):
            buffer = library.rtcSetNewGeometryBuffer(geometry, kind, 0, fmt, 12, len(rows))
            if not buffer:
                raise SceneError(f"Embree refused a buffer of {len(rows)} rows (out of memory?)")
            ctypes.memmove(buffer, rows.ctypes.data, rows.nbytes)
        library.rtcCommitGeometry(geometry)
        self.handle: int = library.rtcNewScene(_device())
        library.rtcSetSceneFlags(self.handle, _SCENE_FLAG_ROBUST)
        library.rtcSetSceneBuildQuality(self.handle, _BUILD_QUALITY_HIGH)
        library.rtcAttachGeometry(self.handle, geometry)
        library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self.handle)
        error = library.rtcGetDeviceError(_device())
        if error:
            raise SceneError(f"Embree failed to build a scene of {len(faces)} triangles (error {error})")

    def tied(self, array: np.ndarray) -> np.ndarray:
        """The same array, which keeps this scene: records for kernels hold the handle, a mere number, beside
        it, and threads may run them longer than whoever started them stays."""
        return np.asarray(_Tie(array, self))

    def __deepcopy__(self, _: object) -> RayScene:
        """The same: a handle has one owner, which releases it once."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a RayScene is of this process; pickle the Scene, which makes its own")

    def __del__(self) -> None:
        handle = getattr(self, "handle", None)
        if handle:
            _library().rtcReleaseScene(handle)
            self.handle = 0


class _Tie:
    """Owner of an array's memory and of what must live as long."""

    def __init__(self, array: np.ndarray, scene: RayScene) -> None:
        self.__array_interface__ = array.__array_interface__
        self._kept = array, scene


def _word(builder: Any, words: Any, index: int, kind: Any) -> Any:
    address = cgutils.gep_inbounds(builder, words, 0, index)
    return builder.bitcast(address, kind.as_pointer())


def _call(context: Any, builder: Any, symbol: str, handle: Any, words: Any) -> None:
    pointer = ir.IntType(8).as_pointer()
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(ir.VoidType(), [pointer] * 3), symbol
    )
    null = ir.Constant(pointer, None)
    builder.call(function, [builder.inttoptr(handle, pointer), builder.bitcast(words, pointer), null])


def _as_float32(context: Any, builder: Any, signature: Any, arguments: Any) -> list[Any]:
    """Numbers, and the elements of tuples, as the floats that Embree reads."""
    floats = []
    for kind, value in zip(signature, arguments, strict=True):
        inner = isinstance(kind, types.BaseTuple)
        for k in range(len(kind)) if inner else [0]:
            element = builder.extract_value(value, k) if inner else value
            floats.append(context.cast(builder, element, kind[k] if inner else kind, types.float32))
    return floats


def _ray_on_stack(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write RTCRay: org, tnear, dir, time, tfar, mask, id, flags; `arguments`: origin, direction, tfar."""
    # 96 bytes hold RTCRayHit of every Embree 4 build (80, or 84 with instance arrays), 16-aligned.
    words = cgutils.alloca_once(builder, ir.ArrayType(ir.IntType(32), 24))
    words.align = 16
    ox, oy, oz, dx, dy, dz, far = _as_float32(context, builder, signature, arguments)
    zero = ir.Constant(ir.FloatType(), 0.0)
    for i, value in enumerate((ox, oy, oz, zero, dx, dy, dz, zero, far)):
        builder.store(value, _word(builder, words, i, ir.FloatType()))
    for i, bits in ((9, -1), (10, 0), (11, 0)):
        builder.store(ir.Constant(ir.IntType(32), bits), _word(builder, words, i, ir.IntType(32)))
    return words


@intrinsic
def intersect(
    typing_context: Any, handle: Any, origin: Any, direction: Any, limit: Any
) -> tuple[Any, Callable[..., Any]]:
    """Nearest hit of a ray within `limit`: (distance, triangle), or (inf, -1).

    Compiled code calls it with the `handle` of a `RayScene`, `origin` (x, y, z) in m, a unit `direction` and
    `limit` in m.
    """
    signature = types.Tuple((types.float64, types.int64))(types.int64, origin, direction, limit)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        words = _ray_on_stack(context, builder, sig.args[1:], args[1:])
        int32 = ir.IntType(32)
        for i in (17, 18, 19, 20):  # primID, geomID, instID, instPrimID: invalid until hit
            builder.store(ir.Constant(int32, -1), _word(builder, words, i, int32))
        _call(context, builder, _INTERSECT_SYMBOL, args[0], words)
        triangle = builder.sext(
            builder.load(_word(builder, words, 17, int32), typ=int32), ir.IntType(64)
        )
        far = builder.load(_word(builder, words, 8, ir.FloatType()), typ=ir.FloatType())
        distance = builder.fpext(far, ir.DoubleType())
        missed = builder.icmp_signed("<", triangle, ir.Constant(ir.IntType(64), 0))
        distance = builder.select(missed, ir.Constant(ir.DoubleType(), float("inf")), distance)
        return context.make_tuple(builder, sig.return_type, [distance, triangle])

    return signature, codegen


@intrinsic
def occluded(
    typing_context: Any, handle: Any, origin: Any, direction: Any, limit: Any
) -> tuple[Any, Callable[..., Any]]:
    """True if anything lies on a ray before `limit`; arguments as `intersect`."""
    signature = types.boolean(types.int64, origin, direction, limit)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        words = _ray_on_stack(context, builder, sig.args[1:], args[1:])
        _call(context, builder, _OCCLUDED_SYMBOL, args[0], words)
        far = builder.load(_word(builder, words, 8, ir.FloatType()), typ=ir.FloatType())
        zero = ir.Constant(ir.FloatType(), 0.0)
        return builder.fcmp_ordered("<", far, zero)  # Embree sets tfar = -inf on any hit

    return signature, codegen
