"""Simulated cameras that watch a real controller's arm: a scenario's cell, drawn where the robot says that it was."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.control.session.channels import JointTrack
from armsight.drivers import Robot, Skew, listen
from armsight.drivers.live import SILENCE_S
from armsight.errors import ArmsightError, DeviceFailed, DeviceLost, Inconsistent
from armsight.ops.simulation.scenarios import live_cell
from armsight.records import Frame

KEPT = 8192
"""Readings kept: eight seconds at 1000 a second, for pictures that take long to draw."""
TICK_S = 1e-3
END_S = 2.0
"""Longest wait for what draws to end."""


def when_heard(track: JointTrack, clock: Clock) -> Callable[[float], Array]:
    """Return what gives the joints (n,) at a time of the clock: it waits until they are heard, and guesses nothing.

    It raises DeviceLost where they do not come within SILENCE_S, StaleData for a time before the first that is kept.
    """

    def joints(t_s: float) -> Array:
        until_s = clock.now_s() + SILENCE_S
        while not track.reaches(t_s):
            if clock.now_s() >= until_s:
                raise DeviceLost(
                    f"the robot told no joints for {SILENCE_S:g} s",
                    consequence="Where its arm was at a picture's exposure is not known, and there is no picture",
                    cure="Look at the robot's controller and its link",
                )
            clock.sleep_until(clock.now_s() + TICK_S)
        return track.at(t_s)

    return joints


def followed_cell(scenario: str, robot: Robot, clock: Clock, **asked: Any) -> Any:
    """Return the live cell of a scenario whose cameras watch the joints that a robot, not yet open, will tell.

    The scenario's arm is what the cameras see moved by them, its own robot stays unused. asked: of live_cell. Raises
    UsageError for a robot whose link does not tell when its joints were read, Inconsistent for one of another number of
    joints, and as live_cell.
    """
    cell = live_cell(scenario, clock, **asked)
    require_joints(cell.robot.n_joints, robot.name, robot.n_joints)
    with cell.pairs:
        cell.pairs.pair(0)  # what draws is compiled before a controller waits for answers
    track = JointTrack(robot.n_joints, slots=KEPT)
    listen(robot, track.write)
    cell.robot.follow(when_heard(track, clock))
    return cell


def watching_cell(scenario: str, robot: Robot, clock: Clock, **asked: Any) -> Any:
    """Return `pairs`, `origin_s` and `one_image` of a followed cell that a process of its own draws.

    Drawn beside the link, pictures hold the interpreter for a tenth of a second, and the controller gets no answer.
    On another clock than the system's, which only this process knows, it is followed_cell. Raises as that.
    """
    if not isinstance(clock, SystemClock):
        return followed_cell(scenario, robot, clock, **asked)
    track = JointTrack(robot.n_joints, slots=KEPT)
    listen(robot, track.write)
    cell = DrawnApart(scenario, track, asked)
    require_joints(cell.n_joints, robot.name, robot.n_joints)
    return cell


class DrawnApart:
    """The pairs of a cell that another process draws where a track says the arm is, each when it is asked for.

    It can be opened once. one_image: both views are on one image.
    """

    skew: Skew | None = None
    total: int | None = None

    def __init__(self, scenario: str, track: JointTrack, asked: Any) -> None:
        """Start the process; what draws is compiled then. Raises as live_cell with what is asked."""
        context = multiprocessing.get_context("spawn")
        self._cell, other = context.Pipe()
        self._process = context.Process(
            target=_draw, args=(scenario, track, asked, other), name="armsight-pictures", daemon=True
        )
        self._process.start()
        other.close()
        self.pairs = self
        self.origin_s = 0.0
        self.name, self.n_joints, self.one_image = self._answer()

    def __enter__(self) -> Self:
        self.origin_s = self._asked()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cell.close()  # which is what ends it, as this process's own end does
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        while True:
            yield self._asked()

    def _asked(self) -> Any:
        with suppress(OSError):  # of a process that ended: what it said last tells why
            self._cell.send(None)
        return self._answer()

    def _answer(self) -> Any:
        try:
            answer = self._cell.recv()
        except (EOFError, OSError):
            raise DeviceFailed(
                "the process that draws the simulated cameras has ended", consequence="There are no pictures"
            ) from None
        if isinstance(answer, ArmsightError):
            raise answer
        return answer


def _draw(scenario: str, track: JointTrack, asked: Any, orders: Connection) -> None:
    """Draw until the other end of orders closes: say what the cell is, then when it opened, then pair by pair."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both processes; the other ends this one in order
    clock = SystemClock()
    with suppress(EOFError, OSError):
        try:
            cell = live_cell(scenario, clock, **asked)
            with cell.pairs:
                cell.pairs.pair(0)
            cell.robot.follow(when_heard(track, clock))
            orders.send((cell.pairs.name, cell.robot.n_joints, cell.one_image))
            orders.recv()
            with cell.pairs as pairs:
                orders.send(float(cell.origin_s))
                pictures = iter(pairs)
                while True:
                    orders.recv()
                    orders.send(next(pictures))
        except ArmsightError as error:
            orders.send(error)


def require_joints(n: int, robot: str, n_robot: int) -> None:
    """Raise Inconsistent where a scenario's arm has another number of joints, n, than a robot."""
    if n != n_robot:
        raise Inconsistent(
            f"the scenario's arm has {n} joints, {robot} has {n_robot}",
            consequence="Its cameras cannot show this robot",
            cure="Make a scenario of this robot's arm: armsight simulate SCENARIO --arm FILE -o FOLDER",
        )
