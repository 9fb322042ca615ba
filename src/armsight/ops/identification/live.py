"""An unknown arm identified online: a small probe, a plan with the accuracy to expect, then the sweeps."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np

from armsight.arrays import Array, Image
from armsight.calibrate.identify import Identification, Sweeps, even_ones, identify
from armsight.calibrate.identify.plan import PROBE_SHARE, Plan, checked_limits, probe, propose_sweeps
from armsight.calibrate.identify.result import JointStd, PlannedSweepOutput, PlanOutput, ProposedPlanOutput
from armsight.calibrate.identify.rough_arm import RoughArm, known_arm, rough_arm
from armsight.calibrate.identify.sweeps import require_two
from armsight.clock import Clock, SystemClock
from armsight.control.joint_sweep import BeaconObserver, Pace, Sweeper
from armsight.defaults import SWEEP_READINGS
from armsight.drivers import AUTOMATIC, CameraSettings, MomentSource, Robot, RobotTraits, moments_of
from armsight.errors import ArmsightError, Cancelled, DataRefused, UsageError
from armsight.kinematics import Arm
from armsight.measure.poses.moments import require_views
from armsight.measure.poses.pipeline import Setup
from armsight.ops.identification.beacon_observer import CameraBeaconObserver, beacon_note, beacon_settings, reach_m
from armsight.ops.identification.left_out import FirstJoints, consequence, first_joints, swept_joints
from armsight.ops.identification.solve import solve_sweeps
from armsight.ops.identify import SweepReadings
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.requests.motion import RobotJob
from armsight.ops.verification.live import open_supervised
from armsight.optics import Rig
from armsight.records import Progress, Silent, Target
from armsight.store import World
from armsight.store.arm_points import write_sweeps
from armsight.units import DEG, MM, displayed

SIM = "sim:"
RANGE_SPARE = 1e-6
"""Rounding that a limit may be beyond the robot's own, in rad or m."""
LARGEST_SHARE = 0.4
"""Probes grow no further than this share of the travel; what is not told by then, the plan says."""
SIGMA_PX = 0.2
"""Noise of a reading where only a model is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorCallbacks:
    """Who watches the robot: confirm is asked before it moves, show is given the plan before the sweeps."""

    confirm: Callable[[str], bool] = lambda _: False
    show: Callable[[PlanOutput], None] = lambda _: None


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """The rig, where it stands, an arm roughly right whose tool is the beacon, and the arm to put beside the result."""

    rig: Rig
    world: World | None = None
    model: Arm | None = None
    nominal: Arm | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveSweeps:
    """The sweeps of a robot that is moved before live cameras; limits (n, 2) are of all joints, in rad or m.

    left_out: joints from 1, held where they are. around_m: as propose_sweeps takes it. propose: tell the plan only.
    out: arm.yaml, beside which what was read is written; None: nothing is.
    """

    limits: Array
    left_out: tuple[int, ...] = ()
    readings: SweepReadings = SWEEP_READINGS
    pace: Pace = field(default_factory=Pace)
    sigma: float | None = None
    method: str = "ml"
    propose: bool = False
    around_m: float = 0.0
    out: Path | None = None

    def file(self, ending: str) -> Path | None:
        """Return the file beside `out` with this ending."""
        return None if self.out is None else self.out.with_suffix(ending)


def identify_live(
    sweeps: LiveSweeps,
    known: Known,
    target: Target,
    link: RobotJob,
    sources: Mapping[str, str],
    person: OperatorCallbacks,
    settings: CameraSettings = AUTOMATIC,
    mask: Image | None = None,
    progress: Progress | None = None,
    *,
    clock: Clock | None = None,
    devices: tuple[Robot, MomentSource] | None = None,
) -> Identification | ProposedPlanOutput:
    """Probe, plan, sweep and identify; return the arm, or the plan where that alone is asked for.

    The robot moves only where the person confirms, and is stopped on every error; what was read until then is beside
    the arm (.probe.csv, .sweep.csv). A model takes the place of the probe, and needs a world. sources: live cameras by
    name, of sim:SCENARIO its own. clock, devices: in place of the machine's and of those named. Raises UsageError,
    DataRefused (also for a lost beacon), DeviceFailed, Cancelled.
    """
    clock, progress = clock or SystemClock(), progress or Silent()
    swept_joints(len(sweeps.limits), sweeps.left_out)  # refused before anything is opened
    _check(sweeps, known)
    setup = Setup(rig=known.rig, target=target, settings=beacon_settings(target, mask))
    sweeps = replace(sweeps, around_m=reach_m(target))
    require_views(setup, len(known.rig.cameras))
    robot, moments = devices or open_devices(link, known.rig, sources, settings, target, clock)
    prepare(progress, views=not known.rig.is_pair)  # a controller that waits for compilers gives the link up
    with robot, moments:
        observer = CameraBeaconObserver(setup, moments_of(moments), clock)
        done = identify_observed(sweeps, known, person, robot, observer, clock, progress)
    first = beacon_note(target.names[0], len(target.names))
    if isinstance(done, ProposedPlanOutput):
        return replace(done, notes=[*first, *done.notes])
    return replace(done, notes=(*first, *done.notes))


def identify_observed(
    job: LiveSweeps,
    known: Known,
    person: OperatorCallbacks,
    robot: Robot,
    observer: BeaconObserver,
    clock: Clock,
    progress: Progress,
) -> Identification | ProposedPlanOutput:
    """Do as identify_live, with a robot that is open and whoever sees the beacon."""
    rig, limits = known.rig, job.limits
    require_two(rig)
    m = swept_joints(len(limits), job.left_out)
    held = np.empty(0)
    if m < len(limits):
        _check_joints(robot, limits)
        robot, limits = (first := FirstJoints(robot=robot, m=m)), limits[:m]
        held = first.held
    base = None if known.world is None else known.world.T_parent_rig.inv().as_matrix()
    low_high, start = checked_limits(limits, robot.read().q)
    _check_range(robot, low_high)
    sweeper = Sweeper(robot, observer, low_high, clock, progress, job.pace, rig.names)
    if known.model is not None:
        arm, notes = _modelled(known, held, job.sigma or SIGMA_PX), list[str]()
    else:
        with _stopped_on_error(robot, sweeper, job.file(".probe.csv")):
            arm, notes = _probed(job, person, robot, sweeper, rig)
    if not (known.model is not None and job.propose):
        start = sweeper.standing
    plan = propose_sweeps(arm, rig, low_high, start, readings=job.readings, base=base, around_m=job.around_m)
    notes = [*([consequence(m + len(held), job.left_out)] if len(held) else []), *notes]
    planned = plan_output(plan, notes)
    person.show(planned)
    if job.propose:
        return ProposedPlanOutput(plan=planned, notes=planned.notes)
    _ask(person, _sweeps_question(robot, plan, [axis.revolute for axis in arm.axes], job.pace))
    sweeps, uneven = even_ones(_swept(job, plan, robot, sweeper))
    if uneven and (file := job.file(".sweep.csv")) is not None:
        write_sweeps(file, sweeps)
    return _solved(job, known, sweeps, held, uneven, planned)


def _solved(
    job: LiveSweeps, known: Known, sweeps: Sweeps, held: Array, notes: Sequence[str], plan: PlanOutput
) -> Identification:
    return solve_sweeps(
        sweeps,
        rig=known.rig,
        world=known.world,
        nominal=known.nominal,
        held=held.tolist(),
        name="identified" if job.out is None else job.out.stem,
        notes=notes,
        plan=plan,
        sigma=job.sigma,
        method=job.method,
    )


def _check_joints(robot: Robot, limits: Array) -> None:
    if len(limits) != robot.n_joints:
        raise UsageError(
            f"the limits are of {len(limits)} joints, {robot.name} has {robot.n_joints}",
            consequence="Nothing is moved",
            cure="Write lo:hi for every joint, also for those that are left out",
        )


def _check_range(robot: Robot, limits: Array) -> None:
    """Refuse limits beyond the range that the robot's link tells: the sweeps would end there, minutes later."""
    told = RobotTraits.of(robot).joint_range
    if told is None:
        return
    for j, (low, high, lower, upper) in enumerate(zip(*limits.T, *told, strict=True)):
        if low < lower - RANGE_SPARE or high > upper + RANGE_SPARE:
            raise UsageError(
                f"joint {j + 1} is to go from {low:.4g} to {high:.4g}, and {robot.name} takes it from {lower:.4g} to "
                f"{upper:.4g}",
                consequence="Nothing is moved",
                cure=f"Write {max(low, lower):.4f}:{min(high, upper):.4f} for it in --limits, or less",
            )


