"""A request for a motion that calibrates a cell: what is known is read and checked, the motion planned and written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight._files import real_path
from armsight.arrays import Array
from armsight.calibrate.cell.knowledge import Knowledge, TargetShape, with_priors
from armsight.calibrate.cell.model import CellModel, start_vector
from armsight.control.guard import Limits, joint_bounds
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.file_names import ARM, RIG, TARGET, WORLD
from armsight.kinematics import Arm, fk
from armsight.ops.arm_files import arm_file, load_arm
from armsight.ops.calibration.cell import read_priors
from armsight.ops.kinematics_results import reading_values
from armsight.ops.measurement.run import target_of
from armsight.optics import SIDES, LensKind, Rig, RigKind
from armsight.records import Motion, Progress, Silent, Target
from armsight.records.output import Output, output
from armsight.store import read_rig, read_world
from armsight.store.limits_file import read_limits
from armsight.store.tracks import write_joints
from armsight.units import MM
from armsight_lab.cell_plan.cautious import cautious_motion
from armsight_lab.cell_plan.information import blank_recording
from armsight_lab.cell_plan.path import MotionBounds
from armsight_lab.cell_plan.plan import CellPlan, PlanSettings, check_bounds, check_start, plan_motion
from armsight_lab.cell_plan.request import CellPlanJob
from armsight_lab.cell_plan.scene import Free, Scene
from armsight_lab.design.plan import mounted
from armsight_lab.design.request import Box
from armsight_lab.links import Links, Wall

EDGE_PX = 10.0
"""What lights keep from the images' edges, beside what the cameras may stand elsewhere."""
JOINT_MARGIN = 0.01
"""Share of a joint's range that is kept from each of its ends."""
DEVIATIONS = tuple(f"{who}_{when}_m" for when in ("before", "after", "least") for who in ("measured", "commanded"))
"""Of the tip in an output: by the cameras and by the arm, before, after, and what no motion would take off."""


@output
class CellPlanKind(Output):
    """What a kind of parameter does to the tip, all others exact."""

    name: Annotated[str, Doc("lenses, places of the cameras, arm or lights.")]
    before_m: Annotated[float, Doc("RMS deviation of the tip before the motion, m.")]
    after_m: Annotated[float, Doc("The same after it, m.")]


@output
class CellPlanOutput(Output):
    """armsight calibrate cell-plan."""

    file: Annotated[str, Doc("The motion: joints.csv.")]
    kind: Annotated[str, Doc("planned: for the tip over the volume; cautious: small moves about the start.")]
    duration_s: Annotated[float, Doc("How long it takes, s.")]
    n_rows: Annotated[int, Doc("Rows of the motion.")]
    n_places: Annotated[int, Doc("Places it goes through; 0 of a cautious one.")]
    moved: Annotated[list[float], Doc("Range of each joint, rad or m.")]
    seen: Annotated[float | None, Doc("Share of the time in which both cameras see all lights; null: not known.")]
    measured_before_m: Annotated[
        float | None, Doc("RMS deviation of the tip over the volume as the cameras measure it, before, m.")
    ]
    measured_after_m: Annotated[float | None, Doc("The same after a calibration from this motion, m.")]
    commanded_before_m: Annotated[float | None, Doc("RMS deviation of the tip as the arm says it, before, m.")]
    commanded_after_m: Annotated[float | None, Doc("The same after, m.")]
    measured_least_m: Annotated[float | None, Doc("What no motion of this kind would take off it, m.")]
    commanded_least_m: Annotated[float | None, Doc("The same of the tip as the arm says it, m.")]
    kinds: Annotated[list[CellPlanKind], Doc("What each kind of parameter does to the tip.")]
    untold: Annotated[list[str], Doc("Parameters that the motion does not tell.")]
    notes: Annotated[list[str], Doc("What stays open, and what would help.")]


