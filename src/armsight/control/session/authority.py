"""The one place where a robot is driven from: who drives, what they ask, who stops it; the loop does the rest."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, replace
from threading import RLock
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control import setpoints
from armsight.control.guard import GuardState
from armsight.control.session.loop_host import LoopHost, flange_pose, synchronized
from armsight.control.status import RobotStatus
from armsight.drivers import RobotState
from armsight.drivers.remote.protocol import RobotDescription
from armsight.errors import DeviceFailed, Inconsistent, StaleData, UsageError
from armsight.units import MS

SILENT_S = 10.0
"""A driver who sent no heartbeat for so long may be replaced by another; held the robot has been long since."""

LEAD_S = 0.2
"""Steps lead the robot by no more than a joint's way in so long: else it went on long after the last of them."""

RELEASED_CYCLES = 3.0
"""Cycles after which the loop has told that the enable was let go of."""

RANGE_MARGIN = 1e-9
"""A goal so little (rad or m) beyond a limit is at it: rounding."""


class AuthorityLog(Protocol):
    """Keeps what is asked of the control authority; never waits."""

    def event(self, t_s: float, level: str, message: str) -> None:
        """Keep something that happened; level: info, warning or error."""

    def command(self, t_s: float, who: str, kind: str, values: dict[str, Any]) -> None:
        """Keep what somebody asked and was given."""


