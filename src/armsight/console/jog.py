"""Keys that move the robot while they are held: joints, or the tool along the base's axes or its own."""

from __future__ import annotations

from functools import partial

from nicegui import ui
from nicegui.elements.mixins.text_element import TextElement

from armsight.app.operator.robot_cell import RobotCell
from armsight.console import texts
from armsight.console.layout import TICK_S, button, card, set_text, text_of
from armsight.errors import ArmsightError
from armsight.units import DEG, MM


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
