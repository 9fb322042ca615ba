"""What is found on the bus when it is opened, and whether it is the arm that was asked for. Nothing is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from armsight.drivers.servo_bus.line import OPENING_S, Line
from armsight.drivers.servo_bus.settings import JointOfServo
from armsight.drivers.servo_bus.tables import STEPS, Family
from armsight.errors import DeviceFailed, DeviceNotFound

TRIES = 5
"""A question is asked so often before a servo is said not to answer."""
LOOKED = range(1, 13)
"""Ids under which a servo that does not answer is looked for: those of two arms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoFound:
    """One servo's own settings: range in steps, infinite where it has none; least volts and most heat, as its table."""

    lowest: float
    highest: float
    least_volts: int
    most_heat: int


def found(line: Line, family: Family, joints: Sequence[JointOfServo], baud: int, name: str) -> list[ServoFound]:
    """Return the servos of joints; name: the robot's. Raises DeviceNotFound for one that is silent, DeviceFailed."""
    start, size = family.fixed
    told: dict[int, bytes] = {}
    for joint in joints:
        question = family.packets.read(joint.id, start, size)
        for _ in range(TRIES):
            if answer := line.heard(question, [joint.id], size, OPENING_S).get(joint.id):
                told[joint.id] = answer.data
                break
    if missing := [joint for joint in joints if joint.id not in told]:
        raise _absent(line, family, joints, missing, baud, name)
    _check_alone(line, family, joints, name)
    return [_right(family, joint, told[joint.id], name) for joint in joints]


def _absent(
    line: Line, family: Family, joints: Sequence[JointOfServo], missing: list[JointOfServo], baud: int, name: str
) -> DeviceNotFound:
    for joint in missing:
        ping, size = family.packets.ping(joint.id), 0 if family.tick is None else 3
        if all(line.garbled(ping, size) for _ in range(3)):
            return _not_alone(joint, name)
    if len(missing) == len(joints):
        for i, other in enumerate(family.bauds):
            if other != baud:
                line.at(other)
                if any(_answers(line, family, joint.id, more=i) for joint in joints[:2]):
                    return DeviceNotFound(
                        f"{name}: its servos talk at {other} baud, and this link is set to {baud}",
                        cure=f"Give --robot-set baud={other}",
                    )
        return DeviceNotFound(
            f"{name}: no servo answers, at {baud} baud or any other",
            cure="Switch the arm's own supply on (USB does not feed servos), and check the port and the servos' cable",
        )
    words = ", ".join(joint.called for joint in missing)
    asked = [joint.id for joint in joints]
    others = [id for id in LOOKED if id not in asked and _answers(line, family, id)]
    there = [str(joint.id) for joint in joints if joint not in missing]
    beside = f"; not asked for, but there: {', '.join(map(str, others))}" if others else ""
    return DeviceNotFound(
        f"{name}: {words} {'does' if len(missing) == 1 else 'do'} not answer, and {', '.join(there)} "
        f"{'does' if len(there) == 1 else 'do'}{beside}",
        cure="Check the cable before the first that is missing, its id, or give the ids of this arm (--robot-set ids=)",
    )


def _answers(line: Line, family: Family, id: int, more: int = 0) -> bool:
    """Tell whether a servo answers; more: bytes that are asked for beside its model, so that no late answer counts."""
    start, size = family.model.at, family.model.size + more
    return bool(line.heard(family.packets.read(id, start, size), [id], size, OPENING_S))


def _check_alone(line: Line, family: Family, joints: Sequence[JointOfServo], name: str) -> None:
    """Refuse an id that two servos have: their settings are alike and read as one, their positions are not."""
    start, size = family.state
    for joint in joints:
        question = family.packets.read(joint.id, start, size)
        if not any(line.heard(question, [joint.id], size, OPENING_S) for _ in range(TRIES)):
            raise _not_alone(joint, name)


def _not_alone(joint: JointOfServo, name: str) -> DeviceNotFound:
    return DeviceNotFound(
        f"{name}: what answers as {joint.called} is garbled: two servos have this id, or the line is disturbed",
        consequence="The robot is not opened: both would move as one",
        cure="Connect the servos one at a time, and give each its own id",
    )


def _right(family: Family, joint: JointOfServo, data: bytes, name: str) -> ServoFound:
    """Return a servo's settings. Raises DeviceFailed where it cannot be driven, or is not that of the file."""

    def wrong(why: str, cure: str) -> DeviceFailed:
        return DeviceFailed(f"{name}: {joint.called} {why}", cure=cure)

    def of(field: str) -> int:
        return int(getattr(family, field).of(data, family.fixed[0]))

    if (model := of("model")) not in family.models:
        known = ", ".join(f"{text} ({number})" for number, text in family.models.items())
        raise wrong(f"is of model {model}, whose table is not known", f"Known are: {known}")
    if (mode := of("mode")) not in family.right_modes:
        raise wrong(
            f"is in mode {mode} ({family.modes.get(mode, 'unknown')}), in which a goal is no position",
            "Set it to position mode",
        )
    lowest, highest = of("lowest"), of("highest")
    if joint.noted is not None:
        _check_file(joint, (of("offset"), lowest, highest), wrong)
    if mode != family.right_modes[0]:
        return ServoFound(
            lowest=-float("inf"), highest=float("inf"), least_volts=of("least_volts"), most_heat=of("most_heat")
        )
    if not lowest < highest:
        lowest, highest = 0, STEPS - 1
    return ServoFound(
        lowest=float(lowest), highest=float(highest), least_volts=of("least_volts"), most_heat=of("most_heat")
    )


def _check_file(joint: JointOfServo, own: tuple[int, int, int], wrong: Callable[[str, str], DeviceFailed]) -> None:
    """Raise DeviceFailed where the calibration file is not that of this servo, which keeps what was found for it."""
    words = ("homing offset", "lowest position", "highest position")
    off = [
        f"{word} {here} and by the file {noted}"
        for word, here, noted in zip(words, own, joint.noted or own, strict=True)
        if here != noted
    ]
    if off:
        raise wrong(
            f"is not that of the calibration file: {'; '.join(off)}",
            "Give the file of this arm, or calibrate it again in LeRobot, which writes both",
        )
