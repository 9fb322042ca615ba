"""What drivers of controllers that send their state over UDP have in common: socket, sender, guidance by poses."""

from __future__ import annotations

import contextlib
import socket
import threading
from abc import abstractmethod
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.drivers.cyclic import CyclicRobot
from armsight.drivers.goals import PoseGoals, away, between
from armsight.drivers.link_settings import UdpSettings
from armsight.drivers.pace import ENOUGH, LinkCounts, LinkTimes, possible
from armsight.drivers.proof import Probe, flange_probe, flange_probe_by_joints
from armsight.drivers.protocols import PROVING, Sent
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent, UsageError
from armsight.priority import control_first
from armsight.records import JointReading

Sender = tuple[str, int]

LARGEST_PACKET = 4096
"""Bytes of a packet at most: a controller's state has about 700."""

RESTART_PACKETS = 3
RESTART_CYCLES = 25
RESTART_ROW = 10
"""So many packets in order, all older than the newest by more than RESTART_CYCLES, are those of a link that has started
anew; RESTART_ROW where they are less old. A network that doubles or delays packets brings newer ones between."""

DEAF_ANSWERS = 50
"""Where none of so many answers was taken, none will be: half of what a controller bears before it ends by itself."""


NEW_SESSION_CYCLES = 9
"""A controller that was silent for longer may have ended what it did and begun anew, before it is given up."""


class UdpState(Protocol):
    """A controller's state of one cycle: joints (n,) in rad, and the flange's pose where it tells one."""

    @property
    def q(self) -> Array:
        """Joint values (n,) in rad."""

    @property
    def T_base_flange(self) -> RigidTransform | None:
        """The flange's measured pose; None where it is not told."""


State = TypeVar("State", bound=UdpState)


