"""Drivers of bus servos against their twins: the contract of robots, what is found at opening, broken answers."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.contracts.servo_pairs import KINDS, ServoPair

from armsight.drivers import RobotState, RobotTraits
from armsight.drivers.servo_bus import robot as robot_module
from armsight.drivers.servo_bus.packets import DynamixelPackets, StsPackets
from armsight.errors import BadFile, DeviceFailed, DeviceNotFound, UsageError
from armsight.kinematics import Arm, Joint
from armsight.ops.robot.opening import LinkArm
from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController
from armsight_sim.twins.servo_bus import BusFault
from refusals import refuses

STEP = math.tau / 4096


@pytest.fixture(params=list(KINDS))
def make(request: Any) -> Iterator[Callable[..., ServoPair]]:
    pairs: list[ServoPair] = []

    def one(**more: Any) -> ServoPair:
        pairs.append(ServoPair(request.param, **more))
        return pairs[-1]

    yield one
    for pair in pairs:
        pair.close()


class TestContract(RobotContract):
    @pytest.fixture(autouse=True)
    def _of(self, make: Any) -> None:
        self._make = make

    def make(self) -> RobotCase:
        pair = self._make()
        return RobotCase(
            robot=pair.robot,
            advance=pair.advance,
            lose_link=lambda: pair.twin.fault("silent"),
            freeze=None,  # an old answer is known by its size: it is none
            stand_still=pair.clock.pass_over,
            true_joints=lambda: pair.twin.q,
            tolerance=1.6 * STEP,
        )

    def make_wrong(self, fault: WrongController) -> WrongCase | str:
        pair = self._make()
        if fault is WrongController.RELATIVE and pair.kind == "feetech":
            pair.twin.servos[2].table[33] = 3
            return WrongCase(robot=pair.robot, advance=pair.advance, joints=lambda: pair.twin.q)
        if fault.cycles != 1.0:
            return "a servo has no cycle: it answers when it is asked"
        return "goal and position of a servo are steps of the same encoder: what is wrong with one is so with both"


def test_opening_writes_nothing_and_the_first_motion_holds_the_arm_where_it_was_held(make: Any) -> None:
    pair = make(sag=0.02)
    for servo in pair.twin.servos[:3]:
        servo.table[pair.twin.torque_at] = 1
    pair.twin._write(pair.twin.servos[0], pair.twin.torque_at, b"\x01")
    pair.clock.advance(0.5)
    hung, before = pair.twin.q, len(pair.twin.told)
    assert hung[0] == pytest.approx(pair.home[0] - 0.02, abs=STEP)
    with pair.robot as robot:
        pair.advance(0.5)
        assert len(pair.twin.told) == before
        assert not robot.proven
        pair.enable()
        pair.advance(0.5)
        assert robot.proven
        assert np.abs(pair.twin.q - hung)[:3].max() < 1e-4, "what was held sinks no further"
        assert np.abs(pair.twin.q - hung)[3:].max() <= 0.02 + STEP
    assert all(servo.table[pair.twin.torque_at] for servo in pair.twin.servos), "closing switches nothing off"


def test_torque_is_switched_off_only_where_that_is_asked(make: Any) -> None:
    pair = make(torque="off")
    for servo in pair.twin.servos:
        servo.table[pair.twin.torque_at] = 1
    with pair.robot as robot:
        assert not any(servo.table[pair.twin.torque_at] for servo in pair.twin.servos)
        pair.twin.push(np.full(6, 0.02))
        pair.advance(0.05)
        assert np.abs(robot.read().q - pair.home - 0.02).max() < STEP


@pytest.mark.parametrize("tags", [8, 1])
def test_no_position_of_another_moment_is_used_whatever_comes(
    make: Any, tags: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_module, "TAGS", tags)
    pair, rng, true, wrong, used = make(), np.random.default_rng(5), {}, 0, 0
    read_all = pair.twin._read_all

    def noted(body: bytes) -> Any:
        true[pair.clock.now_s()] = pair.twin.q
        return read_all(body)

    pair.twin._read_all = noted
    with pair.robot as robot:
        pair.enable()
        place = 0
        for i in range(500):
            if i % 2:
                place = int(rng.integers(6))
                pair.twin.plant(list(BusFault)[1 + i // 2 % 5], place, rng)
            elif i % 10 == 4:  # the one that is late has no newer one beside it when it comes
                pair.twin.plant(BusFault.LOST, place, rng)
            robot.step_joints(np.full(6, 0.006 if i % 160 < 80 else -0.006))
            pair.advance(pair.cycle_s)
            assert robot.state is not RobotState.LOST, robot.why
            reading = robot._reading
            used += reading.t_s == pair.clock.now_s()
            wrong += bool(np.abs(reading.q - true[reading.t_s]).max() > 0.51 * STEP)
        counts = robot.counts
    assert pair.twin.wrong_answers >= 250
    if tags > 1:
        assert wrong == 0
        assert used > 150
        assert counts.missed > 100
        assert counts.late > 30
        assert counts.repeated > 30
        assert counts.garbage_bytes > 100
    elif pair.kind == "feetech":
        assert wrong > 0, "without sizes that tell the question, old answers are taken for new ones"


SPOILT: dict[str, tuple[Callable[[ServoPair], object], str]] = {
    "missing": (lambda pair: setattr(pair.twin.servos[2], "there", False), r"servo 3 does not answer.*1, 2, 4, 5, 6"),
    "all missing": (lambda pair: pair.twin.fault("silent"), "no servo answers.*supply"),
    "two of one id": (lambda pair: pair.twin.double(4), "servo 4 is garbled: two servos"),
    "another speed": (lambda pair: setattr(pair.twin, "baud", 500_000 if pair.kind == "feetech" else 57_600), "baud="),
    "another model": (lambda pair: pair.twin.servos[1].put(MODEL[pair.kind], 2, 350), "servo 2 is of model 350"),
    "another mode": (lambda pair: pair.twin.servos[1].put(MODE[pair.kind], 1, 1), "servo 2 is in mode 1 .speed"),
    "an alarm": (lambda pair: alarm(pair, 5, 32), "servo 5 tells overload"),
    "a low supply": (lambda pair: pair.twin.servos[0].put(VOLTS[pair.kind], 1, 30), "supply of servo 1.*3.0 V"),
}
MODEL, MODE, VOLTS = {"feetech": 3, "dynamixel": 0}, {"feetech": 33, "dynamixel": 11}, {"feetech": 62, "dynamixel": 144}


def alarm(pair: ServoPair, id: int, bits: int) -> None:
    servo = pair.twin.servos[id - 1]
    servo.error = bits if pair.kind == "feetech" else 0x80 * bool(bits)
    if pair.kind == "dynamixel":
        servo.put(70, 1, bits)


@pytest.mark.parametrize("what", SPOILT)
def test_what_is_not_right_is_told_and_nothing_is_written(make: Any, what: str) -> None:
    pair = make()
    spoil, told = SPOILT[what]
    spoil(pair)
    with pytest.raises(DeviceFailed) as caught, pair.robot:
        pass
    assert re.search(told, str(caught.value)), str(caught.value)
    assert "not opened" in caught.value.consequence
    assert caught.value.cure
    assert pair.twin.told == []
    assert np.array_equal(pair.twin.q, pair.home)


def test_the_ids_that_are_there_and_the_speed_that_is_told_open_it(make: Any) -> None:
    pairs = [make(), make(ids=[1, 2, 4, 5, 6])]
    for pair in pairs:
        pair.twin.servos[2].there = False
    with refuses(DeviceNotFound, "servo 3", "--robot-set ids="), pairs[0].robot:
        pass
    with pairs[1].robot as robot:
        assert robot.n_joints == 5
    speed = 500_000 if pairs[0].kind == "feetech" else 2_000_000
    pairs = [make(), make(baud=speed)]
    for pair in pairs:
        pair.twin.baud = speed
    pairs[1].port.baudrate = pairs[1].robot.settings.baud  # as its port is opened
    with refuses(DeviceNotFound, f"--robot-set baud={speed}"), pairs[0].robot:
        pass
    with pairs[1].robot as robot:
        assert robot.n_joints == 6


def brown_out(pair: ServoPair) -> None:
    pair.twin.servos[1].put(VOLTS[pair.kind], 1, 55)


RUNNING: dict[str, tuple[Callable[[ServoPair], object], str]] = {
    "an alarm": (lambda pair: alarm(pair, 5, 32), "servo 5 tells overload: take the load off"),
    "heat": (lambda pair: alarm(pair, 2, 4), "servo 2 tells overheating"),
    "a supply that sags": (brown_out, "supply of servo 2 has fallen to 5.5 V"),
    "a servo that lost its supply for a moment": (
        lambda pair: pair.twin.restart(pair.twin.servos[3]),
        "servo 4 (holds a goal|.*torque)|torque of servo 4 is off",
    ),
    "a cable": (lambda pair: setattr(pair.twin.servos[5], "there", False), "servo 6 does not answer any more"),
}


@pytest.mark.parametrize("what", RUNNING)
def test_what_goes_wrong_stops_the_arm_and_is_told(make: Any, what: str) -> None:
    pair = make()
    spoil, told = RUNNING[what]
    with pair.robot as robot:
        pair.enable()
        for _ in range(20):
            robot.step_joints(np.full(6, 0.004))
            pair.advance(pair.cycle_s)
        spoil(pair)
        pair.advance(15 * pair.cycle_s)
        assert robot.state in (RobotState.STOPPED, RobotState.LOST)
        assert re.search(told, robot.why), robot.why
        with pytest.raises(DeviceFailed):
            robot.step_joints(np.full(6, 0.004))
        goals = pair.twin.told[-1]
        pair.advance(0.5)
        assert pair.twin.told[-1] == goals


def test_an_overload_that_ends_is_to_be_reset_and_pulls_nothing_back(make: Any) -> None:
    pair = make()
    with pair.robot as robot:
        pair.enable()
        pair.advance(0.3)
        alarm(pair, 5, 32)
        pair.advance(0.2)
        with pytest.raises(DeviceFailed, match="overload"):
            robot.reset()
        alarm(pair, 5, 0)
        pair.advance(0.2)
        assert robot.state is RobotState.STOPPED
        robot.reset()
        rest = pair.twin.q
        pair.enable()
        pair.advance(0.3)
        assert np.abs(pair.twin.q - rest).max() <= STEP


def lerobot(pair: ServoPair, **changed: int) -> dict[str, dict[str, int]]:
    """The file as LeRobot writes it, and the servos as it leaves them; changed: of servo 2 in the file alone."""
    names, made = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"), {}
    for i, (name, servo) in enumerate(zip(names, pair.twin.servos, strict=True)):
        offset, low, high = 40 - 20 * i, 700 + 50 * i, 3500 - 30 * i
        if pair.kind == "feetech":
            servo.put(31, 2, abs(offset) | (0x800 if offset < 0 else 0))
            servo.put(9, 2, low)
            servo.put(11, 2, high)
        else:
            servo.put(20, 4, offset)
            servo.put(52, 4, low)
            servo.put(48, 4, high)
        entry = {"id": i + 1, "drive_mode": 0, "homing_offset": offset, "range_min": low, "range_max": high}
        made[name] = entry
    made["shoulder_lift"].update(changed)
    return made


def of_file(make: Any, tmp_path: Path, **changed: int) -> ServoPair:
    pair = make()
    file = tmp_path / "arm.json"
    file.write_text(json.dumps(lerobot(pair, **changed)))
    with_file = type(pair.robot)("line", settings={"calibration": file}, clock=pair.clock)
    with_file._open_port, with_file._finish = pair.robot._open_port, pair.robot._finish
    pair.file_robot = with_file
    return pair


def test_a_calibration_file_gives_directions_and_zeros(make: Any, tmp_path: Path) -> None:
    pair = of_file(make, tmp_path, drive_mode=1)
    joints = pair.file_robot.joints
    assert [joint.id for joint in joints] == [1, 2, 3, 4, 5], "the gripper's servo is no joint of the arm"
    sign = -1 if pair.kind == "feetech" else 1  # a Dynamixel turns itself round
    middle = (750 + 3470) / 2
    assert joints[1].q(3000) == pytest.approx(sign * math.radians((3000 - middle) * 360 / 4096))
    assert joints[1].steps(joints[1].q(3000)) == 3000
    assert joints[0].q(3000) == pytest.approx(math.radians((3000 - 2100) * 360 / 4095) * 4095 / 4096)


def test_the_file_of_another_arm_is_refused_by_what_the_servos_keep(make: Any, tmp_path: Path) -> None:
    pair = of_file(make, tmp_path, homing_offset=-11)
    robot = pair.file_robot
    with refuses(DeviceFailed, "servo 2 (shoulder_lift)", "homing offset 20", "by the file -11"), robot:
        pass
    assert pair.twin.told == []


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"a": 1}', '{"a": {"id": 1}}', json.dumps({"a": dict.fromkeys(("id", *"bcde"), 1)})]
)
def test_a_file_that_is_no_calibration_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.json"
    file.write_text(text)
    with refuses(BadFile, "arm.json", "not opened"):
        KINDS["feetech"][1]("line", settings={"calibration": file})


def ranged(lower: list[float], upper: list[float]) -> LinkArm:
    """Return an arm of joints with these ranges."""
    ends = zip(lower, upper, strict=True)
    return LinkArm(
        arm=Arm(name="ranged", joints=tuple(Joint(name=f"j{i}", lower=a, upper=b) for i, (a, b) in enumerate(ends)))
    )


def test_ranges_of_the_servos_hold_and_those_of_another_zero_are_refused(make: Any) -> None:
    pair = make(arm=ranged([-1.0] * 6, [1.0] * 6))
    for servo in pair.twin.servos:
        at, size = (11, 2) if pair.kind == "feetech" else (48, 4)
        servo.put(at, size, 2800)
    with pair.robot as robot:
        assert robot._goals._limits.upper == pytest.approx(np.full(6, (2800 - 2048) * STEP))
    other = make(arm=ranged([1.0] * 6, [4.0] * 6))
    at, size = (11, 2) if other.kind == "feetech" else (48, 4)
    other.twin.servos[2].put(at, size, 2100)
    with refuses(DeviceFailed, "servo 3", "direction"), other.robot:
        pass
    short = make(arm=ranged([1.0] * 5, [4.0] * 5))
    with refuses(UsageError, "5 joints", "gripper"), short.robot:
        pass
    with make(arm=ranged([-1.0] * 5, [1.0] * 5), ids=[1, 2, 3, 4, 5]).robot as robot:
        assert robot.n_joints == 5


@pytest.mark.parametrize("signs", [[1] * 6, [1, 1, -1, 1, 1, 1]])
def test_a_direction_that_is_not_the_files_is_refused_and_signs_are_the_cure(make: Any, signs: list[int]) -> None:
    pair = make(arm=ranged([-0.1] * 6, [3.0] * 6), signs=signs)
    at, size = (11, 2) if pair.kind == "feetech" else (48, 4)
    pair.twin.servos[2].put(at, size, 2100)
    if signs[2] > 0:
        with refuses(DeviceFailed, "servo 3", "signs and zero_steps"), pair.robot:
            pass
    else:
        with pair.robot as robot:
            assert robot.state is RobotState.READY


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"baud": 57_600}, "longer than a cycle"),
        ({"ids": [1, 1]}, "do not belong together"),
        ({"ids": [1, 2], "signs": [1]}, "do not belong together"),
        ({"signs": ["up"]}, "signs"),
        ({"ids": [300]}, "ids"),
        ({"torque": "on"}, "torque"),
        ({"baudrate": 1}, "baudrate"),
        ({"calibration": "no.json", "ids": [1]}, "one or the other"),
    ],
)
def test_settings_that_cannot_be_are_refused(make: Any, more: dict[str, object], told: str) -> None:
    with refuses(UsageError, told):
        make(**more)


def test_settings_come_as_texts_from_the_command_line() -> None:
    robot = KINDS["feetech"][1]("line", settings={"ids": ["1", "2"], "signs": ["1", "-1"], "cycle_s": "0.02"})
    assert [(joint.id, joint.sign) for joint in robot.joints] == [(1, 1), (2, -1)]
    assert KINDS["feetech"][1]("line", settings={"ids": "3"}).n_joints == 1


def test_a_port_that_is_not_there_is_told() -> None:
    with refuses(DeviceFailed, "there-is-none", "not opened"), KINDS["feetech"][1]("/dev/there-is-none"):
        pass


@given(st.lists(st.binary(max_size=40) | st.sampled_from([b"\xff\xff\x01\x04\x00", b"\xff\xff\xfd\x00\x01\xff\xff"])))
def test_no_bytes_upset_the_readers(pieces: list[bytes]) -> None:
    line = b"".join(pieces)
    for packets in (StsPackets(), DynamixelPackets()):
        answers, foreign = packets.answers(line)
        assert sum(len(one.data) + packets.extra for one in answers) + foreign <= len(line)


def test_a_reading_is_told_to_be_a_step_of_twelve_bits(make: Any) -> None:
    traits = RobotTraits.of(make().robot)
    assert traits.reading_step == pytest.approx(math.radians(0.0879), rel=1e-3)
    assert traits.reading_std == pytest.approx(math.radians(0.0254), rel=2e-3)
