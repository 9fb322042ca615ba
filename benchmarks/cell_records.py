"""A simulated cell's recording as the product's records, and how far the tip is off by what was calibrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import Arm
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.setup import Setup
from armsight.optics import Rig
from armsight.records import Spots, SpotTrack, Target, spot_target
from armsight.store.arm_file import arm_from_mapping

Array = NDArray[np.float64]
EXACT_PX = 1e-3


def track_of(track: Any) -> SpotTrack:
    """Return a camera's recording as the product has it, without names."""
    return SpotTrack(
        t_s=track.t_s,
        frame=track.frame,
        names=("",) * len(track.frame),
        uv_px=track.uv_px,
        covariance_px2=track.covariance_px2,
    )


def arm_of(world: Any) -> Arm:
    """Return the maker's arm."""
    return arm_from_mapping(world.nominal)


def target_of(world: Any) -> Target:
    """Return the target as it was built."""
    return spot_target(world.target)


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """What a calibration hands out to measure with: rig, target, T_base_rig.

    commanded: T_base_target (m, 4, 4) by the calibrated arm, from its joints (m, 6). T_nominal: where the target's
    nominal axes are in those of `target`, by which the tip is known.
    """

    rig: Rig
    target: Target
    T_base_rig: RigidTransform
    T_nominal: RigidTransform
    commanded: Callable[[Array], Array]


def called_as_built(target: Target, world: Any) -> Target:
    """Return the target with the names of the lights as built: the order in which the shapes agree best."""
    nominal = np.array(list(world.target.values()))

    def off(order: tuple[int, ...]) -> float:
        a, b = target.xyz_m[list(order)], nominal
        return float(Rotation.align_vectors(a - a.mean(axis=0), b - b.mean(axis=0))[1])

    order = list(min(permutations(range(len(nominal))), key=off))
    rows = (3 * np.array(order)[:, None] + np.arange(3)).ravel()
    places = dict(zip(world.target, map(tuple, target.xyz_m[order].tolist()), strict=True))
    return spot_target(places, covariance=None if target.covariance is None else target.covariance[np.ix_(rows, rows)])


def nominal_axes(target: Target, world: Any) -> RigidTransform:
    """Return T_target_nominal: the nominal shape laid on the target's lights of the same names."""
    a, b = target.xyz_m, np.array([world.target[name] for name in target.names])
    turn, _ = Rotation.align_vectors(a - a.mean(axis=0), b - b.mean(axis=0))
    return RigidTransform.from_components(a.mean(axis=0) - turn.apply(b.mean(axis=0)), turn)


def tip_errors(world: Any, found: Calibrated) -> tuple[Array, int]:
    """Return the errors (k, 3) of the measured tip in base axes at the world's samples, and how many gave no pose."""
    truth, out, lost = world.truth, [], 0
    setup = Setup(rig=found.rig, target=found.target)
    q = truth.samples
    T = truth.flange(q)
    points = np.einsum("mij,lj->mli", T[:, :3, :3], truth.lights) + T[:, None, :3, 3]
    uv = [camera.project(points) for camera in (truth.left, truth.right)]
    at = found.T_nominal.apply(truth.tip_target_m)
    for k, tip in enumerate(truth.tips(q)):
        left, right = (Spots.of_centres(side[k], EXACT_PX**2 * np.eye(2)) for side in uv)
        pose = measure_spots(setup, 0.0, left, right).pose
        if pose.T_parent_target is None or pose.status.size != 6:
            lost += 1
            continue
        T_rig = RigidTransform.from_matrix(np.asarray(pose.T_parent_target))
        out.append((found.T_base_rig * T_rig).apply(at) - tip)
    return np.array(out).reshape(-1, 3), lost


def commanded_errors(world: Any, found: Calibrated) -> Array:
    """Return the errors (k, 3) of the tip where the calibrated arm's joints say that it is, in base axes."""
    truth = world.truth
    T = found.commanded(truth.samples)
    at = found.T_nominal.apply(truth.tip_target_m)
    return np.asarray(T[:, :3, :3] @ at + T[:, :3, 3] - truth.tips(truth.samples))
