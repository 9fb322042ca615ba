"""A small LinuxCNC for tests: jog counts, the planner of a jog, limits and modes, beside the bridge that is shipped.

The planner is written from what LinuxCNC's own was seen to do (docs/decisions/0069): it brakes in time to rest at its
target, and never leaves its limits of speed and acceleration. Counts that lead beyond a range are dropped whole, as are
those that come while nothing may be jogged. In its world (MDI, AUTO, teleop) axes' offsets are added to the X Y Z A B C
of its program, and the sum becomes joints whatever they need.
"""

import math
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.clock import ManualClock
from armsight.drivers.linuxcnc_bridge.link import Bridge
from armsight.drivers.linuxcnc_bridge.pins import AUTO, E_STOP, ENABLED, HOMED, JOINT_MODE, MDI, allowed
from armsight_sim.twins.base import RIGHT, Wrong, small_arm

SERVO_S = 0.001
SAMPLES = 8
SPEED, ACCELERATION = 30.0, 200.0
SCALE = 1e-4
NEEDED = ENABLED | HOMED | JOINT_MODE
WORLD = ENABLED | HOMED
ARM = small_arm()
OFFSET_SPEED, OFFSET_ACCELERATION = 25.0, 100.0


class Jog:
    """One joint in degrees, or one axis' offset."""

    def __init__(
        self, at: float, low: float, high: float, most: float = SPEED, acceleration: float = ACCELERATION
    ) -> None:
        self.at = self.target = at
        self.most, self.acceleration = most, acceleration
        self.low, self.high = low, high
        self.speed = 0.0

    def ask(self, by: float) -> None:
        if self.low <= self.target + by <= self.high:
            self.target += by

    def servo(self) -> None:
        """Go on for one servo cycle towards the target."""
        gain = self.acceleration * SERVO_S
        way = self.target - self.at
        # at this speed, braking by gain each cycle, the way is used up exactly
        wanted = math.copysign(math.sqrt(2.0 * self.acceleration * abs(way) + 0.25 * gain * gain) - 0.5 * gain, way)
        wanted = min(max(wanted, -self.most), self.most)
        self.speed += min(max(wanted - self.speed, -gain), gain)
        step = self.speed * SERVO_S
        if abs(way) < 1e-6 and abs(self.speed) <= gain:
            self.at, self.speed = self.target, 0.0
        else:
            self.at += step

    def freeze(self) -> None:
        self.target, self.speed = self.at, 0.0


