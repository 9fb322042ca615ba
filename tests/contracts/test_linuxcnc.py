"""The LinuxCNC driver on the real LinuxCNC, where it is installed: the contract, in real time, and its limits."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.contracts.conftest import until

from armsight.clock import SystemClock
from armsight.drivers import RobotState
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.errors import DeviceFailed
from armsight.ops.robot.opening import LinkArm
from armsight.ops.robot.recorder import run_with_progress
from armsight.store.arm_file import arm_from_mapping
from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController
from armsight.testing.clocks import HaltingClock
from armsight_sim.twins import linuxcnc
from armsight_sim.twins.base import small_arm_mapping
from armsight_sim.twins.linuxcnc import LinuxcncTwin
from refusals import refuses

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(bool(linuxcnc.missing()), reason=f"{linuxcnc.missing()}: {linuxcnc.APT}"),
]

JOG_SCALE = 1e-4
SCALES = {
    WrongController.REVERSED: {1: -1.0},
    WrongController.SCALE: dict.fromkeys(range(6), 1.1),
    WrongController.GEAR: {2: 2.0},
}
"""Joints' jog-scale in HAL as a multiple of what it should be."""


@pytest.fixture(scope="module")
def twin() -> Iterator[LinuxcncTwin]:
    with LinuxcncTwin(port="49170") as twin:
        yield twin


class Line:
    """What comes from LinuxCNC, on the way to its driver."""

    def __init__(self, robot: LinuxcncRobot) -> None:
        self._received, robot._received = robot._received, self.received  # type: ignore[method-assign]
        self.cut = self.frozen = False
        self._last: list[Any] = []

    def received(self, wait_s: float) -> list[Any]:
        packets = self._received(wait_s)
        if self.cut:
            return []
        self._last = self._last if self.frozen else packets[-1:] or self._last
        return self._last if self.frozen else packets


@pytest.fixture
def make(twin: LinuxcncTwin) -> Callable[..., RobotCase]:
    def of(scales: dict[int, float]) -> RobotCase:
        for joint in range(6):
            twin.hal("setp", f"joint.{joint}.jog-scale", repr(JOG_SCALE * scales.get(joint, 1.0)))
        clock = HaltingClock(SystemClock())
        robot = LinuxcncRobot(twin.address.partition(":")[2], settings={"switch_on": True}, clock=clock)
        line = Line(robot)

        def stand_still(time_s: float) -> None:
            clock.halt(robot.name)
            time.sleep(time_s)
            clock.go_on()

        return RobotCase(
            robot=robot,
            advance=time.sleep,
            lose_link=lambda: setattr(line, "cut", True),
            freeze=lambda: setattr(line, "frozen", True),
            stand_still=stand_still,
            true_joints=lambda: np.radians(twin.joints_deg()),
            tolerance=2e-4,
        )

    return of


class TestContract(RobotContract):
    STAND_STILLS: ClassVar[tuple[tuple[float, bool], ...]] = ((0.15, False), (1.5, False))

    @pytest.fixture(autouse=True)
    def _of(self, make: Callable[..., RobotCase]) -> None:
        self._make = make

    def make(self) -> RobotCase:
        return self._make({})

    def make_wrong(self, fault: WrongController) -> WrongCase | str:
        if fault not in SCALES:
            return "counts are differences in degrees, in cycles that the driver chooses; others are in test_links.py"
        case = self._make(SCALES[fault])
        return WrongCase(robot=case.robot, advance=case.advance, joints=case.true_joints or (lambda: np.zeros(6)))


OF_THE_DRIVER = (
    *("test_the_constructor_opens_nothing", "test_it_says_what_it_is", "test_nonsense_is_refused_and_nothing_sent"),
    *("test_readings_carry_time_number_and_source", "test_a_lost_link_is_told", "test_old_readings_are_refused"),
)
"""What test_links.py has on a virtual clock, with the same bridge."""
for name in OF_THE_DRIVER:
    setattr(TestContract, name, None)


WHERE = """
import sys
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
linuxcnc.nmlfile = "linuxcnc.nml"
stat = linuxcnc.stat()
stat.poll()
print(*stat.position[:6])
"""


def test_the_twins_kinematics_are_the_arms(twin: LinuxcncTwin) -> None:
    told, _ = twin.begin("/usr/bin/python3", "-c", WHERE, stdout=subprocess.PIPE, text=True).communicate()
    x, y, z, a, b, c = map(float, told.split())
    pose = np.eye(4)
    for joint, q in zip(small_arm_mapping()["joints"], np.radians(twin.joints_deg()), strict=True):
        twist, turn = Rotation.from_euler("x", joint["alpha_rad"]), Rotation.from_euler("z", q)
        before, after = np.eye(4), np.eye(4)
        before[:3, :3], before[0, 3] = twist.as_matrix(), joint["a_m"]
        after[:3, :3], after[2, 3] = turn.as_matrix(), joint["d_m"]
        pose = pose @ before @ after
    assert np.abs(pose[:3, 3] - np.array([x, y, z]) / 1000.0).max() < 1e-6
    turned = Rotation.from_euler("xyz", [a, b, c], degrees=True)
    assert (turned * Rotation.from_matrix(pose[:3, :3]).inv()).magnitude() < 1e-6


