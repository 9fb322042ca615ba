"""What `armsight verify` is told in each of its ways: rows of a file, a plan, a running arm, after a crash."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.app.requests.motion import LATENCY_S, RobotJob
from armsight.app.requests.plant import PlantFlags, Publishing
from armsight.fields import Bounds, Doc, Flag, Flags, loaded
from armsight.ops.flags import AN_ARM, KNOWN_ARM, LIVE, MASTERING, OutFolder, automatic, ours
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.drivers import CameraSettings
    from armsight.store.interpret import TableFormat
    from armsight.verify.supervision import Limits

JOINT_STD = 2e-5
"""Of a joint reading in rad or m: a step of a 17-bit encoder is 5e-5 rad."""
LATENCY_STD_S = 0.01
"""Of motion.LATENCY_S, of cameras nobody has measured."""

ARM = Doc(f"{KNOWN_ARM}.")
WORLD = Doc("world.yaml: where the measuring rig stands.")
MEASURED = Doc(
    "Measured poses or points: poses.csv, points.csv, a tracker's table (x_m,y_m,z_m), TUM. With columns "
    "pose and visit, or run, the figures of ISO 9283."
)
RIG = Doc("rig.yaml of the two cameras.")
TARGET = Doc("target.yaml of the lights on the tool.")
Joints: TypeAlias = Annotated[
    Path | None, Doc("joints.csv of the controller. [default: q1 .. qn of the measured file]")
]


@dataclass(frozen=True, kw_only=True)
class VerifyJob:
    """What was measured, and what it is held against: an arm at joints, or commanded poses."""

    out: OutFolder
    measured: Annotated[Path, MEASURED, Flag(metavar="FILE")]
    arm: Annotated[str | None, ARM, AN_ARM] = None
    joints: Joints = None
    commanded: Annotated[
        Path | None, Doc("Instead of an arm: the poses that were commanded."), Flag(metavar="FILE")
    ] = None
    world: Annotated[Path | None, WORLD] = None
    align: Annotated[
        str | None,
        Doc("What is laid where it fits best. [default: both; none with --world]"),
        Flag(metavar="none|base|tool|both"),
    ] = None
    compare: Annotated[
        Path | None, Doc("An earlier run, to stand beside this one in the report."), Flag(metavar="FOLDER")
    ] = None
    band_m: Annotated[
        float | None,
        Doc(
            "For rows with a column arrival: the limit band that the arm settles into. [default: the pose "
            "repeatability of the same pose]"
        ),
        Flag(quantity="m"),
    ] = None
    table: TableFormat = field(default_factory=ours)


@dataclass(frozen=True, kw_only=True)
class PlanJob:
    """The plan of a test by ISO 9283. part: cube (all motions), poses (all but paths), paths, or a motion's name."""

    out: OutFolder
    arm: Annotated[str | None, ARM, AN_ARM] = None
    part: Annotated[
        str,
        Doc("With --plan: which part of the test. [default: cube, all]"),
        Flag(positional=True, metavar="[cube|poses|paths]", default=None),
    ] = "cube"
    side_m: Annotated[
        float | None, Doc("With --plan: the cube's side. [default: the largest that fits]"), Flag(quantity="m")
    ] = None
    speed_m_s: Annotated[float | None, Doc("With --plan: the speed along the paths."), Flag(quantity="m/s")] = None
    plane: str = "a"


@dataclass(frozen=True, kw_only=True)
class LimitsFlags:
    """The levels of a supervision."""

    warn_m: Annotated[float | None, Doc("Error of place that warns."), Flag(unit=MM, panel=LIVE)] = None
    stop_m: Annotated[float | None, Doc("Error of place that stops the robot."), Flag(unit=MM, panel=LIVE)] = None
    warn_rad: Annotated[float | None, Doc("Error of rotation that warns."), Flag(unit=DEG, panel=LIVE)] = None
    stop_rad: Annotated[float | None, Doc("Error of rotation that stops the robot."), Flag(unit=DEG, panel=LIVE)] = None

    def made(self, notify: Callable[[str], None]) -> Limits:
        """Return the levels. Raises UsageError."""
        from armsight.verify.supervision import Limits

        return Limits(warn_m=self.warn_m, stop_m=self.stop_m, warn_rad=self.warn_rad, stop_rad=self.stop_rad)


