"""LinuxCNC, whose joints follow goals as jogs: within its own limits of speed, acceleration and position.

The bridge beside it (linuxcnc_bridge) sends a state every few servo cycles, counted by HAL's sampler, and takes a goal
of all joints as the answer. Degrees, and the INI's length unit, are on the wire only. Each state names a session:
it ends where LinuxCNC takes no joint jogs, where this program was silent or stopped in motion, and where counts were
not taken; goals of an older one move nothing, and the goal is then where LinuxCNC is commanded to be.
"""

from __future__ import annotations

import contextlib
import secrets
import socket
import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock, monotonic_s
from armsight.drivers.goals import PoseGoals
from armsight.drivers.link_settings import USUAL_JOINTS, Positive, UdpSettings
from armsight.drivers.linuxcnc.machine import Machine, check_machine, check_offsets, check_ranges, parse
from armsight.drivers.linuxcnc.offsets import ROUND, Corrections, Uncorrected, bounded
from armsight.drivers.linuxcnc.state import MAY, MOVING, STOPPED, WHY, LinuxcncState
from armsight.drivers.pace import LARGEST_RAD, ControllerClock
from armsight.drivers.proof import Probe
from armsight.drivers.protocols import Sent
from armsight.drivers.udp import Sender, UdpRobot, udp_port
from armsight.errors import DeviceFailed, DeviceNotFound, Inconsistent, UsageError

USUAL_PORT = 49160
ASK_S = 0.1
"""The bridge is asked anew so often until it answers."""

HELLO, BEGIN, STATE, GOAL = (struct.Struct(f"<4s{rest}") for rest in ("I", "IHH", "IIIQIHBB", "IIIIHH"))
STOP = 1
SWITCH_ON, HOME, OFFSETS, READS = 1, 2, 4, 8
SILENT_S = 0.075
"""Within the ten cycles of 8 ms after which a link has to be lost."""
ONLY_READS = "this link only reads (reads_only)"
TURNS = "the correction cannot follow the turns of LinuxCNC's program"
FAR = 3.0
"""Goals farther than the way of so many cycles are given up, one before the bridge takes none of them."""


class LinuxcncSettings(UdpSettings):
    """Settings of a link to LinuxCNC, beside those of every link by UDP.

    joints: how many the arm has. linear: those of them, from 1, that move along a line. units: of the INI's lengths.
    kinematics: the module that is expected there. switch_on, home: whether opening may end the e-stop and switch on,
    and home, which may move the arm. silent_s: silence after which the link is lost. motion: jogs of the joints, or
    offsets, which correct the flange's pose, also while LinuxCNC runs a program; largest_m, largest_rad: of these.
    reads_only: nothing is moved, switched or homed, and it opens while others move the arm, too.
    """

    link: ClassVar[str] = "the LinuxCNC link"

    cycle_s: Positive = 0.008
    stale_s: Positive = 0.04
    silent_s: Positive = SILENT_S
    joints: Annotated[int, Field(ge=1, le=9)] = USUAL_JOINTS
    linear: list[int] = Field(default_factory=list)
    units: Literal["mm", "inch"] = "mm"
    kinematics: str = ""
    switch_on: bool = False
    home: bool = False
    reads_only: bool = False
    motion: Literal["jogs", "offsets"] = "jogs"
    largest_m: Positive = 0.01
    largest_rad: Positive = 0.1