def test_a_second_one_is_refused_and_no_port_is_open(twin: LinuxcncTwin) -> None:
    with refuses(DeviceFailed, "another LinuxCNC"), LinuxcncTwin(port="49171"):
        pass
    with pytest.raises(OSError), socket.create_connection(("127.0.0.1", 5005), timeout=1.0):
        pass


def test_an_e_stop_and_auto_are_told_and_what_is_allowed_is_switched(twin: LinuxcncTwin) -> None:
    device = twin.address.partition(":")[2]
    for press, named in (("halui.estop.activate", "e-stop"), ("halui.mode.auto", "AUTO")):
        twin.hal("setp", press, "1")
        robot = LinuxcncRobot(device)
        with robot:
            assert robot.state is RobotState.STOPPED
            twin.hal("setp", press, "0")
            until(lambda robot=robot, named=named: named in robot.why)
        with LinuxcncRobot(device, settings={"switch_on": True, "open_s": 20.0}) as robot:
            assert robot.state is RobotState.READY


MODEL = LinkArm(arm=arm_from_mapping({"format": "armsight/arm", "version": 1, **small_arm_mapping()}, "small"))
UP = RigidTransform.from_components([0.0, 0.0, 0.002], Rotation.from_rotvec([0.0, 0.005, -0.01]))
PROGRAM = """
import sys, time
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
linuxcnc.nmlfile = "linuxcnc.nml"
command = linuxcnc.command()
command.abort()
command.wait_complete(5.0)
if sys.argv[1:]:
    open("path.ngc", "w").write(sys.argv[1] + "\\nM2\\n")
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete(5.0)
    command.program_open("path.ngc")
    command.wait_complete(5.0)
    command.auto(linuxcnc.AUTO_RUN, 0)
"""
CLIENT = """
import sys
from tests.contracts.test_linuxcnc import RigidTransform, corrects, corrected
from armsight.ops.robot.recorder import run_with_progress
with corrects(sys.argv[1]) as robot:
    run_with_progress(lambda: corrected(robot, RigidTransform.from_translation([0.009, 0.0, 0.0]), sys.stdout), str)
    sys.exit(f"ended: {robot.state}, {robot.why}")
"""


def corrects(device: str) -> LinuxcncRobot:
    return LinuxcncRobot(device, settings={"motion": "offsets", "arm": MODEL, "switch_on": True})


def corrected(robot: LinuxcncRobot, goal: RigidTransform, told: Any = None, cycles: int = 500) -> None:
    """Prove the link where that is needed, and correct for so many cycles; tell, where wanted, when it begins.

    A busy machine's late cycles make a right link's probe too short or too long now and then: it is proven once more.
    """
    pace, some, again = robot.wait_step(-1, 1.0), RigidTransform.from_translation([0.0, 0.0, 1e-9]), 2
    for _ in range(cycles + 1500 * (not robot.proven)):
        if again and not robot.proven and robot.state is RobotState.STOPPED and "as far as sent" in robot.why:
            again -= 1
            robot.reset()
            time.sleep(1.0)  # the arm stands
            pace = robot.wait_step(-1, 1.0)
        if cycles == 0 or robot.state not in (RobotState.READY, RobotState.MOVING):
            return
        if robot.proven and told is not None:
            told = print("corrects", file=told, flush=True)
        cycles -= robot.proven
        robot.correct(goal if robot.proven else goal * some)
        pace = robot.wait_step(pace.steps, 0.05)


def runs(twin: LinuxcncTwin, *program: str) -> None:
    """Let LinuxCNC run a program of its own; without one, end it."""
    twin.begin("/usr/bin/python3", "-c", PROGRAM, *program).wait()


def is_on(twin: LinuxcncTwin, pin: str) -> bool:
    return twin.hal("getp", pin).strip() == "TRUE"


def flange(twin: LinuxcncTwin) -> RigidTransform:
    return MODEL.fk(np.radians(twin.joints_deg()))


TOO_LATE = ("no answer for too long", "fallen silent", "stood still")
"""Why a busy machine's link is lost; LinuxCNC's program is then paused, and the arm comes to rest: as it should."""


def late(why: str) -> bool:
    return any(words in why for words in TOO_LATE)


def test_a_correction_arrives_while_linuxcnc_runs_a_program(twin: LinuxcncTwin) -> None:
    told = [corrected_meanwhile(twin)]
    while late(told[-1]) and len(told) < 4:
        told.append(corrected_meanwhile(twin))
    assert told[-1] == ""


