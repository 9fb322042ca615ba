"""The messages between a robot server and its clients: one JSON object in each text message of a WebSocket.

The server, the Python client and the documentation use these models; other programs follow the published JSON schema.
Lengths are in m, angles in rad, times in s on the server's monotonic clock, whose zero means nothing to a client.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from armsight.errors import ArmsightError, Inconsistent

VERSION = 1
"""Of the protocol: it stands in every path (/api/v1/) and grows where an old client would misread a message."""

MAX_BYTES = 16_384
"""Longest message that the server takes: 50 times a command for the longest arm."""

MAX_JOINTS = 16

STREAM_PATH = f"/api/v{VERSION}/stream"
DRIVE_PATH = f"/api/v{VERSION}/drive"
STATE_PATH = f"/api/v{VERSION}/state"
STOP_PATH = f"/api/v{VERSION}/stop"

Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Time = Annotated[float, Field(allow_inf_nan=False)]
Joints = Annotated[list[Number], Field(min_length=1, max_length=MAX_JOINTS)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Four = Annotated[list[Number], Field(min_length=4, max_length=4)]
Text = Annotated[str, Field(max_length=2000)]


class _Model(BaseModel):
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, frozen=True)


class PoseMessage(_Model):
    """A pose of one frame in another; the key says which: T_a_b is the pose of b in a."""

    xyz_m: Three = Field(description="Position in m.")
    quat_xyzw: Four = Field(description="Orientation as a quaternion, scalar last.")


class _FromClient(_Model):
    """What every message of a client carries: it is taken once, session is this connection's, and seq grows."""

    session: str = Field(max_length=64, description="The connection's nonce, from `welcome`.")
    seq: int = Field(ge=1, lt=2**53, description="Number of the message; grows with each message of a connection.")


class Heartbeat(_FromClient):
    """The driver is alive. Motion needs one with enable that was sent within the last `heartbeat_s` of `welcome`.

    Send it several times in that span, on the driving connection and on the line for stops, on both with the same
    number: whichever way is faster counts.
    """

    type: Literal["heartbeat"] = "heartbeat"
    enable: bool = Field(description="Whether the operator allows motion now (the deadman's switch).")
    number: int | None = Field(
        None, ge=1, lt=2**53, description="Grows with each heartbeat of a driver; one that is overtaken does not count."
    )
    key: str = Field("", max_length=64, description="On the line for stops: `enable_key` of the driver's `welcome`.")


class JointGoalMessage(_FromClient):
    """Go to joint values as fast as the limits allow."""

    type: Literal["joint_goal"] = "joint_goal"
    q: Joints = Field(description="Joint values in rad or m.")


class JointVelocityMessage(_FromClient):
    """Move with joint velocities; holds for `setpoint_s` of `welcome`, then the robot comes to rest."""

    type: Literal["joint_velocity"] = "joint_velocity"
    qd: Joints = Field(description="Joint velocities in rad/s or m/s.")


class JointStepMessage(_FromClient):
    """Move on by a step; all steps within one cycle lead no further together than one cycle allows."""

    type: Literal["joint_step"] = "joint_step"
    step: Joints = Field(description="Step of each joint in rad or m.")


class FlangePoseMessage(_FromClient):
    """Move the flange towards a pose, as far as one cycle allows."""

    type: Literal["flange_pose"] = "flange_pose"
    T_base_flange: PoseMessage = Field(description="Where the flange is to go.")


class ToolTwistMessage(_FromClient):
    """Move the tool with a velocity; holds for `setpoint_s` of `welcome`, then the robot comes to rest."""

    type: Literal["tool_twist"] = "tool_twist"
    velocity_m_s: Three = Field(description="Of the tool's origin in m/s, in base axes.")
    angular_rad_s: Three = Field(description="Angular velocity in rad/s, in base axes.")


