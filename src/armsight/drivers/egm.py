"""ABB's Externally Guided Motion: the controller sends its state over UDP each 4 ms and is answered with a goal.

Messages are built at run time from field numbers and types, those of ABB's published definition of the sensor interface
(package abb.egm, proto2), chapter "Externally Guided Motion" of the application manual "Controller software IRC5 /
OmniCore". Fields left out here are skipped by every protobuf reader. All fields are optional here; what must be there
is checked by `parse`. Degrees and mm are on the wire only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from pydantic import Field
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.drivers.goals import GivenGoals
from armsight.drivers.link_settings import USUAL_JOINTS, Positive, UdpSettings
from armsight.drivers.pace import LARGEST_M, LARGEST_RAD, ControllerClock
from armsight.drivers.udp import Sender, UdpRobot
from armsight.errors import Inconsistent
from armsight.units import MM, MS

FIELD = descriptor_pb2.FieldDescriptorProto
UINT32, UINT64, BOOL, DOUBLE, ENUM = (
    FIELD.TYPE_UINT32,
    FIELD.TYPE_UINT64,
    FIELD.TYPE_BOOL,
    FIELD.TYPE_DOUBLE,
    FIELD.TYPE_INT32,  # an enumeration and an int32 are the same on the wire, and unknown values stay readable
)

MESSAGES: dict[str, dict[str, tuple[int, int | str, bool]]] = {
    "EgmHeader": {"seqno": (1, UINT32, False), "tm": (2, UINT32, False), "mtype": (3, ENUM, False)},
    "EgmCartesian": {"x": (1, DOUBLE, False), "y": (2, DOUBLE, False), "z": (3, DOUBLE, False)},
    "EgmQuaternion": {f"u{i}": (i + 1, DOUBLE, False) for i in range(4)},
    "EgmPose": {"pos": (1, "EgmCartesian", False), "orient": (2, "EgmQuaternion", False)},
    "EgmJoints": {"joints": (1, DOUBLE, True)},
    "EgmClock": {"sec": (1, UINT64, False), "usec": (2, UINT64, False)},
    "EgmPlanned": {"joints": (1, "EgmJoints", False), "cartesian": (2, "EgmPose", False)},
    "EgmFeedBack": {
        "joints": (1, "EgmJoints", False),
        "cartesian": (2, "EgmPose", False),
        "time": (4, "EgmClock", False),
    },
    "EgmState": {"state": (1, ENUM, False)},
    "EgmRobot": {
        "header": (1, "EgmHeader", False),
        "feedBack": (2, "EgmFeedBack", False),
        "planned": (3, "EgmPlanned", False),
        "motorState": (4, "EgmState", False),
        "mciState": (5, "EgmState", False),
        "mciConvergenceMet": (6, BOOL, False),
        "rapidExecState": (8, "EgmState", False),
    },
    "EgmSensor": {"header": (1, "EgmHeader", False), "planned": (2, "EgmPlanned", False)},
}
"""Field name: (number, type or message, repeated). EgmState stands for the three messages of one enumeration each."""


def _classes() -> dict[str, Any]:
    file = descriptor_pb2.FileDescriptorProto(name="armsight/egm.proto", package="armsight.egm", syntax="proto2")
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for field, (number, kind, repeated) in fields.items():
            label = FIELD.LABEL_REPEATED if repeated else FIELD.LABEL_OPTIONAL
            entry = message.field.add(name=field, number=number, label=label)
            if isinstance(kind, str):
                entry.type, entry.type_name = FIELD.TYPE_MESSAGE, f".armsight.egm.{kind}"
            else:
                entry.type = kind  # type: ignore[assignment]
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"armsight.egm.{name}")) for name in MESSAGES
    }


CLASSES = _classes()
EgmRobotMessage: Any = CLASSES["EgmRobot"]
EgmSensorMessage: Any = CLASSES["EgmSensor"]


DATA, CORRECTION = 2, 3
"""What a packet is (EgmHeader.mtype)."""

MOTORS_OFF, PROGRAM_STOPPED = 2, 1
"""Of motorState and of rapidExecState."""

EGM_ERROR, EGM_STOPPED, EGM_RUNNING = 1, 2, 3
"""Of mciState: whether EGM takes motion."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControllerPacket:
    """What the controller told in one cycle.

    sequence, tm_ms: its number and the controller's clock, both from its start. q (n,): measured joint values in rad.
    T_base_flange: measured pose where it is told, in the frame that EGMActPose or EGMActJoint has set on the
    controller. q_planned, T_planned: where it means to be, as far as it tells. why_still: why it takes no motion just
    now, in words; empty where it does.
    """

    sequence: int
    tm_ms: int
    q: Array
    q_planned: Array | None
    T_base_flange: RigidTransform | None
    T_planned: RigidTransform | None
    why_still: str


