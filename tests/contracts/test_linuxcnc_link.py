"""The LinuxCNC driver and its bridge beside a small LinuxCNC, on one clock: what is refused, stopped and rebased."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.truth.emulated_links import Model

from armsight.drivers import RobotState
from armsight.drivers.linuxcnc import LinuxcncRobot, driver, state
from armsight.drivers.linuxcnc.machine import parse
from armsight.drivers.linuxcnc_bridge import ini, link, pins
from armsight.drivers.linuxcnc_bridge.feed import Feed
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, UsageError
from linuxcnc_world import ACCELERATION, AUTO, E_STOP, ENABLED, HOMED, JOINT_MODE, MDI, SPEED
from refusals import refuses

BRAKING_DEG = SPEED**2 / (2.0 * ACCELERATION)
STEP = 0.1


def machine(pair: Any) -> dict[str, Any]:
    return pair.twin.world.machine


def ways(robot: Any, pair: Any, cycles: int, speed_deg_s: float) -> None:
    """Let all joints go at a speed for so many cycles."""
    for _ in range(cycles):
        robot.step_joints(np.full(6, math.radians(speed_deg_s) * pair.cycle_s))
        pair.advance(pair.cycle_s)


def test_both_sides_pack_alike() -> None:
    for name in ("HELLO", "BEGIN", "STATE", "GOAL"):
        assert getattr(driver, name).format == getattr(link, name).format
    flags = ("MAY", "ENABLED", "HOMED", "JOINT_MODE", "E_STOP", "AUTO", "MDI", "SWITCH_ON", "HOME", "OFFSETS", "READS")
    assert (
        [getattr(driver, name, getattr(state, name, None)) for name in flags]
        == [getattr(pins, name) for name in flags]
        == [1, 2, 4, 8, 16, 32, 64, 1, 2, 4, 8]
    )
    whys = link.BEGUN, link.LET_GO, link.STOPPED, link.NOT_TAKEN
    assert (driver.STOP, driver.STOPPED, *driver.WHY) == (link.STOP, whys[2], whys[0], whys[1], whys[3])
    packed = link.STATE.pack(b"ASLS", 0x01020304, 5, 6, 7, 8, 9, 1, 6)
    assert packed.hex() == "41534c5304030201050000000600000007000000000000000800000009000106"
    assert link.GOAL.pack(b"ASLG", 1, 2, 3, 4, 1, 6).hex() == "41534c470100000002000000030000000400000001000600"


def changed(name: str, value: object) -> Callable[[Any], None]:
    return lambda pair: machine(pair).update({name: value})


def joint(number: int, **values: object) -> Callable[[Any], None]:
    return lambda pair: machine(pair)["joints"][number - 1].update(values)


@pytest.mark.parametrize(
    ("wrong", "more", "named"),
    [
        (changed("bridge", 1), {}, ("version 1", "of 2", "armsight.drivers.linuxcnc")),
        (changed("kinematics", "trivkins"), {}, ("trivkins", "genserkins")),
        (changed("kinematics", "genserkins"), {"kinematics": "pumakins"}, ("genserkins", "pumakins")),
        (changed("linear_units", "inch"), {}, ("LINEAR_UNITS inch", "mm", "units to inch")),
        (changed("angular_units", "rad"), {}, ("ANGULAR_UNITS rad",)),
        (changed("servo_s", 0.003), {}, ("3 ms", "cycle_s")),
        (joint(3, linear=True), {}, ("joint 3", "LINEAR", "linear")),
        (joint(2, lower=-35.0), {"arm": Model()}, ("joint 2 lower -171.9 here and -35.0 there",)),
        (lambda pair: machine(pair)["joints"].pop(), {}, ("5 joints", "not 6")),
    ],
)
def test_a_machine_that_is_not_the_one_expected_is_refused(
    make_linuxcnc: Any, wrong: Callable[[Any], None], more: dict[str, Any], named: tuple[str, ...]
) -> None:
    pair = make_linuxcnc(**more)
    wrong(pair)
    with refuses(DeviceFailed, *named[:1]) as caught, pair.robot:
        pass
    assert all(word in str(caught.value) for word in named), caught.value
    assert pair.robot.state is RobotState.CLOSED
    assert np.abs(pair.twin.q - pair.home).max() < 1e-12


@pytest.mark.parametrize(
    ("wrong", "more"),
    [
        (changed("linear_units", "inch"), {"units": "inch"}),
        (changed("kinematics", "trivkins"), {"kinematics": "trivkins"}),
        (joint(6, linear=True), {"linear": [6]}),
    ],
)
def test_what_is_declared_is_taken(make_linuxcnc: Any, wrong: Callable[[Any], None], more: dict[str, Any]) -> None:
    pair = make_linuxcnc(**more)
    wrong(pair)
    with pair.robot as robot:
        pair.advance(2 * pair.cycle_s)
        assert robot.state is RobotState.READY
        per_degree = 1e-3 if "linear" in more else math.radians(1.0)
        assert robot.read().q[5] == pytest.approx(per_degree * math.degrees(pair.home[5]))


def test_nothing_answers_where_linuxcnc_does_not_run(free_port: int) -> None:
    robot = LinuxcncRobot(f"127.0.0.1:{free_port}", settings={"open_s": 0.05})
    with refuses(DeviceNotFound, "nothing answers", "LinuxCNC"), robot:
        pass


@pytest.mark.parametrize("device", ["", ":49160", "127.0.0.1:70000", "127.0.0.1:x"])
def test_an_address_that_is_none_is_refused(device: str) -> None:
    with refuses(UsageError, "no"):
        LinuxcncRobot(device)


def test_a_link_that_only_reads_opens_while_others_move_the_arm_and_moves_nothing(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc(reads_only=True, switch_on=True)
    joint = pair.twin.world.joints[0]
    joint.ask(40.0)  # by the operator's hand
    with pair.robot as robot:
        pair.advance(0.4)
        assert abs(joint.speed) == pytest.approx(SPEED), "it goes at full speed"
        assert robot.read().q[0] == pytest.approx(math.radians(joint.at), abs=math.radians(2.0 * SPEED * pair.cycle_s))
        for asked in (robot.reset, lambda: robot.step_joints(np.full(6, 1e-3))):
            with refuses(DeviceFailed, "only reads"):
                asked()
        pair.advance(2.0)
    assert joint.at == pytest.approx(math.degrees(pair.home[0]) + 40.0)
    assert not {"jog-enable", "session", "estop-reset", "machine-on"} & {
        k for k, v in pair.twin.world.pins.items() if v
    }


def test_an_arm_that_moves_is_refused_with_the_way_to_read_it(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc(open_s=0.1)
    joint = pair.twin.world.joints[0]
    joint.high = math.inf
    joint.ask(1e9)
    with refuses(DeviceFailed, "reads_only"), pair.robot:
        pass


def test_a_second_program_is_refused_and_the_first_goes_on(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    with pair.robot as robot:
        pair.prove()
        machine(pair)["driver"] = "127.0.0.1:1"
        with refuses(DeviceFailed, "another program"):
            robot._check(parse(link.json.dumps(pair.twin.bridge._told()).encode()))
        ways(robot, pair, 20, 5.0)
        assert robot.state is RobotState.MOVING


def test_what_is_wrong_and_refuses_nothing_is_told(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    machine(pair).update(jog_acceleration=10.0, listens=True)
    pair.twin.world.signals.clear()
    with pair.robot as robot:
        told = robot.notes
    assert [any(word in note for note in told) for word in ("DEFAULT_LINEAR_ACCELERATION", "5005", "watchdog")] == [
        True
    ] * 3
    assert "joints 1, 2, 3, 4, 5, 6" in told[0]
    assert "200" in told[0]


@pytest.mark.parametrize(
    ("doing", "named"),
    [
        (HOMED | JOINT_MODE, "off"),
        (E_STOP | HOMED | JOINT_MODE, "e-stop"),
        (ENABLED | JOINT_MODE, "homed"),
        (ENABLED | HOMED, "joint mode"),
        (ENABLED | HOMED | JOINT_MODE | AUTO, "AUTO"),
        (ENABLED | HOMED | JOINT_MODE | MDI, "MDI"),
    ],
)
def test_a_linuxcnc_that_takes_no_jogs_is_told_and_pulled_back_nowhere(
    make_linuxcnc: Any, doing: int, named: str
) -> None:
    pair = make_linuxcnc()
    with pair.robot as robot:
        pair.prove()
        ways(robot, pair, 30, 20.0)
        pair.twin.world.doing = doing
        pair.advance(3 * pair.cycle_s)
        assert robot.state is RobotState.STOPPED
        with refuses(DeviceFailed, named):
            robot.step_joints(np.zeros(6))
        with refuses(DeviceFailed, "stays stopped"):
            robot.reset()
        pair.advance(0.5)
        pair.twin.push(np.full(6, STEP))
        there = pair.twin.q
        pair.twin.world.doing = ENABLED | HOMED | JOINT_MODE
        pair.advance(0.1)
        with refuses(DeviceFailed, "goes on"):
            robot.step_joints(np.zeros(6))
        robot.reset()
        pair.advance(0.5)
        assert np.abs(pair.twin.q - there).max() < 1e-12
        pair.prove()
        ways(robot, pair, 20, 5.0)
        pair.advance(0.5)
        assert np.abs(pair.twin.q - robot._goals.sent).max() < math.radians(1e-3)


def test_opening_switches_on_and_homes_where_that_is_allowed_alone(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    pair.twin.world.doing = E_STOP
    with pair.robot as robot:
        pair.advance(2.0)
        assert robot.state is RobotState.STOPPED
        assert pair.twin.world.doing == E_STOP
    allowed = make_linuxcnc(switch_on=True, home=True)
    allowed.twin.world.doing = E_STOP
    with allowed.robot as robot:
        assert robot.state is RobotState.READY
        allowed.twin.world.doing |= E_STOP
        allowed.twin.world.doing &= ~ENABLED
        allowed.advance(1.0)
        assert robot.state is RobotState.STOPPED  # an e-stop that comes later stays
        assert allowed.twin.world.doing & E_STOP


@pytest.mark.parametrize("how", ["killed", "stopped"])
def test_an_arm_that_is_let_go_in_motion_brakes_and_never_comes_back(make_linuxcnc: Any, how: str) -> None:
    pair = make_linuxcnc()
    track = []
    with pair.robot as robot:
        pair.prove()
        ways(robot, pair, 60, 20.0)
        last = robot._goals.sent
        if how == "killed":
            robot._answer = lambda state, sender: None
            pair.answered = lambda heard: False  # nobody waits for what never comes
        else:
            robot.stop()
        for _ in range(60):
            pair.advance(pair.cycle_s)
            track.append(pair.twin.q)
        beyond = np.degrees(track[-1] - last)
        assert (np.diff(np.array(track), axis=0) > -1e-9).all()
        # 20 degrees/s at 200 degrees/s2: one degree
        assert np.all((beyond > 0.9) & (beyond < 1.05))
        assert np.abs(robot._goals.sent - track[-1]).max() < 1e-6
        assert robot.state in (RobotState.STOPPED, RobotState.LOST)


def test_counts_that_are_dropped_are_found_and_taken_for_where_it_stands(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    with pair.robot as robot:
        pair.prove()
        for one in pair.twin.world.joints:
            one.high = one.at + 3.0  # a limit that the INI does not tell
        ways(robot, pair, 60, 20.0)
        pair.advance(0.8)
        assert robot.state is RobotState.STOPPED
        assert "did not take" in robot.why
        there = pair.twin.q
        robot.reset()
        pair.advance(0.3)
        assert np.abs(pair.twin.q - there).max() < 1e-12
        for one in pair.twin.world.joints:
            one.high = 175.0
        pair.prove()
        robot.step_joints(np.full(6, -0.002))
        pair.advance(0.5)
        assert np.abs(pair.twin.q - robot._goals.sent).max() < math.radians(1e-3)
        assert np.abs(pair.twin.q - there + 0.002).max() < math.radians(1e-3)


def test_goals_stay_within_the_ranges_of_the_ini(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    joint(1, upper=math.degrees(pair.home[0]) + 2.0)(pair)
    pair.twin.world.joints[0].high = math.degrees(pair.home[0]) + 2.0
    pair.restart()
    with pair.robot as robot:
        pair.prove()
        for _ in range(60):
            sent = robot.step_joints(np.full(6, 0.002))
            pair.advance(pair.cycle_s)
        assert "range of joint 1" in sent.limited
        pair.advance(0.6)
        assert robot.state is RobotState.READY  # what leads did not go beyond the range, and nothing was dropped
        assert math.degrees(pair.twin.q[0] - pair.home[0]) == pytest.approx(1.99, abs=1e-3)


def test_goals_of_an_older_session_or_of_a_stranger_move_nothing(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    with pair.robot as robot:
        pair.prove()
        bridge, rest = pair.twin.bridge, pair.twin.q
        client = bridge._client
        goal = struct.pack("<6d", *np.degrees(rest + 0.01))
        for token, session, number in (
            (client.token, bridge._session - 1, client.number),
            (client.token + 1, bridge._session, client.number),
            (client.token, bridge._session, client.number - 2),
        ):
            bridge._take(
                link.GOAL.pack(b"ASLG", token, session, number, 99, 0, 6) + goal, client.where, pair.clock.now_s()
            )
        bridge._take(
            link.GOAL.pack(b"ASLG", client.token, bridge._session, client.number, 99, 0, 6) + goal, ("1.2.3.4", 5), 0.0
        )
        far = struct.pack("<6d", *np.degrees(rest + 0.05))
        bridge._take(
            link.GOAL.pack(b"ASLG", client.token, bridge._session, client.number, 99, 0, 6) + far, client.where, 0.0
        )
        pair.advance(0.3)
        assert np.abs(pair.twin.q - rest).max() < 1e-6
        assert robot.state is RobotState.READY


def test_a_bridge_that_starts_anew_is_lost(make_linuxcnc: Any) -> None:
    pair = make_linuxcnc()
    with pair.robot as robot:
        pair.prove()
        pair.restart()
        pair.advance(0.2)
        with refuses(DeviceLost, "anew"):
            robot.read()


def test_the_feed_leads_by_the_braking_distance_and_within_its_limits() -> None:
    one = {"linear": False, "lower": -90.0, "upper": 90.0, "speed": 30.0, "acceleration": 400.0}
    feed = Feed({"joints": [one], "servo_s": 0.001, "jog_acceleration": 200.0})
    feed.start([1.0], [70])
    for i in range(100):
        rows = feed.step([1.0 + 0.16 * (i + 1)], 8, 8)
    # 20 degrees/s at the smaller of both accelerations: one degree ahead
    assert feed.target[0] - feed.at[0] == pytest.approx(1.0)
    assert rows[-1][0] == 70 + round((16.0 + 1.0) / ini.COUNT)
    assert rows[-1][0] - rows[0][0] == pytest.approx(7 * 0.02 / ini.COUNT, abs=1.0)
    feed.step([500.0], 8, 8)
    assert feed.at[0] == pytest.approx(17.0 + 30.0 * 0.008)
    feed.start([89.9])
    feed.step([90.0], 8, 8)
    assert feed.target[0] == pytest.approx(90.0 - 2e-3)


def test_an_ini_file_is_read_as_linuxcnc_does(tmp_path: Path) -> None:
    nml = tmp_path / "own.nml"
    nml.write_text("B emcCommand SHMEM localhost 8192 0 0 1 16 1001 xdr\n")
    file = tmp_path / "arm.ini"
    file.write_text(
        "[EMC]\nNML_FILE = own.nml\n[KINS]\n  JOINTS = 2\nKINEMATICS = genserkins coordinates=xy # mine\n"
        "[EMCMOT]\nSERVO_PERIOD = 2000000\n[TRAJ]\nLINEAR_UNITS = inch\nDEFAULT_LINEAR_ACCELERATION = 10.0 ; inch/s2\n"
        "[JOINT_0]\nTYPE = ANGULAR\nMAX_VELOCITY = 30\nMAX_VELOCITY = 60\nMAX_ACCELERATION = 200\nMIN_LIMIT = -5\n"
        "[JOINT_1]\nMAX_LIMIT = 7\n"
    )
    told = ini.describe(file)
    assert (told["kinematics"], told["servo_s"], told["linear_units"]) == ("genserkins", 0.002, "inch")
    assert (told["jog_acceleration"], told["listens"]) == (10.0, False)
    first, second = told["joints"]
    assert first == {"linear": False, "lower": -5.0, "upper": 1e99, "speed": 30.0, "acceleration": 200.0}
    assert second == {"linear": True, "lower": -1e99, "upper": 7.0, "speed": 1.0, "acceleration": 1.0}
    nml.write_text("B emcCommand SHMEM localhost 8192 0 0 1 16 1001 TCP=5005 xdr\n")
    assert ini.describe(file)["listens"]
    hal = ini.hal_lines(file, "/there/linuxcnc_bridge", "127.0.0.1", 49160)
    assert "cfg=ss\n" in hal
    assert "cfg=ffff\n" in hal
    assert "joint.1.pos-fb => sampler.0.pin.3" in hal
