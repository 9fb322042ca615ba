"""The contract of every robot driver."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.drivers import Paced, Robot, RobotState
from armsight.errors import DataRefused, DeviceFailed, StaleData, UsageError
from armsight.testing.checks import check, refused
from armsight.testing.wrong_controllers import WrongCase, WrongController, check_wrong, prove

SETTLE_CYCLES = 400
"""Cycles after which a robot told to go a tenth of a cycle's way is at rest: 11 s at 28 ms."""


REST_CYCLES = 60
"""... told to go a hundredth of that: 0.24 s at 4 ms, five times the lag of slow motors."""


def _unsaid(time_s: float) -> None:
    raise AssertionError("tell the contract how the program's side of the link stands still: RobotCase.stand_still")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCase:
    """A robot not yet opened, and the test's power over its world.

    advance: lets so many seconds pass (a ManualClock's advance, or a sleep). lose_link, freeze: cut the link, and
    stop new readings from coming; None where the test cannot do that to this robot. stand_still: lets the program's
    side of the link stand still for so many seconds while the controller goes on, as a process that the system has
    stopped; to be given, None for a robot without a link alone. true_joints: returns where the joints (n,) are by the
    controller itself; None: by the newest reading.
    tolerance: by how much (rad or m) a reading at rest may differ from what was sent: encoder step and play.
    """

    robot: Robot
    advance: Callable[[float], None]
    stand_still: Callable[[float], None] | None = _unsaid
    true_joints: Callable[[], NDArray[np.float64]] | None = None
    lose_link: Callable[[], None] | None = None
    freeze: Callable[[], None] | None = None
    tolerance: float = 1e-3


class RobotReadingContract:
    """What also a robot that can only be read must do. Subclass it as Test..., and return a new case from make()."""

    def make(self) -> RobotCase:
        """Return a new robot, not opened, standing where small steps of all joints are possible."""
        raise NotImplementedError("return a RobotCase from make()")

    def test_the_constructor_opens_nothing(self) -> None:
        """A robot that was only made is closed, and refuses to be read or moved."""
        robot = self.make().robot
        check(robot.state is RobotState.CLOSED, "a robot that was not opened is closed")
        with refused(DeviceFailed, "a closed robot cannot be read"):
            robot.read()
        with refused(DeviceFailed, "a closed robot cannot be moved"):
            robot.step_joints(np.zeros(robot.n_joints))
        with refused(DeviceFailed, "a closed robot cannot be reset"):
            robot.reset()

    def test_it_says_what_it_is(self) -> None:
        """It has a name, joints and a cycle."""
        robot = self.make().robot
        check(bool(robot.name), "it has a name")
        check(robot.n_joints >= 1, "it has a joint at least")
        check(robot.cycle_s > 0.0, "its cycle is a positive time")

    def test_stop_is_always_legal(self) -> None:
        """Stop never raises: before opening, twice, stopped, after closing."""
        robot = self.make().robot
        robot.stop()
        with robot:
            robot.stop()
            robot.stop()
            check(robot.state is RobotState.STOPPED, "after stop it is stopped")
        robot.stop()
        check(robot.state is RobotState.CLOSED, "after closing it is closed")

    def test_readings_carry_time_number_and_source(self) -> None:
        """Readings have one value per joint, a time that runs forward, growing numbers and the robot's name."""
        case = self.make()
        with case.robot as robot:
            readings = []
            for _ in range(4):
                case.advance(2.0 * robot.cycle_s)
                readings.append(robot.read())
        for reading in readings:
            check(reading.q.shape == (robot.n_joints,), "a reading has one value per joint")
            check(robot.name in reading.source, "a reading names its robot as the source")
        for before, after in itertools.pairwise(readings):
            check(after.t_s > before.t_s, "the time of readings increases")
            check(after.sequence > before.sequence, "the number of readings increases")

    def test_a_lost_link_is_told(self) -> None:
        """Without a link it neither reads nor moves, says so, and may still be stopped."""
        case = self.make()
        if case.lose_link is None:
            return
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            robot.read()
            case.lose_link()
            case.advance(10.0 * robot.cycle_s)
            with refused(DeviceFailed, "a robot without a link cannot be read"):
                robot.read()
            with refused(DeviceFailed, "a robot without a link cannot be moved"):
                robot.step_joints(np.zeros(robot.n_joints))
            check(robot.state is RobotState.LOST, "a robot without a link is lost")
            robot.stop()

    def test_old_readings_are_refused(self) -> None:
        """Where no new readings come, the last one is not passed off as the present."""
        case = self.make()
        if case.freeze is None:
            return
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            robot.read()
            case.freeze()
            case.advance(50.0 * robot.cycle_s)
            with refused(StaleData, "a reading fifty cycles old is stale"):
                robot.read()


