"""The shipped contract of robots: the simulated robots pass it, and each planted fault fails it by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.clock import ManualClock
from armsight.drivers import Pace, RobotState, Sent
from armsight.records import JointReading
from armsight.testing import RobotCase, RobotContract, WrongCase, WrongController, contract_tests
from armsight_sim.arms import Drive, FlangeLimits, SimArm, SimJoint
from armsight_sim.robot import RobotFault, SimRobot

QUARTER = np.pi / 2


def six_axes() -> SimArm:
    table = ((0.04, -1, 0.44), (0.25, 0, 0.0), (0.12, 0, 0.0), (0.09, 1, 0.0), (0.0, -1, 0.0), (0.0, 0, 0.15))
    return SimArm(
        joints=tuple(
            SimJoint(name=f"j{i}", a_m=a, alpha_rad=k * QUARTER, d_m=d) for i, (a, k, d) in enumerate(table, 1)
        )
    )


def two_and_a_slide() -> SimArm:
    return SimArm(
        joints=(
            SimJoint(name="j1", d_m=1.27, alpha_rad=QUARTER),
            SimJoint(name="j2", a_m=0.1, d_m=-0.05, alpha_rad=QUARTER),
            SimJoint(name="j3", prismatic=True, lower=0.0, upper=1.2),
        )
    )


HOME = {6: [0.1, -1.2, 2.0, -0.8, -1.3, 0.4], 3: [0.2, 1.6, 0.6]}


def make_robot(
    kind: type[SimRobot] = SimRobot, arm: Callable[[], SimArm] = six_axes, cycle_s: float = 0.028
) -> tuple[SimRobot, ManualClock]:
    clock = ManualClock(100.0)
    nominal = arm()
    robot = kind(
        "sim",
        true=nominal.with_errors(np.random.default_rng(1), 5e-4, 1e-3),
        nominal=nominal,
        drive=Drive(
            cycle_s=cycle_s, lag_s=0.05, max_speed=np.full(nominal.n, 1.0), encoder_step=np.full(nominal.n, 1e-5)
        ),
        home=HOME[nominal.n],
        clock=clock,
        limits=FlangeLimits(speed_m_s=0.1, speed_rad_s=np.pi / 3),
    )
    return robot, clock


def case(robot: SimRobot, clock: ManualClock) -> RobotCase:
    return RobotCase(
        robot=robot,
        advance=clock.advance,
        lose_link=lambda: robot.fault("link_lost"),
        freeze=lambda: robot.fault("frozen"),
        stand_still=None,
        true_joints=lambda: robot.true_joints(clock.now_s()),
        tolerance=1e-4,
    )


def wrong_case(robot: SimRobot, clock: ManualClock) -> WrongCase:
    return WrongCase(robot=robot, advance=clock.advance, joints=lambda: robot.true_joints(clock.now_s()))


class Simulated(RobotContract):
    def make_wrong(self, fault: WrongController) -> str:
        return "a simulated robot is its own controller"


class TestSimulatedSixAxes(Simulated):
    def make(self) -> RobotCase:
        return case(*make_robot())


class TestSimulatedSlide(Simulated):
    def make(self) -> RobotCase:
        return case(*make_robot(arm=two_and_a_slide, cycle_s=0.008))


class OpensAtOnce(SimRobot):
    def __init__(self, *args: object, **more: object) -> None:
        super().__init__(*args, **more)  # type: ignore[arg-type]
        self.__enter__()


class StopRaisesWhenClosed(SimRobot):
    def stop(self) -> None:
        self._check_link("stop")
        super().stop()


class EchoesTheWish(SimRobot):
    def step_joints(self, step: np.ndarray) -> Sent:
        wished = self._servo.goal + step if np.shape(step) == (self.n_joints,) else step
        return replace(super().step_joints(step), q=wished)


class HidesTheLimit(SimRobot):
    def step_joints(self, step: np.ndarray) -> Sent:
        return replace(super().step_joints(step), limited=())


class AddsUpWithinACycle(SimRobot):
    def _begin_cycle(self) -> None:
        super()._begin_cycle()
        self._from = self._servo.goal


class TakesNonsense(SimRobot):
    def step_joints(self, step: np.ndarray) -> Sent:
        return super().step_joints(np.nan_to_num(np.resize(step, self.n_joints)))


class MovesWhileStopped(SimRobot):
    def _check_motion(self) -> None:
        self._check_link("move")


class StateOfAStopForgotten(SimRobot):
    @property
    def state(self) -> RobotState:
        state = super().state
        return RobotState.READY if state is RobotState.STOPPED else state


class ReadsOnWithoutALink(SimRobot):
    def read(self) -> JointReading:
        self._faults.discard(RobotFault.LINK_LOST)
        return super().read()


class PassesOldOffAsNew(SimRobot):
    def read(self) -> JointReading:
        self._faults.discard(RobotFault.FROZEN)
        return super().read()


class AlwaysTheSameNumber(SimRobot):
    def read(self) -> JointReading:
        return replace(super().read(), sequence=0)


class NoSource(SimRobot):
    def read(self) -> JointReading:
        return replace(super().read(), source="")


class DoesNotMove(SimRobot):
    def _send(self, goal: np.ndarray, limited: tuple[str, ...]) -> Sent:
        return super()._send(self._servo.goal, limited)


class NeverProves(SimRobot):
    """Goes along with any controller."""


class HasNoName(SimRobot):
    def __init__(self, *args: object, **more: object) -> None:
        super().__init__(*args, **more)  # type: ignore[arg-type]
        self.name = ""


class RunsOnWhenClosed(SimRobot):
    def __exit__(self, *_: object) -> None:
        self._servo.command(self._now_s(), self._servo.goal + 1e3)
        self._open = False


class JumpsToItsPose(SimRobot):
    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        sent = super().move_pose(T_base_flange)
        return replace(sent, q=sent.q + 0.1)


class IsALinkThatNeverStandsStill(SimRobot):
    def wait_step(self, after: int, wait_s: float) -> Pace:
        raise NotImplementedError

    def slow_down(self, max_speed: np.ndarray) -> None: ...


FAULTS: dict[type[SimRobot], str] = {
    IsALinkThatNeverStandsStill: "test_a_stand_still_ends_what_was_asked",
    OpensAtOnce: "test_the_constructor_opens_nothing",
    StopRaisesWhenClosed: "test_stop_is_always_legal",
    EchoesTheWish: "test_commands_return_what_was_really_sent",
    HidesTheLimit: "test_commands_return_what_was_really_sent",
    AddsUpWithinACycle: "test_commands_of_one_cycle_do_not_add_up",
    TakesNonsense: "test_nonsense_is_refused_and_nothing_sent",
    MovesWhileStopped: "test_a_stopped_robot_moves_only_after_a_reset",
    StateOfAStopForgotten: "test_stop_is_always_legal",
    ReadsOnWithoutALink: "test_a_lost_link_is_told",
    PassesOldOffAsNew: "test_old_readings_are_refused",
    AlwaysTheSameNumber: "test_readings_carry_time_number_and_source",
    NoSource: "test_readings_carry_time_number_and_source",
    DoesNotMove: "test_it_goes_where_it_says_it_was_sent",
    NeverProves: "test_no_motion_on_a_wrong_premise",
    HasNoName: "test_it_says_what_it_is",
    RunsOnWhenClosed: "test_closing_stops_it",
    JumpsToItsPose: "test_poses_are_approached_and_reported",
}


@pytest.mark.parametrize("kind", FAULTS, ids=lambda kind: kind.__name__)
def test_a_planted_fault_is_found(kind: type[SimRobot]) -> None:
    contract = RobotContract()
    contract.make = lambda: case(*make_robot(kind))  # type: ignore[method-assign]
    contract.make_wrong = lambda fault: wrong_case(*make_robot(kind))  # type: ignore[method-assign]
    with pytest.raises((AssertionError, Exception)) as caught:
        getattr(contract, FAULTS[kind])()
    assert caught.type is AssertionError or kind is StopRaisesWhenClosed, f"found by accident: {caught.value!r}"


def test_every_test_of_the_contract_finds_a_fault() -> None:
    assert set(contract_tests(RobotContract)) == set(FAULTS.values())
