"""What `armsight identify` is told, of sweeps that are there and of one before live cameras."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.app.requests.motion import RobotJob
from armsight.defaults import SWEEP_READINGS, SWEEP_SPEED
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag, Flags, loaded
from armsight.ops.flags import A_SRC, KNOWN_ARM, OUT, SRC, Cameras, Table, automatic, ours

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from armsight.control.joint_sweep import Pace

    Array: TypeAlias = NDArray[np.float64]

Result: TypeAlias = Annotated[Path, Doc("arm.yaml to write."), OUT]
TARGET = Doc("Instead of a sweep: target.yaml of the beacon, with frames.")
LEFT = Doc(f"Left frames: {SRC}.")
RIGHT = Doc("Right frames, in step with the left ones.")
RIG = Doc("rig.yaml: fit pixels instead of positions.")
WORLD = Doc("world.yaml: where the rig stands to the arm's base.")
METHOD = Doc("ml (maximum likelihood) or paper (triples, Chauvenet, means).")
SIGMA = Doc("Noise: px of a pixel with --rig, else m of a place; else it is found.")
MASK = Doc("With frames or --live: image that is black where no light may be looked for.")
NOMINAL = Doc(f"{KNOWN_ARM} to put beside, in the report.")


@dataclass(frozen=True, kw_only=True)
class IdentifyJob:
    """A sweep file; or frames (left, right) of a beacon (target) before a rig, with the joints of each.

    With a world the first frame is the base's foot on the first axis. held: where the joints stood, in rad or m, that
    the robot has behind the swept ones.
    """

    out: Result
    sweep: Annotated[Path | None, Doc("sweep.csv: joint,q1..qn and positions (x_m,y_m,z_m), pixels, or both.")] = None
    target: Annotated[Path | None, TARGET] = None
    left: Annotated[str | None, LEFT, A_SRC] = None
    right: Annotated[str | None, RIGHT, A_SRC] = None
    joints: Annotated[Path | None, Doc("sweep_joints.csv: frame,joint,q1..qn of those frames.")] = None
    rig: Annotated[Path | None, RIG] = None
    world: Annotated[Path | None, WORLD] = None
    method: Annotated[str, METHOD] = "ml"
    increments: Annotated[str, Doc("known: commanded values are exact; order: only their order.")] = "known"
    sigma: Annotated[float | None, SIGMA, Bounds(least=1e-9)] = None
    mask: Annotated[Path | None, MASK] = None
    nominal: Annotated[str | None, NOMINAL, Flag(metavar="ARM")] = None
    table: Table = field(default_factory=ours)
    held: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PaceFlags:
    """How fast a robot is swept."""

    speed: Annotated[float, Doc("With --live: share of a joint's travel a second."), Bounds(least=0.001, most=1.0)] = (
        SWEEP_SPEED
    )

    def made(self, notify: Callable[[str], None]) -> Pace:
        """Return the pace."""
        from armsight.control.joint_sweep import Pace

        return Pace(speed=self.speed)


def joint_numbers(text: str) -> tuple[int, ...]:
    """Return the joints of '5,6'. Raises UsageError."""
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--leave-out {text!r} names no joints", cure="Write their numbers: --leave-out 5,6") from None


def limits_of(text: str) -> Array:
    """Return the limits (n, 2) of 'lo:hi,lo:hi' or of a limits.yaml. Raises UsageError, BadFile, Inconsistent."""
    from armsight.app.identify.live import read_limits

    return read_limits(text)


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveJob(RobotJob):
    """A robot that is moved before live cameras; of sim:SCENARIO those are camera:sim:SCENARIO:left and :right.

    A model takes the place of the probe, and needs world. around_px: as propose_sweeps takes it. limits (n, 2)
    are of all joints, those left out too, in rad or m.
    """

    out: Result
    target: Annotated[Path, TARGET]
    left: Annotated[str, LEFT, A_SRC]
    right: Annotated[str, RIGHT, A_SRC]
    rig: Annotated[Path, RIG]
    world: Annotated[Path | None, WORLD] = None
    method: Annotated[str, METHOD] = "ml"
    sigma: Annotated[float | None, SIGMA, Bounds(least=1e-9)] = None
    mask: Annotated[Path | None, MASK] = None
    nominal: Annotated[str | None, NOMINAL, Flag(metavar="ARM")] = None
    robot: Annotated[
        str,
        Doc("Move this robot: DRIVER:DEVICE, or sim:SCENARIO with its own cameras."),
        Flag("--live", metavar="ROBOT"),
    ]
    limits: Annotated[
        Array,
        Doc("With --live: lo:hi,lo:hi ... in rad or m (or -90deg:90deg,0mm:500mm), or limits.yaml. Never left."),
        Flag(metavar="LIMITS", read=limits_of),
    ]
    readings: Annotated[int, Doc("With --live: readings of a sweep."), Bounds(least=4, most=1000)] = SWEEP_READINGS
    pace: Annotated[Pace, Flags(PaceFlags)] = field(default_factory=loaded("armsight.control.joint_sweep:Pace()"))
    propose: Annotated[bool, Doc("With --live: probe and tell the plan only; with --model do not move.")] = False
    model: Annotated[
        Path | None, Doc("With --live: an arm roughly right, its tool the beacon; no probe."), Flag(metavar="ARM")
    ] = None
    left_out: Annotated[
        tuple[int, ...],
        Doc("With --live: the last joints, not swept but held where they are."),
        Flag("--leave-out", metavar="5,6", read=joint_numbers),
    ] = ()
    around_px: float = 0.0
    camera_settings: Cameras = field(default_factory=automatic)
