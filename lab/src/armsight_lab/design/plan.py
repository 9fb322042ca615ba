"""A request read and checked: the planned rig, target, volume, calibration and arm."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Inconsistent, UsageError
from armsight.geometry import pose_from_euler
from armsight.kinematics import Arm
from armsight.measure.planning import with_baseline
from armsight.ops.arm_files import load_arm
from armsight.ops.measurement.run import target_of
from armsight.optics import Camera, Rig, RigKind
from armsight.records import Target
from armsight.store import parse_board, read_rig, read_world
from armsight.units import DEG, MM
from armsight_lab.design.planned_calibrations import RobotNoise
from armsight_lab.design.request import Box, DesignJob

SPOT_PX = 0.1
"""Standard deviation of a light's centre or a corner's place where nobody says: what webcams reach (MATH 2.3)."""
FAR_M = 30.0
"""No cell is so wide: such numbers are millimetres."""
NARROWEST, WIDEST = 10.0, 0.2
"""Focal length over image width of lenses from 6 to 137 degrees wide; beyond, a unit is wrong."""
SAME_SHAPE = 0.02
"""Image sizes of one shape differ by rounding, to 8 or 16 px."""
LEAST_POSES = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """How the rig will be calibrated."""

    board: Target
    views: int
    corner_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmPlan:
    """An arm that carries the target before the rig, and from how many poses the rig's place is found."""

    arm: Arm
    T_base_rig: RigidTransform
    T_flange_target: RigidTransform
    poses: int
    noise: RobotNoise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """All that the deviations follow from.

    rig: without covariance where a calibration is planned. T_frame_rig: frame of the volume. spot_px: None where it
    follows from the cameras' noise.
    """

    rig: Rig
    target: Target
    volume: Box
    frame: str
    T_frame_rig: RigidTransform
    calibration: Calibration | None
    arm: ArmPlan | None = None
    spot_px: float | None = SPOT_PX
    least_px: float = 2.0
    tilt_rad: float = 0.0
    relative: bool = False
    average: int = 1
    cells: int = 9
    link_radius_m: float = 0.0
    assumptions: tuple[str, ...] = field(default=())


def plan_of(job: DesignJob) -> Plan:
    """Return the plan of a request. Raises UsageError, DataRefused for what cannot be."""
    target = target_of(job.target)
    if not target.model_known:
        raise Inconsistent(
            f"{job.target}: the places of the target's lights are not known",
            consequence="What is measured of it cannot be foretold",
            cure="Give spots_m in target.yaml: as drawn is enough for a plan",
        )
    rig = _rig(job)
    world = None if job.world is None else read_world(job.world)
    T_frame_rig = RigidTransform.identity() if world is None else world.T_parent_rig
    calibration = None
    if job.board is not None:
        calibration = Calibration(board=parse_board(job.board), views=job.views, corner_px=job.corner_noise_px)
        rig = replace(rig, covariance=None)
    elif rig.covariance is None:
        raise UsageError(
            "it is not said how the rig will be calibrated, and its file does not tell how well it was",
            consequence="Deviations without the calibration's share would look far too good",
            cure="Give --board checkerboard:9x6:0.025 and --views 20",
        )
    known = job.spot_noise_px is None and not target.is_board and all(rig.noise)
    plan = Plan(
        rig=rig,
        target=target,
        volume=_checked(job.volume),
        frame="rig" if world is None else world.parent,
        T_frame_rig=T_frame_rig,
        calibration=calibration,
        arm=_arm(job, "" if world is None else world.parent, T_frame_rig),
        spot_px=None if known else job.spot_noise_px or SPOT_PX,
        least_px=job.least_spot_px,
        tilt_rad=job.tilt_rad,
        relative=job.relative,
        average=job.average,
        cells=job.cells,
        link_radius_m=_link_radius(job),
    )
    return replace(plan, assumptions=_assumptions(job, plan))