def _sweeps_question(robot: Robot, plan: Plan, revolute: Sequence[bool], pace: Pace) -> str:
    """Return what is asked before the sweeps: each joint's way in degrees or mm."""
    ways = []
    for sweep in plan.sweeps:
        name, unit = displayed("rad" if revolute[sweep.joint] else "m")
        first, last = sweep.q[0, sweep.joint] / unit, sweep.q[-1, sweep.joint] / unit
        ways.append(f"joint {sweep.joint + 1} from {first:.1f} to {last:.1f} {name}")
    return (
        f"Move {robot.name} along {len(plan.sweeps)} sweeps as planned ({'; '.join(ways)}), at up to "
        f"{pace.speed:.0%} of a joint's travel a second?"
    )


def _probe_question(robot: Robot, limits: Array) -> str:
    """Return what is asked before the probe: of joints whose kind is not known yet, the way in degrees and in mm."""
    ways = "; ".join(
        f"joint {j + 1} {PROBE_SHARE * travel / DEG:.1f} deg (or {PROBE_SHARE * travel / MM:.0f} mm, if it slides)"
        for j, travel in enumerate((limits[:, 1] - limits[:, 0]).tolist())
    )
    return (
        f"Move each joint of {robot.name} by {PROBE_SHARE:.0%} of its travel ({ways}), one after the other, and where "
        f"that does not tell the joint by up to {LARGEST_SHARE:.0%}?"
    )


