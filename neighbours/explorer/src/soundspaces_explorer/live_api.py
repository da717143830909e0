"""Requests about a live scene and their answers."""

from __future__ import annotations

from http import HTTPStatus

from soundspaces_explorer import live_payloads, payloads
from soundspaces_explorer.answers import (
    Answered,
    RefusedError,
    floats_answer,
    json_answer,
    number_in,
    sound_answer,
)
from soundspaces_explorer.job import JobMaker
from soundspaces_explorer.live import LiveScene, NotYetError

_WAIT_S = 5.0  # that an answer waits for a better estimate


class LiveSession:
    """A scene that is simulated while one listens, at `rate` Hz, and who writes jobs of it."""

    def __init__(self, scene: LiveScene, jobs: JobMaker, rate: int) -> None:
        self.scene, self.jobs, self.rate = scene, jobs, rate
        self._gives = {
            "scene": lambda _: json_answer(live_payloads.scene_of(scene, rate)),
            "cut": lambda query: json_answer(
                live_payloads.cut_of(scene, number_in(query, "y", 1e6, "metres"))
            ),
            "floor": lambda query: floats_answer(
                live_payloads.floor_of(scene, int(number_in(query, "storey", 1e3, "a storey")))
            ),
            "pair": self._pair,
            "response": self._response,
            "sounds": lambda _: json_answer({"sounds": list(payloads.SOUNDS)}),
            "sound": lambda query: sound_answer(rate, query),
            "forecast": lambda _: json_answer(jobs.forecast()),
        }

    def warm_up(self) -> None:
        """Make what the page asks for first, while a browser opens."""
        self.scene.warm_up(self.rate)
        payloads.sound(payloads.SOUNDS[0], self.rate)

    def answer(self, name: str, query: dict[str, str]) -> Answered:
        """To a question by its name. Raises `RefusedError`, `SoundSpacesSimError`."""
        if name not in self._gives:
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        return self._gives[name](query)

    def change(self, name: str, query: dict[str, str]) -> Answered:
        """``job``: write one. Raises `RefusedError`, `SoundSpacesSimError`."""
        if name != "job":
            raise RefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        chosen = live_payloads.question_of(self.scene, query).chosen
        return json_answer(self.jobs.write(number_in(query, "spacing", 1e3, "metres"), chosen))

    def _pair(self, query: dict[str, str]) -> Answered:
        question = live_payloads.question_of(self.scene, query)
        after = int(number_in(query, "after", 1e9, "a version"))
        try:
            answer = self.scene.ask(question, after, _WAIT_S)
        except NotYetError as error:
            return json_answer({"waiting": str(error)})
        return json_answer(live_payloads.answer_of(question, answer, self.scene.compiling))

    def _response(self, query: dict[str, str]) -> Answered:
        question = live_payloads.question_of(self.scene, query)
        heading = number_in(query, "heading", 3600.0, "degrees")
        try:
            answer = self.scene.ask(question)
        except NotYetError as error:
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from error
        return floats_answer(self.scene.ears(answer, heading, self.rate))
