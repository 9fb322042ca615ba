"""What drivers of controllers that exchange one packet a cycle have in common: state, readings, goals, refusals.

A thread of the driver answers the controller in every cycle with the goal of that moment; a caller that is late leaves
the goal where it is, so the arm holds its position. The controller sets the pace: each of its cycles takes one step at
most, and none before it took the last one, so it has never anything to catch up.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock, StandStill
from armsight.drivers.goals import JointGoals, JointLimits, PoseGoals, between
from armsight.drivers.pace import ControllerClock, Heard, LinkTimes, Pace
from armsight.drivers.proof import Probe, Proof, ProofState, Standing, joint_probe
from armsight.drivers.protocols import PROVING, RobotState, Sent
from armsight.errors import DeviceFailed, DeviceLost, StaleData, UsageError, leads_to
from armsight.priority import bound_control
from armsight.records import JointReading
from armsight.units import MS

END_S = 1.5
"""Closing a link that something is wrong with waits so long at most for the arm to stand."""
REST = 2e-4
"""Joints nearer to their goal than this, in rad or m, are at rest: encoders and servos keep a little off."""
ROUNDING = 1e-9
"""A pose this near to another, in m and rad, is the same."""


class CyclicRobot(ABC):
    """A robot behind a link with a cycle. A driver says how the link is opened, closed and kept going.

    The link's thread calls _stood_still in each of its turns, _heard and _hear_clock for each good reading, _tick, and
    _outlived before its answer; _lose where the link is gone, _halt where the controller takes no motion just now,
    _begin_anew where it takes it in another session than that in which the arm moved. Proven first (proof.py).
    """

    takes_poses = False

    def __init__(
        self, name: str, *, limits: JointLimits, times: LinkTimes, clock: Clock, poses: PoseGoals | None = None
    ) -> None:
        """poses: where the flange is told to go, on a link that takes poses."""
        self.name = name
        self.cycle_s = times.cycle_s
        self._times = times
        self._clock = clock
        self._goals = JointGoals(name, limits, times.cycle_s)
        self._poses = poses or PoseGoals(name, math.inf, math.inf, times.cycle_s)
        self._lock = threading.RLock()
        self._ticked = threading.Condition()
        self._pace = Pace(steps=0, asked=-1, cycles=0, t_s=clock.now_s())
        self._reading: JointReading | None = None
        self._heard_s = clock.now_s()
        self._open = False
        self._stopped = ""
        self._lost = ""
        self._held = False
        self._commands = 0
        self._moved = False
        self._before = self._goals.sent, self._poses.sent
        self._turns = StandStill(times.cycle_s)
        self._stood_s = 0.0
        self._proof, self._standing = Proof(times.cycle_s), Standing(times.cycle_s)
        self._base_q, self._wrong = self._goals.sent, False
        self._controller_clock = ControllerClock(times.cycle_s, numbered=False)

    @property
    def n_joints(self) -> int:
        """How many joints it has."""
        return self._goals.n

    @property
    def joint_range(self) -> tuple[Array, Array]:
        """Ends of its joints' ranges, (n,) each: its own, once it is open, where the controller tells them."""
        return self._goals.limits.lower, self._goals.limits.upper

    @property
    def state(self) -> RobotState:
        """What it can do just now."""
        if not self._open or (reading := self._reading) is None:
            return RobotState.CLOSED
        if self._lost or self._silent():
            return RobotState.LOST
        moves = RobotState.MOVING if self._off(reading) > REST else RobotState.READY
        return RobotState.STOPPED if self._stopped else moves

    @property
    def why(self) -> str:
        """Why it is stopped or lost, in words; empty where it is neither."""
        return self._lost or self._stopped or ("its controller has fallen silent" if self._silent() else "")

    @property
    def measured_cycle_s(self) -> float | None:
        """The cycle that its controller keeps, s; None where too little was heard."""
        return self._controller_clock.measured_s

    @property
    def proven(self) -> bool:
        """Whether it was seen what its controller makes of what it is sent; else the first motion is a probe."""
        return self._proof.state is ProofState.PASSED

    def __enter__(self) -> Self:
        """Open the link and wait for the first reading. Raises DeviceFailed where that cannot be done."""
        if self._open:
            raise DeviceFailed(f"{self.name} is open already", consequence="It is not opened twice")
        self._reading, self._stopped, self._lost, self._held, self._wrong = None, "", "", False, False
        self._unprove()
        self._controller_clock.start()
        self._moved, self._stood_s = False, 0.0
        self._turns.begin()
        bound_control()  # opened in the main thread, the link's thread may go first
        with leads_to("The robot is not opened"):
            self._start()
        self._open = True
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        if self._open:
            if self._wrong:  # what makes the arm stand goes out until it does
                with self._ticked:
                    self._ticked.wait_for(lambda: self._standing.stands or bool(self._lost), END_S)
            self._open = False
            self._finish()

    def read(self) -> JointReading:
        """Return the newest reading. Raises DeviceFailed where closed, DeviceLost, StaleData."""
        reading = self._linked("read")
        if (age_s := self._clock.now_s() - reading.t_s) > self._times.stale_s:
            old = f"{self.name}: the newest reading is {age_s:.3f} s old"
            cure = "Stop the robot and look at its controller"
            raise StaleData(old, consequence="Where the arm is now is not known", cure=cure)
        return reading

    def step_joints(self, step: Array) -> Sent:
        """Move on from where it was last told to go by step (n,) in rad; return what goes out with the next packet."""
        with self._lock:  # a stop from another thread comes before it or after it, never into it
            reading = self._ready()
            q, limited = self._goals.step(step, reading.q)
            if self._proving(asks=bool((q != self._goals.sent).any())):
                return self._note(self._base_q, None, (PROVING, *limited))
            return self._note(q, None, limited)

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Refuse: this link takes joint values."""
        self._ready()
        raise UsageError(f"{self.name} takes no poses", cure="Send joint steps")

    def stop(self) -> None:
        """Hold what was last sent, from the controller's next cycle on, until reset; legal always."""
        with self._lock:
            self._stopped = self._stopped or "it was told to stop"
            self._hold()
            self._standing.begin()

    def reset(self) -> None:
        """Take commands again. Raises DeviceFailed where closed or where the controller takes no motion, DeviceLost."""
        self._linked("reset")
        with self._lock:
            if self._held:
                raise DeviceFailed(
                    f"{self.name}: {self._stopped}", consequence="It stays stopped", cure="Set its controller going"
                )
            self._stopped, self._wrong, self._moved = "", False, False

    def wait_step(self, after: int, wait_s: float) -> Pace:
        """Return the pace once more than `after` steps and the last command went out, or what it is after wait_s."""
        with self._ticked:
            self._ticked.wait_for(lambda: self._pace.steps > max(after, self._pace.asked), wait_s)
            return self._pace

    def listen(self, heard: Heard) -> None:
        """Tell `heard`, in the link's thread, of each reading q (n,) and when it was sent by the controller's clock."""
        self._controller_clock.heard = heard

    def slow_down(self, max_speed: Array) -> None:
        """Let no joint go faster than max_speed (n,) in rad/s or m/s, whoever asks; it is never faster than before."""
        self._goals.slow_down(max_speed)

    @abstractmethod
    def _start(self) -> None:
        """Open the link, start its thread and wait for the first reading; leave nothing open where that fails."""

    @abstractmethod
    def _finish(self) -> None:
        """Close the link; never raises."""

    def _tick(self, cycles: int, *, taken: bool) -> None:
        """Begin the answer to one of the controller's cycles, the given number after the one answered last.

        taken: whether it took what it was sent last, as far as it tells; else that goes out again.
        """
        with self._lock:  # a step belongs to the cycle before or after, never into it
            self._before = self._goals.sent, self._poses.sent
            proven = self._prove(cycles, taken=taken)
            steps = proven and taken and self._controller_clock.take_step()
            if steps:
                self._goals.take()
                self._poses.take()
            self._watch_standing()
            pace = self._pace
            self._pace = replace(pace, steps=pace.steps + steps, cycles=pace.cycles + cycles, t_s=self._clock.now_s())
        with self._ticked:
            self._ticked.notify_all()

    def _proving(self, *, asks: bool) -> bool:
        """Tell whether motion has to wait for the proof of the link, and forget it then; begin that where it asks."""
        if self._proof.state is ProofState.PASSED:
            return False
        if asks and self._proof.state is ProofState.NEEDED:
            self._proof.begin(self._probe())
        if running := self._proof.state is ProofState.RUNNING:
            self._hold()
        return running

    def _prove(self, cycles: int, *, taken: bool) -> bool:
        """Do a cycle of the proof where one runs; tell whether none runs."""
        if self._proof.state is not ProofState.RUNNING:
            self._proof.rest(self._axes())
            return True
        offset, cause = self._proof.step(self._axes(), cycles, taken=taken)
        self._put(np.zeros_like(offset) if self._stopped else offset)
        if self._stopped:
            self._unprove()
        if cause:
            self._refuse(cause)
        return False

    def _probe(self) -> Probe:
        return joint_probe(*self._goals.room())

    def _axes(self) -> Array:
        """Return where what is moved to prove the link is read, (n,)."""
        return np.zeros(self.n_joints) if self._reading is None else self._reading.q

    def _put(self, offset: Array) -> None:
        """Send the axes of the probe by (n,) away from where they stood."""
        self._goals.start(self._base_q + offset)

    def _refuse(self, why: str) -> None:
        """Stop because of something that is wrong with the controller; what makes the arm stand goes out."""
        with self._lock:
            self._stopped, self._wrong = why, True
            self._hold()
            self._unprove()
            self._standing.begin()

    def _watch_standing(self) -> None:
        """Answer no more where a stopped arm goes on moving: its controller then ends by itself what it does."""
        if self._stopped and not self._held and self._standing.moves(self._axes()):
            self._lose(f"{self._stopped}; the arm went on moving all the same, and is answered no more")

    def _hear_clock(self, stamp_s: float, number: int) -> None:
        """Note the controller's clock; stop where it jumps or its cycle is not what the link is set to."""
        jump = self._controller_clock.hear(stamp_s, number, self._clock.now_s(), self._reading)
        wrong = self._controller_clock.wrong if self._controller_clock.sure else ""
        if self._open and not self._wrong and (jump or wrong):
            self._refuse(jump or f"{wrong}: {self._controller_clock.cure}")

    def _measured(self) -> bool:
        return self._controller_clock.measured_s is not None

    def _hold(self) -> None:
        self._goals.hold()
        self._poses.hold()

    def _rebase(self, q: Array) -> None:
        """Take the position where the arm stands, q (n,), for its goal; what was proven was so for another session."""
        self._goals.start(q)
        self._unprove()

    def _unprove(self) -> None:
        """Take nothing for proven; where the axes are told to be is what the next probe leaves from."""
        self._proof.forget()
        self._base_q = self._goals.sent

    def _off(self, reading: JointReading) -> float:
        """Return how far it is from where it was last told to go, in rad or m."""
        return float(np.abs(self._goals.sent - reading.q).max())

    def _leads_on(self, q: Array, pose: RigidTransform | None) -> bool:
        if pose is None:
            return bool((q != self._goals.sent).any())
        return bool(np.abs(np.concatenate(between(self._poses.sent, pose))).max() > ROUNDING)

    def _heard(self, q: Array, t_s: float) -> None:
        """Take a good reading q (n,) of time t_s on the clock."""
        number = 0 if self._reading is None else self._reading.sequence + 1
        reading = JointReading(q=q, t_s=t_s, sequence=number, source=self.name)
        if self._reading is None:
            self._rebase(reading.q)
        self._heard_s, self._stood_s = t_s, 0.0
        self._reading = reading

    def _lose(self, why: str) -> None:
        """Give the link up until it is opened again; the first reason counts."""
        with self._lock:
            self._lost = self._lost or why
            self._hold()

    def _halt(self, why: str, q: Array) -> None:
        """Note that the controller takes no motion while the arm stands at q (n,); an empty reason: it does again."""
        with self._lock:
            if why:
                self._stopped = why
            elif self._held:
                self._stopped = f"{self._stopped}, and goes on now"
            self._held = bool(why)
            if why:
                # it may be moved by hand meanwhile: from where it stands then, nothing may pull it back
                self._rebase(q)

    def _stood_still(self) -> bool:
        """Note a turn of the link's thread; tell whether it stood still before, so that what has come is of the past.

        What was asked counts no more, an arm in motion is stopped. The controller may have ended its session.
        """
        with self._lock:
            now_s = self._clock.now_s()
            stood_s = self._turns.turn(now_s)
            if stood_s:
                self._hold()
                self._stop_moved(f"this program stood still for {stood_s / MS:.0f} ms")
                self._stood_s, self._heard_s = max(self._stood_s, stood_s), now_s
            return bool(stood_s)

    def _outlived(self) -> bool:
        """Tell whether this program stood still since its turn: the answer must not go out, and its step is taken back.

        The next turn finds the stand-still itself.
        """
        stood = bool(self._turns.since(self._clock.now_s()))
        if stood:
            with self._lock:
                self._goals.start(self._before[0])
                self._poses.start(self._before[1])
        return stood

    def _unheard_s(self) -> float:
        """Return for how long the controller was not heard: it was silent, or this program stood still."""
        return self._stood_s + self._clock.now_s() - self._heard_s

    def _begin_anew(self, why: str, q: Array) -> None:
        """Take up another session of the controller, where the arm stands, q (n,); an arm that moved is stopped."""
        with self._lock:
            self._stop_moved(why)
            self._rebase(q)

    def _stop_moved(self, why: str) -> None:
        """Stop an arm that was set in motion since it was opened or reset: nothing else was asked or enabled."""
        if self._moved and why not in self._stopped:
            self._standing.begin()
            self._stopped = f"{self._stopped}, and {why}" if self._stopped else why

    def _silent(self) -> bool:
        return self._open and self._clock.now_s() - self._heard_s > self._times.silent_s

    def _fallen_silent(self) -> bool:
        """Tell the link's thread whether at its turn the controller had been silent for too long."""
        return self._open and (self._turns.turn_s or 0.0) - self._heard_s > self._times.silent_s

    def _linked(self, what: str) -> JointReading:
        reading = self._reading
        if not self._open or reading is None:
            raise DeviceFailed(f"{self.name} is not open", consequence=f"It cannot {what}", cure="Open it first")
        if self._lost or self._silent():
            raise DeviceLost(
                f"the link to {self.name} is lost: {self.why}",
                consequence=f"It cannot {what}, and where the arm is is not known",
                cure="Check the cable and the controller, and open it again",
            )
        return reading

    def _ready(self) -> JointReading:
        reading = self._linked("move")
        if self._stopped:
            raise DeviceFailed(
                f"{self.name} is stopped: {self._stopped}",
                consequence="Nothing was sent",
                cure="Set that right on its controller, then reset it or open it again",
            )
        return reading

    def _note(self, q: Array, pose: RigidTransform | None, limited: tuple[str, ...]) -> Sent:
        self._moved = self._moved or self._leads_on(q, pose)
        self._commands += 1
        self._pace = replace(self._pace, asked=self._pace.steps)
        return Sent(q=q, t_s=self._clock.now_s(), sequence=self._commands - 1, pose=pose, limited=limited)
