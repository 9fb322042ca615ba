"""What can be wrong with a rig that is no pair: by camera, each for itself, so that the one that moved has a name.

The parameters are those of evidence.rig_of: a camera that sees nothing stands first and is held, so that every camera
of the rig may have moved, the first one as well.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from armsight.arrays import Array, Index
from armsight.columns import POSITION
from armsight.measure.consistency.causes import (
    DELAY_WIDTH_S,
    FOCAL_WIDTH,
    K1,
    K1_WIDTH,
    LIGHT_WIDTH_M,
    PLACE_WIDTH_M,
    SCALE_WIDTH,
    TURN_WIDTH_RAD,
    Cause,
    larger_target,
    lens_widths,
    lights,
    more_than_one,
    scale,
    together,
)
from armsight.measure.poses.setup import Setup
from armsight.optics import PLACE

POSE = len(PLACE)

RECALIBRATE = "calibrate the cameras anew with `armsight calibrate cameras`"

AGREEING = 2
"""Cameras that must be left and agree where others are said to have moved: of two it is open which one did."""


def again(name: str) -> str:
    """Return what places a camera of a standing rig anew."""
    return f"Fasten the camera {name}, then place it anew with `armsight calibrate cameras --again {name}`"


def intrinsics_at(setup: Setup, k: int) -> int:
    """Return where the intrinsics of the rig's camera k begin among the parameters."""
    return setup.packed.n_intrinsics * (k + 1)


def pose_at(setup: Setup, k: int) -> int:
    """Return where the pose of the rig's camera k begins among the parameters; of k = v those of the target do."""
    return intrinsics_at(setup, len(setup.packed.k)) + POSE * k


def widths(setup: Setup, q: int, *, scale_only: bool) -> Array:
    """Return (q,): how far off each parameter usually is where it is wrong; see causes.parameter_widths."""
    v, camera = len(setup.packed.k), lens_widths(setup.packed.n_intrinsics)
    poses = [*[PLACE_WIDTH_M] * 3, *[TURN_WIDTH_RAD] * 3] * v
    p = q - pose_at(setup, v) - v
    target = [SCALE_WIDTH] if scale_only else [LIGHT_WIDTH_M] * p
    return np.array([*camera * (v + 1), *poses, *target, *[DELAY_WIDTH_S] * v])


def places(setup: Setup) -> Index:
    """Return where the parameters of the rig, which holds its first camera, stand among all."""
    v = len(setup.packed.k)
    lenses = range(intrinsics_at(setup, 0), intrinsics_at(setup, v))
    return np.array([*lenses, *range(pose_at(setup, 1), pose_at(setup, v))])


def causes_of_cameras(setup: Setup, basis: Array) -> tuple[Cause, ...]:
    """Return all causes that the setup of a rig that is no pair can have; see causes.causes_of."""
    v = len(setup.rig.cameras)
    q = pose_at(setup, v) + basis.shape[2] + v
    moved = [_moved(setup, q, k) for k in range(v)] if v > AGREEING else []
    own = [cause for k in range(v) for cause in _of_camera(setup, q, k, alone=v == 1)]
    size = [_scale(setup, basis, q)] if v > 1 else []  # one camera does not tell a larger target from a farther one
    static = [*size, *lights(setup, basis, q, pose_at(setup, v)), *own]
    changed = [_since(setup, q, k) for k in range(v)] if moved else []
    both = []
    if v >= 2 * AGREEING:
        both = [_both(one, other) for one, other in combinations(moved, 2)]
    rig = own if v == 1 else [cause for cause in static if cause.cameras]
    return (*static, *moved, *changed, *both, *more_than_one(static, rig, RECALIBRATE))


def _cause(name: str, key: str, V: Array, width: float, labels: tuple[str, ...], unit: str, words: str) -> Cause:
    return Cause(
        key=f"{key} {name}",
        V=V,
        width=np.full(V.shape[1], width),
        labels=labels,
        unit=unit,
        words=words,
        advice=again(name),
        cameras=(name,),
    )


