"""The one place where a robot is driven from: who drives, what they ask, who stops it; the loop does the rest."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from threading import RLock
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from armsight.app.robot.host import Host, Snapshot, flange_pose
from armsight.app.robot.synchronized import synchronized
from armsight.control.setpoints import Hold, JointGoal, JointVelocity, SetPoint, ToolTwist
from armsight.drivers import RobotState
from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceFailed, Inconsistent, StaleData, UsageError
from armsight.geometry import pose_from_quat, xyz_quat
from armsight.units import MS

Array = NDArray[np.float64]

SILENT_S = 10.0
"""A driver who sent no heartbeat for so long may be replaced by another; held the robot has been long since."""

LEAD_S = 0.2
"""Steps lead the robot by no more than a joint's way in so long: else it went on long after the last of them."""

STOPPED = "stopped"

RANGE_MARGIN = 1e-9
"""A goal so little (rad or m) beyond a limit is at it: rounding."""


class AuthorityLog(Protocol):
    """Keeps what is asked of the control authority; never waits."""

    def event(self, t_s: float, level: str, message: str) -> None:
        """Keep something that happened; level: info, warning or error."""
        ...

    def command(self, t_s: float, who: str, kind: str, values: dict[str, Any]) -> None:
        """Keep what somebody asked and was given."""
        ...