class RobotContract(RobotReadingContract):
    """Subclass it in a test file as Test..., and return a new case from make(); pytest then runs every test."""

    STAND_STILLS: ClassVar[tuple[tuple[float, bool], ...]] = ((0.1, False), (0.6, False), (1.5, False), (5.0, True))
    """How long it stands still in s, and whether at rest; fewer for a link that works in the time of the machine."""

    def make_wrong(self, fault: WrongController) -> WrongCase | str:
        """Return a robot whose controller is wrong, or, in words, why that cannot be behind this driver."""
        raise NotImplementedError("return a WrongCase from make_wrong(), or why there is none")

    def test_no_motion_on_a_wrong_premise(self) -> None:
        """A controller that takes commands otherwise is found out by a probe of a few hundredths of a degree."""
        for fault in WrongController:
            case = self.make_wrong(fault)
            if isinstance(case, str):
                check(bool(case), f"it is said why {fault} cannot be")
            else:
                check_wrong(fault, case)

    def test_it_goes_where_it_says_it_was_sent(self) -> None:
        """What a command returns is where the robot then goes."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            prove(robot, case.advance)
            start = robot.read().q
            sent = None
            for _ in range(20):
                sent = robot.step_joints(np.full(robot.n_joints, 5.0 * case.tolerance))
                case.advance(robot.cycle_s)
            case.advance(SETTLE_CYCLES * robot.cycle_s)
            end = robot.read().q
            state = robot.state
        if sent is None:
            return
        check(bool(np.abs(end - sent.q).max() <= case.tolerance), "it comes to rest where the command says it was sent")
        check(bool(np.abs(end - start).max() > 2.0 * case.tolerance), "it moves when it is told to")
        check(state is RobotState.READY, "at rest it is ready")

    def test_commands_return_what_was_really_sent(self) -> None:
        """A step far too long for one cycle is cut, and the command says so."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            prove(robot, case.advance)
            start = robot.read().q
            sent = robot.step_joints(np.full(robot.n_joints, 100.0))
            check(bool(np.abs(sent.q - start).max() < 50.0), "a step of 100 rad within one cycle is cut")
            check(bool(sent.limited), "a command that was cut names the limit")
            case.advance(SETTLE_CYCLES * robot.cycle_s)
            end = robot.read().q
            check(
                bool(np.abs(end - sent.q).max() <= case.tolerance), "a command that was cut says where it really goes"
            )

    def test_commands_of_one_cycle_do_not_add_up(self) -> None:
        """Many commands within one cycle move it no further than one."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            prove(robot, case.advance)
            far = np.full(robot.n_joints, 100.0)
            first = robot.step_joints(far)
            for _ in range(5):
                last = robot.step_joints(far)
            check(
                bool(np.abs(last.q - first.q).max() <= case.tolerance),
                "commands sent within one cycle do not add up beyond the speed limit",
            )

    def test_nonsense_is_refused_and_nothing_sent(self) -> None:
        """Steps of the wrong size or that are not finite are refused and do not move it."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            start = robot.read().q
            with refused((UsageError, DataRefused), "a step with too many values is refused"):
                robot.step_joints(np.zeros(robot.n_joints + 1))
            with refused((UsageError, DataRefused), "a step that is not finite is refused"):
                robot.step_joints(np.full(robot.n_joints, np.nan))
            case.advance(10.0 * robot.cycle_s)
            check(bool(np.abs(robot.read().q - start).max() <= case.tolerance), "a refused step does not move it")

    def test_a_stopped_robot_moves_only_after_a_reset(self) -> None:
        """Stop holds until reset; reset does not bring back what was commanded before."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            prove(robot, case.advance)
            step = np.full(robot.n_joints, 100.0)
            for _ in range(10):
                robot.step_joints(step)
                case.advance(robot.cycle_s)
            robot.stop()
            with refused(DeviceFailed, "a stopped robot refuses to be moved"):
                robot.step_joints(step)
            case.advance(SETTLE_CYCLES * robot.cycle_s)
            rest = robot.read().q
            robot.reset()
            case.advance(50.0 * robot.cycle_s)
            moved = np.abs(robot.read().q - rest).max()
            check(bool(moved <= case.tolerance), "after a reset it stays where it stopped")
            robot.step_joints(0.1 * step)

    def test_a_stand_still_ends_what_was_asked(self) -> None:
        """A program that stood still moves nothing by what it asked before: at rest or in motion, shortly or long."""
        for stood_s, at_rest in self.STAND_STILLS:
            self._stands_still(self.make(), stood_s, at_rest=at_rest)

    def _stands_still(self, case: RobotCase, stood_s: float, *, at_rest: bool) -> None:
        robot, where = case.robot, case.true_joints or (lambda: case.robot.read().q)
        told = f"after {stood_s:g} s {'at rest' if at_rest else 'in motion'} "
        if case.stand_still is None:
            check(not isinstance(robot, Paced), "a link can stand still")
            return
        with robot:
            case.advance(2.0 * robot.cycle_s)
            prove(robot, case.advance)
            step = np.full(robot.n_joints, 5.0 * case.tolerance)
            for _ in range(20):
                robot.step_joints(step)
                case.advance(robot.cycle_s)
            if at_rest:
                case.advance(REST_CYCLES * robot.cycle_s)
            else:
                robot.step_joints(step)
            case.stand_still(stood_s)
            rest = where()
            with refused(DeviceFailed, f"{told}a robot that was moved is to be reset"):
                robot.step_joints(step)
            case.advance(REST_CYCLES * robot.cycle_s)
            check(_apart(where(), rest) <= case.tolerance, f"{told}it stays where it stood")
            if robot.state is RobotState.LOST:
                robot.__exit__(None, None, None)
                robot.__enter__()
            robot.reset()
            case.advance(10.0 * robot.cycle_s)
            check(_apart(where(), rest) <= case.tolerance, f"{told}a reset moves nothing")
            prove(robot, case.advance)
            sent = robot.step_joints(step)
            case.advance(REST_CYCLES * robot.cycle_s)
            check(_apart(where(), sent.q) <= case.tolerance, f"{told}it goes where it says")
            check(_apart(sent.q, rest) <= 6.0 * case.tolerance, f"{told}the first step begins where it stands")

    def test_closing_stops_it(self) -> None:
        """A robot that is closed while it moves comes to rest, and is closed."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            prove(robot, case.advance)
            for _ in range(10):
                robot.step_joints(np.full(robot.n_joints, 100.0))
                case.advance(robot.cycle_s)
            near = robot.read().q
        check(robot.state is RobotState.CLOSED, "after closing it is closed")
        case.advance(SETTLE_CYCLES * robot.cycle_s)
        with robot:
            case.advance(2.0 * robot.cycle_s)
            first = robot.read().q
            case.advance(10.0 * robot.cycle_s)
            second = robot.read().q
        check(bool(np.abs(first - second).max() <= case.tolerance), "closed, it has come to rest")
        check(bool(np.isfinite(first - near).all()), "it can be opened again and read")

    def test_poses_are_approached_and_reported(self) -> None:
        """A pose far away is approached by no more than a cycle's way, and the command says how far."""
        case = self.make()
        with case.robot as robot:
            case.advance(2.0 * robot.cycle_s)
            sent = robot.step_joints(np.zeros(robot.n_joints))
            if not robot.takes_poses:
                with refused(UsageError, "a robot that takes no poses says so"):
                    robot.move_pose(RigidTransform.identity())
                return
            check(sent.pose is not None, "a robot that takes poses knows the pose of a command")
            if sent.pose is None:
                return
            case.advance(robot.cycle_s)
            here = robot.move_pose(sent.pose)
            check(bool(np.abs(here.q - sent.q).max() <= case.tolerance), "told to go where it is, it stays")


def _apart(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.abs(a - b).max())
