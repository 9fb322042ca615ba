"""Cameras, rigs, hand-eye calibrations and arms of two files, number by number, beside the uncertainty of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtrc, ndtr

from armsight.arrays import Array, Mask
from armsight.columns import POSE6
from armsight.errors import Inconsistent
from armsight.fields import Doc
from armsight.kinematics import Arm, pose
from armsight.optics import Camera, LensKind, Rig, shared_point, triangulate_views
from armsight.records import NamedCovariance
from armsight.records.output import Output, output
from armsight.records.result_parts import Difference
from armsight.store.arm_file import read_arm
from armsight.store.handeye_file import read_handeye
from armsight.store.rigs import read_camera_file, read_rig

GRID = 9
"""Points along each side of the image at which cameras are compared, its corners among them."""

BASELINES = 8.0
"""Working distance at which rigs are compared, in baselines, where none is given."""

POSTURES = 300
ENTRIES = (("a_m", "m"), ("alpha_rad", "rad"), ("d_m", "m"), ("theta_rad", "rad"), ("beta_rad", "rad"))
RIG_POSE = ("tx", "ty", "tz", "rx", "ry", "rz")
NOT_ONE = "Nothing was compared"


BY_CHANCE = 0.01
"""Two results disagree where chance alone would part them so far less often than this."""

RIDGE = 1e-9
"""Added to correlations: a direction that both claim to know without any doubt is held against rounding only."""

SAME = 1e-12
"""Relative difference that is none."""


@output
class Effect(Output):
    """What the differences come to where the result is used."""

    name: Annotated[str, Doc("What it is.")]
    value: Annotated[float, Doc("How much.", unit="as unit says")]
    unit: Annotated[str, Doc("m, rad, px, or 1 for a share.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Two calibrations: their numbers, covariances, and what the differences come to."""

    differences: Sequence[Difference]
    covariances: tuple[NamedCovariance | None, NamedCovariance | None]
    effects: Sequence[Effect]
    notes: Sequence[str] = ()


def compare_cameras(a: Path, b: Path) -> Compared:
    """Compare two camera.yaml. Raises BadFile, and Inconsistent for images of unequal size."""
    first, second = read_camera_file(a), read_camera_file(b)
    _same_size(first.camera, second.camera, "the images")
    values = [Value(name=n, value=v, unit=u) for n, v, u in _intrinsics(first.camera, second.camera, "")]
    others = [v for _, v, _ in _intrinsics(second.camera, first.camera, "")]
    return Compared(
        differences=differences(values, others, first.covariance, second.covariance),
        covariances=(first.covariance, second.covariance),
        effects=_shift_effects(first.camera, second.camera, ""),
    )


def compare_rigs(a: Path, b: Path, distance_m: float | None = None) -> Compared:
    """Compare two rig.yaml at a distance from the first camera, of a rig that is no pair where all look.

    Raises BadFile, and Inconsistent for rigs of two kinds or of other cameras.
    """
    first, second = read_rig(a, any_cameras=True), read_rig(b, any_cameras=True)
    if first.kind is not second.kind or set(first.names) != set(second.names):
        raise Inconsistent(
            f"{a} is a rig of kind {first.kind} with the cameras {', '.join(first.names)}, and {b} of kind "
            f"{second.kind} with {', '.join(second.names)}",
            consequence=NOT_ONE,
            cure="Give two calibrations of one rig",
        )
    second = second.only(*first.names)  # the first camera of A is held in both
    numbers: list[tuple[str, float, str]] = []
    others: list[float] = []
    effects: list[Effect] = []
    for name in first.names:
        _same_size(first.camera(name), second.camera(name), f"the {name} images")
        cameras = first.camera(name), second.camera(name)
        numbers += _intrinsics(*cameras, f"{name}.")
        others += [value for _, value, _ in _intrinsics(*cameras[::-1], "")]
        effects += _shift_effects(first.camera(name), second.camera(name), f"{name}: ")
    pair = first.is_pair
    if len(first.cameras) > 2:  # what the rig as a whole comes to, before its pairs
        effects += _space_effects(first, second, distance_m or _in_sight_m(first))
    for name in first.names[1:]:
        one, other = _two(first, name), _two(second, name)
        T_a, T_b = (rig.T_rig_left.inv() * rig.T_rig_right for rig in (one, other))
        here, there = _pose_values(T_a, T_b)
        units = ("m", "m", "m", "rad", "rad", "rad")
        numbers += [(f"{name}.{key}", value, unit) for key, value, unit in zip(RIG_POSE, here, units, strict=True)]
        others += there
        baseline = (other.baseline_m - one.baseline_m) / one.baseline_m
        what = "baseline" if pair else f"distance from {first.names[0]} to {name}"
        effects.append(Effect(name=f"{what} of B over A, less one", value=baseline, unit="1"))
        found = _space_effects(one, other, distance_m or (BASELINES * one.baseline_m if pair else _in_sight_m(first)))
        effects += found if pair else [replace(row, name=f"{first.names[0]}, {name}: {row.name}") for row in found]
    values = [Value(name=n, value=v, unit=u) for n, v, u in numbers]
    return Compared(
        differences=differences(values, others, first.covariance, second.covariance),
        covariances=(first.covariance, second.covariance),
        effects=effects,
    )


