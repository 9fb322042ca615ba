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
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from armsight.arrays import Array
from armsight.clock import Clock, monotonic_s
from armsight.drivers.link_settings import USUAL_JOINTS, Positive, UdpSettings
from armsight.drivers.linuxcnc.machine import Machine, check_machine, check_ranges, parse
from armsight.drivers.pace import LARGEST_RAD, ControllerClock
from armsight.drivers.udp import Sender, UdpRobot, udp_port
from armsight.errors import DeviceFailed, DeviceNotFound, Inconsistent, UsageError

USUAL_PORT = 49160
ASK_S = 0.1
"""The bridge is asked anew so often until it answers."""

HELLO, BEGIN, STATE, GOAL = (struct.Struct(f"<4s{rest}") for rest in ("I", "IHH", "IIIQIHBB", "IIIIHH"))
MAY, ENABLED, HOMED, JOINT_MODE, E_STOP, AUTO, MDI = (1 << i for i in range(7))
STOP = 1
SWITCH_ON, HOME = 1, 2
WHY = {
    0: "LinuxCNC took no motion meanwhile",
    1: "LinuxCNC had no answer for too long, and let the arm come to rest",
    3: "LinuxCNC did not take what it was sent (a limit, a hold), and stands elsewhere",
}
STOPPED = 2
SILENT_S = 0.075
"""Within the ten cycles of 8 ms after which a link has to be lost."""
MOVING = "LinuxCNC's joints have not come to rest yet"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinuxcncState:
    """What LinuxCNC told in one cycle.

    session, number, sample: of its motion, the packet and the servo. taken: the newest goal it took. flags: what it
    does. q, commanded, at (n,) in rad or m: measured, commanded, and where it is asked to be.
    """

    session: int
    number: int
    sample: int
    taken: int
    flags: int
    why: int
    q: Array
    commanded: Array
    at: Array
    T_base_flange: None = None

    @property
    def why_still(self) -> str:
        """Why it takes no motion just now, in words; empty where it does."""
        flags = self.flags
        words = (
            (flags & MAY, ""),
            (flags & E_STOP, "LinuxCNC is in e-stop"),
            (not flags & ENABLED, "LinuxCNC's machine is off"),
            (not flags & HOMED, "LinuxCNC is not homed, and knows no limits of its joints until then"),
            (flags & AUTO, "LinuxCNC is in AUTO"),
            (flags & MDI, "LinuxCNC is in MDI"),
            (not flags & JOINT_MODE, "LinuxCNC is not in joint mode"),
        )
        return next((text for holds, text in words if holds), MOVING)


class LinuxcncSettings(UdpSettings):
    """Settings of a link to LinuxCNC, beside those of every link by UDP.

    joints: how many the arm has. linear: those of them, from 1, that move along a line. units: of the INI's lengths.
    kinematics: the module that is expected there. switch_on, home: whether opening may end the e-stop and switch on,
    and home, which may move the arm. silent_s: silence after which the link is lost.
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


class LinuxcncRobot(UdpRobot[LinuxcncState]):
    """An arm behind LinuxCNC with armsight's bridge beside it.

    device: HOST[:PORT]. settings: see LinuxcncSettings. Raises UsageError for a device or a setting that cannot be.
    """

    scheme, usual_port = "linuxcnc", USUAL_PORT
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
        super().__init__(port, kept, n=kept.joints, silent_s=kept.silent_s, guidance="joint", clock=clock)
        self.name = f"linuxcnc:{device}"
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
            self._check(machine)
            self._unit, self._samples = machine.unit, round(kept.cycle_s / machine.servo_s)
            self._goals.narrow(machine.limits())
            what = SWITCH_ON * kept.switch_on | HOME * kept.home
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
        lower, upper = (None if one is None else np.array(one) for one in (kept.lower_rad, kept.upper_rad))
        check_ranges(machine, lower, upper)

    def _finish(self) -> None:
        self._say(b"ASLE")
        super()._finish()

    def _say(self, magic: bytes) -> None:
        with contextlib.suppress(OSError):  # who is gone needs not be told
            self._socket.sendto(HELLO.pack(magic, self._token), self._where)

    def _may_begin(self, state: LinuxcncState) -> bool:
        """Begin once LinuxCNC has done what was asked of it at the opening, and its joints rest."""
        switched = self.settings.switch_on or self.settings.home
        may = bool(state.flags & MAY) or (not switched and state.why_still != MOVING)
        self._why_not = "" if may else state.why_still
        if not may:
            self._say(b"ASLK")
        return may

    def _unfit(self) -> tuple[str, str] | None:
        if self._why_not:
            return f"{self._why_not}, and it stays so", "Look at LinuxCNC's screen for the reason"
        return super()._unfit()

    def _rebase(self, q: Array) -> None:
        """Begin where LinuxCNC is commanded to be: where it is read it is not quite, and it would be asked to move."""
        super()._rebase(q if self._last is None else self._last.at)

    def _decode(self, data: bytes) -> LinuxcncState:
        n = self.n_joints
        if data == HELLO.pack(b"ASLN", self._token):
            self._lose("the bridge beside LinuxCNC has started anew, or had not heard of this program for too long")
        if len(data) != STATE.size + 24 * n or data[: HELLO.size] != HELLO.pack(b"ASLS", self._token):
            raise Inconsistent("a packet is no state of this link")
        _, _, session, number, sample, taken, flags, why, joints = STATE.unpack_from(data)
        values = np.array(struct.unpack_from(f"<{3 * n}d", data, STATE.size)).reshape(3, n) * self._unit
        if (
            joints != n or why not in (*WHY, STOPPED) or not (np.abs(values) < LARGEST_RAD).all()
        ):  # not a number fails this, too
            raise Inconsistent("a packet has joint values that no joint can have")
        q, commanded, at = values
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
        if state.why == STOPPED:
            self._goals.start(state.at)  # where it comes to rest: nothing leads back
        else:
            self._begin_anew(WHY[state.why], state.q)

    def _taken(self, state: LinuxcncState) -> bool:
        taken = state.taken == self._given or not state.flags & MAY
        self.counts.late += not taken
        return taken

    def _hear(self, state: LinuxcncState) -> None:
        if state.why_still or self._held:
            self._halt(state.why_still, state.q)

    def _hear_old(self, state: LinuxcncState, newest: LinuxcncState, sender: Sender) -> None:
        """Take no notice: a bridge that has started anew knows no token of before, and is silent."""

    def _encode(self, state: LinuxcncState) -> bytes:
        if state.taken == self._given or not self._given:
            self._given = self._given + 1 & 0xFFFFFFFF or 1
        flags = STOP * bool(self._stopped)
        head = GOAL.pack(b"ASLG", self._token, state.session, state.number, self._given, flags, self.n_joints)
        return head + struct.pack(f"<{self.n_joints}d", *(self._goals.sent / self._unit))
