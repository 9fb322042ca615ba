"""A sweep in, the arm that made it out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armsight.app.identify.beacon_observer import SeenBeacon, beacon_note, beacon_of, beacon_settings
from armsight.app.identify.left_out import consequence, first_joints, named
from armsight.app.identify.results import IdentifiedJoint, IdentifyOutput, JointAxis, JointStd, LeftOutJoint, PlanOutput
from armsight.app.measure.run import target_of
from armsight.app.requests.identify import IdentifyJob
from armsight.calibrate.identify import Identification, Sweeps, even_ones, identify
from armsight.calibrate.identify.result import JointFound, placed_by
from armsight.drivers import is_video
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.file_names import report_path
from armsight.kinematics import Arm, Joint
from armsight.measure.poses.beacon import without_standing
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup, check_sizes
from armsight.measure.spots import find_spots
from armsight.ops.arm_files import given_arm
from armsight.ops.sources.frames import open_pairs
from armsight.optics import Rig
from armsight.records import Progress, Silent, Spots
from armsight.records.result_parts import RejectedRow
from armsight.report.identify_report import identify_report
from armsight.store import World, read_rig, read_world, write_text
from armsight.store.arm_file import write_arm
from armsight.store.arm_points import read_sweep_joints, read_sweeps, write_sweeps


def run_identify(job: IdentifyJob, progress: Progress | None = None) -> IdentifyOutput:
    """Identify the arm, write arm.yaml and its report; return the figures as --json gives them.

    A sweep made from frames is written beside the arm. Raises UsageError, DataRefused, DeviceFailed.
    """
    rig = None if job.rig is None else read_rig(job.rig)
    world = None if job.world is None else read_world(job.world)
    nominal = given_arm(job.nominal)
    notes: list[str] = []
    if job.sweep is not None:
        if job.mask is not None:
            raise UsageError("--mask is for frames, and a sweep has none", cure="Leave it out")
        sweeps = read_sweeps(job.sweep, job.table)
        if rig is None and sweeps.uv_px is not None and not sweeps.xyz_m.any():
            raise UsageError(f"{job.sweep} has pixels only", cure="Give the rig that saw them (--rig)")
    else:
        if rig is None or job.target is None or job.left is None or job.joints is None:
            raise UsageError(
                "nothing to identify from", cure="Give --sweep; or --rig, --target, --left, --right and --joints"
            )
        sweeps, notes = seen_in_frames(job, rig, progress or Silent())
        sweeps, uneven = even_ones(sweeps)
        notes += uneven
        write_sweeps(job.out.with_suffix(".sweep.csv"), sweeps)
    return identified(job, sweeps, rig, world, nominal, notes=notes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """An identified arm, in the world's axes where a world is known; nominal: what it is held against.

    left_out: the joints (from 1) behind the swept ones, of n.
    """

    result: Identification
    arm: Arm
    nominal: Arm | None
    left_out: range
    n: int


def solve_sweeps(job: IdentifyJob, sweeps: Sweeps, rig: Rig | None, world: World | None, nominal: Arm | None) -> Solved:
    """Identify the arm that made these sweeps, as the job says, and read or write nothing. Raises DataRefused."""
    m, n = sweeps.n, sweeps.n + len(job.held)
    left_out = range(m + 1, n + 1)
    if nominal is not None and left_out and nominal.n == n:
        nominal = first_joints(nominal, m, np.array(job.held))
    if nominal is not None and len(nominal.joints) != sweeps.n:
        raise Inconsistent(
            f"the nominal arm has {len(nominal.joints)} joints, the sweep {sweeps.n}",
            consequence="They cannot be compared",
            cure="Give the arm that was swept, or none",
        )
    result = identify(
        sweeps,
        rig=rig if sweeps.uv_px is not None else None,
        sigma=job.sigma,
        method=job.method,
        increments=job.increments,
        base=None if world is None else world.T_parent_rig.inv().as_matrix(),
        name=f"{job.out.stem}, {named(range(1, m + 1))} of {n}" if left_out else job.out.stem,
    )
    _check_paper(result)
    arm = result.arm
    if world is not None:  # found in the rig's axes
        arm = placed_by(world.T_parent_rig, arm, on_base=world.parent == "base")
    return Solved(result=result, arm=arm, nominal=nominal, left_out=left_out, n=n)


def identified(
    job: IdentifyJob,
    sweeps: Sweeps,
    rig: Rig | None,
    world: World | None,
    nominal: Arm | None,
    *,
    notes: Sequence[str] = (),
    plan: PlanOutput | None = None,
) -> IdentifyOutput:
    """Identify the arm that made these sweeps, write arm.yaml and its report; return the figures. notes go first.

    rig, world, nominal: what the job's files hold. plan: of the sweeps, for the figures.
    """
    solved = solve_sweeps(job, sweeps, rig, world, nominal)
    notes = [*([consequence(solved.n, solved.left_out)] if solved.left_out else []), *notes]
    inputs = [path for path in (job.sweep, job.joints, job.rig, job.target, job.world) if path is not None]
    write_arm(job.out, solved.arm, inputs=inputs)
    files = [("file", path.name) for path in inputs]
    write_text(report_path(job.out), identify_report(solved.result, sweeps, rig, nominal=solved.nominal, inputs=files))
    done = identify_output(solved.result, notes=notes, plan=plan)
    held = [LeftOutJoint(joint=joint, held_at=at) for joint, at in zip(solved.left_out, job.held, strict=True)]
    return replace(done, left_out=held or None)


def _check_paper(result: Identification) -> None:
    """Raise Inconsistent where the paper's means miss the readings that they were made from by far."""
    if result.method != "paper" or not result.useless:
        return
    raise Inconsistent(
        f"the paper's method gives an arm that misses its own readings by {result.misfit:.0f} standard deviations of "
        f"their noise, {result.worst_m * 1e3:.3g} mm RMS on the worst joint",
        consequence="The arm is useless and is not written",
        cure="Use --method ml: the same readings, fitted at once",
    )


