"""armsight.connect: watch, drive and stop a served robot, its loop and guard on a clock moved by the test."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import armsight
from armsight.control.session.service import Service
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent, UsageError
from armsight.ops.robot.hosting import ThreadHost
from armsight.server.serving import background
from armsight.store.arm_file import arm_from_mapping
from armsight.testing.clocks import GatedClock
from armsight_sim.arms import Drive, SimArm, SimJoint
from armsight_sim.robot import SimRobot
from refusals import refuses


class NoLog:
    dropped, failed = 0, ""

    def event(self, *_): ...
    def command(self, *_): ...
    def joints(self, *_): ...


@pytest.fixture
def served(monkeypatch):
    clock = GatedClock(10.0)
    nominal = SimArm(joints=(SimJoint(name="j1", a_m=0.3, lower=-1.0, upper=1.0), SimJoint(name="j2", a_m=0.2)))
    drive = Drive(cycle_s=0.02, lag_s=0.02, max_speed=np.full(2, 2.0), encoder_step=np.full(2, 1e-6))
    robot = SimRobot("two", true=nominal, nominal=nominal, drive=drive, home=[0.0, 0.3], clock=clock)
    mapping = {"format": "armsight/arm", "version": 1, **nominal.mapping(RigidTransform.identity())}
    host = ThreadHost(robot, arm_from_mapping(mapping, "x"), clock, ended=clock.leave)
    host.begin()
    clock.advance(0.1)
    host.wait()
    service = Service(host, NoLog())
    try:
        with background(service) as url:
            yield url, clock
    finally:
        host.end(lambda: clock.advance(0.1))


@pytest.fixture
def flows(served, monkeypatch):
    """Time passes while the program waits, with a heartbeat before each step of it; for the program it stands still.

    By the machine's time a program that a busy computer keeps waiting for 0.09 s has to enable anew.
    """

    def start(driver):
        driver._heart._time_s = lambda: 0.0

        def sleep(seconds):
            driver._heart.beat(driver._heart._enable)
            served[1].advance(seconds)

        monkeypatch.setattr("armsight.api.remote.time.sleep", sleep)

    return start


def test_a_connection_tells_what_robot_it_is_and_its_state(served):
    url, _ = served
    with armsight.connect(url) as robot:
        assert robot.robot.name == "two"
        state = robot.state()
        assert state.q == pytest.approx([0.0, 0.3], abs=1e-5)
        assert state.driver == ""
        assert "guard disabled" in repr(state)
        assert state.to_dict()["q_sent"] == [0.0, 0.3]
        assert len(robot.instance) == 16


def test_a_driver_moves_the_robot_and_waits(served, flows):
    url, _ = served
    with armsight.connect(url) as robot, robot.drive() as driver:
        flows(driver)
        driver.enable()
        driver.move_joints([0.1, 0.2])
        assert robot.state().q == pytest.approx([0.1, 0.2], abs=1e-3)
        assert robot.state().driver == "local@127.0.0.1"
        driver.jog([0.1, 0.0])
        driver.hold()


def test_motion_needs_an_enable_and_values_that_can_be(served, flows):
    url, _ = served
    with armsight.connect(url) as robot, robot.drive() as driver:
        flows(driver)
        with refuses(DeviceFailed, "not enabled"):
            driver.move_joints([0.1, 0.2])
        driver.enable()
        with pytest.raises(Inconsistent, match="range"):
            driver.move_joints([1.5, 0.2])
        with pytest.raises(UsageError, match="2 joints"):
            driver.move_joints([0.1])
        with pytest.raises(UsageError):
            driver.jog([float("nan"), 0.0])
        with refuses(UsageError, "no poses"):
            driver.twist([0.1, 0.0, 0.0])
        driver.disable()
        with refuses(DeviceFailed, "not enabled"):
            driver.jog([0.1, 0.0])


def test_a_stop_of_a_watcher_ends_the_motion_until_a_reset(served, flows):
    url, clock = served
    with armsight.connect(url) as robot, robot.drive() as driver:
        flows(driver)
        driver.enable()
        driver.move_joints([0.5, 0.2], wait=False)
        robot.stop()
        clock.advance(0.5)
        with pytest.raises(DeviceFailed, match="stopped"):
            driver.move_joints([0.5, 0.2])
        clock.advance(0.5)
        assert robot.state().robot == "stopped"
        driver.reset()
        driver.enable()
        clock.advance(0.1)
        driver.enable()
        driver.move_joints([0.05, 0.25])
        told: list[str] = []
        while not any("stopped by" in event for event in told):  # events come by themselves, 20 times a second
            told += robot.events()
            robot.state()


@pytest.mark.parametrize("stood_s", [0.05, 0.1, 5.0])
def test_a_program_that_stood_still_has_to_enable_anew(served, flows, monkeypatch, stood_s):
    url, _ = served
    now_s = [0.0]
    with armsight.connect(url) as robot, robot.drive() as driver:
        flows(driver)
        driver._heart._time_s = lambda: now_s[0]
        driver._heart.beat(enable=False)
        driver.enable()
        now_s[0] += stood_s
        if stood_s < 0.09:
            driver.move_joints([0.1, 0.2], wait=False)
            return
        with refuses(DeviceFailed, "stood still", "anew"):
            driver.move_joints([0.1, 0.2])
        with refuses(DeviceFailed, "stood still"):
            driver.jog([0.1, 0.0])
        driver.enable()
        driver.move_joints([0.1, 0.2])
        assert robot.state().q_sent == pytest.approx([0.1, 0.2])


def test_a_motion_that_is_held_is_told(served, flows):
    url, _ = served
    with armsight.connect(url) as robot, robot.drive() as driver:
        flows(driver)
        driver.enable()
        driver.move_joints([0.5, 0.2], wait=False)
        driver._heart._enable = False  # the operator lets go
        with pytest.raises(DeviceFailed, match=r"not enabled|go there"):
            driver.move_joints([0.5, 0.2])


def test_without_a_server_and_after_its_end(served):
    url, _ = served
    with pytest.raises(DeviceNotFound):
        armsight.connect("ws://127.0.0.1:1")
    robot = armsight.connect(url)
    robot.close()
    with pytest.raises(DeviceLost):
        robot.state()
    with pytest.raises(DeviceLost):
        robot.stop()