class LinuxcncRobot(UdpRobot[LinuxcncState]):
    """An arm behind LinuxCNC with armsight's bridge beside it.

    device: HOST[:PORT]. settings: see LinuxcncSettings. Raises UsageError for a device or a setting that cannot be.
    """

    scheme, usual_port = "linuxcnc", USUAL_PORT
    guided_by = "set motion to jogs"
    to_begin = "Start LinuxCNC with armsight.hal in its INI (docs: LinuxCNC)"

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        kept = self.settings = LinuxcncSettings.checked(settings)
        host, _, port = device.partition(":")
        if not host:
            raise UsageError(
                f"{device!r} is no HOST[:PORT]",
                consequence="There is no robot",
                cure="Give for instance linuxcnc:127.0.0.1",
            )
        port = port or str(USUAL_PORT)
        udp_port(port, f"linuxcnc:{host}:{USUAL_PORT}")
        self._offsets = kept.motion == "offsets"
        if self._offsets and kept.arm is None:
            raise UsageError(
                "corrections by offsets need the arm: near a singular pose they would make a joint run away",
                consequence="The robot is not opened",
                cure="Give its file with --arm",
            )
        guidance = "pose" if self._offsets else "joint"
        super().__init__(port, kept, n=kept.joints, silent_s=kept.silent_s, guidance=guidance, clock=clock)
        self.name = f"linuxcnc:{device}"
        self._corrections: Corrections | None = None
        self._offset_unit = np.ones(6)
        self._host = host
        self._machine: Machine | None = None
        self._unit = np.ones(kept.joints)
        self._where: Sender = ("", 0)
        self._token = self._given = 0
        self._samples = 1
        self._why_not = ""
        self._controller_clock = ControllerClock(kept.cycle_s, numbered=True)

    @property
    def machine(self) -> Machine | None:
        """What LinuxCNC told of its machine when the link was opened last."""
        return self._machine

    @property
    def reads_only(self) -> bool:
        """Whether it commands nothing, not even a stop."""
        return self.settings.reads_only

    @property
    def notes(self) -> tuple[str, ...]:
        """What is not as it should be there, and refuses nothing."""
        return () if self._machine is None else self._machine.notes()

    def _bind(self) -> socket.socket:
        """Open the link: ask what machine it is, check that, and ask for its states."""
        kept = self.settings
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            where = self._address()
            link.bind((kept.bind, 0))
            self._token, self._given = secrets.randbelow(1 << 32), 0
            machine = self._machine = self._asked(link, where)
            self._unit = machine.unit
            self._check(machine)
            self._samples = round(kept.cycle_s / machine.servo_s)
            self._goals.narrow(machine.limits())
            what = SWITCH_ON * kept.switch_on | HOME * kept.home | OFFSETS * self._offsets
            what = READS if kept.reads_only else what
            link.sendto(BEGIN.pack(b"ASLB", self._token, self._samples, what), where)
            self._sender = self._where = where
            self._why_not = ""
        except OSError as error:
            link.close()
            raise DeviceFailed(
                f"{self.name} cannot be reached: {error.strerror or error}",
                consequence="The robot is not opened",
                cure="Check the address and the network",
            ) from error
        except BaseException:
            link.close()
            raise
        return link

    def _address(self) -> Sender:
        found = socket.getaddrinfo(self._host, self.port, socket.AF_INET, socket.SOCK_DGRAM)
        host, port = found[0][4][:2]
        return str(host), int(port)

    def _asked(self, link: socket.socket, where: Sender) -> Machine:
        """Return what the bridge tells of the machine. Raises DeviceNotFound where none answers."""
        end_s = monotonic_s() + self.settings.open_s
        link.settimeout(ASK_S)
        while monotonic_s() < end_s:
            link.sendto(HELLO.pack(b"ASLH", self._token), where)
            try:
                data, sender = link.recvfrom(65536)
            except TimeoutError:
                continue
            if sender == where and data[: HELLO.size] == HELLO.pack(b"ASLD", self._token):
                return parse(data[HELLO.size :])
        raise DeviceNotFound(
            f"nothing answers at {where[0]}:{where[1]}: LinuxCNC does not run there, or not with armsight's bridge",
            consequence="The robot is not opened",
            cure=self.to_begin,
        )

    def _check(self, machine: Machine) -> None:
        kept = self.settings
        if machine.driver:
            raise DeviceFailed(
                f"{self.name} is driven by another program, at {machine.driver}",
                consequence="The robot is not opened: one program at a time may drive it",
                cure="End the other one; one that was killed is forgotten soon",
            )
        check_machine(
            machine,
            joints=kept.joints,
            cycle_s=kept.cycle_s,
            linear=kept.linear,
            units=kept.units,
            kinematics=kept.kinematics,
        )
        if kept.arm is not None:
            check_ranges(machine, kept.arm.ranges)
            if self._offsets:
                check_offsets(machine)
                self._corrections = Corrections.of(
                    kept.arm,
                    axes=np.array([(one.speed, one.acceleration) for one in machine.offsets]).T * machine.offset_unit,
                    joint_speed=self._unit * [one.speed for one in machine.joints],
                    speeds=(kept.speed_m_s, kept.speed_rad_s),
                )
                self._offset_unit = machine.offset_unit
                self._poses = PoseGoals(self.name, *self._corrections.speeds, self.cycle_s)

    def _finish(self) -> None:
        self._say(b"ASLE")
        super()._finish()

    def _say(self, magic: bytes) -> None:
        with contextlib.suppress(OSError):  # who is gone needs not be told
            self._socket.sendto(HELLO.pack(magic, self._token), self._where)

    def _begin(self) -> None:
        self._before_state: LinuxcncState | None = None

    def _may_begin(self, state: LinuxcncState) -> bool:
        """Begin once LinuxCNC has done what was asked of it at the opening, and its joints rest; to read, at once."""
        kept = self.settings
        switched = kept.switch_on or kept.home
        may = kept.reads_only or bool(state.flags & MAY) or (not switched and state.why_still != MOVING)
        self._why_not = "" if may else state.why_still
        if not may:
            self._say(b"ASLK")
        return may

    def _unfit(self) -> tuple[str, str] | None:
        if self._why_not:
            cure = "Look at LinuxCNC's screen for the reason"
            if self._why_not == MOVING:
                cure += "; --robot-set reads_only=true reads an arm that moves, for verify --live"
            return f"{self._why_not}, and it stays so", cure
        return super()._unfit()

    def _rebase(self, q: Array) -> None:
        """Begin where LinuxCNC is commanded to be: where it is read it is not quite, and it would be asked to move."""
        last = self._last
        super()._rebase(q if last is None or last.bare else last.at)
        if last is not None and last.bare:
            self._poses.start(last.bare.applied(last.at))
            self._unprove()

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Correct towards a pose of the flange, as far as one cycle allows; where a program moves it, that it has now.

        Raises UsageError where the motion is not by offsets, and as that of every robot.
        """
        bare = None if self._last is None else self._last.bare
        return (
            super().move_pose(T_base_flange)
            if bare is None
            else self._bounded(bare.correction(T_base_flange.as_matrix()))
        )

    def correct(self, correction: RigidTransform) -> Sent:
        """Let the correction go towards a way and turn about the flange in base axes, as far as one cycle allows.

        It slows down in time to come to rest there. Raises as move_pose.
        """
        goal, words = bounded(correction, self.settings.largest_m, self.settings.largest_rad)
        if self._corrections is not None:
            goal = self._corrections.slowed(self._poses.sent, goal, self.cycle_s)
        sent = self._bounded(goal)
        return replace(sent, limited=(*sent.limited, *words))

    def _bounded(self, correction: RigidTransform) -> Sent:
        if not np.isfinite(correction.as_matrix()).all():
            raise Inconsistent(f"{self.name}: a correction is not finite", consequence="Nothing was sent")
        cut, words = bounded(correction, self.settings.largest_m, self.settings.largest_rad)
        sent = super().move_pose(cut)
        return replace(sent, limited=(*sent.limited, *words))

    def _probe(self) -> Probe:
        """Return the probe, as small as the offsets' acceleration needs it."""
        probe, share = super()._probe(), 1.0 if self._corrections is None else self._corrections.probe_share
        return replace(probe, amplitude=share * probe.amplitude)

    def _note(self, q: Array, pose: RigidTransform | None, limited: tuple[str, ...]) -> Sent:
        """Return a command as it goes out; of a correction the pose that it makes of the newest one."""
        sent, bare = super()._note(q, pose, limited), None if self._last is None else self._last.bare
        return (
            sent
            if pose is None or bare is None
            else replace(sent, pose=RigidTransform.from_matrix(bare.corrected(pose)))
        )

    def _decode(self, data: bytes) -> LinuxcncState:
        n = self.n_joints
        if data == HELLO.pack(b"ASLN", self._token):
            self._lose("the bridge beside LinuxCNC has started anew, or had not heard of this program for too long")
        blocks = 4 if self._offsets else 3
        if len(data) != STATE.size + 8 * blocks * n or data[: HELLO.size] != HELLO.pack(b"ASLS", self._token):
            raise Inconsistent("a packet is no state of this link")
        _, _, session, number, sample, taken, flags, why, joints = STATE.unpack_from(data)
        values = np.array(struct.unpack_from(f"<{blocks * n}d", data, STATE.size)).reshape(blocks, n)
        values[:2] *= self._unit
        values[2:] *= self._offset_unit if self._offsets else self._unit
        if (
            joints != n or why not in (*WHY, STOPPED) or not (np.abs(values) < LARGEST_RAD).all()
        ):  # not a number fails this, too
            raise Inconsistent("a packet has joint values that no joint can have")
        q, commanded, at = values[:3]
        bare, arm = None, self.settings.arm
        if self._offsets and arm is not None:
            bare = Uncorrected.of(arm.flange(commanded), values[3])
        return LinuxcncState(
            session=session,
            number=number,
            sample=sample,
            taken=taken,
            flags=flags,
            why=why,
            q=q,
            commanded=commanded,
            at=at,
            bare=bare,
            T_base_flange=None if bare is None or arm is None else bare.correction(arm.flange(q)),
        )

    def _cycles_between(self, last: LinuxcncState, state: LinuxcncState) -> int:
        if state.number <= last.number:
            return state.number - last.number
        return max(1, self._cycle(state) - self._cycle(last))

    def _cycle(self, state: LinuxcncState) -> int:
        return state.sample // self._samples

    def _stamp(self, state: LinuxcncState) -> tuple[float, int]:
        servo_s = self.cycle_s / self._samples
        return state.sample * servo_s, self._cycle(state)

    def _check_session(self, state: LinuxcncState, last: LinuxcncState) -> None:
        if state.session == last.session:
            return
        if state.why == STOPPED and state.bare:
            self._poses.start(state.bare.applied(state.at))
        elif state.why == STOPPED:
            self._goals.start(state.at)  # where it comes to rest: nothing leads back
        else:
            self._begin_anew(WHY[state.why], state.q)

    def _taken(self, state: LinuxcncState) -> bool:
        taken = state.taken == self._given or not state.flags & MAY
        self.counts.late += not taken
        return taken

    def _hear(self, state: LinuxcncState) -> None:
        why = ONLY_READS if self.reads_only else state.why_still or self._why_uncorrected(state)
        if why or self._held:
            self._halt(why, state.q)

    def _why_uncorrected(self, state: LinuxcncState) -> str:
        """Return why no correction may be made where the arm is and goes; empty where one may, or none is."""
        if state.bare is None or self._corrections is None:
            return ""
        before, self._before_state = self._before_state, state
        if before is None:
            return self._corrections.why_not(state.commanded, np.zeros(self.n_joints))
        time_s = self.cycle_s / self._samples * max(1, state.sample - before.sample)
        off = np.abs(state.bare.offsets(self._poses.sent) - state.at)
        if (off > FAR * self.cycle_s * self._corrections.axis_speed).any():
            return TURNS
        return self._corrections.why_not(state.commanded, (state.commanded - before.commanded) / time_s)

    def _hear_old(self, state: LinuxcncState, newest: LinuxcncState, sender: Sender) -> None:
        """Take no notice: a bridge that has started anew knows no token of before, and is silent."""

    def _encode(self, state: LinuxcncState) -> bytes:
        if state.taken == self._given or not self._given:
            self._given = self._given + 1 & 0xFFFFFFFF or 1
        flags = STOP * bool(self._stopped)
        goal = self._goals.sent / self._unit
        if state.bare is not None:
            goal = np.round(state.bare.offsets(self._poses.sent) / self._offset_unit, ROUND)
        head = GOAL.pack(b"ASLG", self._token, state.session, state.number, self._given, flags, self.n_joints)
        return head + struct.pack(f"<{self.n_joints}d", *goal)
