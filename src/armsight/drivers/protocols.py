"""What every source of frames and every robot offers, whether hardware, a file, a recording or a simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from types import TracebackType
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.errors import UsageError
from armsight.records import Frame, JointReading, frozen_array
from armsight.records.result_parts import Skew


class FrameSource(Protocol):
    """Frames of one camera in the order of time. Its constructor opens nothing; `with` opens and closes it.

    Frames carry increasing t_s, sequence 0, 1, 2 ... and the source's name or file. A source may be opened and
    read again, unless it is live.
    """

    @property
    def name(self) -> str:
        """What the person called it: folder, pattern, video file, camera."""
        ...

    @property
    def total(self) -> int | None:
        """How many frames there will be; None where that cannot be known (live, some videos)."""
        ...

    def __enter__(self) -> Self:
        """Open it. Raises DataRefused or DeviceFailed where that cannot be done."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it; legal at any time."""
        ...

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames. Raises BadImage, Inconsistent or DeviceLost at the frame that fails."""
        ...


Views: TypeAlias = tuple[Frame | None, ...]
"""A frame of each camera at one time, or None where one has none."""


class MomentSource(Protocol):
    """Moments in step: a frame of each of some cameras, in one order, or None where one has none.

    Opened and closed like a FrameSource. Of a pair every moment has both.
    """

    @property
    def name(self) -> str:
        """What the person called it."""
        ...

    @property
    def total(self) -> int | None:
        """How many moments there will be; None where that cannot be known."""
        ...

    @property
    def skew(self) -> Skew | None:
        """How far apart the frames of a moment were so far; None where all views share one time stamp."""
        ...

    def __enter__(self) -> Self:
        """Open it. Raises DataRefused or DeviceFailed where that cannot be done."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it; legal at any time."""
        ...

    def __iter__(self) -> Iterator[Views]:
        """Yield the moments. Raises BadImage, Inconsistent or DeviceLost at the one that fails."""
        ...


class RobotState(StrEnum):
    """What a robot's link can do just now."""

    CLOSED = "closed"
    READY = "ready"
    MOVING = "moving"
    STOPPED = "stopped"
    LOST = "lost"


PROVING = "the link is being proven"
"""What Sent.limited says while a probe shows what the controller makes of its commands: until then the arm is told to
stand, whatever is asked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sent:
    """A command as it really went to the controller, after every limit.

    q: (n,) joint values in rad or m that the robot was told to go to. pose: T_base_flange that belongs to them by the
    controller's own geometry; None where the link does not know it. limited: the limits that cut the command, in
    words; empty where it went out as asked.
    """

    q: NDArray[np.float64]
    t_s: float
    sequence: int
    pose: RigidTransform | None = None
    limited: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array("q", self.q, (None,)))


class Robot(Protocol):
    """One robot arm. Its constructor opens nothing; `with` opens and closes it, and closing stops it.

    A command holds for one cycle; a robot that hears none stays where it was last told to go.
    """

    @property
    def name(self) -> str:
        """What the person called it."""
        ...

    @property
    def n_joints(self) -> int:
        """How many joints it has."""
        ...

    @property
    def cycle_s(self) -> float:
        """Time between two commands that the controller takes, in s."""
        ...

    @property
    def takes_poses(self) -> bool:
        """Whether move_pose is possible."""
        ...

    @property
    def state(self) -> RobotState:
        """What it can do just now; never raises."""
        ...

    def __enter__(self) -> Self:
        """Open the link. Raises DeviceFailed where that cannot be done."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop it and close the link; legal at any time."""
        ...

    def read(self) -> JointReading:
        """Return the newest reading. Raises StaleData where it is too old, DeviceLost without a link, DeviceFailed."""
        ...

    def step_joints(self, step: NDArray[np.float64]) -> Sent:
        """Move on from where it was last told to go by step (n,) in rad or m; return what was really sent.

        Raises UsageError for another number of joints, Inconsistent for values that are not finite, DeviceFailed
        where the robot is closed or stopped, DeviceLost.
        """
        ...

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move towards a pose of the flange as far as one cycle allows; return what was really sent.

        Raises as step_joints does; UsageError where the robot takes no poses, Inconsistent out of its reach.
        """
        ...

    def stop(self) -> None:
        """Come to rest and take no commands until reset. Legal at any time, in any state; never raises."""
        ...

    def reset(self) -> None:
        """Take commands again after a stop, from where it stands. Raises DeviceFailed where closed, DeviceLost."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotTraits:
    """What only some robots are or know; a robot that says nothing of it is as the defaults are.

    takes_joints: step_joints moves it; else move_pose alone does. guarded: it is behind a loop with a guard of its own.
    arm_mapping: returns the arm that its controller computes with, as arm.yaml has it. true_joints: returns where its
    joints (n,) really were at a time of the clock, as only a simulated robot knows. listen: has a function told of each
    reading: when it was sent, on the clock, and its joints (n,). reading_step: of its encoders, in rad or m, where that
    is more than a reading's noise: readings are whole steps. hangs_rad: by so much may its joints rest off their goals
    under load. joint_range: lower and upper (n,) ends beyond which its
    link takes it nowhere, in rad or m. reads_only: its link commands nothing, not even a stop.
    """

    takes_joints: bool = True
    guarded: bool = False
    arm_mapping: Callable[[], Mapping[str, Any]] | None = None
    true_joints: Callable[[float], NDArray[np.float64]] | None = None
    listen: Callable[[Callable[[float, NDArray[np.float64]], object]], None] | None = None
    reading_step: float = 0.0
    hangs_rad: float = 0.0
    joint_range: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    reads_only: bool = False

    @property
    def reading_std(self) -> float:
        """Standard deviation that the encoder's step alone leaves in a reading."""
        return self.reading_step / math.sqrt(12.0)

    @classmethod
    def of(cls, robot: Robot) -> RobotTraits:
        """Return the traits of a robot, which has them as attributes of these names; none of them is needed."""
        found = {field.name: getattr(robot, field.name) for field in fields(cls) if hasattr(robot, field.name)}
        return cls(**found)


def listen(robot: Robot, heard: Callable[[float, NDArray[np.float64]], object]) -> None:
    """Have `heard` told of each reading of a robot: when it was sent, on the clock, and its joints (n,).

    Raises UsageError for a robot that does not tell that.
    """
    told = RobotTraits.of(robot).listen
    if told is None:
        raise UsageError(
            f"{robot.name} does not tell when its joints were read",
            consequence="Where its arm is at a picture's exposure would not be known, and nothing is moved",
            cure="Name the controller itself, such as rsi:49152 or egm:6510; sim:SCENARIO brings its own cameras",
        )
    told(heard)