def seen_in_frames(job: IdentifyJob, rig: Rig, progress: Progress) -> tuple[Sweeps, list[str]]:
    """Return the sweep that frames show, and notes on those in which the beacon is not seen."""
    if job.target is None or job.left is None or job.joints is None:
        raise UsageError("frames need --target, --left and --joints")
    target = target_of(job.target)
    frames, joint, q = read_sweep_joints(job.joints, job.table)
    setup = Setup(rig=rig, target=target, settings=beacon_settings(target, job.mask))
    wanted = set(frames.tolist())
    spots: list[tuple[int, Spots, Spots]] = []
    with open_pairs(job.left, job.right, colour=target.colour is not None) as pairs:
        for count, (left, right) in enumerate(pairs):
            # by time a frame without partner leaves no pair, and the next one keeps its number
            number = left.sequence if is_video(job.left) else count
            if progress.cancelled():
                raise Cancelled("the frames were not read to the end", consequence="Nothing was written")
            progress.update(count + 1, max(wanted) + 1, "looking for the beacon")
            if number in wanted:
                check_sizes(setup.rig, left, right)
                at_left, at_right = (find_spots(frame.image, setup.settings) for frame in (left, right))
                spots.append((number, at_left, at_right))
    name, seen, notes = beacons(setup, spots)
    rows = [i for i, frame in enumerate(frames.tolist()) if frame in seen]
    if not rows:
        raise NotEnoughData(
            f"the beacon is seen in none of the {len(frames)} frames; {notes[0] if notes else 'there are none'}",
            consequence="The arm is not identified",
            cure="Look at the frames: one light, on, in both views",
        )
    return Sweeps(
        joint=joint[rows],
        q=q[rows],
        xyz_m=np.array([seen[int(frames[i])].xyz_m for i in rows]),
        uv_px=np.array([seen[int(frames[i])].uv_px for i in rows]),
        std_px=np.array([seen[int(frames[i])].std_px for i in rows]),
    ), [*beacon_note(name, len(target.names)), *notes]


def beacons(setup: Setup, spots: list[tuple[int, Spots, Spots]]) -> tuple[str, dict[int, SeenBeacon], list[str]]:
    """Return which light is the beacon, the beacon by frame, and why it is not seen in the others.

    The beacon moves with the arm: what stands at one place in most frames is something else. Of several lights it is
    the one that is seen most often, in all frames the same.
    """
    names = setup.target.names
    by_light: dict[str, dict[int, SeenBeacon]] = {name: {} for name in names}
    whys: dict[int, str] = {}
    lefts = without_standing([left for _, left, _ in spots])
    rights = without_standing([right for _, _, right in spots])
    for (number, _, _), left, right in zip(spots, lefts, rights, strict=True):
        found = measure_spots(setup, float(number), left, right)
        whys[number] = found.pose.why or "the beacon is not seen"
        for name in names:
            if (beacon := beacon_of(found, name, len(names))) is not None:
                by_light[name][number] = beacon
    chosen = max(names, key=lambda name: len(by_light[name]))
    notes = [f"frame {number}: {why}" for number, why in whys.items() if number not in by_light[chosen]]
    return chosen, by_light[chosen], notes


def identify_output(
    result: Identification, *, notes: Sequence[str] = (), plan: PlanOutput | None = None
) -> IdentifyOutput:
    """Return an identification as --json gives it. notes go first; plan: of the sweeps, where armsight made them."""
    return IdentifyOutput(
        joints=[
            _joint(number, joint, found)
            for number, (joint, found) in enumerate(zip(result.arm.joints, result.joints, strict=True), 1)
        ],
        method=result.method,
        notes=[*notes, *result.notes],
        noise=result.sigma,
        misfit=result.misfit,
        plan=plan,
        verdict_=result.verdict_,
    )


def _joint(number: int, joint: Joint, found: JointFound) -> IdentifiedJoint:
    return IdentifiedJoint(
        index=number,
        type=str(joint.type),
        a_m=joint.a_m,
        alpha_rad=joint.alpha_rad,
        d_m=joint.d_m,
        theta_rad=joint.theta_rad,
        beta_rad=joint.beta_rad,
        lower=found.travel[0],
        upper=found.travel[1],
        sign=joint.sign,
        std=joint_std(found.std),
        n=len(found.rows) + len(found.discarded),
        discarded=[RejectedRow(row=row + 1, why=why) for row, why in found.discarded],
        residual_rms_m=found.residual_rms_m,
        residual_rms_px=found.residual_rms_px,
        p_line=found.p_line,
        decided=found.decided,
        radius_m=found.radius_m,
        axis=JointAxis(point_m=found.axis.point_m.tolist(), direction=found.axis.direction.tolist()),
    )


def joint_std(std: Mapping[str, float]) -> JointStd:
    """Return the standard deviations of a joint's entries; one that means nothing is None."""
    return JointStd(**{key: value if math.isfinite(value) else None for key, value in std.items()})
