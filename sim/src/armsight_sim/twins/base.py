"""What every twin is: an emulated controller of its own process, found by name among the entry points."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import DeviceFailed, Inconsistent, UsageError
from armsight_sim.arms import Drive, SimArm, SimJoint

BEHIND_S = 0.1
"""A twin that wakes so late has been silent for longer than its driver may wait (rtde: 0.1 s): it says so."""

MAX_SPEED = 3.0
"""Largest joint speed in rad/s or m/s where the arm's file states none."""

LAG_S = 0.02
"""Time constant of the motors."""

ENCODER_STEP = 1e-5
"""Resolution of the encoders in rad or m."""

HOME = (0.1, -0.4, 0.5, -0.8, 0.9, 0.4)
"""Joint values a twin stands at first, as far as its ranges allow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrong:
    """What is wrong with how a controller takes what it is sent; joints and axes count from 0.

    adds: it takes each correction as one to the last (relative mode); where that is its mode, as one to where it began.
    reversed, exchanged: axes. scale: of all. gear: a joint and how many times as far it goes.
    """

    adds: bool = False
    reversed: tuple[int, ...] = ()
    exchanged: tuple[int, int] | None = None
    scale: float = 1.0
    gear: tuple[int, float] | None = None

    def of(self, offset: Array) -> Array:
        """Return what it makes of an offset (n,) from where it began, but for the gear and for what adds up."""
        made = np.array(offset, dtype=float)
        made[list(self.reversed)] *= -1.0
        if self.exchanged is not None:
            made[list(self.exchanged)] = made[list(self.exchanged[::-1])]
        return self.scale * made

    def guided(self, q: Array, first: Array, last: Array) -> Array:
        """Return where joints go that are guided to q (n,), where they were guided first and where they are going."""
        if self == RIGHT:
            return q
        start = last if self.adds else first
        return self.joints(start + self.of(q - first), start)

    def joints(self, q: Array, start: Array) -> Array:
        """Return where joints told to go to q (n,) go, from a start (n,), by their gears."""
        made = np.array(q, dtype=float)
        if self.gear is not None:
            j, ratio = self.gear
            made[j] = start[j] + ratio * (made[j] - start[j])
        return made


RIGHT = Wrong()

TABLE = (
    (0.0, -1, 0.29, 0),
    (0.27, 0, 0.0, -1),
    (0.07, -1, 0.0, 0),
    (0.0, 1, 0.302, 0),
    (0.0, -1, 0.0, 0),
    (0.0, 0, 0.072, 0),
)
"""The arm of a twin that was given none: a in m, alpha in quarter turns, d in m, theta in quarter turns."""


class Twin(Protocol):
    """An emulated controller; `with` opens and closes it.

    Made as XTwin(port=, connect=, arm=, cycle_s=, clock=), each but the clock None where the person did not say it.
    port: where it listens; connect: HOST:PORT of the driver it sends to; arm: arm.yaml's structure. A twin shares no
    protocol code with the driver it is for.
    """

    @property
    def address(self) -> str:
        """What the driver is told to open it, as DRIVER:DEVICE; known when it is open."""
        ...

    @property
    def messages(self) -> list[str]:
        """Why it stopped the arm or fell silent, oldest first; whoever tells them takes them out."""
        ...

    def __enter__(self) -> Self:
        """Open its line. Raises DeviceFailed where that cannot be done."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close its line."""
        ...

    def run(self, on: Callable[[], bool]) -> None:
        """Work in real time as long as on() holds; it is asked once a cycle."""
        ...


class SerialController(Protocol):
    """A controller at the end of a pseudo terminal, whose other end is a device at path."""

    path: str

    def close(self) -> None:
        """Close both ends."""
        ...


Controller = TypeVar("Controller", bound=SerialController)


class SerialTwin(Generic[Controller]):
    """A twin on a serial line: a pseudo terminal, under the name in port where one is given."""

    kind: str
    """The driver that opens it."""

    def __init__(self, port: str | None) -> None:
        self._name = None if port is None else Path(port)
        self.controller: Controller | None = None

    def _begin(self) -> Controller:
        """Return the controller, its line open."""
        raise NotImplementedError

    @property
    def address(self) -> str:
        """What opens its driver."""
        return f"{self.kind}:{self._name or (self.controller.path if self.controller else '')}"

    def __enter__(self) -> Self:
        self.controller = self._begin()
        if self._name is not None:
            try:
                self._name.symlink_to(self.controller.path)
            except OSError as error:
                self.controller.close()
                raise DeviceFailed(
                    f"{self._name} cannot be made: {error.strerror}",
                    consequence="There is no twin",
                    cure="Give a name that is free, in a folder that can be written",
                ) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.controller is not None:
            self.controller.close()
            if self._name is not None:
                self._name.unlink(missing_ok=True)