def open_devices(
    link: RobotJob,
    rig: Rig,
    sources: Mapping[str, str],
    settings: CameraSettings,
    target: Target,
    clock: Clock,
) -> tuple[Robot, MomentSource]:
    """Return the robot and a rig's cameras; nothing is opened yet. Raises as open_supervised."""
    of_robot = (link, rig, sources, target, clock, None)
    seen = open_supervised(*of_robot, play=False, camera_settings=settings, tell=warnings.warn)
    return seen.robot, cast(MomentSource, seen.pairs)  # of cameras


def plan_output(plan: Plan, notes: Sequence[str] = ()) -> PlanOutput:
    """Return a plan as --json gives it; joints count from 1, a standard deviation that means nothing is null."""
    return PlanOutput(
        sweeps=[
            PlannedSweepOutput(
                joint=sweep.joint + 1,
                start=float(sweep.q[0, sweep.joint]),
                end=float(sweep.q[-1, sweep.joint]),
                readings=len(sweep.q),
                rest=sweep.q[0].tolist(),
                way=sweep.way.tolist(),
                radius_m=sweep.radius_m,
                ended_by=sweep.ends,
            )
            for sweep in plan.sweeps
        ],
        expected_std=[JointStd.of(one) for one in plan.expected],
        noise_px=plan.sigma_px,
        notes=[*notes, *plan.notes],
    )


def _check(job: LiveSweeps, known: Known) -> None:
    if known.rig is not None:
        require_two(known.rig)
    if known.model is not None and known.world is None:
        raise UsageError("a model needs the rig's place", cure="Give --world beside --model")
    if not 0.0 < job.pace.speed <= 1.0 or job.readings < 4 or job.pace.frames_per_reading < 1:
        raise UsageError(
            "speed is a share of the travel a second in (0, 1], a sweep has 4 readings or more of a frame or more each"
        )


def _ask(person: OperatorCallbacks, question: str) -> None:
    if not person.confirm(question):
        raise Cancelled(
            "not confirmed", consequence="The robot is not moved further", cure="Give --yes to move without asking"
        )


@contextmanager
def _stopped_on_error(robot: Robot, sweeper: Sweeper, file: Path | None) -> Iterator[None]:
    """Stop the robot at once where the work in it fails or ends early, and write what was read."""
    try:
        yield
    except BaseException as error:
        robot.stop()
        sweeps = sweeper.sweeps
        if sweeps is not None and file is not None:
            write_sweeps(file, sweeps)
            if isinstance(error, ArmsightError):
                kept = f"the {len(sweeps)} readings until then are in {file}"
                error.consequence = "; ".join(part.rstrip(".") for part in (error.consequence, kept) if part)
        raise