class EnableLost(DeviceFailed):
    """The enable is not held, or was not heard of in time: the robot is held, and goes on once it is held anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """The right to drive: one at a time. number tells leases of the same person apart; who: as it is shown.

    person: whom the token stands for, who alone may use it. key: what their enable is known by on the line for stops.
    """

    number: int
    who: str
    person: str
    since_s: float
    key: str


class ControlAuthority:
    """Takes commands from one driver at a time, and stops from everyone; any thread may call it.

    lock: held while a call lasts; shared with whoever else speaks to the host.
    """

    def __init__(self, host: LoopHost, log: AuthorityLog, *, instance: str, lock: RLock | None = None) -> None:
        self.lock = lock or RLock()
        self._host = host
        self._log = log
        self.instance = instance
        self._lease: Lease | None = None
        self._leases = 0
        self._beat_s = -np.inf
        self._enabled = False
        self._reenable = False
        self._let_go_s = -np.inf
        self._stopped = False
        self._reset_cycle = -1
        self._goal: Array | None = None
        self._dropped = -1
        self._cycle = -1
        self._from: Array = np.empty(0)
        joints = host.description.joints
        self._lower = np.array([-np.inf if joint.lower is None else joint.lower for joint in joints])
        self._upper = np.array([np.inf if joint.upper is None else joint.upper for joint in joints])
        self._speed = np.array([joint.max_speed for joint in joints])

    @property
    def robot(self) -> RobotDescription:
        """What robot it is."""
        return self._host.description

    @property
    def driver(self) -> Lease | None:
        """Who drives; None where nobody does."""
        return self._lease

    @synchronized
    def take(self, who: str, person: str = "") -> Lease:
        """Return the right to drive; person: the name that the token of who stands for, where they are shown by more.

        Raises DeviceFailed, saying who has it and since when, where it is taken.
        """
        now_s, held = self._host.now_s(), self._lease
        if held is not None:
            if now_s - max(self._beat_s, held.since_s) < SILENT_S:
                raise DeviceFailed(
                    f"{held.who} drives {self.robot.name} since {now_s - held.since_s:.0f} s",
                    consequence=f"{who} may watch and stop it, but not drive",
                    cure="Wait until they have left, or ask them to",
                )
            self.leave(held, f"{held.who} was silent for {SILENT_S:g} s and {who} drives now")
        self._leases += 1
        key = secrets.token_hex(16)
        self._lease = Lease(number=self._leases, who=who, person=person or who, since_s=now_s, key=key)
        self._host.grant(self._lease.number, key, self._lease.person)
        self.note("info", f"{who} drives")
        return self._lease

    @synchronized
    def leave(self, lease: Lease, why: str) -> None:
        """Give the right to drive back: the robot is held at once. Does nothing where another has it."""
        if lease is not self._lease:
            return
        # first of all nobody drives: the line for stops must not renew what is being released here
        self._lease = None
        self._enabled, self._reenable, self._goal = False, False, None
        self._let_go_s = self._host.now_s()
        self._host.grant(lease.number, "")
        self._host.release(why, lease=lease.number)
        self.note("info", f"{lease.who} no longer drives: {why}")

    @synchronized
    def stop(self, who: str) -> None:
        """Bring the robot to rest until it is reset; legal for everyone, at any time; never raises."""
        # counted here at once: the loop tells of its stop a cycle later, and what is asked meanwhile must find it
        # stopped
        self._stopped = True
        self._goal = None
        self._host.stop(f"stopped by {who}")
        self.note("warning", f"stopped by {who}")

    @synchronized
    def perform(self, lease: Lease, command: setpoints.Command, *, seq: int = 1, age_s: float = 0.0) -> setpoints.Taken:
        """Do what the driver asked age_s ago and return where it leads; seq: number of their message, for the log.

        Raises DeviceFailed where the robot is stopped, not enabled, or driven by another; StaleData for a set point
        that was too long under way; Inconsistent and UsageError for what it cannot do; DeviceLost where the loop has
        ended.
        """
        stops = isinstance(command, setpoints.Stop)
        if lease is not self._lease and not stops:
            raise DeviceFailed(
                f"{lease.who} no longer drives", consequence="Nothing was done", cure="Open the connection again"
            )
        now_s = self._host.now_s()
        if stops:
            self.stop(lease.who)  # before all that may be refused
        if not isinstance(command, setpoints.Heartbeat):
            kind, values = setpoints.logged(command)
            self._log.command(now_s, lease.who, kind, {"seq": seq, **values})
        now = self._host.status()
        # the log has the command already: what is refused below was asked all the same
        q, limited = self._done(lease, command, now, age_s)
        T = flange_pose(self._host.arm, q) if q is not None and self.robot.takes_poses else None
        return setpoints.Taken(t_s=now_s, cycle=now.cycle, q=q, T_base_flange=T, limited=limited)

    @synchronized
    def status(self) -> RobotStatus:
        """Return the robot's status as it counts here and now. Raises DeviceLost where the loop has ended."""
        now, now_s, lease = self._host.status(), self._host.now_s(), self._lease
        return replace(
            now,
            t_s=now_s,
            robot=self._robot_state(now),
            driver="" if lease is None else lease.who,
            driver_s=0.0 if lease is None else now_s - lease.since_s,
            lateness_p99_s=self._host.lateness_p99_s(),
        )

    @synchronized
    def note(self, level: str, message: str) -> None:
        """Keep something that happened."""
        self._log.event(self._host.now_s(), level, message)

    def _done(
        self, lease: Lease, command: setpoints.Command, now: RobotStatus, age_s: float
    ) -> tuple[Array | None, tuple[str, ...]]:
        match command:
            case setpoints.Heartbeat():
                self._beat(lease, command, age_s)
            case setpoints.Hold():
                self._post(setpoints.Hold(why=f"{lease.who} asked for it"), age_s)
            case setpoints.Stop():
                pass  # it is done
            case setpoints.Reset():
                self._reset(lease, now)
            case _:
                return self._move(command, now, age_s)
        return None, ()

    def _move(self, command: setpoints.Motion, now: RobotStatus, age_s: float) -> tuple[Array | None, tuple[str, ...]]:
        self._allow(now, age_s)
        match command:
            case setpoints.JointVelocity(qd=qd):
                self._check_joints("qd", qd)
                self._post(command, age_s)
            case setpoints.ToolTwist():
                self._need_poses()
                self._post(command, age_s)
            case setpoints.JointGoal(q=q):
                return self._go(self._reachable(q), now, age_s), ()
            case setpoints.JointStep(step=step):
                self._check_joints("step", step)
                begin = self._begin_cycle(now)
                return self._cut((begin if self._goal is None else self._goal) + step, now, age_s)
            case setpoints.FlangePose(T_base_flange=T):
                return self._cut(self._joints_of(T, self._begin_cycle(now)), now, age_s)
        return None, ()

    def _beat(self, lease: Lease, beat: setpoints.Heartbeat, age_s: float) -> None:
        """Take an enable, or its end; it counts from when it was sent."""
        self._reenable = self._reenable and beat.enable
        self._beat_s, self._enabled = self._host.now_s() - age_s, beat.enable and not self._reenable
        if not beat.enable:
            self._goal, self._let_go_s = None, self._host.now_s()
        self._host.beat(enable=beat.enable, age_s=age_s, lease=lease.number, number=beat.number)

    def _reset(self, lease: Lease, now: RobotStatus) -> None:
        self._host.reset()
        self._stopped, self._goal, self._reset_cycle = False, None, now.cycle
        self._enabled, self._reenable = False, True  # who still holds the enable must let go of it first
        self.note("info", f"reset by {lease.who}")

    def _post(self, setpoint: setpoints.SetPoint, age_s: float) -> None:
        self._goal = None
        self._host.post(setpoint, age_s=age_s)

    def _go(self, q: Array, now: RobotStatus, age_s: float) -> Array:
        self._host.post(setpoints.JointGoal(q=q), age_s=age_s)
        self._goal, self._dropped = q, now.dropped
        return q

    def _cut(self, goal: Array, now: RobotStatus, age_s: float) -> tuple[Array, tuple[str, ...]]:
        """Go towards joint values (n,) as far as one cycle allows, all joints alike, within their range."""
        joints = self.robot.joints
        way = goal - self._from
        longest = self._speed * self.robot.cycle_s
        share = float(np.min(longest / np.maximum(np.abs(way), 1e-300), initial=1.0))
        slow = tuple(
            f"speed of {j.name}" for j, w, m in zip(joints, way, longest, strict=True) if abs(w) > m * (1 + 1e-9)
        )
        asked = self._from + share * way
        lead = LEAD_S * self._speed
        # where the robot is held back, or slower than the steps come, the goal may not run away from it
        near = np.clip(asked, now.q_sent - lead, now.q_sent + lead)
        far = tuple(f"lead of {j.name}" for j, a, b in zip(joints, asked, near, strict=True) if a != b)
        # who stands beyond an end stays there, or comes back as far as was asked: a step of one joint moves no other
        q = np.clip(near, np.minimum(self._lower, now.q_sent), np.maximum(self._upper, now.q_sent))
        ends = tuple(f"range of {j.name}" for j, a, b in zip(joints, near, q, strict=True) if a != b)
        return self._go(q, now, age_s), slow + far + ends

    def _begin_cycle(self, now: RobotStatus) -> Array:
        """Return where this cycle's steps begin: together they lead no further from there than a cycle's way."""
        if self._dropped != now.dropped:
            self._goal = None  # the loop forgot it on the way
        if now.cycle != self._cycle or self._goal is None:
            self._cycle = now.cycle
            self._from = now.q_sent if self._goal is None else self._goal
        return self._from

    def _allow(self, now: RobotStatus, age_s: float) -> None:
        """Raise DeviceFailed where motion is not allowed now, StaleData for what was asked too long ago."""
        if self._robot_state(now) is RobotState.LOST:
            raise DeviceFailed(f"the link to {self.robot.name} is lost", consequence="Nothing was sent")
        if self._robot_state(now) is RobotState.STOPPED:
            raise DeviceFailed(
                f"{self.robot.name} is stopped" + (f" ({now.why})" if now.why else ""),
                consequence="Nothing was sent",
                cure="Reset it first",
            )
        longest_s = self._host.enable_age_s
        old_s = self._host.now_s() - self._beat_s
        if lapsed := self.lapsed(now):
            raise EnableLost(
                f"motion is not enabled: {lapsed}",
                consequence="Nothing was sent",
                cure="Let the enable go and give it anew: a heartbeat without and one with enable",
            )
        if not self._enabled or old_s > longest_s:
            off = "the enable must be let go of and given anew" if self._reenable else "the driver's enable is off"
            raise EnableLost(
                f"motion is not enabled: {f'the newest enable is {old_s:.2f} s old' if self._enabled else off}",
                consequence="Nothing was sent",
                cure=f"Send a heartbeat with enable several times in {longest_s:g} s, over a line that is faster",
            )
        if age_s > longest_s:
            raise StaleData(
                f"a command that may be {age_s / MS:.0f} ms old",
                consequence="Nothing was sent",
                cure=f"Drive over a line whose round trip is well below {longest_s / MS:.0f} ms",
            )

    def lapsed(self, now: RobotStatus) -> str:
        """Return why the enable ended by itself, '' where it did not, or was let go of. now: the newest status."""
        told = now.t_s > self._let_go_s + RELEASED_CYCLES * self.robot.cycle_s
        return now.lapsed if told else ""

    def _robot_state(self, now: RobotStatus) -> RobotState:
        """Return the robot's state; what was stopped or reset here counts before the loop has told so."""
        if now.robot is RobotState.LOST:
            return RobotState.LOST
        if self._stopped or (now.guard is GuardState.STOPPED and now.cycle > self._reset_cycle + 1):
            return RobotState.STOPPED
        return RobotState.READY if now.robot in (RobotState.STOPPED, RobotState.CLOSED) else now.robot

    def _check_joints(self, name: str, values: Array) -> None:
        if values.shape != (self.robot.n_joints,):
            raise UsageError(
                f"{self.robot.name} has {self.robot.n_joints} joints, but {name} has {values.size} values",
                cure=f"Give {self.robot.n_joints} values",
            )

    def _reachable(self, q: Array) -> Array:
        """Return joint values (n,) that are within the range. Raises Inconsistent, UsageError."""
        self._check_joints("q", q)
        for value, joint, low, high in zip(q, self.robot.joints, self._lower, self._upper, strict=True):
            if not low - RANGE_MARGIN <= value <= high + RANGE_MARGIN:
                raise Inconsistent(
                    f"{value:.6g} of {joint.name} is out of its range {low:.6g} to {high:.6g}",
                    consequence="Nothing was sent",
                    cure="Give a place within the range",
                )
        return q

    def _need_poses(self) -> None:
        if not self.robot.takes_poses or self._host.arm is None:
            raise UsageError(f"{self.robot.name} takes no poses here", cure="Send joint values")

    def _joints_of(self, T_base_flange: RigidTransform, near: Array) -> Array:
        """Return the joint values (n,) that bring the flange to a pose, nearest to near (n,)."""
        self._need_poses()
        arm = self._host.arm
        if arm is None:
            return near
        found = arm.ik(arm.T_world_base * T_base_flange * arm.T_flange_tool, arm.values(near))
        if not found:
            raise Inconsistent(
                f"{self.robot.name} cannot bring its flange there: {found.why}",
                consequence="Nothing was sent",
                cure="Give a pose within its reach",
            )
        return arm.readings(found[0].q)