def _checked(volume: Box) -> Box:
    """Return a volume that can be. Raises UsageError, Inconsistent."""
    for name, (low, high) in zip("xyz", volume, strict=True):
        if not np.isfinite([low, high]).all():
            raise UsageError(
                f"the volume runs from {low:g} to {high:g} m along {name}",
                consequence="It is not known where the target will be",
                cure="Give finite numbers",
            )
        if low > high:
            raise UsageError(
                f"the volume is reversed along {name}: from {low:g} to {high:g} m",
                consequence="There is nothing within",
                cure=f"Write {high:g}:{low:g}",
            )
        if low == high:
            raise UsageError(
                f"the volume is empty: it has no extent along {name}",
                consequence="There is nothing within",
                cure=f"Write for instance {low - 0.05:g}:{high + 0.05:g}",
            )
    widest = max(max(abs(low), abs(high)) for low, high in volume)
    if widest > FAR_M:
        raise Inconsistent(
            f"the volume reaches {widest:g} m far: these look like millimetres given as metres",
            consequence="Every deviation would be wrong by far",
            cure="Write metres, or the unit: 600mm",
        )
    smallest = max(high - low for low, high in volume)
    if smallest < MM:
        raise Inconsistent(
            f"the volume is {1e6 * smallest:.3g} micrometres wide", cure="Write metres, or the unit: 600mm"
        )
    return volume


def _rig(job: DesignJob) -> Rig:
    """Return the rig of the file with what is changed of it, or the planned one."""
    focal_px = _focal_px(job)
    if job.rig is None:
        return _planned(job, focal_px)
    rig = read_rig(job.rig, any_cameras=True)
    _require_known(rig, job, focal_px)
    if job.toe_in_rad is not None:
        raise UsageError("--toe-in-deg is of planned cameras, and --rig says how they stand", cure="Leave one away")
    changed = focal_px is not None or job.size is not None or job.baseline_m is not None
    if changed and job.board is None:
        raise UsageError(
            "another baseline, lens or image size than the rig's needs a calibration anew",
            consequence="That of the file does not hold for it",
            cure="Give --board and --views",
        )
    for one in rig.cameras:
        _require_shape(one.camera, focal_px, job.size)
    cameras = [_other(one.camera, focal_px, job.size) for one in rig.cameras]
    rig = rig.with_each(camera=cameras)
    if rig.kind is RigKind.MIRROR and all(camera.plate is None for camera in cameras):
        raise Inconsistent(
            f"{job.rig}: a mirror rig without a glass plate",
            consequence="Its left view goes through the half-silvered mirror 1, which shifts it",
            cure="Give `plate: {thickness_m: 0.001, index: 1.5}` of the left camera",
        )
    if job.baseline_m is not None:
        _require_metres(job.baseline_m)
        rig = at_baseline(rig, job.baseline_m / rig.baseline_m)
    for camera in cameras:
        _require_lens(camera)
    return rig


def _require_known(rig: Rig, job: DesignJob, focal_px: float | None) -> None:
    """Raise UsageError where other cameras than a pair are to be calibrated, or changed, only in the plan."""
    planned = any(one is not None for one in (job.board, job.baseline_m, job.size, job.toe_in_rad, focal_px))
    if planned and not rig.is_pair:
        raise UsageError(
            f"{job.rig} is of the cameras {', '.join(rig.names)}, and calibrations are planned of pairs alone",
            consequence="How well these cameras would be known cannot be foretold",
            cure="Calibrate them (armsight calibrate cameras) and give that rig.yaml, without --board and what changes "
            "the cameras",
        )


def at_baseline(rig: Rig, factor: float) -> Rig:
    """Return a rig with its baseline times a factor: the right camera moves, of a mirror rig both outer mirrors do."""
    if rig.kind is not RigKind.MIRROR:
        return with_baseline(rig, factor)
    # the virtual centres stand at (-+b/2, 0, -b/2) of the real camera (MATH 3.1)
    more = 0.5 * (factor - 1.0) * rig.baseline_m
    moved = [
        RigidTransform.from_components(np.asarray(T.translation) + np.array([sign * more, 0.0, -more]), T.rotation)
        for sign, T in ((-1.0, rig.T_rig_left), (1.0, rig.T_rig_right))
    ]
    return rig.with_each(T_rig_camera=moved)


