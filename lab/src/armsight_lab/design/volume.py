"""The deviations that a plan leads to, cell by cell of its volume, and what they are made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Mask
from armsight.errors import Inconsistent
from armsight.geometry.poses import skew
from armsight.kinematics import ik
from armsight.measure.poses.setup import SLACK_PX, Setup, rig_slack_px
from armsight.optics import Rig, mean_axes
from armsight.units import DEG
from armsight_lab.design.expected_poses import Expected, SpotNoise, centre_deviation, expected_poses
from armsight_lab.design.plan import ArmPlan, Plan
from armsight_lab.design.planned_calibrations import (
    PlannedHandEye,
    PlannedViews,
    planned_handeye,
    planned_rig,
    planned_views,
    tool_slopes,
)
from armsight_lab.links import Links, apart

NOISE, RIG, TARGET, ARM = "noise of one frame", "calibration of the rig", "measures of the target", "poses of the arm"
"""What a deviation is made of."""
OUT_OF_REACH = "beyond the arm's reach"
TURNS_RAD, ROLL_RAD = 30.0 * DEG, 60.0 * DEG
"""How far the target is turned between the poses from which the rig's place in the arm's base is found."""
TRIED = 12
"""Candidates for each such pose."""
LEAST_ALIGNED = 8
"""Cells to which a volume is aligned: the six numbers of a motion hide all that is off at two, half of it at four."""
DRAWN = 2
"""Their seed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """m cells of a volume: their middles xyz_m (m, 3) in its frame, z by y by x, and the counts along x, y, z."""

    xyz_m: Array
    counts: tuple[int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """What points are told in: R (3, 3) from the rig's axes, and how the frame itself is off: slopes (6, 26) of dt, dw
    by the rig's parameters, and covariance (6, 6) of what else makes it so."""

    R: Array
    slopes: Array
    covariance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forecast:
    """What a plan leads to in each of m cells.

    rig: as it will be calibrated; views: of the board. parts: covariances (m, 6, 6) by what they are of. measured (m,):
    whether there is a position; whole (m,): and an orientation; why: where not, the reason. slopes (m, 6, p):
    d pose / d what is the same in every frame. handeye: T_rig_target of the arm's poses, and what they leave open.
    """

    plan: Plan
    rig: Rig
    views: PlannedViews | None
    cells: Cells
    expected: Expected
    measured: Mask
    whole: Mask
    why: tuple[str, ...]
    parts: dict[str, Array]
    slopes: Array
    frame: Frame
    handeye: tuple[RigidTransform, PlannedHandEye] | None = None

    @property
    def can_align(self) -> bool:
        """Tell whether enough is measured, along two axes at least, for an alignment to leave what is within it."""
        places = self.cells.xyz_m[self.measured]
        return len(places) >= LEAST_ALIGNED and np.linalg.matrix_rank(places - places.mean(axis=0), tol=1e-4) > 1

    def within_volume(self) -> Forecast:
        """Return the same once the measured volume is aligned as a whole."""
        places = np.asarray(self.expected.T_rig_target.translation)
        common = rigid_part(self.slopes, places, self.measured)
        slopes = self.slopes - moving(places) @ common
        n = len(self.rig.parameters)
        frame = Frame(R=np.eye(3), slopes=-common[:, :n], covariance=np.zeros((6, 6)))
        return replace(self, parts={NOISE: self.parts[NOISE], **self.shared(slopes)}, slopes=slopes, frame=frame)

    def point_m(self) -> Array:
        """Return the expected distance (m, n) of each light, placed by itself, from where it is; NaN: not seen."""
        alone, covariance = self.expected.points, _joint(self.rig, self.plan)
        n = len(self.rig.parameters)
        G = moving(alone.xyz_m @ self.frame.R.T)  # (m, n, 6, 6)
        slopes = self.frame.R @ alone.slopes + G[..., :3, :] @ self.frame.slopes
        noise = self.frame.R @ (alone.random / self.plan.average) @ self.frame.R.T
        shared = G[..., :3, :] @ self.frame.covariance @ G[..., :3, :].swapaxes(-1, -2)
        total = noise + slopes @ covariance[:n, :n] @ slopes.swapaxes(-1, -2) + shared
        return np.asarray(np.sqrt(np.trace(total, axis1=2, axis2=3)))

    def shared(self, slopes: Array) -> dict[str, Array]:
        """Return the parts that are the same in every frame, from d pose / d what is shared (m, 6, p)."""
        n = len(self.rig.parameters)
        carried = _joint(self.rig, self.plan)
        parts = {RIG: _carried(slopes[:, :, :n], carried[:n, :n])}
        return parts | ({TARGET: _carried(slopes[:, :, n:], carried[n:, n:])} if len(carried) > n else {})

    @property
    def covariance(self) -> Array:
        """All parts together, (m, 6, 6)."""
        return np.asarray(np.sum(list(self.parts.values()), axis=0))

    @property
    def position_m(self) -> Array:
        """Expected distance (m,) of the measured from the true position, RMS; NaN where none is measured."""
        return np.where(self.measured, size_of(self.covariance[:, :3, :3]), np.nan)

    @property
    def orientation_rad(self) -> Array:
        """Expected angle (m,) between the measured and the true orientation, RMS; NaN where none is measured."""
        return np.where(self.whole, size_of(self.covariance[:, 3:, 3:]), np.nan)


def size_of(C: Array) -> Array:
    """Return the RMS length (m,) of errors of covariances (m, 3, 3)."""
    return np.asarray(np.sqrt(np.trace(C, axis1=1, axis2=2)))


def forecast(plan: Plan) -> Forecast:
    """Return the deviations over a plan's volume. Raises DataRefused where there is nothing to say."""
    calibration, rig, views = plan.calibration, plan.rig, None
    if calibration is not None:
        views = planned_views(rig, calibration.board, calibration.views, calibration.corner_px)
        rig = planned_rig(rig, views)
    slack_px = rig_slack_px(rig) if rig.is_pair else SLACK_PX
    setup = Setup(rig=rig, target=plan.target, slack_px=slack_px, many=True)
    cells = cells_of(plan)
    expected = _expected(plan, setup, _facing(plan, rig, cells))
    measured, why = expected.placed.copy(), list(expected.why)
    if plan.arm is not None:
        beyond = ~_reached(plan.arm, expected.T_rig_target)
        why = [OUT_OF_REACH if far else text for far, text in zip(beyond, why, strict=True)]
        measured &= ~beyond
    if not measured.any():
        raise _nothing(plan, why)
    found = Forecast(
        plan=plan,
        rig=rig,
        views=views,
        cells=cells,
        expected=expected,
        measured=measured,
        whole=measured & expected.whole,
        why=tuple(why),
        parts={},
        slopes=expected.slopes,
        frame=Frame(R=np.eye(3), slopes=np.zeros((6, len(rig.parameters))), covariance=np.zeros((6, 6))),
    )
    noise = expected.random / plan.average
    if plan.arm is not None:
        return _at_tool(found, plan.arm, noise, setup)
    found = replace(found, parts={NOISE: noise, **found.shared(found.slopes)})
    if plan.relative and not found.can_align:
        raise Inconsistent(
            f"{measured.sum()} of {len(measured)} cells are measured: an alignment to so few hides deviations",
            consequence="Deviations within the volume would look far too good",
            cure="Give more --cells, or a volume of which the cameras see more",
        )
    return found.within_volume() if plan.relative else found


def _at_tool(found: Forecast, arm: ArmPlan, noise: Array, setup: Setup) -> Forecast:
    """Return the deviations of the tool in the arm's base."""
    expected = found.expected
    if not found.whole.any():
        raise Inconsistent(
            "the target has no orientation for this rig, so the rig's place before the arm cannot be found",
            consequence="Nothing can be said of the tool in the arm's base",
            cure="Use a target of three lights or more, or a board",
        )
    poses, known = _handeye(found, arm, setup)
    of_camera, of_known = tool_slopes(known, expected.T_rig_target, arm.arm.T_flange_tool)
    slopes = of_camera @ expected.slopes + of_known @ known.slopes
    parts = {
        NOISE: of_camera @ noise @ of_camera.transpose(0, 2, 1),
        **found.shared(slopes),
        ARM: of_known @ known.covariance @ of_known.transpose(0, 2, 1),
    }
    frame = Frame(
        R=known.T_base_rig.rotation.as_matrix(),
        slopes=known.slopes[:6, : len(found.rig.parameters)],
        covariance=known.covariance[:6, :6],
    )
    return replace(found, parts=parts, slopes=slopes, handeye=(poses, known), measured=found.whole, frame=frame)


def _joint(rig: Rig, plan: Plan) -> Array:
    """Return the covariance of what is shared: the rig's parameters, and the lights' places where not exact."""
    return Setup(rig=rig, target=plan.target, many=True).covariance


def _carried(slopes: Array, covariance: Array) -> Array:
    return np.asarray(slopes @ covariance @ slopes.transpose(0, 2, 1))


def cells_of(plan: Plan) -> Cells:
    """Return the cells of a plan's volume, about as long as wide, the outer ones' middles on its faces."""
    low, high = np.array(plan.volume).T
    size = high - low
    n = np.maximum(np.rint(plan.cells * size / size.max()), min(3, plan.cells)).astype(int)
    # from edge to edge: the worst is in a corner, as a rule
    axes = [np.linspace(low[a], high[a], n[a]).round(9) if n[a] > 1 else [0.5 * (low[a] + high[a])] for a in range(3)]
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    xyz = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    return Cells(xyz_m=xyz, counts=(int(n[0]), int(n[1]), int(n[2])))


def spot_noise(plan: Plan) -> SpotNoise:
    """Return the deviation of spots by their size, as the plan or the cameras' noise has it."""
    if plan.spot_px is not None:
        sigma = plan.spot_px
        return lambda size, side: np.full(size.shape, sigma)
    models = [model for model in plan.rig.noise if model is not None]  # of both, where a plan has no deviation
    return lambda size, side: centre_deviation(models[side], size)


def _facing(plan: Plan, rig: Rig, cells: Cells) -> RigidTransform:
    """Return T_rig_target of the cells' middles: z along the mean optical axis, turned about y by the tilt."""
    turn = Rotation.from_matrix(mean_axes(rig)) * Rotation.from_rotvec([0.0, plan.tilt_rad, 0.0])
    places = plan.T_frame_rig.inv().apply(cells.xyz_m)
    return RigidTransform.from_components(places, Rotation.concatenate([turn] * len(places)))


def rigid_part(slopes: Array, places: Array, measured: Mask) -> Array:
    """Return the motion (6, p) that fits slopes (m, 6, p) of the measured places best, by their positions (m, 3).

    It is what an alignment of the measured volume takes away; about the origin.
    """
    G = moving(places)
    # about the middle of the places, where shift and turn are told apart well
    off = moving(places - places[measured].mean(axis=0))
    found = np.linalg.lstsq(
        off[measured, :3].reshape(-1, 6), slopes[measured, :3].reshape(-1, slopes.shape[2]), rcond=None
    )
    out = found[0].copy()
    out[:3] -= G[measured, :3, 3:].mean(axis=0) @ out[3:]
    return np.asarray(out)


def moving(places: Array) -> Array:
    """Return how poses at places (..., 3) follow dt, dw of the frame that they are told in, (..., 6, 6)."""
    G = np.zeros((*places.shape[:-1], 6, 6))
    G[..., :3, :3] = G[..., 3:, 3:] = np.eye(3)
    G[..., :3, 3:] = -skew(places)
    return G


def _expected(plan: Plan, setup: Setup, poses: RigidTransform) -> Expected:
    """Return what is measured of the target at poses, before what the plan's arm hides."""
    hides = None
    if plan.arm is not None and plan.link_radius_m:
        hides = partial(hidden_ways, plan.arm, plan.link_radius_m, setup.rig)
    return expected_poses(setup, poses, spot_noise(plan), least_px=plan.least_px, hides=hides)


def hidden_ways(arm: ArmPlan, radius_m: float, rig: Rig, poses: RigidTransform, points: Array) -> Mask:
    """Return which ways (m, n, v) from lights (m, n, 3) to a rig's cameras the arm's links are in, at poses.

    A link is a line with a thickness; one in whose thickness a light stands carries it, and hides it not. Of several
    postures the one that hides least counts; where the arm cannot be nothing is hidden. All in rig axes.
    """
    links = Links(arm=arm.arm, radius_m=radius_m, keep_m=0.0, walls=())
    eyes = np.array([arm.T_base_rig.apply(np.asarray(one.T_rig_camera.translation)) for one in rig.cameras])  # (v, 3)
    out = np.zeros((*points.shape[:2], len(eyes)), bool)
    for i, postures in enumerate(_postures(arm, poses)):
        if not len(postures):
            continue
        chain = links.chain(postures)  # (s, ., 3)
        a, b = (chain[:, None, None, links.parts[:, end]] for end in (0, 1))  # (s, 1, 1, k, 3)
        lights = arm.T_base_rig.apply(points[i])[None, :, None, None]  # (1, n, 1, 1, 3)
        carried = apart(lights, lights, a, b) < radius_m
        crossed = apart(lights, eyes[None, None, :, None], a, b) < radius_m  # (s, n, v, k)
        hidden = np.logical_or.reduce(~carried & crossed, axis=3)
        out[i] = hidden[hidden.sum(axis=(1, 2)).argmin()]
    return out


def _postures(arm: ArmPlan, T_rig_target: RigidTransform) -> list[Array]:
    """Return the readings (s, n) with which the arm brings the target to each pose."""
    tools = arm.arm.T_world_base * arm.T_base_rig * T_rig_target * arm.T_flange_target.inv() * arm.arm.T_flange_tool
    return [np.array([one.q for one in ik(arm.arm, tools[i])]) for i in range(len(tools))]


def _reached(arm: ArmPlan, T_rig_target: RigidTransform) -> Mask:
    """Tell to which poses of the target the arm can bring it."""
    return np.array([len(each) > 0 for each in _postures(arm, T_rig_target)])


def _handeye(found: Forecast, arm: ArmPlan, setup: Setup) -> tuple[RigidTransform, PlannedHandEye]:
    """Return T_rig_target of the arm's planned poses, and how well the rig's place in its base is found from them."""
    rng = np.random.default_rng(DRAWN)
    plan, usable = found.plan, np.flatnonzero(found.whole)
    at = found.expected.T_rig_target[rng.choice(usable, TRIED * arm.poses)]
    way, lean = rng.uniform(0.0, 2.0 * np.pi, len(at)), TURNS_RAD * np.sqrt(rng.uniform(0.0, 1.0, len(at)))
    tilt = Rotation.from_rotvec(np.column_stack([lean * np.cos(way), lean * np.sin(way), 0.0 * lean]))
    roll = Rotation.from_rotvec(np.outer(rng.uniform(-ROLL_RAD, ROLL_RAD, len(at)), [0.0, 0.0, 1.0]))
    at = RigidTransform.from_components(at.translation, at.rotation * tilt * roll)
    there = _expected(plan, setup, at)
    fine = np.flatnonzero(there.whole)
    fine = fine[_reached(arm, at[fine])][: arm.poses] if len(fine) else fine
    if len(fine) < arm.poses:
        raise Inconsistent(
            f"the arm can bring the target to {len(fine)} of {arm.poses} poses, turned by up to "
            f"{TURNS_RAD / DEG:.0f} deg, that both cameras see",
            consequence="The rig's place in the arm's base would not be found",
            cure="Move the rig, choose a volume nearer to the arm's middle, or mount the target otherwise",
        )
    there = there.take(fine)
    T_base_flange = arm.T_base_rig * there.T_rig_target * arm.T_flange_target.inv()
    camera = (there.random, there.slopes)
    known = planned_handeye(arm.T_base_rig, arm.T_flange_target, T_base_flange, camera, arm.noise)
    return there.T_rig_target, known


CURES = {
    "behind": "The cameras look along z of the rig's axes: give a volume before them, or turn them",
    "outside": "Move the volume into what both cameras see, turn the cameras towards each other (--toe-in-deg), or "
    "take wider lenses",
    "turned": "Turn the target towards the rig, or move the cameras closer together",
    "a light": "Take larger lights, longer lenses, or come closer; or say what is found with --least-spot-px",
    "the arm is before": "Add a camera that looks from elsewhere (--one-more tells where), or mount the target "
    "further out",
    "beyond": "Move the rig or the volume to where the arm can go; the volume is in the frame of --world",
}


def _nothing(plan: Plan, why: list[str]) -> Inconsistent:
    """Return the refusal of a volume in which nothing can be measured, with the most frequent reason."""
    reasons = [text for text in why if text]
    most = max(set(reasons), key=reasons.count) if reasons else "nothing is seen"
    share = reasons.count(most) / max(len(why), 1)
    cure = next((cure for start, cure in CURES.items() if most.startswith(start)), "Choose another volume or rig")
    return Inconsistent(
        f"the target cannot be measured anywhere in the volume: in {100.0 * share:.0f} % of it, {most}",
        consequence="There is no deviation to foretell",
        cure=cure,
    )