@dataclass(frozen=True, kw_only=True)
class LiveVerifyJob(RobotJob):
    """A running arm before live cameras; of sim:SCENARIO those are camera:sim:SCENARIO:left and :right.

    world: where the rig stands, of the base or of the world that the arm's base is given in. limit: pairs.
    """

    robot: Annotated[str, Doc("Whose joints are read."), Flag(metavar="DRIVER:DEVICE", panel=LIVE)]
    left: Annotated[str, Doc("The left camera: camera:NAME."), Flag(metavar="SRC", panel=LIVE)]
    right: Annotated[str, Doc("The right camera."), Flag(metavar="SRC", panel=LIVE)]
    rig: Annotated[Path, RIG, Flag(panel=LIVE)]
    target: Annotated[Path, TARGET, Flag(panel=LIVE)]
    arm: Annotated[str, ARM, AN_ARM]
    world: Annotated[Path, WORLD]
    out: OutFolder
    limits: Annotated[Limits, Flags(LimitsFlags)] = field(
        default_factory=loaded("armsight.verify.supervision:Limits()")
    )
    blind_stop_s: Annotated[
        float | None, Doc("Stop where nothing is seen for so long."), Flag("--stop-blind", metavar="S", panel=LIVE)
    ] = None
    joint_std: Annotated[
        float,
        Doc("Of a joint reading, deg (a slide: m x 57). [default: 0.001]"),
        Flag("--joint-std", unit=DEG, default=None, panel=LIVE),
    ] = JOINT_STD
    latency_s: Annotated[
        float, Doc("From exposure to frame in memory, s. [default: 0.03]"), Flag(default=None, panel=LIVE)
    ] = LATENCY_S
    latency_std_s: Annotated[
        float, Doc("How well that is known, s. [default: 0.01]"), Flag(default=None, panel=LIVE)
    ] = LATENCY_STD_S
    seconds_s: Annotated[float | None, Doc("End after so long."), Bounds(above=0.0), Flag(panel=LIVE)] = None
    limit: Annotated[int | None, Doc("End after so many pairs."), Bounds(least=1), Flag("--frames", panel=LIVE)] = None
    frames: Annotated[bool, Doc("Keep the images in the recording too."), Flag("--keep-frames", panel=LIVE)] = False
    play: Annotated[bool, Doc("A simulated robot goes its scenario's way by itself."), Flag(panel=LIVE)] = False
    plant: Annotated[Publishing | None, Flags(PlantFlags)] = None
    camera_settings: CameraSettings = field(default_factory=automatic)


@dataclass(frozen=True, kw_only=True)
class MasteringJob:
    """An arm after a crash. world: where the rig stood before it; without it base and tool are free.

    measured, joints: of the poses; without measured, poses are proposed, with rig, target and world those that both
    cameras see.
    """

    out: OutFolder
    arm: Annotated[str, ARM, AN_ARM]
    world: Annotated[Path | None, WORLD] = None
    measured: Annotated[Path | None, MEASURED, Flag(metavar="FILE")] = None
    joints: Joints = None
    rig: Annotated[Path | None, RIG, Flag(panel=LIVE)] = None
    target: Annotated[Path | None, TARGET, Flag(panel=LIVE)] = None
    around: Annotated[
        str | None,
        Doc("Propose poses about these joints, rad or m (or 90deg)."),
        Flag(metavar="Q1,..,QN", panel=MASTERING),
    ] = None
    span_rad: Annotated[
        float,
        Doc("How far joints may go from there, deg. [default: 30]"),
        Flag("--span", unit=DEG, default=None, panel=MASTERING),
    ] = 30.0 * DEG
    tool: Annotated[
        str | None,
        Doc("Whether the tool is known from before. [default: fixed with --world, else free]"),
        Flag(metavar="fixed|free", panel=MASTERING),
    ] = None