class UdpRobot(CyclicRobot, Generic[State]):
    """A robot that sends to this computer's UDP port and takes the answer from there.

    A driver says what a packet is, whether it is newer than the last, what is wrong with it, and what the answer is. Of
    packets that have piled up only the newest is answered: the cycles of the others are over.

    device: the UDP port. Raises UsageError for one that cannot be.
    """

    scheme = "udp"
    """What stands before the port in the robot's name."""

    usual_port = 0
    """The controller maker's own port, for an example."""

    guided_by = "poses"
    """What to do instead where a robot that is guided by poses is asked for joint steps."""

    to_begin = ""
    """What to do on the controller where none has spoken."""

    def __init__(
        self, device: str, settings: UdpSettings, *, n: int, silent_s: float, guidance: str, clock: Clock | None
    ) -> None:
        """n: joints. silent_s: silence after which the link is lost. guidance: joint or pose."""
        name, limits = f"{self.scheme}:{device}", settings.joint_limits(n)
        self.port = udp_port(device, f"{self.scheme}:{self.usual_port}")
        times = LinkTimes(cycle_s=settings.cycle_s, stale_s=settings.stale_s, silent_s=silent_s)
        poses = PoseGoals(name, settings.speed_m_s, settings.speed_rad_s, times.cycle_s)
        super().__init__(name, limits=limits, times=times, clock=clock or SystemClock(), poses=poses)
        self.takes_poses = guidance == "pose"
        self.counts = LinkCounts()
        self._link_settings = settings
        self._last: State | None = None
        self._base_pose = RigidTransform.identity()

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (n,) in rad; in pose guidance only a step of zeros, which asks for nothing."""
        if not self.takes_poses:
            return super().step_joints(step)
        with self._lock:
            reading = self._ready()
            if np.shape(step) != (self.n_joints,) or np.any(step):  # not a number is not zero
                raise UsageError(f"{self.name} is guided by poses", cure=f"Send poses, or {self.guided_by}")
            return self._note(reading.q, self._poses.next, ())

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move towards a pose of the flange in the controller's frame, as far as one cycle allows.

        The joint values of the answer are those read last: only the controller knows which belong to the pose.
        """
        if not self.takes_poses:
            return super().move_pose(T_base_flange)
        with self._lock:
            reading = self._ready()
            here = None if self._last is None else self._last.T_base_flange
            if here is None:
                raise DeviceLost(f"{self.name} tells no pose", consequence="Nothing was sent")
            pose, limited = self._poses.go(T_base_flange, here)
            if self._proving(asks=bool(np.concatenate(between(self._poses.sent, pose)).any())):
                return self._note(reading.q, self._base_pose, (PROVING, *limited))
            return self._note(reading.q, pose, limited)

    def _start(self) -> None:
        self.counts = LinkCounts()
        self._last = None
        self._behind, self._behind_number = 0, -1
        self._answers = 0
        self._sender: Sender | None = None
        self._other: Sender | None = None
        self._closing = False
        self._begin()
        self._socket = self._bind()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        if not self._first.wait(self._link_settings.open_s) or self._unfit():
            self._finish()
            raise self._not_opened()

    def _own_address(self) -> str:
        """Return where to listen: not at the interfaces of other networks, as far as it is known which one it is."""
        kept = self._link_settings
        if kept.bind or not kept.controller:
            return kept.bind or "0.0.0.0"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
            way.connect((kept.controller, self.port))  # nothing is sent: it only chooses the interface
            return str(way.getsockname()[0])

    def _bind(self) -> socket.socket:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            link.bind((self._own_address(), self.port))
        except OSError as error:
            link.close()
            raise DeviceFailed(
                f"UDP port {self.port} cannot be taken: {error.strerror or error}",
                consequence="The robot is not opened: one program at a time may drive it",
                cure="Stop the other program, or choose another port here and on the controller",
            ) from error
        return link

    def _finish(self) -> None:
        # the thread reads the socket until it ends: one closed before might be another file's by then
        self._closing = True
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        control_first()
        while not self._closing:
            packets = self._received(self.cycle_s)
            if self._stood_still():
                packets = []  # of the past, as is what lies in the socket, which has dropped what came after it
                self._received(0.0)
            if not packets and self._fallen_silent():
                self._lose(self._why_silent())
            newest = {sender: i for i, (_, sender) in enumerate(packets)}
            for i, (data, sender) in enumerate(packets):
                self._take(data, sender, newest=newest[sender] == i)

    def _received(self, wait_s: float) -> list[tuple[bytes, Sender]]:
        packets: list[tuple[bytes, Sender]] = []
        self._socket.settimeout(wait_s)
        with contextlib.suppress(OSError):  # none within the time, no more, or a datagram's error report
            while True:
                packets.append(self._socket.recvfrom(LARGEST_PACKET))
                self._socket.settimeout(0.0)
        return packets

    def _take(self, data: bytes, sender: Sender, *, newest: bool = True) -> None:
        # before it is parsed: whoever is foreign shall not even cost that
        if self._sender not in (None, sender) or self._link_settings.controller not in ("", sender[0]):
            self.counts.foreign += 1
            self._other = sender
            return
        try:
            state = self._decode(data)
        except Inconsistent:
            state = None
        if state is None or (self.takes_poses and state.T_base_flange is None):
            self.counts.refused += 1
            return
        last = self._last
        if last is None and not self._may_begin(state):
            return
        self._sender, cycles = sender, 1 if last is None else self._cycles_between(last, state)
        if last is not None and cycles <= 0:
            # a controller that repeats itself lives, though it tells nothing new: the link is not silent
            self.counts.repeated += 1
            self._heard_s = self._clock.now_s()
            self._hear_old(state, last, sender)
            return
        if last is not None and not possible(state.q, last.q, cycles, self.cycle_s):
            self.counts.refused += 1
            return
        self._last, taken = state, True
        if last is not None:
            self._check_session(state, last)
            taken = self._taken(state)
        self.counts.missed += cycles - 1
        self._behind, self._behind_number = 0, -1
        self._hear(state)
        self._heard(state.q, self._clock.now_s())
        self._hear_clock(*self._stamp(state))
        self.counts.heard += 1
        if newest and not self._lost:
            self._tick(cycles, taken=taken)
            self._answer(state, sender)
        self._first_heard()

    def _why_silent(self) -> str:
        other = f"; {self._other[0]}:{self._other[1]} sends instead" if self._other else ""
        return f"its controller has fallen silent{other}"

    def _begin(self) -> None:
        """Forget the link of before."""

    def _may_begin(self, state: State) -> bool:
        """Tell whether the link may begin with this state."""
        return True

    @abstractmethod
    def _check_session(self, state: State, last: State) -> None:
        """Begin anew, or lose the link, where a state may be of a session that has begun since the last one."""

    def _first_heard(self) -> None:
        """Let the link be opened, or refused, where enough was heard."""
        clock = self._controller_clock
        if self._deaf(DEAF_ANSWERS) or (clock.wrong and clock.sure) or (self._measured() and not self._unfit()):
            self._first.set()

    def _unfit(self) -> tuple[str, str] | None:
        """Return why the robot may not be opened, and the cure; None where nothing is known against it."""
        if clock := self._controller_clock.wrong:
            return clock, self._controller_clock.cure
        return self._deaf(1)

    def _deaf(self, answers: int) -> tuple[str, str] | None:
        """Return that the controller has taken none of so many answers at least, and the cure; None: it has, or may."""
        return None

    def _not_opened(self) -> DeviceFailed:
        """Return the error of a link on which no controller has spoken, or none that may be opened."""
        if unfit := self._unfit():
            return DeviceFailed(f"{self.name}: {unfit[0]}", cure=unfit[1])
        wrong = f" ({self.counts.refused} packets were no state)" if self.counts.refused else ""
        few = f", or fewer than {ENOUGH} packets" if self.counts.heard else ""
        return DeviceNotFound(
            f"no controller has sent to UDP port {self.port} within {self._link_settings.open_s:g} s{wrong}{few}",
            cure=self.to_begin,
        )

    def _restarted(self, number: int, newest: int, cycle: int) -> bool:
        """Tell whether a packet older than the newest is of a link that started anew; cycle: what numbers go by."""
        self._behind += number > self._behind_number
        self._behind_number = number
        far = newest - number > RESTART_CYCLES * cycle
        return self._behind >= (RESTART_PACKETS if far else RESTART_ROW)

    def _answer(self, state: State, sender: Sender) -> None:
        data = self._encode(state)
        if data is None or self._outlived():
            return
        with contextlib.suppress(OSError):  # a controller that is gone is told by its silence
            self._socket.sendto(data, sender)
            self._answers += 1
            self._answered(state)

    def _answered(self, state: State) -> None:
        """Note that the answer to a state went out."""

    @abstractmethod
    def _decode(self, data: bytes) -> State:
        """Return the state in a packet. Raises Inconsistent where it holds none."""

    @abstractmethod
    def _encode(self, state: State) -> bytes | None:
        """Return the packet that answers a state with where the arm is told to go; None where none may go out."""

    @abstractmethod
    def _cycles_between(self, last: State, state: State) -> int:
        """Return by how many of the controller's cycles a state is newer than the last; 0 or less: it is not."""

    @abstractmethod
    def _stamp(self, state: State) -> tuple[float, int]:
        """Return the controller's time in s and the number of a state, 0 where it has none."""

    @abstractmethod
    def _taken(self, state: State) -> bool:
        """Tell whether the controller took the last answer, as far as this state tells."""

    @abstractmethod
    def _hear(self, state: State) -> None:
        """Take what a state that is newer than all before tells besides its joints, before they are taken."""

    @abstractmethod
    def _hear_old(self, state: State, newest: State, sender: Sender) -> None:
        """Take a state that is not newer than the newest: a late one, the same again, or those of a new start."""

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        if self._last is not None and self._last.T_base_flange is not None:
            self._poses.start(self._last.T_base_flange)
            self._unprove()

    def _unprove(self) -> None:
        super()._unprove()
        self._base_pose = self._poses.sent

    def _probe(self) -> Probe:
        arm, reading = self._link_settings.arm, self._reading
        if not self.takes_poses:
            return super()._probe()
        if arm is None or reading is None:
            return flange_probe()
        q, here = reading.q, arm.fk(reading.q)
        return flange_probe_by_joints(len(q), lambda by: np.concatenate(between(here, arm.fk(q + by))))

    def _axes(self) -> Array:
        here = None if self._last is None else self._last.T_base_flange
        if not self.takes_poses or here is None:
            return super()._axes()
        return np.concatenate(between(self._base_pose, here))

    def _put(self, offset: Array) -> None:
        if self.takes_poses:
            self._poses.start(away(self._base_pose, offset))
        else:
            super()._put(offset)

    def _off(self, reading: JointReading) -> float:
        here = None if self._last is None else self._last.T_base_flange
        if not self.takes_poses or here is None:
            return super()._off(reading)
        way_m, turn = between(here, self._poses.sent)
        return float(max(np.abs(way_m).max(), np.abs(turn).max()))


def udp_port(device: str, example: str) -> int:
    """Return the UDP port that a person gave. Raises UsageError with an example such as egm:6510."""
    if device.isascii() and device.isdigit() and 0 < int(device) < 65536:
        return int(device)
    raise UsageError(f"{device!r} is no UDP port", cure=f"Give for instance {example}")