def _two(rig: Rig, name: str) -> Rig:
    """Return the first camera and another one as a pair; a pair itself."""
    if rig.is_pair:
        return rig
    return Rig(cameras=(replace(rig.cameras[0], name="left"), replace(rig.only(name).cameras[0], name="right")))


def _in_sight_m(rig: Rig) -> float:
    """Return how far from the first camera the point is at which all cameras look."""
    return float(np.linalg.norm(shared_point(rig) - np.asarray(rig.cameras[0].T_rig_camera.translation)))


def compare_handeyes(a: Path, b: Path) -> Compared:
    """Compare two handeye.yaml. Raises BadFile, and Inconsistent for cameras on hand and beside it."""
    first, second = read_handeye(a), read_handeye(b)
    if first.setup is not second.setup:
        raise Inconsistent(
            f"{a} is {first.setup} and {b} is {second.setup}",
            consequence=NOT_ONE,
            cure="Give two calibrations of one camera on one arm",
        )
    here, there = _pose_values(first.T_parent_camera, second.T_parent_camera)
    units = ("m", "m", "m", "rad", "rad", "rad")
    named = zip(POSE6, here, units, strict=True)
    values = [Value(name=f"camera.{name}", value=value, unit=unit) for name, value, unit in named]
    found = differences(values, there, first.covariance, second.covariance)
    off = first.T_parent_camera.inv() * second.T_parent_camera
    effects = [
        Effect(name="camera moved by", value=float(np.linalg.norm(off.translation)), unit="m"),
        Effect(name="camera turned by", value=float(off.rotation.magnitude()), unit="rad"),
    ]
    note = "The target's own pose is not compared: it may have stood elsewhere."
    return Compared(differences=found, covariances=(first.covariance, second.covariance), effects=effects, notes=[note])


def compare_arms(a: Path, b: Path) -> Compared:
    """Compare two arm.yaml. Raises BadFile, and Inconsistent for arms of other joints."""
    first, second = read_arm(a), read_arm(b)
    kinds = [[joint.type.value for joint in arm.joints] for arm in (first, second)]
    if kinds[0] != kinds[1] or first.convention != second.convention:
        raise Inconsistent(
            f"{a} has the joints {', '.join(kinds[0])} ({first.convention}), {b} {', '.join(kinds[1])} "
            f"({second.convention})",
            consequence=NOT_ONE,
            cure="Give two calibrations of one arm, in one convention (armsight convert arm)",
        )
    values: list[Value] = []
    others: list[float] = []
    names: dict[str, str] = {}
    for i, (one, other) in enumerate(zip(first.joints, second.joints, strict=True), 1):
        for key, unit in ENTRIES:
            names |= {f"{one.name}.{key}": f"joint {i} {key}", f"{other.name}.{key}": f"joint {i} {key}"}
            values.append(Value(name=f"joint {i} {key}", value=getattr(one, key), unit=unit))
            others.append(getattr(other, key))
    of = tuple(_renamed(arm.covariance, names) for arm in (first, second))
    return Compared(
        differences=differences(values, others, of[0], of[1]),
        covariances=(of[0], of[1]),
        effects=_reach_effects(first, second),
    )