def run_cell_plan(job: CellPlanJob, progress: Progress | None = None) -> CellPlanOutput:
    """Plan a motion and write it to job.out. Raises UsageError, DataRefused with what keeps it from being planned."""
    job = _following(job)
    _check_files(job)
    arm = load_arm(job.model)
    limits = (Limits() if job.limits is None else read_limits(job.limits)).slowed(job.speed)
    start = np.asarray(reading_values(arm, job.start), dtype=np.float64)
    bounds = _near(job, arm, motion_bounds(arm, limits), start)
    settings = PlanSettings(
        duration_s=job.duration_s,
        rate_hz=job.rate_hz,
        frames_hz=job.frames_hz,
        spot_px=job.spot_noise_px,
        seed=job.seed,
    )
    given = {"--rig": job.rig, "--world": job.world, "--target": job.target, "--volume": job.volume}
    missing = [name for name, value in given.items() if value is None]
    check_start(arm, bounds, free_of(arm, limits, np.empty((0, 3)), job.clearance_m), start)
    links = links_of(arm, limits, job.clearance_m, job.link_radius_m)
    _require_clear(links, start)
    if len(missing) == len(given):
        return _cautious(job, arm, bounds, limits, start, settings, links)
    if missing or job.target is None:
        raise UsageError(
            f"{', '.join(missing)} are missing" if len(missing) > 1 else f"{missing[0]} is missing",
            consequence="What the cameras would see cannot be told, and no motion is planned",
            cure="Give --rig, --world, --target and --volume; or none of them, for small moves about --start",
        )
    target = _lights(job.target)
    T_flange_target = arm.T_flange_tool if job.mount is None else mounted(job.mount)
    scene = scene_of(job, arm, bounds, limits, target, T_flange_target, links)
    scene = replace(scene, normal=_normal(scene, start))
    learned = None if job.after is None else _learned(job.after, scene, target)
    plan = plan_motion(
        scene, target, T_flange_target, settings, start=start, learned=learned, progress=progress or Silent()
    )
    write_joints(job.out, plan.motion)
    return _planned(job, plan)


def _following(job: CellPlanJob) -> CellPlanJob:
    """Return the request with the files of a first calibration in place of those that were not given."""
    if job.after is None:
        return job
    arm = job.after / ARM
    if not arm.is_file():
        raise UsageError(
            f"{job.after} holds no {ARM}",
            consequence="What a first recording told is not known",
            cure="Give the folder that `armsight calibrate cell -o` wrote",
        )
    return replace(
        job,
        model=str(arm),
        rig=job.rig or job.after / RIG,
        world=job.world or job.after / WORLD,
        target=job.target or job.after / TARGET,
    )


def _learned(after: Path, scene: Scene, target: Target) -> Array:
    """Return the information (P, P) of a first recording about lenses and places; arm and target bring their own."""
    priors = read_priors([after / RIG, after / WORLD], scene.model.recording.sizes)
    nothing = np.zeros((len(scene.x), len(scene.x)))
    none = Knowledge(x=scene.x, information=nothing, shape=TargetShape.of(target))
    return nothing if priors is None else with_priors(scene.model, none, priors, scene.x).information


def motion_bounds(arm: Arm, limits: Limits) -> MotionBounds:
    """Return what a motion keeps of a guard's limits, a little from the joints' ends."""
    bounds = joint_bounds(arm, limits)
    with np.errstate(invalid="ignore"):
        kept = np.nan_to_num(JOINT_MARGIN * (bounds.upper - bounds.lower), posinf=0.0)
    return MotionBounds(
        lower=bounds.lower + kept,
        upper=bounds.upper - kept,
        speed=bounds.speed,
        acceleration=bounds.acceleration,
        speed_m_s=limits.speed_m_s,
        turn_rad_s=limits.turn_rad_s,
        acceleration_m_s2=limits.acceleration_m_s2,
        turn_acceleration_rad_s2=limits.turn_acceleration_rad_s2,
    )


def _near(job: CellPlanJob, arm: Arm, bounds: MotionBounds, start: Array) -> MotionBounds:
    """Return the bounds about the start. Raises Inconsistent where some are not known, or are not those of it."""
    check_bounds(arm, bounds)
    if start.shape != (arm.n,):
        return bounds  # refused with all else that the start may not be
    swing = np.where(arm.revolute, job.swing_rad, np.inf)
    inside = (start >= bounds.lower) & (start <= bounds.upper)
    return replace(
        bounds,
        lower=np.where(inside, np.maximum(bounds.lower, start - swing), bounds.lower),
        upper=np.where(inside, np.minimum(bounds.upper, start + swing), bounds.upper),
    )