class HoldMessage(_FromClient):
    """Come to rest and stay there; commands are taken again at once."""

    type: Literal["hold"] = "hold"


class StopMessage(_FromClient):
    """Come to rest and take no commands until a driver's reset. Every role may send it, on either connection."""

    type: Literal["stop"] = "stop"


class ResetMessage(_FromClient):
    """Take commands again after a stop."""

    type: Literal["reset"] = "reset"


class ReadMessage(_FromClient):
    """Ask for the state now; the answer's `reply_to` is this message's number."""

    type: Literal["read"] = "read"


Motion = JointGoalMessage | JointVelocityMessage | JointStepMessage | FlangePoseMessage | ToolTwistMessage
"""What sets the robot in motion."""

Command = Heartbeat | Motion | HoldMessage | StopMessage | ResetMessage | ReadMessage
"""What a client may say."""

ALLOWED: dict[str, tuple[type[_FromClient], ...]] = {
    "watch": (StopMessage, ReadMessage),
    "drive": get_args(Command),
    "stop": (StopMessage, Heartbeat),
}
"""What a client may say on which connection."""


class JointDescription(_Model):
    """One joint of the robot."""

    name: str
    lower: float | None = Field(description="Smallest value in rad or m; null where it has no end.")
    upper: float | None = Field(description="Largest value in rad or m; null where it has no end.")
    max_speed: float = Field(description="Largest speed in rad/s or m/s.")


class RobotDescription(_Model):
    """What robot it is."""

    name: str
    driver: str = Field(description="DRIVER:DEVICE that the server was started with.")
    n_joints: int
    cycle_s: float = Field(description="Time between two commands to the controller in s.")
    takes_poses: bool = Field(description="Whether `flange_pose` is possible.")
    joints: list[JointDescription]


class Welcome(_Model):
    """The first message of the server on a connection."""

    type: Literal["welcome"] = "welcome"
    version: int = Field(description="Of the protocol.")
    software: str = Field(description="Name and version of the server's program.")
    instance: str = Field(description="Of this run of the server: another one means that it was started anew.")
    session: str = Field(description="This connection's nonce; every message to the server carries it.")
    role: Literal["watch", "drive"] = Field(description="What this connection may do.")
    who: str = Field(description="The name that the token stands for.")
    robot: RobotDescription
    heartbeat_s: float = Field(description="An enable sent longer ago than this is none, in s: the robot is held.")
    setpoint_s: float = Field(description="How long a velocity holds without being sent again, in s.")
    max_bytes: int = Field(description="Longest message that the server takes.")
    stop_port: int | None = Field(None, description="Port of the line for stops on the same machine; null: none.")
    enable_key: str = Field("", description="Names the driver's enable on the line for stops; empty for watchers.")


class LineWelcome(_Model):
    """The first message on the line for stops."""

    type: Literal["line"] = "line"
    version: int = Field(description="Of the protocol.")
    session: str = Field(description="This connection's nonce; every message on it carries it.")


class Done(_Model):
    """The answer on the line for stops: the loop has been told."""

    type: Literal["done"] = "done"
    reply_to: int


class ReadingMessage(_Model):
    """A reading of the joints."""

    q: list[float] = Field(description="Joint values in rad or m.")
    t_s: Time
    age_s: Time = Field(description="How old it is in s, by the server's clock.")
    sequence: int


class Driver(_Model):
    """Who drives."""

    who: str
    since_s: Time = Field(description="For how long in s.")