def parse(data: bytes, n: int) -> ControllerPacket:
    """Return the packet of a controller with n joints. Raises Inconsistent for anything that is not one."""
    message = EgmRobotMessage()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise Inconsistent(f"a packet is no EgmRobot message: {error}") from error
    if not (message.HasField("header") and message.header.HasField("seqno") and message.header.HasField("tm")):
        raise Inconsistent("a packet has no number or time")
    if message.header.mtype != DATA:
        raise Inconsistent(f"a packet is of type {message.header.mtype}, not of a controller's data")
    if not message.HasField("mciState"):
        raise Inconsistent("a packet does not tell whether EGM runs")
    q = _joints(message.feedBack, n)
    if q is None:
        raise Inconsistent("a packet has no measured joints")
    return ControllerPacket(
        sequence=message.header.seqno,
        tm_ms=message.header.tm,
        q=q,
        q_planned=_joints(message.planned, n) if message.HasField("planned") else None,
        T_base_flange=_pose(message.feedBack),
        T_planned=_pose(message.planned) if message.HasField("planned") else None,
        why_still=_why_still(message),
    )


def answer_joints(sequence: int, tm_ms: int, q: Array) -> bytes:
    """Return an EgmSensor packet that guides the joints to q (n,) in rad."""
    message = _answer(sequence, tm_ms)
    message.planned.joints.joints.extend(np.rad2deg(q).tolist())
    return bytes(message.SerializeToString())


def answer_pose(sequence: int, tm_ms: int, pose: RigidTransform) -> bytes:
    """Return an EgmSensor packet that guides the flange to a pose in the controller's correction frame."""
    message = _answer(sequence, tm_ms)
    x, y, z, w = pose.rotation.as_quat(canonical=True).tolist()
    position, turn = message.planned.cartesian.pos, message.planned.cartesian.orient
    position.x, position.y, position.z = (np.asarray(pose.translation) / MM).tolist()
    turn.u0, turn.u1, turn.u2, turn.u3 = w, x, y, z  # ABB puts the scalar first
    return bytes(message.SerializeToString())


def _answer(sequence: int, tm_ms: int) -> Any:
    message = EgmSensorMessage()
    message.header.seqno = sequence & 0xFFFFFFFF
    message.header.tm = tm_ms & 0xFFFFFFFF
    message.header.mtype = CORRECTION
    return message


def _joints(part: Any, n: int) -> Array | None:
    """Return joint values (n,) in rad; None where the part has none."""
    if not part.HasField("joints") or not part.joints.joints:
        return None
    if len(part.joints.joints) != n:
        raise Inconsistent(f"a packet has {len(part.joints.joints)} joints instead of {n}")
    q: Array = np.deg2rad(np.array(part.joints.joints, dtype=float))
    if not (np.abs(q) < LARGEST_RAD).all():  # not a number fails this, too
        raise Inconsistent("a packet has joint values that no joint can have")
    return q


def _pose(part: Any) -> RigidTransform | None:
    if not (part.HasField("cartesian") and part.cartesian.HasField("pos") and part.cartesian.HasField("orient")):
        return None
    position, turn = part.cartesian.pos, part.cartesian.orient
    xyz_m = MM * np.array([position.x, position.y, position.z])
    quat = np.array([turn.u1, turn.u2, turn.u3, turn.u0])
    if not ((np.abs(xyz_m) < LARGEST_M).all() and np.abs(quat).max() < 2.0 and abs(float(quat @ quat) - 1.0) < 1e-2):
        raise Inconsistent("a packet has a pose that no flange can have")
    return RigidTransform.from_components(xyz_m, Rotation.from_quat(quat))


