"""Which joint positions would tell two explanations apart."""

from __future__ import annotations

import numpy as np

from armsight.arrays import Array
from armsight.kinematics import fk_jacobian
from armsight.verify.evidence import Case
from armsight.verify.model import Model, ModelFit
from armsight.verify.records import Measured

DECIDING_POSES = 6
CANDIDATES, SEED = 400, 11
"""Joint positions looked at, drawn evenly over what the arm may do; the same rows give the same proposal."""
OPEN_RAD, OPEN_M = np.pi, 0.3
"""Range of a joint without limits, or with wider ones, to either side of the middle of the rows'."""


def deciding_poses(case: Case, fitted: ModelFit, joints: tuple[int, ...]) -> Array:
    """Return joint values (k, n), in the order of their worth, that would best tell the zeros of these joints (from 0)
    from each other and from base and tool."""
    rng = np.random.default_rng(SEED)
    bare, middle = case.bare, case.q.mean(axis=0)
    span = np.where(bare.revolute, OPEN_RAD, OPEN_M)
    low, high = np.maximum(bare.lower, middle - span), np.minimum(bare.upper, middle + span)
    q = rng.uniform(low, high, (CANDIDATES, bare.n))
    sigma = np.median(fitted.noise.sigma, axis=0)
    chosen, _ = best_poses(case, fitted.p, sigma, joints, q, DECIDING_POSES)
    return q[chosen]


def best_poses(
    case: Case, p: Array, sigma: Array, joints: tuple[int, ...], q: Array, count: int
) -> tuple[list[int], Array]:
    """Return which of the joint positions q (c, n) to measure beside the case's, in the order of their worth, and the
    covariances (k + 1, j, j) of the joints' zeros: with all of them, then with each left out.

    p: base and tool. sigma (2,): noise of a coordinate in m and of a turn in rad.
    """
    n_joints = len(joints)
    width = len(case.free) + n_joints
    here = np.empty((0, width))
    if len(case.q):
        here = _columns(case, case.q, p, sigma, joints).reshape(-1, width)
    there = _columns(case, q, p, sigma, joints)
    every = there.reshape(-1, width)
    H = here.T @ here
    scale = np.sqrt(np.maximum(np.diag(H) + np.diag(every.T @ every), 1e-300))
    H = H / np.outer(scale, scale) + 1e-9 * np.eye(len(H))
    there = there / scale
    gained = np.swapaxes(there, 1, 2) @ there  # (c, width, width)
    chosen: list[int] = []
    for _ in range(min(count, len(q))):
        left_open = _log_det_covariance(H + gained, n_joints)
        left_open[chosen] = np.inf
        best = int(np.argmin(left_open))
        chosen.append(best)
        H = H + gained[best]
    less = [H, *(H - gained[k] for k in chosen)]
    own = scale[-n_joints:]
    return chosen, np.array([np.linalg.inv(h)[-n_joints:, -n_joints:] / np.outer(own, own) for h in less])


def _log_det_covariance(H: Array, n_joints: int) -> Array:
    """Return (c,) the log determinants of the covariances of the last parameters, of information (c, k, k)."""
    inverse = np.linalg.inv(H)[:, -n_joints:, -n_joints:]
    return np.asarray(np.linalg.slogdet(inverse)[1])


def _columns(case: Case, q: Array, mounts: Array, sigma: Array, joints: tuple[int, ...]) -> Array:
    """Return the whitened columns (m, rows, B + joints) of base, tool and the joints' zeros at joint values q."""
    F, J = fk_jacobian(case.bare, q)
    label = case.measured.labels[0]
    points = _placed(case, len(q), label)
    more = J[:, :, list(joints)]
    model = Model(measured=points, expected=lambda _: (F, more), extra=tuple(f"zero{i}" for i in joints))
    names = [name for name in case.free if name.split(".")[0] in ("base", _tool(label))]
    p = np.concatenate([mounts[:12], np.zeros(len(joints))])
    _, columns = model.linearised(p)
    out = np.zeros((*columns.shape[:2], len(case.free) + len(joints)))
    for k, name in enumerate(case.free):
        if name in names:
            out[:, :, k] = columns[:, :, model.names.index(name)]
    out[:, :, len(case.free) :] = columns[:, :, 12:]
    return np.asarray(out / np.repeat(sigma, 3)[: columns.shape[1]][:, None])


def _tool(label: str) -> str:
    return f"tool:{label}" if label else "tool"


def _placed(case: Case, m: int, label: str) -> Measured:
    """Return m rows in any position: only what moves with the joints counts."""
    rotation = None if case.measured.rotation is None else np.tile(np.eye(3), (m, 1, 1))
    return Measured(xyz_m=np.zeros((m, 3)), rotation=rotation, point=(label,) * m)