class StateMessage(_Model):
    """The state of robot and loop; sent some times a second, and as the answer to `read`."""

    type: Literal["state"] = "state"
    reply_to: int | None = Field(None, description="The number of the `read` that this answers; null where none.")
    instance: str
    t_s: Time = Field(description="Now, on the loop's clock in s.")
    cycle: int = Field(description="Number of the loop's cycle.")
    robot: Literal["closed", "ready", "moving", "stopped", "lost"] = Field(description="The robot's own state.")
    guard: str = Field(description="The guard's state.")
    why: str = Field(description="Why the guard holds or stopped, in words; may be empty.")
    reading: ReadingMessage | None = Field(description="The newest reading; null before the first one.")
    q_sent: list[float] = Field(description="Where the robot was last told to go, rad or m.")
    enabled: bool = Field(description="Whether the driver's enable is alive.")
    driver: Driver | None = Field(description="Who drives; null where nobody does.")
    late: int = Field(description="Cycles of the loop that began late.")
    missed: int = Field(description="Cycles of the loop that were left out.")
    lateness_p99_s: float = Field(description="99 % of the cycles began at most so late, in s.")


class EventMessage(_Model):
    """Something that happened: a change of the guard's state, who drives, what was refused."""

    type: Literal["event"] = "event"
    t_s: Time
    level: Literal["info", "warning", "error"]
    message: Text


class Accepted(_Model):
    """The answer to a command that was taken."""

    type: Literal["accepted"] = "accepted"
    reply_to: int
    t_s: Time
    cycle: int = Field(description="The loop's cycle in which it was taken.")
    q: list[float] | None = Field(description="Where it takes the joints, in rad or m; null where it has no place.")
    T_base_flange: PoseMessage | None = Field(description="The flange's pose there; null where it is not known.")
    limited: list[str] = Field(description="The limits that cut the command, in words.")


class Refused(_Model):
    """The answer to a message that was not taken."""

    type: Literal["refused"] = "refused"
    reply_to: int | None = Field(description="The message's number; null where it could not be read.")
    kind: str = Field(description="The class of the error, one of `armsight.errors`.")
    cause: str
    consequence: str
    cure: str

    @classmethod
    def of(cls, error: ArmsightError, seq: int | None) -> Self:
        """Return an error as the client gets it, as the answer to message seq."""
        return cls(
            reply_to=seq, kind=type(error).__name__, cause=error.cause, consequence=error.consequence, cure=error.cure
        )


ServerMessage = Welcome | StateMessage | EventMessage | Accepted | Refused | LineWelcome | Done
"""What the server may say."""

_COMMANDS: TypeAdapter[Command] = TypeAdapter(Annotated[Command, Field(discriminator="type")])
_ANSWERS: TypeAdapter[ServerMessage] = TypeAdapter(Annotated[ServerMessage, Field(discriminator="type")])


def parse_command(text: str | bytes) -> Command:
    """Return a client's message. Raises Inconsistent where it is none, too long, or says more than its kind may."""
    command: Command = _parsed(_COMMANDS, text, limit=MAX_BYTES)
    return command


def parse_answer(text: str | bytes) -> ServerMessage:
    """Return a server's message. Raises Inconsistent where it is none."""
    answer: ServerMessage = _parsed(_ANSWERS, text, limit=64 * MAX_BYTES)
    return answer


def protocol_schema() -> dict[str, Any]:
    """Return the JSON schema of the protocol: one of the messages of either side."""
    schema: dict[str, Any] = TypeAdapter(Command | ServerMessage).json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"armsight robot server, protocol version {VERSION}",
        "from_client": [kind.__name__ for kind in get_args(Command)],
        "from_server": [kind.__name__ for kind in get_args(ServerMessage)],
        **schema,
    }


def _parsed(adapter: TypeAdapter[Any], text: str | bytes, *, limit: int) -> Any:
    size = len(text.encode("utf-8", "surrogatepass")) if isinstance(text, str) else len(text)
    if size > limit:
        raise Inconsistent(f"a message of {size} bytes is longer than {limit}", consequence="It was not read")
    try:
        return adapter.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise Inconsistent(
            f"a message is not of protocol version {VERSION}: {where or 'message'}: {first['msg']}"[:300],
            consequence="Nothing was done",
            cure=f"Send messages as the schema of version {VERSION} has them",
        ) from error