def _planned(job: DesignJob, focal_px: float | None) -> Rig:
    missing = [
        flag
        for flag, value in (
            ("--size", job.size),
            ("--focal-mm and --pixel-um", focal_px),
            ("--baseline", job.baseline_m),
        )
        if value is None
    ]
    if missing or job.size is None or focal_px is None or job.baseline_m is None:
        raise UsageError(
            f"cameras without --rig need {', '.join(missing)} as well",
            consequence="It is not known what they see",
            cure="Give --rig rig.yaml, or --size 1280x720 --focal-mm 4 --pixel-um 3 --baseline 0.2",
        )
    _require_metres(job.baseline_m)
    width, height = job.size
    middle = (0.5 * (width - 1.0), 0.5 * (height - 1.0))
    camera = Camera(width=width, height=height, intrinsics=np.array([focal_px, focal_px, *middle, *np.zeros(6)]))
    _require_lens(camera)
    toe_in = job.toe_in_rad or 0.0
    R = [Rotation.from_rotvec([0.0, sign * toe_in, 0.0]) for sign in (1.0, -1.0)]
    # in the left camera's axes, which are the rig's
    T_middle = [
        RigidTransform.from_components([sign * 0.5 * job.baseline_m, 0.0, 0.0], turn)
        for sign, turn in zip((-1.0, 1.0), R, strict=True)
    ]
    return Rig(
        kind=RigKind.STEREO,
        left=camera,
        right=camera,
        T_rig_left=RigidTransform.identity(),
        T_rig_right=T_middle[0].inv() * T_middle[1],
    )


def _focal_px(job: DesignJob) -> float | None:
    if (job.focal_m is None) != (job.pixel_m is None):
        raise UsageError(
            "--focal-mm and --pixel-um go together",
            consequence="The one without the other gives no focal length in px",
            cure="Give both, or --focal-px",
        )
    if job.focal_m is None or job.pixel_m is None:
        return job.focal_px
    if job.focal_px is not None:
        raise UsageError("--focal-px and --focal-mm say the same twice", cure="Leave one away")
    return job.focal_m / job.pixel_m


def _require_shape(camera: Camera, focal_px: float | None, size: tuple[int, int] | None) -> None:
    """Raise UsageError where another image size alone would make pixels that are not square."""
    if size is None or focal_px is not None:
        return
    wider, higher = size[0] / camera.width, size[1] / camera.height
    if abs(wider / higher - 1.0) > SAME_SHAPE:
        raise UsageError(
            f"an image of {size[0]}x{size[1]} px has another shape than {camera.width}x{camera.height}",
            consequence="Whether it shows more or less than the rig's, and so its focal length in px, is not known",
            cure="Give --focal-px with --size (or --focal-mm and --pixel-um)",
        )


def _other(camera: Camera, focal_px: float | None, size: tuple[int, int] | None) -> Camera:
    """Return a camera with another focal length, or another image size of the same sensor."""
    k = camera.intrinsics.copy()
    if focal_px is not None:
        k[:2] *= focal_px / k[0]
    if size is None:
        return replace(camera, intrinsics=k)
    share = np.array(size) / [camera.width, camera.height]
    k[2:4] = (k[2:4] + 0.5) * share - 0.5
    if focal_px is None:
        k[:2] *= share
    return replace(camera, width=size[0], height=size[1], intrinsics=k)


def _require_metres(baseline_m: float) -> None:
    if baseline_m > 0.5 * FAR_M:
        raise Inconsistent(
            f"a baseline of {baseline_m:g} m looks like millimetres given as metres",
            consequence="Every deviation would be wrong by far",
            cure="Write metres, or the unit: 120mm",
        )


def _require_lens(camera: Camera) -> None:
    share = camera.intrinsics[0] / camera.width
    if not WIDEST <= share <= NARROWEST:
        raise Inconsistent(
            f"a focal length of {camera.intrinsics[0]:.4g} px before an image {camera.width} px wide is no lens of a "
            "camera: a unit is wrong",
            consequence="Every deviation would be wrong by far",
            cure="--focal-mm is in millimetres and --pixel-um in micrometres: a webcam has 3 to 5 and 1.4 to 4",
        )