def corrected_meanwhile(twin: LinuxcncTwin) -> str:
    """Run a program of six seconds and correct UP meanwhile; return why the link was lost, if it was."""
    runs(twin)
    with corrects(twin.address.partition(":")[2]) as robot:
        run_with_progress(lambda: corrected(robot, RigidTransform.identity(), cycles=20), lambda: None)
        before = flange(twin)
        runs(twin, "G21 G91 G64\nG1 F600 Y60")
        run_with_progress(lambda: corrected(robot, UP, cycles=250), lambda: None)
        meanwhile = is_on(twin, "halui.program.is-running")
        until(lambda: not is_on(twin, "halui.program.is-running"))
        if late(robot.why):
            return robot.why
        assert robot.why == ""
        assert meanwhile, "the correction arrived meanwhile"
        way = np.asarray(flange(twin).translation) - np.asarray(before.translation)
        turn = (flange(twin).rotation * before.rotation.inv()).as_rotvec()
        assert way == pytest.approx([0.0, 0.06, 0.002], abs=2e-5)
        assert turn == pytest.approx(UP.rotation.as_rotvec(), abs=2e-5)
        run_with_progress(lambda: corrected(robot, RigidTransform.identity(), cycles=300), lambda: None)
    return ""


def test_a_program_towards_a_singular_pose_is_paused(twin: LinuxcncTwin) -> None:
    told = [towards_singular(twin)]
    while late(told[-1]) and len(told) < 4:
        told.append(towards_singular(twin))
    assert "singular" in told[-1]


def towards_singular(twin: LinuxcncTwin) -> str:
    """Run a program towards a wrist in line; return why it was paused. No joint may be faster than it may."""
    rows: list[tuple[float, Any]] = []
    runs(twin)
    with corrects(twin.address.partition(":")[2]) as robot:
        run_with_progress(lambda: corrected(robot, RigidTransform.identity(), cycles=20), lambda: None)
        here, there = (np.radians(twin.joints_deg()) for _ in range(2))
        there[4] = 0.0  # the wrist in line
        robot.listen(lambda t_s, q: rows.append((t_s, q)))
        runs(twin, moved(here, there))
        why = ""
        try:
            run_with_progress(lambda: corrected(robot, RigidTransform.identity(), cycles=4000), lambda: None)
        except DeviceFailed as error:  # it stops between two corrections
            why = str(error)
        why = robot.why or why
        assert why
        until(lambda: not is_on(twin, "halui.program.is-running"))
        until(lambda: bool(np.ptp([q for _, q in rows[-20:]], axis=0).max() < 1e-6))
    q, t_s = np.array([q for _, q in rows]), np.array([t for t, _ in rows])
    assert np.degrees(np.abs(q[5:] - q[:-5]).max(axis=1) / (t_s[5:] - t_s[:-5])).max() < 30.0
    runs(twin, moved(np.radians(twin.joints_deg()), here))
    until(lambda: not is_on(twin, "halui.program.is-running"))
    runs(twin)
    return why


def moved(here: Any, there: Any) -> str:
    """Return a program that leads from joints (rad) to others in a straight line of the flange."""
    ends = [MODEL.flange(q) for q in (here, there)]
    way = 1e3 * (ends[1] - ends[0])[:3, 3]
    turn = np.subtract(*(Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True) for T in ends[::-1]))
    turn = (turn + 180.0) % 360.0 - 180.0  # the short way round
    axes = " ".join(f"{axis}{value:.4f}" for axis, value in zip("XYZABC", [*way, *turn], strict=True))
    return f"G21 G91 G64\nG1 F600 {axes}"


def test_a_killed_client_leaves_its_correction_and_a_paused_program(twin: LinuxcncTwin) -> None:
    runs(twin)
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", CLIENT, twin.address.partition(":")[2]]
    for _ in range(3):  # one whose proof late cycles have spoilt ends without a word
        client = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
        assert client.stdout is not None
        said = client.stdout.readline()
        if said:
            break
        client.communicate()
    assert said == "corrects\n"
    runs(twin, "G21 G91 G64\nG1 F600 Y-60")
    client.kill()
    client.communicate()
    until(lambda: not is_on(twin, "halui.program.is-running"))
    time.sleep(0.5)
    offset, there = float(twin.hal("getp", "axis.x.eoffset")), flange(twin)
    time.sleep(0.5)
    assert is_on(twin, "halui.program.is-paused")
    assert 0.1 < offset < 9.3
    assert float(twin.hal("getp", "axis.x.eoffset")) == offset
    assert np.abs(flange(twin).as_matrix() - there.as_matrix()).max() < 1e-9
    runs(twin)
    with corrects(twin.address.partition(":")[2]) as robot:  # who comes next begins with what is in force
        run_with_progress(lambda: corrected(robot, RigidTransform.identity(), cycles=600), lambda: None)
        assert np.abs([float(twin.hal("getp", f"axis.{axis}.eoffset")) for axis in "xyzabc"]).max() < 0.02