def note_silence(messages: list[str], late_s: float) -> None:
    """Note that a twin was silent because this computer woke it so late."""
    if late_s > BEHIND_S:
        messages.append(f"silent for {late_s:.2f} s: this computer had no time for it")


def twin_arm(mapping: Mapping[str, Any] | None) -> SimArm:
    """Return the arm of arm.yaml's structure, or the small one of six axes. Raises UsageError where it cannot be."""
    if mapping is None:
        return small_arm()
    if mapping.get("convention", "standard") != "standard":
        raise UsageError("the twin's arm is not in standard convention", cure="Convert it: armsight convert arm")
    joints = []
    for row in mapping["joints"]:
        odd = [key for key in ("beta_rad", "coupled") if row.get(key)] + ["sign"] * (row.get("sign", 1) != 1)
        if odd:
            raise UsageError(
                f"joint {row['name']} has {', '.join(odd)}, which a twin cannot emulate",
                consequence="There is no twin",
                cure="Take an arm of nominal lengths and angles",
            )
        lengths = {key: float(row.get(key) or 0.0) for key in ("a_m", "alpha_rad", "d_m", "theta_rad")}
        joints.append(
            SimJoint(
                name=str(row["name"]),
                prismatic=row.get("type") == "prismatic",
                lower=_or(row.get("lower"), -math.inf),
                upper=_or(row.get("upper"), math.inf),
                max_speed=_or(row.get("max_speed"), MAX_SPEED),
                mass_kg=_or(row.get("mass_kg"), 0.0),
                com_m=row.get("com_m") or (0.0, 0.0, 0.0),
                **lengths,
            )
        )
    begin = mapping.get("T_base_frame0")
    T_base_frame0 = np.eye(4)
    if begin is not None:
        T_base_frame0[:3, :3] = Rotation.from_quat(begin["quat_xyzw"]).as_matrix()
        T_base_frame0[:3, 3] = begin["xyz_m"]
    return SimArm(joints=tuple(joints), T_base_frame0=T_base_frame0)


def small_arm() -> SimArm:
    """Return a small arm of six axes."""
    quarter = math.pi / 2
    return SimArm(
        joints=tuple(
            SimJoint(
                name=f"j{i}",
                a_m=a,
                alpha_rad=k * quarter,
                d_m=d,
                theta_rad=t * quarter,
                lower=-3.0,
                upper=3.0,
                max_speed=MAX_SPEED,
            )
            for i, (a, k, d, t) in enumerate(TABLE, 1)
        )
    )


def small_arm_mapping() -> dict[str, Any]:
    """Return a small arm of six axes whose joints are counted from where Craig's x axes are parallel."""
    quarter = math.pi / 2
    table = ((0.0, 0, 0.29), (0.0, -1, 0.0), (0.27, 0, 0.0), (0.07, -1, 0.302), (0.0, 1, 0.0), (0.0, -1, 0.072))
    joints = [
        {"name": f"j{i}", "a_m": a, "alpha_rad": k * quarter, "d_m": d, "lower": -3.0, "upper": 3.0}
        for i, (a, k, d) in enumerate(table, 1)
    ]
    return {"convention": "craig", "joints": joints}


def twin_drive(arm: SimArm, cycle_s: float, *, lag_s: float = LAG_S, noise: float = 0.0) -> Drive:
    """Return the motors of a twin; noise: of readings, in rad or m. Raises UsageError for a cycle that cannot be."""
    if not 0.0 < cycle_s <= 1.0:
        raise UsageError(f"a cycle of {cycle_s} s cannot be", cure="Give 0.004 or 0.028, for instance")
    speed = np.array([joint.max_speed for joint in arm.joints])
    step = np.full(arm.n, ENCODER_STEP)
    return Drive(cycle_s=cycle_s, lag_s=lag_s, max_speed=speed, encoder_step=step, noise=noise)


def twin_home(arm: SimArm) -> Array:
    """Return joint values (n,) within the ranges, away from where the axes of six line up."""
    return clipped(arm, np.resize(HOME, arm.n))


def clipped(arm: SimArm, q: Array) -> Array:
    """Return joint values (n,) within the ranges of an arm. Raises Inconsistent where they are not finite."""
    if not np.isfinite(q).all():
        raise Inconsistent("joint values are not finite")
    return np.clip(q, [joint.lower for joint in arm.joints], [joint.upper for joint in arm.joints])


def host_port(text: str) -> tuple[str, int]:
    """Return the host and port of HOST:PORT, or of PORT on this machine. Raises UsageError."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit()):
        raise UsageError(f"{text!r} is not HOST:PORT", cure="Give for instance 127.0.0.1:49152")
    if not 0 < int(port) < 65536:
        raise UsageError(f"there is no port {port}", cure="Give one from 1 to 65535, for instance 127.0.0.1:49152")
    return host or "127.0.0.1", int(port)


def _or(value: Any, otherwise: float) -> float:
    return otherwise if value is None else float(value)