def _arm(job: DesignJob, parent: str, T_frame_rig: RigidTransform) -> ArmPlan | None:
    if job.arm is None:
        if job.mount is not None:
            raise UsageError("--mount is of the target on an arm, and none is given", cure="Give --arm with it")
        return None
    if job.poses < LEAST_POSES:
        raise UsageError(
            f"{job.poses} poses of the arm are planned, {LEAST_POSES} are the fewest that tell the rig's place",
            consequence="Nothing can be said of the tool in the arm's base",
            cure="Plan 15 to 30 poses",
        )
    if not parent:
        raise UsageError(
            "it is not said where the rig will stand before the arm",
            consequence="Which poses the arm can take before it is not known",
            cure="Give --world world.yaml with T_base_rig as planned; the volume is then in the arm's base",
        )
    arm = load_arm(job.arm)
    T_base_rig = T_frame_rig if parent == "base" else arm.T_world_base.inv() * T_frame_rig
    return ArmPlan(
        arm=arm,
        T_base_rig=T_base_rig,
        T_flange_target=arm.T_flange_tool if job.mount is None else mounted(job.mount),
        poses=job.poses,
        noise=RobotNoise(position_m=job.arm_noise_m, orientation_rad=job.arm_turn_rad),
    )


def _link_radius(job: DesignJob) -> float:
    if job.link_radius_m and job.arm is None:
        raise UsageError("--link-radius-mm is of an arm, and none is given", cure="Give --arm with it")
    return job.link_radius_m


def mounted(values: tuple[float, ...]) -> RigidTransform:
    """Return T_flange_target of m and, where there are six values, degrees about x, y, z."""
    return pose_from_euler(values[:3], [DEG * value for value in values[3:] or (0.0, 0.0, 0.0)])


def _assumptions(job: DesignJob, plan: Plan) -> tuple[str, ...]:
    """Return what was taken for granted, a line each."""
    what = "corner" if plan.target.is_board else "light"
    out = [
        f"each coordinate of a {what} is off by {plan.spot_px:g} px (standard deviation)"
        + ("" if job.spot_noise_px else ": taken, not known; --spot-noise-px says otherwise")
        if plan.spot_px is not None
        else "the lights' noise follows from that of the cameras in rig.yaml, for lights of 180 grey levels"
    ]
    turned = f", turned by {plan.tilt_rad / DEG:g} deg" if plan.tilt_rad else ""
    hidden = "nothing hides it"
    if plan.link_radius_m:
        hidden = (
            f"the arm's links, {plan.link_radius_m / MM:g} mm about the lines from joint to joint, hide it, in the "
            "posture that hides least"
        )
    out.append(f"the target faces the rig{turned}, holds still, and {hidden}")
    if not plan.target.is_board and plan.target.diameter_m is None:
        out.append(
            "the lights are large enough to be found, small enough to stay apart, and seen from every side: their size "
            "is not known; diameter_m in target.yaml tells it"
        )
    if plan.target.covariance is None:
        out.append("the target's measures are exact")
    if plan.calibration is None:
        out.append("the rig is calibrated as well as its file says, and after a change of it as well again")
    else:
        out.append(
            f"the calibration: {plan.calibration.views} pictures, corners off by {plan.calibration.corner_px:g} px, "
            "board flat and true to size"
        )
    if plan.arm is not None:
        noise = plan.arm.noise
        out.append(
            f"the arm is off by {noise.position_m / MM:g} mm and {noise.orientation_rad / DEG:g} deg in each axis "
            "while the rig's place is found"
        )
    if plan.average > 1:
        out.append(f"each pose is the mean of {plan.average} frames, whose noise is independent")
    return tuple(out)


def input_files(job: DesignJob) -> list[Path]:
    """Return the files that a plan was made of."""
    given = (job.rig, job.target, job.world, None if job.arm is None else Path(job.arm))
    return [path for path in given if path is not None and path.is_file()]
