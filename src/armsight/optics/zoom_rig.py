"""A rig with zoom lenses: at one setting of each it is a rig like any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.optics.camera import INTRINSICS
from armsight.optics.mounted import MountedZoom
from armsight.optics.rig import PLACE, Rig, RigKind
from armsight.optics.zoom import SURE, ZoomLens, ZoomState
from armsight.records import NamedCovariance

SAME_FOCAL = 2e-3
"""Share by which a lens's focal length may differ from the rig's at the same zoom, beyond what both claim: motors come
back to a setting to about a thousandth."""

Zooms = tuple[float | None, ...]
"""The zoom of each camera, in the rig's order; None for a camera without zoom."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigAtZoom:
    """A rig without zoom settings, as it is at one setting of each lens; states: by camera, None without zoom."""

    rig: Rig
    states: tuple[ZoomState | None, ...]


def with_zoom(rig: Rig, lenses: Sequence[ZoomLens | None], at: Zooms) -> Rig:
    """Return a rig that was calibrated at the zooms `at`, with the settings of its lenses.

    Raises Inconsistent for a mirror rig, a lens of another image size, and a setting at which the lens has clearly
    another focal length than the rig; NotEnoughData for one outside a lens's range.
    """
    if rig.kind is RigKind.MIRROR:
        raise Inconsistent("a mirror rig is one camera that sees twice; it takes no zoom settings")
    return rig.with_each(
        zoom=tuple(
            None if lens is None else _mounted(rig, name, lens, value)
            for name, lens, value in zip(rig.names, lenses, at, strict=True)
        )
    )


def at_zoom(rig: Rig, zoom: Zooms = ()) -> RigAtZoom:
    """Return the rig at one setting of each lens.

    A camera that stands where the rig was calibrated keeps that calibration. Of the others the intrinsics are the
    lens's, with its covariance, independent of the rig's; the cameras' places keep the rig's covariance, and move with
    the pupils where the settings tell these. Raises UsageError where a zoom is missing, or given for a camera that
    has none; NotEnoughData as ZoomLens.at.
    """
    states: list[ZoomState | None] = []
    moved: dict[str, ZoomState] = {}
    given = (None,) * len(rig.cameras) if all(one is None for one in zoom) else zoom
    if len(given) != len(rig.cameras):
        raise UsageError(
            f"{len(given)} zooms are given for the cameras {', '.join(rig.names)}",
            consequence="It is open which is whose",
            cure="Give one of each camera, in their order",
        )
    for side, mounted, value in zip(rig.names, rig.zoom, given, strict=True):
        state = None if mounted is None else mounted.lens.at(_required(side, mounted, value))
        if mounted is None and value is not None:
            raise UsageError(
                f"a zoom is given for the {side} camera, and the rig's file has no zoom settings of it",
                consequence="Nobody knows what the lens does there",
                cure=f"Leave --zoom-{side} away, or add the settings with armsight calibrate zoom-rig",
            )
        states.append(state)
        if state is None or mounted is None:
            continue
        if abs(state.zoom - mounted.at) > 1e-9 * max(abs(state.zoom), float(np.ptp(mounted.lens.zooms))):
            moved[side] = state
    return RigAtZoom(rig=_moved(rig, moved), states=tuple(states))


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


def _mounted(rig: Rig, side: str, lens: ZoomLens, at: float | None) -> MountedZoom:
    if at is None:
        raise UsageError(f"at which zoom the {side} camera was calibrated is not said", cure=f"Give --zoom-{side}")
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
    plain = rig.with_each(zoom=(None,) * len(rig.cameras))
    if not moved:
        return plain
    cameras, pupils = [], []
    for one, mounted in zip(plain.cameras, rig.zoom, strict=True):
        if one.name not in moved or mounted is None:
            cameras.append(one)
            pupils.append(np.zeros((3, 3)))
            continue
        here, there = moved[one.name], mounted.lens.at(mounted.at)
        axis = one.T_rig_camera.rotation.as_matrix()[:, 2]
        pupils.append((here.pupil_std_m**2 + there.pupil_std_m**2) * np.outer(axis, axis))
        T = one.T_rig_camera * RigidTransform.from_translation([0.0, 0.0, here.pupil_m - there.pupil_m])
        cameras.append(replace(one, camera=here.camera, T_rig_camera=T))
    return replace(plain, cameras=tuple(cameras), covariance=_zoomed_covariance(rig, moved, pupils))


def _zoomed_covariance(rig: Rig, moved: dict[str, ZoomState], pupils_m2: Sequence[Array]) -> NamedCovariance:
    """Return the covariance of what the rig keeps, of the lenses at their zooms, and of the pupils' way.

    pupils_m2: (3, 3) of each camera's; that of the first one, which is held, moves all others alike.
    """
    known = rig.covariance
    names = () if known is None else known.names
    places = [[f"{name}.{axis}" for axis in PLACE[:3]] for name in rig.names[1:]]
    kept = tuple(name for name in names if name.split(".")[0] not in moved or name.split(".")[1] in PLACE)
    kept += tuple(name for place in places for name in place if name not in kept)
    both = kept + tuple(f"{name}.{intrinsic}" for name in moved for intrinsic in INTRINSICS)
    matrix = np.zeros((len(both), len(both)))
    if known is not None:
        here = [i for i, name in enumerate(kept) if name in names]
        matrix[np.ix_(here, here)] = known.block(tuple(kept[i] for i in here))
    rows = [[kept.index(name) for name in place] for place in places]
    for i, a in enumerate(rows):
        for j, b in enumerate(rows):
            matrix[np.ix_(a, b)] += pupils_m2[0] + pupils_m2[1 + i] if i == j else pupils_m2[0]
    for i, state in enumerate(moved.values()):
        at = slice(len(kept) + i * len(INTRINSICS), len(kept) + (i + 1) * len(INTRINSICS))
        matrix[at, at] = state.covariance.matrix
    return NamedCovariance(names=both, matrix=matrix)
