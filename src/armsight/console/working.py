"""What a page shows of work that moves the robot: how far it is, what it asks, why it ended."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from armsight.app.operator.job_runner import BackgroundJob, JobRunner
from armsight.console import texts
from armsight.console.layout import TICK_S, button, set_attribute, set_text, text_of


class Working:
    """The line of one kind of work; `ended` is called once its result is there, also of work found on loading."""

    def __init__(self, bench: JobRunner, name: str, ended: Callable[[BackgroundJob], None]) -> None:
        """Put it onto the page that is being built; name: of the work."""
        self._bench, self._name, self._ended = bench, name, ended
        self._shown: BackgroundJob | None = None
        self._browser = ui.context.client.id
        self._said = text_of("p", role="status", testid="work").classes("hint")
        with ui.element("div").classes("row") as self._asking:
            self._question = text_of("p")
            button(texts.YES, lambda: self._answer(yes=True), testid="yes")
            button(texts.NO, lambda: self._answer(yes=False), kind="act quiet")
        with ui.element("div").classes("row") as self._ending:
            button(texts.END_WORK, self._end, kind="act quiet", testid="end-work")
        ui.timer(TICK_S, self._tick)
        self._tick()

    def _work(self) -> BackgroundJob | None:
        return self._bench.named(self._name)

    def _answer(self, *, yes: bool) -> None:
        work = self._work()
        if work is not None:
            work.answer(yes, self._browser)

    def _end(self) -> None:
        work = self._work()
        if work is not None:
            work.cancel()

    def _tick(self) -> None:
        work = self._work()
        state = None if work is None else work.state
        self._asking.set_visibility(bool(state and state.question))
        self._ending.set_visibility(bool(state and state.running))
        if work is None or state is None:
            return
        set_text(self._question, state.question)
        if state.failure:
            set_text(self._said, texts.ENDED_WORK.format(why=state.failure))
        elif state.running and not state.question:
            told = texts.WORKING.format(note=state.note, done=state.done, total=state.total)
            set_text(
                self._said, f"{told if state.total else texts.UNDER_WAY.format(note=state.note)}. {texts.HOLD_TO_MOVE}"
            )
        else:
            set_text(self._said, "")
        set_attribute(self._said, "data-level", "bad" if state.failure else "good")
        if not state.running and work.result is not None and self._shown is not work:
            self._shown = work
            self._ended(work)