class EnableLost(DeviceFailed):
    """The enable is not held, or was not heard of in time: the robot is held, and goes on once it is held anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """The right to drive: one at a time. number tells leases of the same person apart.

    key: what their enable is known by on the line for stops; for them alone.
    """

    number: int
    who: str
    since_s: float
    key: str


class ControlAuthority:
    """Takes commands from one driver at a time, and stops from everyone; any thread may call it.

    lock: held while a call lasts; shared with whoever else speaks to the host.
    """

    def __init__(self, host: Host, log: AuthorityLog, *, instance: str, lock: RLock | None = None) -> None:
        self.lock = lock or RLock()
        self._host = host
        self._log = log
        self.instance = instance
        self._lease: Lease | None = None
        self._leases = 0
        self._beat_s = -np.inf
        self._enabled = False
        self._reenable = False
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
    def robot(self) -> say.RobotDescription:
        """What robot it is."""
        return self._host.description

    @property
    def driver(self) -> Lease | None:
        """Who drives; None where nobody does."""
        return self._lease

    @synchronized
    def take(self, who: str) -> Lease:
        """Return the right to drive. Raises DeviceFailed, saying who has it and since when, where it is taken."""
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
        self._lease = Lease(number=self._leases, who=who, since_s=now_s, key=secrets.token_hex(16))
        self._host.grant(self._lease.number, self._lease.key)
        self.note("info", f"{who} drives")
        return self._lease

    @synchronized
    def leave(self, lease: Lease, why: str) -> None:
        """Give the right to drive back: the robot is held at once. Does nothing where another has it."""
        if lease is not self._lease:
            return
        self._lease = None
        self._enabled, self._reenable, self._goal = False, False, None
        self._host.grant(lease.number, "")
        self._host.release(why, lease=lease.number)
        self.note("info", f"{lease.who} no longer drives: {why}")

    @synchronized
    def stop(self, who: str) -> None:
        """Bring the robot to rest until it is reset; legal for everyone, at any time; never raises."""
        self._stopped = True
        self._goal = None
        self._host.stop(f"stopped by {who}")
        self.note("warning", f"stopped by {who}")

    @synchronized
    def perform(self, lease: Lease, command: say.Command, *, age_s: float = 0.0) -> say.Accepted:
        """Do what the driver asked age_s ago and return where it leads.

        Raises DeviceFailed where the robot is stopped, not enabled, or driven by another; StaleData for a set point
        that was too long under way; Inconsistent and UsageError for what it cannot do; DeviceLost where the loop has
        ended.
        """
        if lease is not self._lease:
            raise DeviceFailed(
                f"{lease.who} no longer drives", consequence="Nothing was done", cure="Open the connection again"
            )
        now_s = self._host.now_s()
        if not isinstance(command, say.Heartbeat):
            self._log.command(
                now_s, lease.who, command.type, command.model_dump(exclude={"session", "type"}, mode="json")
            )
        now = self._host.snapshot()
        q, limited = self._done(lease, command, now, age_s)
        T = flange_pose(self._host.arm, q) if q is not None and self.robot.takes_poses else None
        return say.Accepted(
            reply_to=command.seq,
            t_s=now_s,
            cycle=now.cycle,
            q=None if q is None else q.tolist(),
            T_base_flange=None if T is None else pose_message(T),
            limited=list(limited),
        )

    @synchronized
    def state(self, reply_to: int | None = None) -> say.StateMessage:
        """Return the state for a client. Raises DeviceLost where the loop has ended."""
        now, now_s = self._host.snapshot(), self._host.now_s()
        reading = None
        if now.reading is not None:
            reading = say.ReadingMessage(
                q=now.reading.q.tolist(),
                t_s=now.reading.t_s,
                age_s=now_s - now.reading.t_s,
                sequence=now.reading.sequence,
            )
        lease = self._lease
        return say.StateMessage(
            reply_to=reply_to,
            instance=self.instance,
            t_s=now_s,
            cycle=now.cycle,
            robot=self._robot_state(now).value,
            guard=now.guard,
            why=now.why,
            reading=reading,
            q_sent=now.q_sent.tolist(),
            enabled=now.enabled,
            driver=None if lease is None else say.Driver(who=lease.who, since_s=now_s - lease.since_s),
            late=now.late,
            missed=now.missed,
            lateness_p99_s=self._host.lateness_p99_s(),
        )

    @synchronized
    def note(self, level: str, message: str) -> None:
        """Keep something that happened."""
        self._log.event(self._host.now_s(), level, message)

    def _done(
        self, lease: Lease, command: say.Command, now: Snapshot, age_s: float
    ) -> tuple[Array | None, tuple[str, ...]]:
        """Do what is asked; return the joint values it leads to (n,), and the limits that cut it."""
        match command:
            case say.Heartbeat():
                self._beat(lease, command, age_s)
            case say.HoldMessage():
                self._post(Hold(why=f"{lease.who} asked for it"), age_s)
            case say.StopMessage():
                self.stop(lease.who)
            case say.ResetMessage():
                self._reset(lease, now)
            case say.ReadMessage():
                raise UsageError("read is no command of a driver", consequence="Nothing was done")
            case _:
                return self._move(command, now, age_s)
        return None, ()

    def _move(self, command: say.Motion, now: Snapshot, age_s: float) -> tuple[Array | None, tuple[str, ...]]:
        """Do what sets the robot in motion, where that is allowed; return as _done."""
        self._allow(now, age_s)
        match command:
            case say.JointVelocityMessage():
                self._post(JointVelocity(qd=self._joints("qd", command.qd)), age_s)
            case say.ToolTwistMessage(velocity_m_s=v, angular_rad_s=w):
                self._need_poses()
                self._post(ToolTwist(velocity_m_s=np.array(v), angular_rad_s=np.array(w)), age_s)
            case say.JointGoalMessage():
                return self._go(self._reachable(command.q), now, age_s), ()
            case say.JointStepMessage():
                begin, step = self._begin_cycle(now), self._joints("step", command.step)
                return self._cut((begin if self._goal is None else self._goal) + step, now, age_s)
            case say.FlangePoseMessage():
                return self._cut(self._joints_of(command.T_base_flange, self._begin_cycle(now)), now, age_s)
        return None, ()

    def _beat(self, lease: Lease, said: say.Heartbeat, age_s: float) -> None:
        """Take an enable, or its end; it counts from when it was sent."""
        self._reenable = self._reenable and said.enable
        self._beat_s, self._enabled = self._host.now_s() - age_s, said.enable and not self._reenable
        if not said.enable:
            self._goal = None
        self._host.beat(enable=said.enable, age_s=age_s, lease=lease.number, number=said.number)

    def _reset(self, lease: Lease, now: Snapshot) -> None:
        self._host.reset()
        self._stopped, self._goal, self._reset_cycle = False, None, now.cycle
        self._enabled, self._reenable = False, True  # who still holds the enable must let go of it first
        self.note("info", f"reset by {lease.who}")

    def _post(self, setpoint: SetPoint, age_s: float) -> None:
        self._goal = None
        self._host.post(setpoint, age_s=age_s)

    def _go(self, q: Array, now: Snapshot, age_s: float) -> Array:
        self._host.post(JointGoal(q=q), age_s=age_s)
        self._goal, self._dropped = q, now.dropped
        return q

    def _cut(self, goal: Array, now: Snapshot, age_s: float) -> tuple[Array, tuple[str, ...]]:
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
        near = np.clip(asked, now.q_sent - lead, now.q_sent + lead)
        far = tuple(f"lead of {j.name}" for j, a, b in zip(joints, asked, near, strict=True) if a != b)
        # who stands beyond an end stays there, or comes back as far as was asked: a step of one joint moves no other
        q = np.clip(near, np.minimum(self._lower, now.q_sent), np.maximum(self._upper, now.q_sent))
        ends = tuple(f"range of {j.name}" for j, a, b in zip(joints, near, q, strict=True) if a != b)
        return self._go(q, now, age_s), slow + far + ends

    def _begin_cycle(self, now: Snapshot) -> Array:
        """Return where this cycle's steps begin: together they lead no further from there than a cycle's way."""
        if self._dropped != now.dropped:
            self._goal = None  # the loop forgot it on the way
        if now.cycle != self._cycle or self._goal is None:
            self._cycle = now.cycle
            self._from = now.q_sent if self._goal is None else self._goal
        return self._from

    def _allow(self, now: Snapshot, age_s: float) -> None:
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

    def _robot_state(self, now: Snapshot) -> RobotState:
        """Return the robot's state; what was stopped or reset here counts before the loop has told so."""
        if now.robot is RobotState.LOST:
            return RobotState.LOST
        if self._stopped or (now.guard == STOPPED and now.cycle > self._reset_cycle + 1):
            return RobotState.STOPPED
        return RobotState.READY if now.robot in (RobotState.STOPPED, RobotState.CLOSED) else now.robot

    def _joints(self, name: str, values: ArrayLike) -> Array:
        array = np.asarray(values, dtype=float)
        if array.shape != (self.robot.n_joints,):
            raise UsageError(
                f"{self.robot.name} has {self.robot.n_joints} joints, but {name} has {array.size} values",
                consequence="Nothing was sent",
                cure=f"Give {self.robot.n_joints} values",
            )
        return array

    def _reachable(self, values: ArrayLike) -> Array:
        q = self._joints("q", values)
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
            raise UsageError(
                f"{self.robot.name} takes no poses here", consequence="Nothing was sent", cure="Send joint values"
            )

    def _joints_of(self, pose: say.PoseMessage, near: Array) -> Array:
        """Return the joint values (n,) that bring the flange to a pose, nearest to near (n,)."""
        self._need_poses()
        arm = self._host.arm
        if arm is None:
            return near
        T_base_flange = pose_from_quat(pose.xyz_m, pose.quat_xyzw)
        found = arm.ik(arm.T_world_base * T_base_flange * arm.T_flange_tool, arm.values(near))
        if not found:
            raise Inconsistent(
                f"{self.robot.name} cannot bring its flange there: {found.why}",
                consequence="Nothing was sent",
                cure="Give a pose within its reach",
            )
        return arm.readings(found[0].q)


def pose_message(T: RigidTransform) -> say.PoseMessage:
    """Return a pose as messages have it."""
    xyz, quat = xyz_quat(T)
    return say.PoseMessage(xyz_m=xyz.tolist(), quat_xyzw=quat.tolist())
