"""Parts of pages that move the robot: how far its work is, and keys that jog it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.operator.job_runner import BackgroundJob, JobRunner
from armsight.app.operator.robot_cell import RobotCell
from armsight.console import texts
from armsight.console.layout import TICK_S, button, card, say, set_text, text_of
from armsight.console.routes import page_name
from armsight.errors import ArmsightError
from armsight.units import DEG, MM


class Working:
    """The line of one kind of work; `ended` is called once its result is there, also of work found on loading."""

    def __init__(self, jobs: JobRunner, name: str, ended: Callable[[BackgroundJob], None]) -> None:
        """Put it onto the page that is being built; name: of the work."""
        self._jobs, self._name, self._ended = jobs, name, ended
        self._shown: BackgroundJob | None = None
        self._browser = page_name()
        self._said = text_of("p", role="status", testid="work").classes("hint")
        with ui.element("div").classes("row") as self._asking:
            self._question = text_of("p")
            button(texts.YES, lambda: self._answer(yes=True), testid="yes")
            button(texts.NO, lambda: self._answer(yes=False), kind="act quiet")
        with ui.element("div").classes("row") as self._ending:
            button(texts.END_WORK, self._end, kind="act quiet", testid="end-work")
        ui.timer(TICK_S, self._tick)
        self._tick()

    def _job(self) -> BackgroundJob | None:
        return self._jobs.named(self._name)

    def _answer(self, *, yes: bool) -> None:
        job = self._job()
        if job is not None:
            job.answer(yes, self._browser)

    def _end(self) -> None:
        job = self._job()
        if job is not None:
            job.cancel()

    def _tick(self) -> None:
        job = self._job()
        self._asking.set_visibility(bool(job and job.question))
        self._ending.set_visibility(bool(job and job.running))
        if job is None:
            return
        set_text(self._question, job.question)
        words, (done, total, note) = "", job.newest
        if job.failure:
            words = texts.ENDED_WORK.format(why=job.failure)
        elif job.running and not job.question:
            progress = texts.UNDER_WAY.format(note=note)
            if total:
                progress = texts.WORKING.format(note=note, done=done, total=total)
            words = f"{progress}. {texts.HOLD_TO_MOVE}"
        say(self._said, words, "bad" if job.failure else "good")
        if not job.running and job.result is not None and self._shown is not job:
            self._shown = job
            self._ended(job)


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
