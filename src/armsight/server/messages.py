"""The only place where commands, states and events turn into messages; and what a connection may say."""

from __future__ import annotations

import secrets

import numpy as np

from armsight.control import setpoints
from armsight.control.session.loop_host import LoopEvent
from armsight.control.status import RobotStatus
from armsight.drivers.remote import protocol as say
from armsight.errors import Inconsistent, UsageError
from armsight.geometry import pose_from_quat, xyz_quat

LONGEST_EVENT = 2000
"""Characters of an event's text at most, as the protocol has it."""


def command_of(message: say.Command) -> setpoints.Command:
    """Return what a driver's message asks for. Raises UsageError for a read, Inconsistent for a pose that is none."""
    match message:
        case say.Heartbeat(enable=enable, number=number):
            return setpoints.Heartbeat(enable=enable, number=number)
        case say.HoldMessage():
            return setpoints.Hold()
        case say.StopMessage():
            return setpoints.Stop()
        case say.ResetMessage():
            return setpoints.Reset()
        case say.ReadMessage():
            raise UsageError("read is no command of a driver")
        case _:
            return _motion_of(message)


def _motion_of(message: say.Motion) -> setpoints.Motion:
    match message:
        case say.JointGoalMessage(q=q):
            return setpoints.JointGoal(q=np.array(q))
        case say.JointVelocityMessage(qd=qd):
            return setpoints.JointVelocity(qd=np.array(qd))
        case say.JointStepMessage(step=step):
            return setpoints.JointStep(step=np.array(step))
        case say.FlangePoseMessage(T_base_flange=pose):
            return setpoints.FlangePose(T_base_flange=pose_from_quat(pose.xyz_m, pose.quat_xyzw))
        case say.ToolTwistMessage(velocity_m_s=v, angular_rad_s=w):
            return setpoints.ToolTwist(velocity_m_s=np.array(v), angular_rad_s=np.array(w))


def accepted(taken: setpoints.Taken, reply_to: int) -> say.Accepted:
    """Return the answer to a command that was taken."""
    pose = None
    if taken.T_base_flange is not None:
        xyz, quat = xyz_quat(taken.T_base_flange)
        pose = say.PoseMessage(xyz_m=xyz.tolist(), quat_xyzw=quat.tolist())
    return say.Accepted(
        reply_to=reply_to,
        t_s=taken.t_s,
        cycle=taken.cycle,
        q=None if taken.q is None else taken.q.tolist(),
        T_base_flange=pose,
        limited=list(taken.limited),
    )


def state_message(status: RobotStatus, instance: str, reply_to: int | None = None) -> say.StateMessage:
    """Return a status as a client gets it. instance: of this run of the server."""
    reading = None
    if status.reading is not None:
        reading = say.ReadingMessage(
            q=status.reading.q.tolist(),
            t_s=status.reading.t_s,
            age_s=status.t_s - status.reading.t_s,
            sequence=status.reading.sequence,
        )
    return say.StateMessage(
        reply_to=reply_to,
        instance=instance,
        t_s=status.t_s,
        cycle=status.cycle,
        robot=status.robot.value,
        guard=status.guard.value,
        why=status.why,
        reading=reading,
        q_sent=status.q_sent.tolist(),
        enabled=status.enabled,
        driver=say.Driver(who=status.driver, since_s=status.driver_s) if status.driver else None,
        late=status.late,
        missed=status.missed,
        lateness_p99_s=status.lateness_p99_s,
    )


def event_message(event: LoopEvent) -> say.EventMessage:
    """Return an event as a client gets it."""
    fields = {"t_s": event.t_s, "level": event.level, "message": event.message[:LONGEST_EVENT]}
    return say.EventMessage.model_validate(fields)


VIOLATIONS = 5
"""After so many messages that no client of ours sends, the connection is closed."""


class Session:
    """Admits a connection's messages. nonce: new for each connection; what was said on another one is refused."""

    def __init__(self, role: str) -> None:
        """role: of say.ALLOWED."""
        self.nonce = secrets.token_hex(16)
        self.violations = 0
        self._role = role
        self._seq = 0

    @property
    def spent(self) -> bool:
        """Whether it broke the rules so often that it is closed."""
        return self.violations >= VIOLATIONS

    def admit(self, text: str | bytes) -> say.Command:
        """Return a message.

        Raises Inconsistent where it is malformed, replayed or of another connection, UsageError where this role may
        not send it; each is a violation.
        """
        try:
            command = say.parse_command(text)
            self._check(command)
        except (Inconsistent, UsageError):
            self.violations += 1
            raise
        self._seq = max(self._seq, command.seq)
        return command

    def _check(self, command: say.Command) -> None:
        if isinstance(command, say.StopMessage):
            return  # from whomever, and whenever: one that is played again stops a robot, and nothing more
        if not secrets.compare_digest(command.session.encode(), self.nonce.encode()):
            raise Inconsistent(
                "a message of another connection", consequence="Nothing was done", cure="Send this one's session"
            )
        if command.seq <= self._seq:
            raise Inconsistent(
                f"message {command.seq} came after message {self._seq}: a replay",
                consequence="Nothing was done",
                cure="Number the messages of a connection upwards",
            )
        if not isinstance(command, say.ALLOWED[self._role]):
            raise UsageError(f"{command.type} is not for this connection", cure="Connect to drive")
