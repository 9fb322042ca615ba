"""The contract of robots, kept by a robot behind a server on loopback, its loop and guard included."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.control.session.service import Service
from armsight.drivers.remote import RemoteRobot
from armsight.errors import ArmsightError
from armsight.ops.robot.hosting import ThreadHost
from armsight.server.serving import background
from armsight.store.arm_file import arm_from_mapping
from armsight.testing import RobotCase, RobotContract, WrongController
from armsight.testing.clocks import GatedClock, HaltingClock
from armsight_sim.arms import Drive, FlangeLimits, SimArm, SimJoint
from armsight_sim.robot import RobotFault, SimRobot

BEAT_S = 0.05
QUARTER = np.pi / 2
SIX = ((0.04, -1, 0.44), (0.25, 0, 0.0), (0.12, 0, 0.0), (0.09, 1, 0.0), (0.0, -1, 0.0), (0.0, 0, 0.15))
HOME = [0.1, -1.2, 2.0, -0.8, -1.3, 0.4]


class NoLog:
    dropped, failed = 0, ""

    def event(self, *_): ...
    def command(self, *_): ...
    def joints(self, *_): ...


@contextmanager
def served() -> Iterator[tuple[RemoteRobot, SimRobot, GatedClock]]:
    clock = GatedClock(100.0)
    nominal = SimArm(
        joints=tuple(SimJoint(name=f"j{i}", a_m=a, alpha_rad=k * QUARTER, d_m=d) for i, (a, k, d) in enumerate(SIX, 1))
    )
    sim = SimRobot(
        "sim",
        true=nominal.with_errors(np.random.default_rng(1), 5e-4, 1e-3),
        nominal=nominal,
        drive=Drive(cycle_s=0.028, lag_s=0.05, max_speed=np.full(6, 1.0), encoder_step=np.full(6, 1e-5)),
        home=HOME,
        clock=clock,
        limits=FlangeLimits(speed_m_s=0.1, speed_rad_s=np.pi / 3),
    )
    mapping = {"format": "armsight/arm", "version": 1, **nominal.mapping(RigidTransform.identity())}
    host = ThreadHost(sim, arm_from_mapping(mapping, "the test's arm"), clock, ended=clock.leave)
    host.begin()
    clock.advance(0.1)
    host.wait()
    try:
        with background(Service(host, NoLog())) as url:
            yield RemoteRobot(url, clock=HaltingClock(clock)), sim, clock
    finally:
        host.end(lambda: clock.advance(0.1))


class TestRemoteRobot(RobotContract):
    STAND_STILLS = ((0.6, False), (1.5, True))
    """Of the client: the server's loop goes on, and the arm has the way to rest."""

    @pytest.fixture(autouse=True)
    def _servers(self) -> Iterator[None]:
        with ExitStack() as self.stack:
            yield

    def make_wrong(self, fault: WrongController) -> str:
        return "the server's own driver proves its controller"

    def make(self) -> RobotCase:
        robot, sim, clock = self.stack.enter_context(served())

        def advance(dt_s: float) -> None:
            while dt_s > 0.0:
                with suppress(ArmsightError):  # closed, or cut: nobody enables it
                    robot.heartbeat()
                clock.advance(min(BEAT_S, dt_s))
                dt_s -= BEAT_S

        def stand_still(time_s: float) -> None:
            halting = robot._clock
            halting.halt("armsight-heartbeat")
            clock.advance(time_s)
            halting.go_on()

        return RobotCase(
            robot=robot,
            advance=advance,
            lose_link=robot.cut,
            freeze=lambda: sim.fault(RobotFault.FROZEN),
            stand_still=stand_still,
            true_joints=lambda: sim.true_joints(clock.now_s()),
            tolerance=1e-4,
        )
