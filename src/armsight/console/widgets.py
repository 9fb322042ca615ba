"""Parts that several pages have: fields with checks, the progress of a job, and the keys that jog the robot."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.operator.job_runner import BackgroundJob, JobRunner
from armsight.app.operator.robot_cell import RobotCell
from armsight.console import texts
from armsight.console.layout import TICK_S, button, card, set_attribute, set_text, text_of
from armsight.errors import ArmsightError, UsageError
from armsight.units import DEG, MM

LARGEST = 1e6
"""Of any figure of a page, in its unit: mm, deg, mm/s, a count."""
LONGEST = 1000
"""Characters of a text: a source of frames is a path, of which systems take 4096 bytes."""


def number(field: ui.number, *, of: str = "", empty: float | None = None) -> float:
    """Return a field's number; empty: what an empty field means, None where it means nothing. of: whose field it is.

    Raises UsageError for what is no number, or not within the field's limits.
    """
    value = field.value
    name = " ".join(part for part in (of, str(field.props.get("label", ""))) if part)
    if value is None or value == "":
        if empty is None:
            raise _refused(texts.FIELD_EMPTY.format(field=name))
        return empty
    try:
        figure = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        raise _refused(texts.FIELD_NO_NUMBER.format(field=name, value=str(value)[:40])) from None
    low, high = max(float(field.min), -LARGEST), min(float(field.max), LARGEST)
    if not (math.isfinite(figure) and low <= figure <= high):
        raise _refused(texts.FIELD_BEYOND.format(field=name, value=figure, low=low, high=high))
    return figure


def whole_number(field: ui.number, *, of: str = "") -> int:
    """Return a field's whole number. Raises UsageError for another, and as number."""
    figure = number(field, of=of)
    if not figure.is_integer():
        raise _refused(texts.FIELD_NOT_WHOLE.format(field=str(field.props.get("label", "")), value=figure))
    return int(figure)


def text(field: Any) -> str:
    """Return a field's text without blanks about it, empty where it holds none.

    Raises UsageError for what is no text, is too long, or has signs in it that cannot be seen.
    """
    value = "" if field.value is None else field.value
    if not isinstance(value, str) or len(value) > LONGEST or not value.isprintable():
        raise _refused(texts.FIELD_NO_TEXT.format(field=field.props.get("label", "")))
    return value.strip()


def file_name(field: Any, kept: str = "") -> str:
    """Return the name of a file in the cell's folder, or below it; kept: what stands there already stays.

    Raises UsageError for a name that leads out of it, and as text.
    """
    name = text(field)
    path = Path(os.path.normpath(name))  # without following links, of which the folder may hold some
    if name != kept and (path.is_absolute() or os.pardir in path.parts):
        raise _refused(texts.FIELD_OUTSIDE.format(field=field.props.get("label", ""), value=name[:40]))
    return name


def ticked(box: Any) -> bool:
    """Return whether a box is ticked: true alone is."""
    return box.value is True


def _refused(cause: str) -> UsageError:
    return UsageError(cause, consequence=texts.FIELD_CONSEQUENCE, cure=texts.FIELD_CURE)


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


def jog_card(robot: RobotCell) -> None:
    """Put the jog keys onto the page that is being built."""
    keys = ui.element("div").classes("jog")
    joints: list[TextElement] = []

    def choose(frame: str) -> None:
        keys.clear()
        joints.clear()
        with keys:
            joints.extend(_keys(robot, frame))

    with card(texts.JOG):
        text_of("p", texts.JOG_HELP).classes("hint")
        with ui.element("div").classes("row"):
            for frame, title in texts.JOG_FRAMES.items():
                button(title, partial(choose, frame), kind="act quiet", testid=f"jog-{frame}")
        keys.move(ui.context.slot.parent)
    choose("joints")
    ui.timer(TICK_S, lambda: _show(robot, joints))


def _keys(robot: RobotCell, frame: str) -> list[TextElement]:
    """Return the labels that tell the joints' values; none where the tool is led."""
    description = robot.service.authority.robot
    joints = frame == "joints"
    names = [texts.JOG_JOINT.format(n=i + 1) for i in range(description.n_joints)] if joints else texts.JOG_AXES
    labels = []
    for axis, name in enumerate(names):
        with ui.element("div").classes("axis"):
            label = text_of("span", name)
            for sense, sign in ((-1, "−"), (1, "+")):
                key = text_of("button", sign, type="button").classes("key")
                said = texts.JOG_KEY.format(axis=name, sense=texts.JOG_SENSES[sense])
                key.props.update({"data-jog": f"{frame}:{axis}:{sense}", "aria-label": said, "aria-pressed": "false"})
            labels.append(label)
    return labels if joints else []


def _show(robot: RobotCell, labels: list[TextElement]) -> None:
    try:
        q = robot.joints() if labels else ()
    except ArmsightError:
        return
    arm = robot.session.arm
    for axis, (label, value) in enumerate(zip(labels, q, strict=True)):
        slides = arm is not None and not arm.revolute[axis]
        now = texts.SLIDE_NOW.format(value=value / MM) if slides else texts.JOINT_NOW.format(value=value / DEG)
        set_text(label, f"{texts.JOG_JOINT.format(n=axis + 1)}  {now}")