class World:
    """HAL's pins as the bridge uses them, and the joints behind; machine: as the bridge tells it."""

    def __init__(self, home: NDArray[np.float64], wrong: Wrong = RIGHT, most_deg: float = 175.0) -> None:
        self.joints = [Jog(at, -most_deg, most_deg) for at in np.degrees(home)]
        self.wrong, self.doing = wrong, NEEDED
        self.pins: dict[str, bool] = {}
        self.rows: list[tuple[int, ...]] = []
        self.number = 0
        self._counts, self.counts = [0] * (len(home) + 6), [0] * (len(home) + 6)
        self.offsets = [Jog(0.0, -1e9, 1e9, OFFSET_SPEED, OFFSET_ACCELERATION) for _ in range(6)]
        self.program: Iterator[NDArray[np.float64]] | None = None
        self.bare: NDArray[np.float64] | None = None  # X Y Z A B C of its program; of a world that has begun
        self.signals = {"ok"}
        self._new = self.paused = False
        one = {"linear": False, "lower": -most_deg, "upper": most_deg, "speed": SPEED, "acceleration": ACCELERATION}
        offset = {"lower": -1e9, "upper": 1e9, "speed": OFFSET_SPEED, "acceleration": OFFSET_ACCELERATION}
        self.machine: dict[str, Any] = {
            "bridge": 2,
            "ini": "arm.ini",
            "joints": [dict(one) for _ in home],
            "offsets": [dict(offset, linear=i < 3) for i in range(6)],
            "servo_s": SERVO_S,
            "kinematics": "genserkins",
            "linear_units": "mm",
            "angular_units": "deg",
            "jog_acceleration": 1000.0,
            "listens": False,
        }

    def servo(self) -> None:
        if self.rows:
            row = self.rows.pop(0)
            asked = SCALE * np.subtract(row, self._counts)
            self._counts, n = list(row), len(self.joints)
            if self.doing == NEEDED and self.pins.get("jog-enable"):
                for joint, by in zip(self.joints, self.made(asked[:n]), strict=True):
                    joint.ask(by)
            if self.doing & ENABLED and self.pins.get("offsets"):
                for offset, by in zip(self.offsets, self.made(asked[n:]), strict=True):
                    offset.ask(by)
        if self.in_world:
            self._move_world()
        for joint in self.joints:
            if not self.doing & ENABLED:
                joint.freeze()
            joint.servo()
        self.number, self._new = self.number + 1, True

    def begin_world(self, doing: int = WORLD) -> None:
        """Leave joint mode: the axes begin where the joints have the flange."""
        pose = ARM.flange(np.radians([joint.at for joint in self.joints])).as_matrix()
        self.doing, self.bare = doing, np.concatenate([1e3 * pose[:3, 3], np.degrees(abc_of(pose[:3, :3]))])

    def _move_world(self) -> None:
        """Go on with the program and the offsets for one servo cycle; a program that is inhibited stands at once."""
        if self.running and not self.pins.get("inhibit"):
            way = next(self.program, None) if self.program is not None else None
            self.program = self.program if way is not None else None
            self.bare = self.bare if way is None else self.bare + way
        for offset in self.offsets:
            if not self.pins.get("offsets"):
                offset.freeze()
            offset.servo()

    def _follow_world(self) -> None:
        """Turn the axes into joints."""
        axes = self.bare + [offset.at for offset in self.offsets]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned(np.radians(axes[3:])), 1e-3 * axes[:3]
        q = ARM.reach(pose, np.radians([joint.at for joint in self.joints]))
        for joint, value in zip(self.joints, np.degrees(q), strict=True):
            joint.at = joint.target = float(value)

    @property
    def in_world(self) -> bool:
        return self.bare is not None and bool(self.doing & ENABLED) and not self.doing & JOINT_MODE

    @property
    def running(self) -> bool:
        return self.program is not None and not self.paused

    def made(self, asked: NDArray[np.float64]) -> NDArray[np.float64]:
        made = self.wrong.of(asked)
        if self.wrong.gear is not None:
            joint, ratio = self.wrong.gear
            made[joint] *= ratio
        return made

    # what follows is what the bridge asks of HAL

    def put(self, name: str, value: bool) -> None:
        pressed = value and not self.pins.get(name)
        self.pins[name] = value
        if pressed and name == "pause":
            self.paused = True
        if pressed and name in ("estop-reset", "machine-off", "machine-on", "home-all", "manual", "joint-mode"):
            self.press(name)

    def press(self, name: str) -> None:
        if name == "estop-reset":
            self.doing &= ~E_STOP
        elif name == "machine-off":
            self.doing &= ~ENABLED
        elif name == "machine-on" and not self.doing & E_STOP:
            self.doing |= ENABLED
        elif name == "home-all" and self.doing & ENABLED:
            self.doing = (self.doing | HOMED) & ~JOINT_MODE
        elif name == "manual":
            self.doing &= ~(AUTO | MDI)
        elif name == "joint-mode" and not self.doing & (AUTO | MDI):
            self.doing |= JOINT_MODE

    def sample(self) -> tuple[int, list[float], list[float], list[float]] | None:
        if not self._new:
            return None
        self._new = False
        if self.in_world:
            self._follow_world()
        at = [joint.at for joint in self.joints]
        return self.number, at, list(at), [offset.at for offset in self.offsets]

    @property
    def waiting(self) -> int:
        return len(self.rows)

    def feed(self, rows: list[tuple[int, ...]]) -> None:
        self.rows += rows
        self.counts = list(rows[-1])

    def get(self, name: str) -> bool:
        return self.running if name == "running" else bool(name == "ok" and self.pins.get("session"))

    def flags(self, offsets: bool) -> int:
        return allowed(self.doing, offsets)


def turned(abc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return LinuxCNC's R = Rz(C) Ry(B) Rx(A)."""
    (sa, sb, sc), (ca, cb, cc) = np.sin(abc), np.cos(abc)
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]]) @ y @ x


def abc_of(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return A, B, C of a rotation, B within 90 degrees."""
    return np.array(
        [math.atan2(R[2, 1], R[2, 2]), math.asin(max(-1.0, min(1.0, -R[2, 0]))), math.atan2(R[1, 0], R[0, 0])]
    )


class LinuxcncController:
    """The world beside the bridge on a real socket; `cycle` lets the samples of one state pass."""

    def __init__(self, home: NDArray[np.float64], clock: ManualClock, port: int = 0, **more: Any) -> None:
        self.world = World(home, **more)
        self.clock = clock
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link.bind(("127.0.0.1", port))
        self.port = self.link.getsockname()[1]
        self._faults: set[str] = set()
        self._last_packet = b""
        self.spoken = 0
        self.reboot()

    def reboot(self) -> None:
        """Start the bridge anew."""
        self.bridge = Bridge(self.world.machine, self.world, self.link)
        self._send, self.bridge._send = self.bridge._send, self._say  # type: ignore[method-assign]

    def _say(self, data: bytes, where: tuple[str, int]) -> None:
        state = data[:4] == b"ASLS"
        if state and "silent" in self._faults:
            return
        if state:
            self.spoken += 1
            self._last_packet = data = self._last_packet if "frozen" in self._faults else data
        self._send(data, where)

    @property
    def q(self) -> NDArray[np.float64]:
        return np.radians([joint.at for joint in self.world.joints])

    def cycle(self) -> None:
        for _ in range(SAMPLES):
            self.world.servo()
        self.bridge.turn(self.clock.now_s())

    def fault(self, fault: str, *, on: bool = True) -> None:
        (self._faults.add if on else self._faults.discard)(fault)

    def push(self, by: NDArray[np.float64]) -> None:
        """Move the arm by (n,) in rad, as somebody does at LinuxCNC's screen."""
        for joint, way in zip(self.world.joints, np.degrees(by), strict=True):
            joint.at += way
            joint.freeze()

    def close(self) -> None:
        self.link.close()