def _why_still(message: Any) -> str:
    if message.HasField("motorState") and message.motorState.state == MOTORS_OFF:
        return "the motors are off"
    if message.HasField("rapidExecState") and message.rapidExecState.state == PROGRAM_STOPPED:
        return "the controller's program is stopped"
    state = message.mciState.state
    if state == EGM_RUNNING:
        return ""
    words = {EGM_ERROR: "EGM has failed on the controller", EGM_STOPPED: "EGM is stopped on the controller"}
    return words.get(state, "EGM is not running on the controller")


class EgmSettings(UdpSettings):
    """Settings of an EGM link, beside those of every link by UDP.

    cycle_s: EGMActJoint's and EGMActPose's SampleRate. joints: how many the arm has. guidance: what the controller's
    program runs, EGMRunJoint or EGMRunPose. silent_s: silence after which the link is lost, CommTimeout of EGMSetupUC.
    """

    link: ClassVar[str] = "the EGM link"

    joints: Annotated[int, Field(ge=1, le=12)] = USUAL_JOINTS
    guidance: Literal["joint", "pose"] = "joint"
    silent_s: Positive = 1.0


class EgmRobot(UdpRobot[ControllerPacket]):
    """An arm that sends EgmRobot packets to this computer's UDP port and takes EgmSensor packets back.

    device: the UDP port. settings: see EgmSettings. Raises UsageError for a port or a setting that cannot be.
    """

    scheme, usual_port = "egm", 6510
    guided_by = "set guidance to joint and run EGMRunJoint on the controller"
    to_begin = "Give this computer's address and port to the controller (UDPUC device) and start its EGM program"

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        kept = self.settings = EgmSettings.checked(settings)
        super().__init__(device, kept, n=kept.joints, silent_s=kept.silent_s, guidance=kept.guidance, clock=clock)
        self._given = GivenGoals()
        self._number = 0
        self._controller_clock = ControllerClock(kept.cycle_s, numbered=True)

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        self._given.start()

    def _decode(self, data: bytes) -> ControllerPacket:
        return parse(data, self.n_joints)

    def _cycles_between(self, last: ControllerPacket, state: ControllerPacket) -> int:
        return state.sequence - last.sequence

    def _check_session(self, state: ControllerPacket, last: ControllerPacket) -> None:
        """Begin anew where the controller had no answer for its CommTimeout: it has ended the guidance by then."""
        if self._unheard_s() > self._times.silent_s:
            self._begin_anew("EGM on its controller has started anew meanwhile", state.q)

    def _stamp(self, state: ControllerPacket) -> tuple[float, int]:
        return state.tm_ms * MS, state.sequence

    def _taken(self, state: ControllerPacket) -> bool:
        taken = self._given.taken(state.T_planned if self.takes_poses else state.q_planned)
        self.counts.late += not taken
        return taken

    def _hear(self, state: ControllerPacket) -> None:
        if state.why_still or self._held:
            self._halt(state.why_still, state.q)

    def _hear_old(self, state: ControllerPacket, newest: ControllerPacket, sender: Sender) -> None:
        """Note a link that has started anew.

        None is answered: after a new start the arm may stand elsewhere, and the old goal must not pull it back.
        """
        if state.tm_ms > newest.tm_ms or self._restarted(state.sequence, newest.sequence, 1):
            self._lose("its controller, or EGM on it, has started anew")

    def _encode(self, state: ControllerPacket) -> bytes:
        tm_ms = int(self._clock.now_s() / MS)
        q, pose = self._goals.sent, self._poses.sent
        self._given.give(pose if self.takes_poses else q)
        data = answer_pose(self._number, tm_ms, pose) if self.takes_poses else answer_joints(self._number, tm_ms, q)
        self._number += 1
        return data