def _renamed(covariance: NamedCovariance | None, names: dict[str, str]) -> NamedCovariance | None:
    if covariance is None:
        return None
    return replace(covariance, names=tuple(names.get(one, one) for one in covariance.names))


def _intrinsics(camera: Camera, other: Camera, prefix: str) -> list[tuple[str, float, str]]:
    """Return name, value and unit of a camera's intrinsics, those with which another one is compared.

    A pinhole is a rational lens whose k4, k5, k6 are zero. Raises Inconsistent for a fisheye and another lens.
    """
    if camera.lens is not other.lens and LensKind.FISHEYE in (camera.lens, other.lens):
        raise Inconsistent(
            f"one lens is a {camera.lens} and the other a {other.lens}",
            consequence="Their coefficients cannot be compared",
            cure="Compare calibrations with one kind of lens",
        )
    named = dict.fromkeys(other.named, 0.0) | camera.named
    return [(f"{prefix}{name}", value, "px" if i < 5 else "1") for i, (name, value) in enumerate(named.items())]


def _pose_values(a: RigidTransform, b: RigidTransform) -> tuple[list[float], list[float]]:
    """Return the six numbers of two poses; those of B's rotation as A's plus the turn between, in the parent's axes."""
    turn = (b.rotation * a.rotation.inv()).as_rotvec()
    start = a.rotation.as_rotvec()
    return [*a.translation.tolist(), *start.tolist()], [*b.translation.tolist(), *(start + turn).tolist()]


def _same_size(a: Camera, b: Camera, what: str) -> None:
    if (a.width, a.height) != (b.width, b.height):
        raise Inconsistent(
            f"{what} are {a.width}x{a.height} px in A and {b.width}x{b.height} px in B",
            consequence=NOT_ONE,
            cure="Give two calibrations of one camera at one resolution",
        )


def _pixels(camera: Camera) -> Array:
    u, v = np.linspace(0, camera.width - 1, GRID), np.linspace(0, camera.height - 1, GRID)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _shift_effects(a: Camera, b: Camera, prefix: str) -> list[Effect]:
    """Return how far B images a ray of A from where A does, over the image and at its corners."""
    uv = _pixels(a)
    rays = np.column_stack([a.rays(uv), np.ones(len(uv))])
    shift = np.linalg.norm(b.project(rays) - uv, axis=1)
    corners = shift.reshape(GRID, GRID)[np.ix_([0, -1], [0, -1])]
    return [
        Effect(name=f"{prefix}shift over the image, RMS", value=float(np.sqrt(np.nanmean(shift**2))), unit="px"),
        Effect(name=f"{prefix}shift at the worst corner", value=float(np.nanmax(corners)), unit="px"),
    ]


def _space_effects(a: Rig, b: Rig, distance_m: float) -> list[Effect]:
    """Return how far B measures points from where A does, on a plane before the first camera that another one sees.

    Each is measured by all cameras that see it, and told in the axes of the first one.
    """
    eye = a.cameras[0]
    grid = _pixels(eye.camera)
    rays = np.column_stack([eye.camera.rays(grid), np.ones(len(grid))]) * distance_m
    points = eye.T_rig_camera.apply(rays[np.isfinite(rays).all(axis=1)])
    uv = np.stack(a.project(points), axis=1)  # (n, V, 2)
    sizes = np.array([[one.camera.width, one.camera.height] for one in a.cameras]) - 0.5
    shown: Mask = np.asarray(((uv > -0.5) & (uv < sizes)).all(axis=2))
    shown[:, 0] = True  # these are its own pixels
    seen = shown[:, 1:].any(axis=1)
    if not seen.any():
        return []
    noise = np.where(shown[seen][:, :, None, None], np.eye(2), np.inf)
    measured = triangulate_views(b, uv[seen], noise).xyz_m
    off = b.cameras[0].T_rig_camera.inv().apply(measured) - eye.T_rig_camera.inv().apply(points[seen])
    off = np.linalg.norm(off, axis=1)
    where = f"at {distance_m:.3g} m"
    return [
        Effect(name=f"points measured {where}, RMS", value=float(np.sqrt(np.nanmean(off**2))), unit="m"),
        Effect(name=f"points measured {where}, largest", value=float(np.nanmax(off)), unit="m"),
    ]


