"""A rig of zoom cameras at one setting of each lens."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.optics.camera import INTRINSICS, SIDES
from armsight.optics.rig import RIGHT_POSE, MountedZoom, Rig, RigKind
from armsight.optics.zoom import SURE, ZoomLens, ZoomState
from armsight.records import NamedCovariance

SAME_FOCAL = 2e-3
"""Share by which a lens's focal length may differ from the rig's at the same zoom, beyond what both claim: motors come
back to a setting to about a thousandth."""

Zooms = tuple[float | None, float | None]
"""The zoom of the left and of the right camera; None for a camera without zoom."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigAtZoom:
    """A rig without zoom settings, as it is at one setting of each lens; states: left and right, None without zoom."""

    rig: Rig
    states: tuple[ZoomState | None, ZoomState | None]


def with_zoom(rig: Rig, lenses: tuple[ZoomLens | None, ZoomLens | None], at: Zooms) -> Rig:
    """Return a rig that was calibrated at the zooms `at`, with the settings of its lenses.

    Raises Inconsistent for a mirror rig, a lens of another image size, and a setting at which the lens has clearly
    another focal length than the rig; NotEnoughData for one outside a lens's range.
    """
    if rig.kind is RigKind.MIRROR:
        raise Inconsistent("a mirror rig is one camera that sees twice; it takes no zoom settings")
    mounted = tuple(
        None if lens is None else _mounted(rig, side, lens, value)
        for side, lens, value in zip(SIDES, lenses, at, strict=True)
    )
    return replace(rig, zoom=(mounted[0], mounted[1]))


def at_zoom(rig: Rig, zoom: Zooms) -> RigAtZoom:
    """Return the rig at one setting of each lens.

    A side that stands where the rig was calibrated keeps that calibration. Of the others the intrinsics are the lens's,
    with its covariance, independent of the rig's; the place of the right camera keeps the rig's covariance, and moves
    with the pupils where the settings tell these. Raises UsageError where a zoom is missing, or given for a camera that
    has none; NotEnoughData as ZoomLens.at.
    """
    states: list[ZoomState | None] = []
    moved: dict[str, ZoomState] = {}
    for side, mounted, value in zip(SIDES, rig.zoom, zoom, strict=True):
        state = None if mounted is None else mounted.lens.at(_required(side, mounted, value))
        if mounted is None and value is not None:
            raise UsageError(
                f"a zoom is given for the {side} camera, and the rig's file has no zoom settings of it",
                consequence="Nobody knows what the lens does there",
                cure=f"Leave --zoom-{side} away, or add the settings with armsight calibrate zoom-rig",
            )
        states.append(state)
        if state is not None and mounted is not None and not _is_at(mounted, state.zoom):
            moved[side] = state
    return RigAtZoom(rig=_moved(rig, moved), states=(states[0], states[1]))


def _required(side: str, mounted: MountedZoom, value: float | None) -> float:
    if value is not None:
        return value
    low, high = mounted.lens.zooms[[0, -1]]
    raise UsageError(
        f"the rig's {side} camera has a zoom lens, and its zoom is not given",
        consequence="Its focal length is open",
        cure=f"Give --zoom-{side} with the value that the lens stood at, {low:g} to {high:g}; for a command that takes "
        "none, make the file of one setting with armsight convert rig --zoom-left --zoom-right",
    )


def _is_at(mounted: MountedZoom, zoom: float) -> bool:
    """Tell whether a zoom is the one at which the rig was calibrated."""
    return abs(zoom - mounted.at) <= 1e-9 * max(abs(zoom), float(np.ptp(mounted.lens.zooms)))


def _mounted(rig: Rig, side: str, lens: ZoomLens, at: float | None) -> MountedZoom:
    if at is None:
        raise UsageError(
            f"it is not said at which zoom the {side} camera stood when the rig was calibrated",
            cure=f"Give --zoom-{side}",
        )
    camera, state = rig.camera(side), lens.at(at)
    if lens.size != (camera.width, camera.height):
        raise Inconsistent(
            f"the {side} lens's settings are of {lens.size[0]}x{lens.size[1]} px, the rig's camera has "
            f"{camera.width}x{camera.height} px",
            consequence="They are not of one camera",
            cure="Calibrate lens and rig at one resolution",
        )
    name = f"{side}.fx"
    known = 0.0 if rig.covariance is None else rig.covariance.std().get(name, 0.0)
    doubt = float(np.hypot(state.covariance.std()["fx"], known))
    gap = abs(float(state.camera.intrinsics[0] - camera.intrinsics[0]))
    if gap > SURE * doubt + SAME_FOCAL * camera.intrinsics[0]:
        raise Inconsistent(
            f"at zoom {at:g} the {side} lens's focal length is {state.camera.intrinsics[0]:.1f} px, in the rig it is "
            f"{camera.intrinsics[0]:.1f} px (standard deviation of the difference {doubt:.2g} px)",
            consequence="The settings are of another camera, or the rig was calibrated at another zoom",
            cure=f"Check the file of the {side} lens, left and right, and --zoom-{side}",
        )
    return MountedZoom(lens=lens, at=at)


def _moved(rig: Rig, moved: dict[str, ZoomState]) -> Rig:
    """Return the rig without settings, the sides in moved as their states say."""
    plain = replace(rig, zoom=(None, None))
    if not moved:
        return plain
    cameras = {side: moved[side].camera if side in moved else rig.camera(side) for side in SIDES}
    poses = {side: rig.T_rig_camera(side) for side in SIDES}
    pupils = np.zeros((3, 3))
    for side, mounted in zip(SIDES, rig.zoom, strict=True):
        if side in moved and mounted is not None:
            there = mounted.lens.at(mounted.at)
            shift = RigidTransform.from_translation([0.0, 0.0, moved[side].pupil_m - there.pupil_m])
            axis = poses[side].rotation.as_matrix()[:, 2]
            pupils += (moved[side].pupil_std_m ** 2 + there.pupil_std_m**2) * np.outer(axis, axis)
            poses[side] = poses[side] * shift
    return replace(
        plain,
        left=cameras["left"],
        right=cameras["right"],
        T_rig_left=poses["left"],
        T_rig_right=poses["right"],
        covariance=_covariance(rig.covariance, moved, pupils),
    )


def _covariance(known: NamedCovariance | None, moved: dict[str, ZoomState], pupils_m2: Array) -> NamedCovariance:
    """Return the covariance of what the rig keeps, of the lenses at their zooms, and of the pupils' way."""
    names = () if known is None else known.names
    kept = tuple(name for name in names if name.split(".")[0] not in moved or name in RIGHT_POSE)
    kept += tuple(name for name in RIGHT_POSE[:3] if name not in kept)
    both = kept + tuple(f"{side}.{name}" for side in moved for name in INTRINSICS)
    matrix = np.zeros((len(both), len(both)))
    if known is not None:
        here = [i for i, name in enumerate(kept) if name in names]
        matrix[np.ix_(here, here)] = known.block(tuple(kept[i] for i in here))
    rows = [kept.index(name) for name in RIGHT_POSE[:3]]
    matrix[np.ix_(rows, rows)] += pupils_m2
    for i, state in enumerate(moved.values()):
        at = slice(len(kept) + i * len(INTRINSICS), len(kept) + (i + 1) * len(INTRINSICS))
        matrix[at, at] = state.covariance.matrix
    return NamedCovariance(names=both, matrix=matrix)