def _modelled(known: Known, held: Array, sigma_px: float) -> RoughArm:
    """Return the model as the rig sees it; its last joints held at these readings."""
    arm, world = known.model, known.world
    if arm is None or world is None:
        raise UsageError("a model needs the rig's place", cure="Give --model and --world")
    arm = first_joints(arm, arm.n - len(held), held) if len(held) else arm
    T = world.T_parent_rig.inv().as_matrix()
    if world.parent == "base":
        T = T @ arm.T_world_base.inv().as_matrix()
    return known_arm(arm, T, sigma_px)


def _probed(
    job: LiveSweeps, person: OperatorCallbacks, robot: Robot, sweeper: Sweeper, rig: Rig
) -> tuple[RoughArm, list[str]]:
    """Return the arm as small sweeps about the start tell it, and notes; those that do not tell a joint's type grow."""
    _ask(person, _probe_question(robot, sweeper.limits))
    sweeper.begin()
    start = sweeper.standing
    checked_limits(sweeper.limits, start)
    shares, parts = np.full(len(start), PROBE_SHARE), {}
    todo = list(range(len(start)))
    while True:
        for j in todo:
            poses = probe(sweeper.limits, start, j, share=float(shares[j]))
            sweeper.clear(len(poses))
            sweeper.sweep(j, poses)
            sweeper.move(start)
            if sweeper.sweeps is not None:
                parts[j] = sweeper.sweeps
        sweeps = joined([parts[j] for j in sorted(parts)])
        found, refused = _tried(sweeps, rig, job.sigma)
        todo = [j for j in range(len(start)) if found is None or not found.joints[j].decided]
        todo = [j for j in todo if shares[j] < LARGEST_SHARE]
        if found is not None and not todo:
            if (file := job.file(".probe.csv")) is not None:
                write_sweeps(file, sweeps)
            return rough_arm(found, sweeps.q, rig), _unsure(found)
        if not todo and refused is not None:
            raise refused
        shares[todo] = np.minimum(2.0 * shares[todo], LARGEST_SHARE)


def _unsure(found: Identification) -> list[str]:
    return [
        f"joint {number}: the probe does not tell whether it turns or slides; the plan takes it as "
        f"{'turning' if joint.axis.revolute else 'sliding'}, and what it says of this joint may be wrong"
        for number, joint in enumerate(found.joints, 1)
        if not joint.decided
    ]


def _tried(sweeps: Sweeps, rig: Rig, sigma: float | None) -> tuple[Identification | None, DataRefused | None]:
    try:
        return identify(sweeps, rig=rig, sigma=sigma), None
    except DataRefused as error:
        return None, error


def joined(parts: list[Sweeps]) -> Sweeps:
    """Return sweeps with pixels, one after the other."""
    uv = [part.uv_px for part in parts if part.uv_px is not None]
    std = [part.std_px for part in parts if part.std_px is not None]
    return Sweeps(
        joint=np.concatenate([part.joint for part in parts]),
        q=np.concatenate([part.q for part in parts]),
        xyz_m=np.concatenate([part.xyz_m for part in parts]),
        uv_px=np.concatenate(uv),
        std_px=np.concatenate(std) if len(std) == len(parts) else None,
        cameras=parts[0].cameras,
    )


def _swept(job: LiveSweeps, plan: Plan, robot: Robot, sweeper: Sweeper) -> Sweeps:
    """Return the readings of the planned sweeps, written beside the arm."""
    file = job.file(".sweep.csv")
    with _stopped_on_error(robot, sweeper, file):
        sweeper.clear(sum(len(sweep.q) for sweep in plan.sweeps))
        sweeper.begin()
        for sweep in plan.sweeps:
            for pose in sweep.way:
                sweeper.move(pose)
            sweeper.sweep(sweep.joint, sweep.q)
        sweeps = sweeper.sweeps
    if sweeps is None:
        raise Cancelled("nothing was read")
    if file is not None:
        write_sweeps(file, sweeps)
    return sweeps
