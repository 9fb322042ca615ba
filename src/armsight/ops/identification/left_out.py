"""How far joints go in an identification, and those left out: held where they stand, behind those that are swept."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.identify.sweeps import HELD
from armsight.drivers import Robot, RobotState, RobotTraits, Sent
from armsight.errors import ArmsightError, BadFile, DeviceFailed, Inconsistent, UsageError
from armsight.kinematics import Arm, Convention, in_convention, link_frames
from armsight.ops.action import Given
from armsight.records import JointReading, checked_array
from armsight.store.interpret import largest, looks_like_degrees
from armsight.store.yamls import read_yaml
from armsight.units import read_value


def swept_joints(n: int, left_out: Sequence[int]) -> int:
    """Return how many of n joints are swept, where some (from 1) are left out: the last ones only.

    Raises UsageError for joints that are not there, for all of them, and for one with a swept joint behind it.
    """
    out = sorted(set(left_out))
    if out and (out[0] < 1 or out[-1] > n):
        raise UsageError(f"joints {named(out)} cannot be left out of {n}", cure=f"Count joints from 1 to {n}")
    m = n - len(out)
    if m == 0:
        raise UsageError(
            "all joints are left out", consequence="There is nothing to identify", cure="Sweep one at least"
        )
    behind = [joint for joint in range(1, n + 1) if joint not in out and out and joint > out[0]]
    if behind:
        raise UsageError(
            f"{named(out[:1])} cannot be left out while {named(behind)} {'is' if len(behind) == 1 else 'are'} swept: "
            "the table's entries between the joints before and behind it hold only while it stands where it does",
            consequence="What came out would be no table of this arm, and its joints would be counted wrongly",
            cure=f"Leave out {named(range(out[0], n + 1))}, or none before the last",
        )
    return m


def named(joints: Sequence[int]) -> str:
    """Return 'joint 5', or 'joints 4, 5 and 6'."""
    numbers = [str(joint) for joint in joints]
    if len(numbers) == 1:
        return f"joint {numbers[0]}"
    return f"joints {', '.join(numbers[:-1])} and {numbers[-1]}"


def consequence(n: int, left_out: Sequence[int]) -> str:
    """Return in words what cannot be identified where the last joints of n are left out. Raises as swept_joints."""
    m = swept_joints(n, left_out)
    if m == n:
        return ""
    held = list(range(m + 1, n + 1))
    one = len(held) == 1
    return (
        f"{named(held)} {'is' if one else 'are'} left out and held: {'its' if one else 'their'} type, axis and entries "
        f"are not identified. The arm that is written has {named(range(1, m + 1))}, with the beacon fixed behind joint "
        f"{m}: it is no model of the whole robot, and holds only while {named(held)} stand{'s' if one else ''} as "
        "during the sweeps"
    )


def first_joints(arm: Arm, m: int, held: Array) -> Arm:
    """Return an arm of its first m joints, the others fixed at the readings held (n - m,) in rad or m.

    The tool is where it was. Raises Inconsistent for held of another length, UsageError where a joint that is left out
    is geared to one that is swept, or the other way round: its value would not stand still.
    """
    if len(held) != arm.n - m:
        raise Inconsistent(f"{arm.name} has {arm.n} joints, {m} are swept and {len(held)} held")
    standard = in_convention(arm, Convention.STANDARD)
    kept = {joint.name for joint in standard.joints[:m]}
    mixed = [one for one in standard.couplings if (one.joint in kept) != (one.by in kept)]
    if mixed:
        raise UsageError(
            f"{mixed[0].joint} and {mixed[0].by} are geared to each other, and one of them is left out",
            consequence="It would not stand still, and nothing is moved",
            cure="Sweep both, or leave out both",
        )
    frames = link_frames(standard, standard.values(np.concatenate([np.zeros(m), held])))
    return replace(
        standard,
        joints=standard.joints[:m],
        couplings=tuple(one for one in standard.couplings if one.joint in kept),
        T_flange_tool=RigidTransform.from_matrix(np.linalg.inv(frames[m]) @ frames[-1]),
        covariance=None,
    )


def joint_limits(name: str, value: Any, given: Given, undo: ExitStack) -> Array:
    """Return limits (n, 2) of an array, of a file, or of a text as the command line takes it; see read_limits."""
    if isinstance(value, str | PathLike):
        return read_limits(str(value))
    return in_radians(checked_array(name, value, (None, 2)))


def read_limits(text: str) -> Array:
    """Return limits (n, 2) of 'lo:hi,lo:hi' or of a limits.yaml, in rad or m; a value may carry its unit, as 90deg.

    Raises UsageError, BadFile; Inconsistent for values without a unit that can only be degrees.
    """
    stated = False
    if Path(text).suffix in (".yaml", ".yml"):
        rows = read_yaml(Path(text)).get("limits")
        refusal: ArmsightError = BadFile(f"{text}: no list 'limits' of [lower, upper] in rad or m")
    else:
        rows = [part.split(":") for part in text.split(",")]
        refusal = UsageError(f"the limits {text!r} are not lo:hi,lo:hi", cure="Write for instance --limits=0:3.1,-1:1")
        stated = all(value.strip()[-1:].isalpha() for row in rows for value in row)
    try:
        limits = np.array([[read_value(str(value))[0] for value in row] for row in cast(Any, rows)])
    except (TypeError, ValueError):
        raise refusal from None
    if limits.ndim != 2 or limits.shape[1] != 2:
        raise refusal
    return limits if stated else in_radians(limits, text)


def in_radians(limits: Array, text: str = "") -> Array:
    """Return limits (n, 2) in rad or m as they are. Raises Inconsistent for values that can only be degrees."""
    if looks_like_degrees(limits):
        text = text or ",".join(f"{low!r}:{high!r}" for low, high in limits.tolist())
        raise Inconsistent(
            f"the limits {text!r} look like degrees: the largest is {largest(limits):g}, and a turn has 6.28 rad",
            consequence="Nothing is moved",
            cure="Give radians, or a unit with every value: --limits=-28deg:298deg,0mm:500mm (deg, rad, mm, m)",
        )
    return limits


@dataclass(slots=True, kw_only=True)
class FirstJoints:
    """A robot of which the first m joints are moved; the others are to stay where they stood when it was opened."""

    robot: Robot
    m: int
    _held: Array | None = field(default=None)

    takes_poses: bool = False

    @property
    def name(self) -> str:
        """The robot's."""
        return self.robot.name

    @property
    def n_joints(self) -> int:
        """Those that are moved."""
        return self.m

    @property
    def cycle_s(self) -> float:
        """The robot's."""
        return self.robot.cycle_s

    @property
    def state(self) -> RobotState:
        """The robot's."""
        return self.robot.state

    @property
    def why(self) -> str:
        """The robot's."""
        return str(getattr(self.robot, "why", ""))

    @property
    def reading_step(self) -> float:
        """The robot's."""
        return RobotTraits.of(self.robot).reading_step

    @property
    def joint_range(self) -> tuple[Array, Array] | None:
        """The first joints'."""
        told = RobotTraits.of(self.robot).joint_range
        return None if told is None else (told[0][: self.m], told[1][: self.m])

    @property
    def held(self) -> Array:
        """Where the others stand (n - m,), rad or m."""
        if self._held is None:
            self._held = self.robot.read().q[self.m :].copy()
        return self._held

    def __enter__(self) -> Self:
        """Open the robot."""
        self.robot.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.robot.__exit__(kind, error, trace)

    def read(self) -> JointReading:
        """Return the first joints' reading. Raises as the robot does, and DeviceFailed where a held joint has moved."""
        reading = self.robot.read()
        off = np.abs(reading.q[self.m :] - self.held)
        if off.max(initial=0.0) > HELD + 1.5 * self.reading_step:
            joint = self.m + 1 + int(np.argmax(off))
            raise DeviceFailed(
                f"joint {joint} is left out and has moved by {off.max():.3g} rad or m",
                consequence="The robot is stopped: the readings would be those of two arms",
                cure="Hold it still, or sweep it as well",
            )
        return replace(reading, q=reading.q[: self.m])

    def step_joints(self, step: Array) -> Sent:
        """Move the first joints on by step (m,)."""
        sent = self.robot.step_joints(np.concatenate([np.asarray(step, dtype=float), np.zeros(len(self.held))]))
        return replace(sent, q=sent.q[: self.m])

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Refuse. Raises UsageError."""
        raise UsageError(f"{self.name} takes joint steps here", consequence="Nothing was sent")

    def stop(self) -> None:
        """Stop the robot."""
        self.robot.stop()

    def reset(self) -> None:
        """Let it go again."""
        self.robot.reset()