def free_of(arm: Arm, limits: Limits, lights: Array, clearance_m: float, links: Links | None = None) -> Free:
    """Return where (m, n) flange, tool and lights (k, 3), in flange axes, are in the workspace and in no forbidden box.

    They keep clearance_m and the guard's margin from both. links: clear as well, where given.
    """
    base, keep = arm.based(), limits.margin_m + clearance_m
    own = np.vstack([np.zeros(3), arm.T_flange_tool.translation, lights])
    points = arm.T_flange_tool.inv().apply(own)  # in tool axes, which fk tells

    def free(q: Array) -> NDArray[np.bool_]:
        T = fk(base, base.values(q))
        xyz = np.einsum("mij,kj->mki", T[:, :3, :3], points) + T[:, None, :3, 3]
        out = np.ones(len(q), bool)
        if limits.workspace is not None:
            box = limits.workspace
            out &= ((xyz >= box.lower_m + keep) & (xyz <= box.upper_m - keep)).all(axis=(1, 2))
        for box in limits.forbidden:
            out &= ~((xyz > box.lower_m - keep) & (xyz < box.upper_m + keep)).all(axis=2).any(axis=1)
        if links is not None:
            out[out] = links(q[out])
        return out

    return free


def links_of(arm: Arm, limits: Limits, clearance_m: float, radius_m: float) -> Links | None:
    """Return what an arm's links keep clear of; None for a radius of 0, which looks at none."""
    if radius_m == 0.0:
        return None
    rooms = [] if limits.workspace is None else [limits.workspace]
    walls = [Wall(name=box.name, lower=box.lower_m, upper=box.upper_m, room=True) for box in rooms]
    walls += [Wall(name=box.name, lower=box.lower_m, upper=box.upper_m) for box in limits.forbidden]
    return Links(arm=arm, radius_m=radius_m, keep_m=limits.margin_m + clearance_m, walls=walls)


def _require_clear(links: Links | None, start: Array) -> None:
    """Raise Inconsistent where a link is too near to something at the start (n,), with its name."""
    struck = "" if links is None else links.struck(start)
    if links is not None and struck:
        raise Inconsistent(
            f"where the arm stands there is {struck}, nearer than {(links.radius_m + links.keep_m) / MM:.0f} mm",
            consequence="No motion begins there",
            cure="Begin elsewhere (--start), correct the boxes (--limits), or say how thick the links are "
            "(--link-radius-mm)",
        )


def scene_of(
    job: CellPlanJob,
    arm: Arm,
    bounds: MotionBounds,
    limits: Limits,
    target: Target,
    T_flange_target: RigidTransform,
    links: Links | None = None,
) -> Scene:
    """Return the scene of a request; the lights' z axis as it is, away from the cameras. Raises DataRefused."""
    if job.rig is None or job.world is None or job.volume is None:
        raise UsageError("rig, world and volume are needed", consequence="No motion is planned")
    rig, world = read_rig(job.rig), read_world(job.world)
    _check_rig(job, rig)
    volume = _extent(job.volume)
    T_base_rig = world.T_parent_rig if world.parent == "base" else arm.T_world_base.inv() * world.T_parent_rig
    cameras, margins = [], []
    lights = np.asarray(T_flange_target.apply(target.xyz_m))
    for side in SIDES:
        camera, T = rig.camera(side), T_base_rig * rig.T_rig_camera(side)
        clock = [0.0, 0.0, 0.5 / job.frames_hz]
        cameras.append(np.concatenate([camera.intrinsics, T.translation, T.rotation.as_rotvec(), clock]))
        far = max(float(np.linalg.norm(volume.mean(axis=1) - T.translation)), 0.1)
        margins.append(EDGE_PX + float(camera.intrinsics[0]) * float(np.hypot(job.rough_rad, job.rough_m / far)))
    recording = blank_recording(
        arm, ((rig.left.width, rig.left.height), (rig.right.width, rig.right.height)), job.frames_hz
    )
    model = CellModel(recording=recording, lights=target.names)
    return Scene(
        model=model,
        x=start_vector(model, cameras, lights),
        bounds=bounds,
        free=free_of(arm, limits, lights, job.clearance_m, links),
        tip_m=np.array(arm.T_flange_tool.translation),
        volume=volume,
        normal=-np.asarray(T_flange_target.rotation.as_matrix()[:, 2]),
        facing_rad=job.facing_rad,
        margin_px=(margins[0], margins[1]),
    )


