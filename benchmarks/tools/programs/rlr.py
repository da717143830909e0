"""SoundSpaces 2.0's engine; its default is 5,000 rays. One mono response per pair, its fastest way."""

from __future__ import annotations

import itertools

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools import rlr
from benchmarks.tools.energies import LENGTH_S, RATE, of_waveforms
from benchmarks.tools.programs import Simulator

NAME, MODULE, UNIT = "rlr-audio-propagation", "rlr_audio_propagation", "rays"
SETTINGS = (250, 1000)
WAVEFORMS, BOXES_ONLY = True, False


def simulator(scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, setting: int) -> Simulator:
    """One source and one listener, moved from pair to pair. Its random numbers go on from run to run."""
    module = rlr.genuine()
    made = rlr.context(
        module, scene, setting, max_ir_length=LENGTH_S, sample_rate=float(RATE), thread_count=1
    )
    made.add_source()
    made.add_listener(module.ChannelLayout(module.ChannelLayoutType.Mono, 1))

    def simulate(_: int) -> list[np.ndarray]:
        responses = []
        for source, listener in itertools.product(sources, listeners):
            made.set_source_position(0, source.tolist())
            made.set_listener_position(0, listener.tolist())
            made.simulate()
            responses.append(np.array(made.get_ir_channel(0, 0, 0)))
        return responses

    return simulate


energies = of_waveforms
