"""What to change for a wanted accuracy: each change of a plan worked out anew, the cheapest first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.distance import pdist
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Cancelled, DataRefused
from armsight.optics import Camera, MountedCamera, Rig, mean_axes
from armsight.optics.rig import PLACE
from armsight.records import NamedCovariance, Progress, Target
from armsight.units import DEG
from armsight_lab.design.plan import Plan, at_baseline
from armsight_lab.design.records import DesignChange
from armsight_lab.design.volume import Forecast, forecast

MORE = 1.5
MORE_NAME, COARSE, LEVEL = "more", 3, 0.1
"""One more camera's name; cells along the volume's longest edge for which places are tried; sine of the angle to what
is upright below which a camera has no level of its own."""
APART_RAD = 22.5 * DEG
"""Nearer to another camera, seen from the volume, one more has little that is new: half a step of the grid."""
FRAMES = 10
FINER = 2
APART = 0.25
"""Further lights stand no nearer to others than this share of what lies between those that are there."""
VOLUME_SHARE = 0.95
"""Share of the volume in which the wanted deviation must be reached: a cell that is not measured does not reach it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change in words, and what it makes of a plan; None where it has none of it to change."""

    name: str
    made: Callable[[Plan], Plan | None]


def _average(plan: Plan) -> Plan:
    return replace(plan, average=FRAMES * plan.average)


def _views(factor: int) -> Callable[[Plan], Plan | None]:
    def made(plan: Plan) -> Plan | None:
        known = plan.calibration
        return None if known is None else replace(plan, calibration=replace(known, views=factor * known.views))

    return made


def _poses(plan: Plan) -> Plan | None:
    return None if plan.arm is None else replace(plan, arm=replace(plan.arm, poses=2 * plan.arm.poses))


def _spacing(plan: Plan) -> Plan | None:
    if len(plan.target.names) < 2:
        return None
    return replace(
        plan, target=replace(plan.target, xyz_m=MORE * plan.target.xyz_m, pitch_m=MORE * plan.target.pitch_m)
    )


def _lights(plan: Plan) -> Plan | None:
    """Return the plan with as many lights again, at the far side of their middle."""
    target = plan.target
    if target.is_board or target.covariance is not None:
        return None
    return replace(plan, target=_doubled(target))


def _doubled(target: Target) -> Target:
    middle = target.xyz_m.mean(axis=0)
    # nearer to the middle than those: a target that looks the same after half a turn has no orientation
    off = -0.8 * (target.xyz_m - middle) if len(target.names) > 1 else np.array([[0.05, 0.0, 0.0]])
    # beside the middle where a light stands near it: two lights in one place are one
    beside = np.array([0.0, 0.13 * float(np.ptp(target.xyz_m, axis=0).max()), 0.0])
    each = [np.concatenate([target.xyz_m, middle + off + k * beside]) for k in (0, 1, -1, 2, -2)]
    apart = [float(pdist(xyz).min()) for xyz in each]
    enough = (k for k, near in enumerate(apart) if near >= APART * float(pdist(target.xyz_m).min(initial=np.inf)))
    names = tuple(f"{name}'" for name in target.names)
    return replace(target, names=(*target.names, *names), xyz_m=each[next(enough, int(np.argmax(apart)))])


def _baseline(plan: Plan) -> Plan | None:
    return None if not plan.rig.is_pair else replace(plan, rig=at_baseline(plan.rig, MORE))


def _cameras(change: Callable[[Camera], Camera]) -> Callable[[Plan], Plan | None]:
    def made(plan: Plan) -> Plan | None:
        return replace(plan, rig=plan.rig.with_each(camera=[change(one.camera) for one in plan.rig.cameras]))

    return made


def _longer(camera: Camera) -> Camera:
    k = camera.intrinsics.copy()
    k[:2] *= MORE
    return replace(camera, intrinsics=k)


def _finer(camera: Camera) -> Camera:
    k = camera.intrinsics.copy()
    k[:2] *= FINER
    k[2:4] = FINER * (k[2:4] + 0.5) - 0.5
    return replace(camera, intrinsics=k, width=FINER * camera.width, height=FINER * camera.height)


def _with_camera(found: Forecast, place_m: Array, middle_m: Array) -> Plan:
    """Return the plan with one more camera at a place, looking at the middle (3,) of the volume, in rig axes.

    Its lens is that of the first camera, and it is known as well as the worst of the others.
    """
    rig = found.rig
    z = (middle_m - place_m) / np.linalg.norm(middle_m - place_m)
    upright = mean_axes(rig)[:, 1]
    x = np.cross(upright, z)
    if np.linalg.norm(x) < LEVEL:  # it looks along what is upright for the others
        x = mean_axes(rig)[:, 0]
    x = x - (x @ z) * z
    R = np.column_stack([x, np.cross(z, x), z * np.linalg.norm(x)]) / np.linalg.norm(x)
    T = RigidTransform.from_components(place_m, Rotation.from_matrix(R))
    first = rig.cameras[0]
    more = MountedCamera(name=MORE_NAME, camera=first.camera, T_rig_camera=T, noise=first.noise)
    wider = Rig(cameras=(*rig.cameras, more), rms_px=rig.rms_px)
    known = rig.covariance
    if known is not None:
        lens = [f"{first.name}.{name}" for name in first.camera.names if f"{first.name}.{name}" in known.names]
        places = [[f"{one.name}.{name}" for name in PLACE] for one in rig.cameras[1:]]
        blocks = [known.block(tuple(each)) for each in places if set(each) <= set(known.names)]
        own = [known.block(tuple(lens)), max(blocks, key=np.trace, default=np.zeros((6, 6)))]
        own_names = [*(name.split(".", 1)[1] for name in lens), *PLACE]
        names = (*known.names, *(f"{MORE_NAME}.{name}" for name in own_names))
        wider = replace(wider, covariance=NamedCovariance(names=names, matrix=block_diag(known.matrix, *own)))
    return replace(found.plan, rig=wider, calibration=None)


def where_it_helps(found: Forecast, wanted_m: float | None, progress: Progress) -> Change:
    """Return one more camera at the place, of a grid about the volume, where it helps most. Raises Cancelled.

    The grid is of the 26 directions to a cube's corners, edges and faces, at the mean distance of the other cameras;
    without those nearer to another camera than half way. What each brings is worked out for few cells.
    """
    rig, plan = found.rig, found.plan
    middle = plan.T_frame_rig.inv().apply(np.array(plan.volume).mean(axis=1))
    ways = np.array([np.asarray(one.T_rig_camera.translation) - middle for one in rig.cameras])
    far = np.linalg.norm(ways, axis=1)
    axes = mean_axes(rig)
    grid = [axes @ np.array(way) / np.linalg.norm(way) for way in product((-1, 0, 1), repeat=3) if any(way)]
    free = [way for way in grid if (ways @ way / far).max() < np.cos(APART_RAD)]
    tried: list[tuple[tuple[float, float], Array]] = []
    for k, way in enumerate(free):
        progress.update(k, len(free), "trying places of one more camera")
        if progress.cancelled():
            raise Cancelled("stopped while places were tried", consequence="Nothing was written")
        place = middle + far.mean() * way
        try:
            coarse = forecast(replace(_with_camera(found, place, middle), cells=COARSE))
        except DataRefused:
            continue
        tried.append((_merit(coarse, wanted_m), place))
    best = max(tried, key=lambda one: one[0])[1] if tried else middle + far.mean() * free[0]
    x, y, z = plan.T_frame_rig.apply(best).round(3).tolist()
    name = f"one more camera at {x:g}, {y:g}, {z:g} m ({plan.frame}), looking at the middle of the volume"
    return Change(name=name, made=lambda _: _with_camera(found, best, middle))


CHANGES: Sequence[Change] = (
    Change(name=f"the mean of {FRAMES} frames for each pose", made=_average),
    Change(name="twice as many pictures of the board", made=_views(2)),
    Change(name="four times as many pictures of the board", made=_views(4)),
    Change(name="twice as many poses of the arm", made=_poses),
    Change(name=f"a target {MORE:g} times as large", made=_spacing),
    Change(name="twice as many lights", made=_lights),
    Change(name=f"a baseline {MORE:g} times as long", made=_baseline),
    Change(name=f"lenses of {MORE:g} times the focal length", made=_cameras(_longer)),
    Change(name=f"cameras of {FINER} times the pixels each way", made=_cameras(_finer)),
)
"""From the cheapest to the dearest: patience, paper, lights, a longer bar, lenses, cameras."""
SUPERSEDED = {"twice as many pictures of the board": "four times as many pictures of the board"}
"""What another change holds already: left out where changes are put together."""


FAR_OFF = 1.0
"""What a cell counts that is not measured, m."""


def reaches(found: Forecast, wanted_m: float) -> bool:
    """Tell whether at least VOLUME_SHARE of all cells are measured as well as wanted."""
    return bool(np.mean(np.nan_to_num(found.position_m, nan=np.inf) <= wanted_m) >= VOLUME_SHARE)


def changes_of(
    found: Forecast, wanted_m: float | None, progress: Progress, *, one_more: bool = False
) -> tuple[DesignChange, ...]:
    """Return what each change of a plan leads to; where none suffices, also those together that help.

    one_more: also one more camera, where it helps most.

    Sorted: what suffices first, the cheapest first; then by the deviation. Raises Cancelled.
    """
    single = [one for one in CHANGES if one.made(found.plan) is not None]
    done = [_tried(found.plan, (one,), wanted_m, progress, (k, len(single)))[0] for k, one in enumerate(single)]
    if one_more:
        done.append(_tried(found.plan, (where_it_helps(found, wanted_m, progress),), wanted_m, progress, (0, 1))[0])
    if wanted_m is not None and not any(one.sufficient for one in done):
        together = _together(found, single, wanted_m, progress)
        done += [together] if together is not None else []
    order = sorted(range(len(done)), key=lambda k: _rank(done[k], k))
    return tuple(done[k] for k in order)


def _together(found: Forecast, single: Sequence[Change], wanted_m: float, progress: Progress) -> DesignChange | None:
    """Return the changes that help, together from the cheapest on until they suffice; None where fewer than two do."""
    names = [one.name for one in single]
    kept: tuple[Change, ...] = ()
    best, now = None, _merit(found, wanted_m)
    for k, one in enumerate(single):
        if SUPERSEDED.get(one.name) in names:
            continue
        change, other = _tried(found.plan, (*kept, one), wanted_m, progress, (k, len(single)))
        if other is None or _merit(other, wanted_m) <= now:
            continue
        kept, now, best = (*kept, one), _merit(other, wanted_m), change
        if change.sufficient:
            break
    return best if len(kept) > 1 else None


def _merit(found: Forecast, wanted_m: float | None) -> tuple[float, float]:
    """Return the share of the volume that is measured as well as wanted, and the less the deviation, the more."""
    most = np.finfo(float).max if wanted_m is None else wanted_m
    fine = float(np.mean(np.nan_to_num(found.position_m, nan=np.inf) <= most))
    return fine, -float(np.nansum(np.where(found.measured, found.position_m, FAR_OFF)))


def _rank(one: DesignChange, place: int) -> tuple[bool, float]:
    if one.sufficient:
        return False, float(place)
    return True, np.inf if one.position_m is None else one.position_m


def _tried(
    plan: Plan, changes: tuple[Change, ...], wanted_m: float | None, progress: Progress, at: tuple[int, int]
) -> tuple[DesignChange, Forecast | None]:
    progress.update(*at, "trying changes")
    if progress.cancelled():
        raise Cancelled("stopped while changes were tried", consequence="Nothing was written")
    name, other = " + ".join(one.name for one in changes), plan
    for one in changes:
        other = one.made(other) or other
    try:
        found = forecast(other)
    except DataRefused as error:
        refused = DesignChange(
            change=name,
            position_m=None,
            orientation_rad=None,
            measured=0.0,
            sufficient=None if wanted_m is None else False,
            why=error.cause,
        )
        return refused, None
    turns = found.orientation_rad[found.whole]
    change = DesignChange(
        change=name,
        position_m=float(np.percentile(found.position_m[found.measured], 95.0)),
        orientation_rad=float(np.percentile(turns, 95.0)) if len(turns) else None,
        measured=float(found.measured.mean()),
        sufficient=None if wanted_m is None else reaches(found, wanted_m),
    )
    return change, found
