"""Which poses to add: those that would lower the uncertainty most, within reach and with the target in view."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.kernels import fit as kernels
from armsight.calibrate.handeye.pairs import Arrays, Setup, components
from armsight.calibrate.handeye.result import HandEye, Proposal
from armsight.errors import Inconsistent
from armsight.units import DEG

N_CANDIDATES = 600
PROPOSAL_SEED = 1994
TILT_RAD = 35.0 * DEG
"""Candidates are tilted up to this far from the mean view: further, the corners of a flat target get poor."""

ROLL_RAD = 60.0 * DEG
MARGIN = 0.15
"""The flange stays within the box of its poses so far, widened by this share of its size."""

LEAST_BOX_M = 0.05


def propose(result: HandEye, n: int, reachable: Callable[[RigidTransform], bool] | None = None) -> tuple[Proposal, ...]:
    """Return the n next poses that lower the uncertainty of the camera's place most, one after the other (greedy).

    reachable: tells whether the robot can go to T_base_flange; without it the box of the poses so far, a little wider,
    stands for its reach. The target stays where the camera has seen it: between the nearest and furthest distance, and
    within the angles off the optical axis, so far. Raises Inconsistent where no candidate is left.
    """
    if n < 1:
        raise Inconsistent(f"{n} poses cannot be proposed", cure="Ask for one or more")
    flange, camera = _candidates(result, reachable)
    arrays = _arrays(result.setup, flange, camera)
    J = _whitened(result, arrays)  # (m, 6, 12)
    information = np.linalg.inv(result.covariance.matrix / result.coverage_factor**2)
    scale = np.sqrt(np.diag(result.covariance.matrix))[:6]
    out = []
    left = np.arange(len(J))
    for _ in range(min(n, len(J))):
        C = np.linalg.inv(information[None] + J[left].transpose(0, 2, 1) @ J[left])  # (m, 12, 12)
        # A-optimal: the sum of the variances of the camera's pose, each over today's, so that m and rad add up
        gain = (np.einsum("maa->ma", C)[:, :6] / scale**2).sum(axis=1)
        best = int(np.argmin(gain))
        k = int(left[best])
        information = information + J[k].T @ J[k]
        out.append(
            Proposal(
                T_base_flange=flange[k],
                T_camera_target=camera[k],
                expected_std_m=float(np.sqrt(np.diag(C[best])[:3].max())),
            )
        )
        left = np.delete(left, best)
    return tuple(out)


def _candidates(
    result: HandEye, reachable: Callable[[RigidTransform], bool] | None
) -> tuple[RigidTransform, RigidTransform]:
    """Return stacks of T_base_flange and T_camera_target."""
    rng = np.random.default_rng(PROPOSAL_SEED)
    seen = result.pairs.T_camera_target[np.flatnonzero(result.used)]
    t = seen.translation
    slope = np.abs(t[:, :2] / t[:, 2:]).max(axis=0)
    z = rng.uniform(t[:, 2].min(), t[:, 2].max(), N_CANDIDATES)
    xyz_m = np.column_stack(
        [rng.uniform(-slope[0], slope[0], N_CANDIDATES) * z, rng.uniform(-slope[1], slope[1], N_CANDIDATES) * z, z]
    )
    direction = rng.uniform(0.0, 2.0 * np.pi, N_CANDIDATES)
    tilt = TILT_RAD * np.sqrt(rng.uniform(0.0, 1.0, N_CANDIDATES))
    tilts = Rotation.from_rotvec(np.column_stack([tilt * np.cos(direction), tilt * np.sin(direction), 0.0 * tilt]))
    rolls = Rotation.from_rotvec(np.outer(rng.uniform(-ROLL_RAD, ROLL_RAD, N_CANDIDATES), [0.0, 0.0, 1.0]))
    camera = RigidTransform.from_components(xyz_m, tilts * seen.rotation.mean() * rolls)
    if result.setup is Setup.EYE_IN_HAND:
        flange = result.T_parent_target * camera.inv() * result.T_parent_camera.inv()
    else:
        flange = result.T_parent_camera * camera * result.T_parent_target.inv()
    if reachable is None:
        visited = result.pairs.T_base_flange.translation
        low, high = visited.min(axis=0), visited.max(axis=0)
        margin = np.maximum(MARGIN * (high - low), LEAST_BOX_M)
        fine = ((flange.translation >= low - margin) & (flange.translation <= high + margin)).all(axis=1)
    else:
        fine = np.array([reachable(flange[i]) for i in range(N_CANDIDATES)])
    index = np.flatnonzero(fine)
    if not len(index):
        raise Inconsistent(
            "no further pose with the target in view is within reach",
            consequence="No pose is proposed",
            cure="Move the target, or give the robot's true reach",
        )
    return flange[index], camera[index]


def _arrays(setup: Setup, flange: RigidTransform, camera: RigidTransform) -> Arrays:
    F = flange if setup is Setup.EYE_IN_HAND else flange.inv()
    return (*components(F), *components(camera))


def _whitened(result: HandEye, arrays: Arrays) -> Array:
    """Return (m, 6, 12): the whitened derivatives of the poses that would be seen."""
    n = len(arrays[0])
    e, J, lever = np.empty((n, 6)), np.empty((n, 6, 12)), np.empty(n)
    noise = result.noise
    theta = np.array([noise.translation_m.size**2, noise.camera_rad.size**2, noise.robot_rad.size**2])
    RX, tX = components(result.T_parent_camera)
    RZ, tZ = components(result.T_parent_target)
    observed = arrays, np.ones(n, bool), result.setup is Setup.EYE_TO_HAND
    kernels.weigh(((RX, tX), (RZ, tZ), 1.0), observed, np.maximum(theta, [1e-14, 1e-14, 0.0]), e, J, lever)
    return J
