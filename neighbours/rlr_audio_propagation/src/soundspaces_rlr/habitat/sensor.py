"""`AudioSensor`: one source, one listener, the response between them, with habitat-sim's method names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from soundspaces_rlr.arguments import vector3
from soundspaces_rlr.context import Context
from soundspaces_rlr.errors import RlrError
from soundspaces_rlr.habitat.node import Node
from soundspaces_rlr.habitat.records import AudioSensorSpec, to_habitat
from soundspaces_rlr.habitat.rotations import as_wxyz
from soundspaces_rlr.records import Ray, band_edges
from soundspaces_sim import Scene
from soundspaces_sim.parts import band_shares

_DEFAULT = "default"  # category of what has no label
_SOURCE, _LISTENER = 0, 0


class AudioSensor:
    """A listener with the layout of its specification.

    A simulator calls `setAudioListenerTransform` and `runSimulation`; clients `setAudioSourceTransform` and
    `setAudioMaterialsJSON`. Raises `RlrError` (a RuntimeError) with what is missing.
    """

    def __init__(self, spec: AudioSensorSpec) -> None:
        self._spec = spec
        spec.channelLayout.layout()  # what cannot be simulated is refused here
        self.node = Node()
        self._runs = -1  # as habitat counts: the first simulation is number 0
        self._source: list[float] | None = None
        self._materials: str | None = None
        self._hrtf: str | None = None
        self.reset()

    @property
    def uuid(self) -> str:
        """Its name."""
        return self._spec.uuid

    def specification(self) -> AudioSensorSpec:
        """What it was made of."""
        return self._spec

    def reset(self) -> None:
        """Forget the scene, the listener and the response; source and materials stay."""
        self._context: Context | None = None
        self._scene: tuple[object, bool, str | None] | None = None
        self._ir: np.ndarray | None = None

    def setAudioSourceTransform(self, sourcePos: Any) -> None:  # noqa: N802, N803
        """Put the source at a position (3,) m in the world."""
        self._source = vector3(sourcePos, "setAudioSourceTransform")

    def setAudioListenerTransform(self, agentPos: Any, agentRotQuat: Any) -> None:  # noqa: N802, N803
        """Put the listener at a position (3,) m in the world, turned by [w, x, y, z]."""
        if self._context is None:
            self._context = Context(self._spec.acousticsConfig.config())
            self._context.add_listener(self._spec.channelLayout.layout())
            if self._hrtf is not None:
                self._context.set_listener_hrtf(_LISTENER, self._hrtf)
        self._context.set_listener_position(_LISTENER, agentPos)
        self._context.set_listener_orientation_quaternion(_LISTENER, agentRotQuat)
        self._runs += 1

    def setAudioMaterialsJSON(self, jsonPath: str) -> None:  # noqa: N802, N803
        """Take materials from this database (the format of RLR) from the next simulation on; without one all is
        of the default material."""
        self._materials = str(jsonPath)

    def setListenerHRTF(self, hrtfPath: str) -> None:  # noqa: N802, N803
        """Hear through the HRTF of a SOFA file (SimpleFreeFieldHRIR) from the next simulation on. Raises `RlrError`
        for one that cannot be read."""
        self._hrtf = str(hrtfPath)
        if self._context is not None:
            self._context.set_listener_hrtf(_LISTENER, self._hrtf)

    def runSimulation(self, sim: Any) -> None:  # noqa: N802
        """Simulate in `sim.scene`, a `Scene`. The scene goes to the engine once, and after it has changed."""
        if self._context is None:
            raise RlrError("runSimulation: there is no listener; call setAudioListenerTransform first")
        if self._source is None:
            raise RlrError("runSimulation: there is no source; call setAudioSourceTransform first")
        config = self._spec.acousticsConfig
        labelled = config.enableMaterials and self._spec.enableMaterials and self._materials is not None
        if (
            self._scene is None
            or self._scene[0] is not sim.scene
            or self._scene[1:] != (labelled, self._materials)
        ):
            self._context.clear_objects()
            if self._materials is not None:
                self._context.set_material_database_json(self._materials)
            _upload(self._context, sim.scene, labelled)
            self._scene = (sim.scene, labelled, self._materials)
        if self._context.get_source_count() == 0:
            self._context.add_source()
        self._context.set_source_position(_SOURCE, self._source)
        self._context.simulate()
        self._ir = self._context.get_listener_source_audio(_LISTENER, _SOURCE).astype(np.float32)
        self._write(self._ir)

    def getIR(self) -> np.ndarray:  # noqa: N802
        """(channels, samples) float32 of the last simulation."""
        if self._ir is None:
            raise RlrError("getIR: nothing has been simulated; call runSimulation first")
        return self._ir

    def get_observation(self, sim: Any) -> np.ndarray:
        """Simulate in `sim` from where the node is; (channels, samples) float32."""
        self.setAudioListenerTransform(
            self.node.absolute_translation, as_wxyz(self.node.rotation, "AudioSensor.node.rotation")
        )
        self.runSimulation(sim)
        return self.getIR()

    def sourceIsVisible(self) -> bool:  # noqa: N802
        """Whether nothing of the scene lies between source and listener of the last simulation."""
        context = self._simulated("sourceIsVisible")
        listener, source = context.places(_LISTENER, _SOURCE)
        if np.array_equal(listener, source):
            return True
        ray = Ray(listener.tolist(), (source - listener).tolist(), 0.0, 1.0)
        context.trace_ray_any_hit(ray)
        return not ray.hit

    def getRayEfficiency(self) -> float:  # noqa: N802
        """Share of rays from the listener that do not escape from the scene, 0 to 1."""
        return self._simulated("getRayEfficiency").get_indirect_ray_efficiency()

    def writeIRWave(self, wavePath: str) -> bool:  # noqa: N802, N803
        """Write the response of the last simulation as a float32 WAV file; True, or `RlrError`."""
        self._simulated("writeIRWave").write_ir_wave(_LISTENER, _SOURCE, str(wavePath))
        return True

    def writeSceneMeshOBJ(self, objPath: str) -> bool:  # noqa: N802, N803
        """Write the scene of the last simulation, habitat's axes, m, as an OBJ file; True, or `RlrError`."""
        self._simulated("writeSceneMeshOBJ").write_scene_mesh_obj(str(objPath))
        return True

    def _simulated(self, what: str) -> Context:
        if self._context is None or self._ir is None:
            raise RlrError(f"{what}: nothing has been simulated; call runSimulation first")
        return self._context

    def _write(self, ir: np.ndarray) -> None:
        """What the configuration wants on disk, in the folder of this simulation."""
        config = self._spec.acousticsConfig
        if not (config.writeIrToFile or config.dumpWaveFiles):
            return
        folder = Path(f"{self._spec.outputDirectory}{self._runs}")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if config.writeIrToFile:
                for c, channel in enumerate(ir):
                    rows = "".join(f"{i}\t{value:.9g}\n" for i, value in enumerate(channel))
                    (folder / f"ir{c}.txt").write_text(rows, encoding="utf-8")
            if config.dumpWaveFiles:
                for b, part in enumerate(_bands(ir, config.frequencyBands, config.sampleRate)):
                    path = folder / f"ir_band{b}.wav"
                    soundfile.write(path, part.T, config.sampleRate, subtype="FLOAT", format="WAV")
        except (OSError, soundfile.SoundFileError) as error:
            raise RlrError(f"{folder}: cannot write the response there ({error})") from error


def _bands(ir: np.ndarray, count: int, rate: int) -> list[np.ndarray]:
    """(C, n) float32 of each band, without phase; together they are the response up to the highest edge."""
    n = ir.shape[1]
    spectrum = np.fft.rfft(ir, 2 * n)
    shares = band_shares(band_edges(count), np.fft.rfftfreq(2 * n, 1.0 / rate), rate)
    return [np.fft.irfft(spectrum * share)[:, :n].astype(np.float32) for share in shares]


def _upload(context: Context, scene: Scene, labelled: bool) -> None:
    """Give a context a scene in habitat's axes, with its labels as categories."""
    context.add_object()
    context.add_mesh_vertices(to_habitat(scene.vertices).ravel().tolist())
    rows = scene.face_label if labelled else np.full(len(scene.faces), -1)
    for row in np.unique(rows):
        name = scene.labels[row] if row >= 0 else _DEFAULT
        context.add_mesh_indices(scene.faces[rows == row].ravel().tolist(), 3, name)
    context.finalize_object_mesh(context.get_object_count() - 1)