def _reach_effects(a: Arm, b: Arm) -> list[Effect]:
    """Return how far the flanges of both arms are apart, in the base's axes, at random postures within A's limits."""
    low, high = (np.array([getattr(joint, end) for joint in a.joints]) for end in ("lower", "upper"))
    low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
    q = np.random.default_rng(0).uniform(low, high, (POSTURES, a.n))
    bare = [arm.based() for arm in (a, b)]
    positions = [np.array([pose(arm, arm.sagged(row)).translation for row in q]) for arm in bare]
    off = np.linalg.norm(positions[1] - positions[0], axis=1)
    return [
        Effect(name="tool apart, RMS over postures", value=float(np.sqrt(np.mean(off**2))), unit="m"),
        Effect(name="tool apart, largest", value=float(off.max()), unit="m"),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """One number of a result: its name, value, and the unit that both are in."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """agree: None where it cannot be told; p: how often chance alone parts two results so far."""

    agree: bool | None
    p: float | None


def differences(
    a: Sequence[Value], b: Sequence[float], of_a: NamedCovariance | None, of_b: NamedCovariance | None
) -> list[Difference]:
    """Return the numbers of A beside those of B (same order); standard deviations as of independent results."""
    stds = [covariance.std() if covariance else {} for covariance in (of_a, of_b)]
    out = []
    for value, other in zip(a, b, strict=True):
        variance = sum(std.get(value.name, 0.0) ** 2 for std in stds)
        known = variance > 0.0 and bool(np.isfinite(variance))
        out.append(
            Difference(
                name=value.name,
                unit=value.unit,
                a=value.value,
                b=other,
                difference=other - value.value,
                std=float(np.sqrt(variance)) if known else None,
            )
        )
    return out


def judged(found: Sequence[Difference], of_a: NamedCovariance | None, of_b: NamedCovariance | None) -> Judgement:
    """Return whether all numbers agree, by chi-square with the sum of both covariances.

    A number that differs and of which neither result tells a standard deviation leaves it open.
    """
    known = [one for one in found if one.std is not None]
    silent = [one for one in found if one.std is None and abs(one.difference) > SAME * max(abs(one.a), abs(one.b))]
    if not known:
        return Judgement(agree=None, p=None)
    names = [one.name for one in known]
    total = _covariance(names, of_a) + _covariance(names, of_b)
    std = np.sqrt(np.diag(total))
    z = np.array([one.difference for one in known]) / std
    correlation = total / np.outer(std, std) + RIDGE * np.eye(len(z))
    p = float(chdtrc(len(z), float(z @ np.linalg.solve(correlation, z))))
    if p < BY_CHANCE:
        return Judgement(agree=False, p=p)
    return Judgement(agree=None if silent else True, p=p)


def judged_singly(found: Sequence[Difference]) -> Judgement:
    """Return whether all numbers agree where nobody tells how they hang together: by the worst one, which chance brings
    at most as often as one of so many (Bonferroni)."""
    worst = max((abs(one.sigmas) for one in found if one.sigmas is not None), default=None)
    if worst is None:
        return Judgement(agree=None, p=None)
    count = sum(one.sigmas is not None for one in found)
    p = min(1.0, count * 2.0 * float(ndtr(-worst)))
    return Judgement(agree=p >= BY_CHANCE, p=p)


def _covariance(names: Sequence[str], covariance: NamedCovariance | None) -> Array:
    """Return the covariance of the names (n, n), zero where the result holds a number as exact."""
    out = np.zeros((len(names), len(names)))
    if covariance is None:
        return out
    position = {name: i for i, name in enumerate(covariance.names)}
    at = [(k, position[name]) for k, name in enumerate(names) if name in position]
    here, there = [k for k, _ in at], [i for _, i in at]
    out[np.ix_(here, here)] = covariance.matrix[np.ix_(there, there)]
    return out