def _extent(given: Box) -> Array:
    """Return the volume (3, 2). Raises UsageError where it is none."""
    volume = np.array(given, dtype=np.float64)
    if not (np.isfinite(volume).all() and (volume[:, 0] < volume[:, 1]).all()):
        raise UsageError(
            "the volume has no extent along each axis",
            consequence="It is not known where the tip is to be",
            cure="Write for instance --volume=0.3:0.6,-0.2:0.2,0.1:0.4, in m",
        )
    return volume


def _normal(scene: Scene, start: Array) -> Array:
    """Return the way the lights shine, in flange axes: against the target's z, as boards are; or along it, where the
    arm stands so that the cameras see them from there."""
    if start.shape != (scene.arm.n,):
        return scene.normal
    T = scene.model.flange(scene.x, start[None])[0]
    middle = T[:3, :3] @ scene.model.lights_m(scene.x).mean(axis=0) + T[:3, 3]
    ways = [np.asarray(scene.model.T_base_camera(scene.x, side).translation) - middle for side in (0, 1)]
    towards = [float(way @ T[:3, :3] @ scene.normal) for way in ways]
    return -scene.normal if max(towards) < 0.0 else scene.normal


def _cautious(
    job: CellPlanJob,
    arm: Arm,
    bounds: MotionBounds,
    limits: Limits,
    start: Array,
    settings: PlanSettings,
    links: Links | None,
) -> CellPlanOutput:
    free = free_of(arm, limits, np.empty((0, 3)), job.clearance_m, links)
    motion = cautious_motion(arm, bounds, free, start, settings)
    write_joints(job.out, motion)
    unknown = dict.fromkeys(("seen", *DEVIATIONS))
    note = (
        "small moves about where the arm stands: they tell where the cameras are, and little of lenses and arm; "
        "calibrate from them, then plan again with --rig, --world and --target as they were found"
    )
    moved = np.ptp(motion.q, axis=0).tolist()
    told = {"n_places": 0, "moved": moved, "kinds": [], "untold": [], "notes": [note], **unknown}
    return _output(job, "cautious", motion, told)


def _planned(job: CellPlanJob, plan: CellPlan) -> CellPlanOutput:
    told = {
        "n_places": len(plan.places),
        "moved": plan.moved.tolist(),
        "seen": plan.seen,
        **dict(zip(DEVIATIONS, (*plan.before_m, *plan.after_m, *plan.least_m), strict=True)),
        "kinds": [CellPlanKind(name=name, before_m=a, after_m=b) for name, (a, b) in plan.kinds.items()],
        "untold": list(plan.untold),
        "notes": list(plan.notes),
    }
    return _output(job, "planned", plan.motion, told)


def _output(job: CellPlanJob, kind: str, motion: Motion, told: dict[str, Any]) -> CellPlanOutput:
    return CellPlanOutput(
        file=str(job.out), kind=kind, duration_s=float(motion.t_s[-1]), n_rows=len(motion.t_s), **told
    )


def _lights(path: Path) -> Target:
    target = target_of(path)
    if target.is_board or not target.model_known:
        raise Inconsistent(
            f"{path} holds no lights whose places are known",
            consequence="A cell is calibrated by lights on the flange; no motion is planned",
            cure="Give a target.yaml with spots_m: as drawn is enough",
        )
    return target


def _check_rig(job: CellPlanJob, rig: Rig) -> None:
    if rig.kind is not RigKind.STEREO or any(rig.camera(side).lens is not LensKind.PINHOLE for side in SIDES):
        raise Inconsistent(
            f"{job.rig} is no rig of two cameras with plain lenses",
            consequence="A cell's calibration does not know it; no motion is planned",
            cure="Give the rig.yaml of two cameras, kind: stereo, no fisheye",
        )


def _check_files(job: CellPlanJob) -> None:
    """Raise UsageError where the result is no .csv, or one of the files to read."""
    if job.out.suffix.lower() != ".csv":
        raise UsageError(
            f"{job.out.name} does not end in .csv",
            consequence="No command would take it for a motion; nothing is planned",
            cure="Give -o motion.csv",
        )
    given = (arm_file(job.model), job.rig, job.world, job.target, job.limits)
    if real_path(job.out) in {real_path(path) for path in given if path is not None}:
        raise UsageError(f"{job.out} is to be read, and would be written over", cure="Give another name with -o")