def _of_camera(setup: Setup, q: int, k: int, *, alone: bool) -> list[Cause]:
    """Return what may be wrong with one camera: its turn, its place, its clock, its lens."""
    v, name, at = len(setup.rig.cameras), setup.rig.names[k], intrinsics_at(setup, k)
    turn, place, focal, bend, late = (np.zeros((q, n)) for n in (3, 3, 1, 1, 1))
    turn[pose_at(setup, k) + 3 : pose_at(setup, k) + 6] = setup.packed.R[k].T
    place[pose_at(setup, k) : pose_at(setup, k) + 3] = np.eye(3)
    focal[at : at + 2, 0] = setup.packed.k[k, :2]
    bend[at + K1] = 1.0
    late[q - v + k] = 1.0
    who = f"the camera {name}"
    axes = tuple(f"about_{axis}_rad" for axis in "xyz")
    lens = [
        _cause(name, "focal", focal, FOCAL_WIDTH, (name,), "1", f"the focal length of {who} is wrong"),
        _cause(name, "distortion", bend, K1_WIDTH, (f"{name}_k1",), "1", f"the lens's distortion of {who} is wrong"),
    ]
    if alone:  # where it stands, and when it exposes, is told by nothing
        return lens
    return [
        _cause(name, "turned", turn, TURN_WIDTH_RAD, axes, "rad", f"{who} is turned against the others"),
        _cause(name, "displaced", place, PLACE_WIDTH_M, POSITION, "m", f"{who} stands beside its place"),
        *lens,
        _cause(name, "timing", late, DELAY_WIDTH_S, ("later_s",), "s", f"{who} does not expose with the others"),
    ]


def _moved(setup: Setup, q: int, k: int) -> Cause:
    turned, displaced = _of_camera(setup, q, k, alone=False)[:2]
    name = setup.rig.names[k]
    return Cause(
        key=f"moved {name}",
        V=np.hstack([turned.V, displaced.V]),
        width=np.concatenate([turned.width, displaced.width]),
        labels=(*turned.labels, *displaced.labels),
        unit="rad",
        words=f"the camera {name} has moved",
        advice=again(name),
        cameras=(name,),
    )


def _since(setup: Setup, q: int, k: int) -> Cause:
    """Return the cause that a camera moved during the run, and beside it that it turned only, or shifted only."""

    def later(cause: Cause, what: str, parts: tuple[Cause, ...] = ()) -> Cause:
        words = f"the camera {cause.cameras[0]} has {what} during the run"
        return replace(cause, key=f"{cause.key} in the run", words=words, from_change=True, parts=parts)

    turned, displaced = _of_camera(setup, q, k, alone=False)[:2]
    return later(_moved(setup, q, k), "moved", (later(turned, "turned"), later(displaced, "shifted")))


def _both(one: Cause, other: Cause) -> Cause:
    """Return the cause that two cameras have moved, each in its own way."""
    a, b = one.cameras[0], other.cameras[0]
    words = f"the cameras {a} and {b} have moved"
    cause = together(f"moved {a} {b}", [one, other], words, f"{again(a)}; then {again(b)}")
    return Cause(
        key=cause.key,
        V=cause.V,
        width=cause.width,
        labels=cause.labels,
        unit="",
        words=words,
        advice=cause.advice,
        cameras=(a, b),
    )


def _scale(setup: Setup, basis: Array, q: int) -> Cause:
    """Target against the distances between the cameras: a larger target in a smaller rig leaves the same residuals."""
    v, p = len(setup.rig.cameras), basis.shape[2]
    target, smaller = np.zeros((q, 1)), np.zeros((q, 1))
    target[pose_at(setup, v) : pose_at(setup, v) + p, 0] = larger_target(setup, basis)
    for k, one in enumerate(setup.rig.cameras):
        smaller[pose_at(setup, k) : pose_at(setup, k) + 3, 0] = -np.asarray(one.T_rig_camera.translation)
    return scale(target, smaller, "rig")
