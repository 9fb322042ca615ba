"""Whether joints that give way under the arm's weight explain what would else be other gears.

A joint that sags turns by its compliance times the torque of what it carries. The masses are not known here; the torque
of a weight at the tool, the lever in m by which it turns the joint, stands for them. Over a joint's range that lever
looks much like the joint's own value: elastic arms seem to turn by 1 to 3 % more or less than they read.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.arm.fit import ArmFit, Tolerance
from armsight.calibrate.arm.model import THETA, ArmModel, D
from armsight.calibrate.arm.points import ArmPoints
from armsight.kinematics import fk_jacobian

Array = NDArray[np.float64]

MOST_SAG = 0.05
"""What a joint is believed to give way by, rad per metre of lever: a humanoid's shoulder carries 10 kg on 1e-3 rad/Nm
and moves by 0.1, an industrial arm's by 0.001."""
STEPS = 4
"""Gauss-Newton steps to all rows; from where the scales have been taken back errors are small."""
FOLDS = 5


def lever_m(model: ArmModel, q: Array) -> Array:
    """Return (m, n) the lever in m by which a weight at the tool turns each joint; the world's z, where the nominal
    base stands in it, is up."""
    return np.asarray(-fk_jacobian(model.arm, q)[1][:, 2])


def sag_left_out(model: ArmModel, points: ArmPoints, fitted: ArmFit, tolerance: Tolerance) -> Array:
    """Return the error (m,) in m at rows left out, of a fit in which sagging joints take the place of scales.

    fitted: with geometry and scales free. All rows of one joint position, or block of time, are left out together.
    """
    n, m = model.arm.n, len(points)
    scales = {f"{joint.name}.scale" for joint in model.arm.joints}
    index = [k for k, name in enumerate(model.names) if name in fitted.free and name not in scales]
    zeros = [5 * k + (THETA if turns else D) for k, turns in enumerate(model.arm.revolute)]
    drive = [5 * n + k for k in range(n)]  # the scales
    p, sag, lever = np.array(fitted.p), np.zeros(n), lever_m(model, points.q)
    p[drive], sign = 0.0, np.array([joint.sign for joint in model.arm.joints])
    believed = np.array([tolerance.of(model.names[k]) if k < model.n_geometry else np.inf for k in index])
    prior = np.concatenate([believed, np.full(n, MOST_SAG)]) ** -2
    none = np.zeros((1, 0))

    def moved(step: Array) -> tuple[Array, Array]:
        whole = np.zeros(len(p))
        whole[index] = step[: len(index)]
        return model.retract(p, none, whole, none)[0], sag + step[len(index) :]

    def off(q: Array, c: Array, rows: NDArray[np.intp]) -> Array:
        given = points.take(rows)
        return model.errors(q, replace(given, q=given.q + lever[rows] * c))[0]

    every = np.arange(m)
    for last in [False] * STEPS + [True]:
        J = model.predict(p, replace(points, q=points.q + lever * sag))[1][:, :3]
        A = np.concatenate([J[:, :, index], J[:, :, zeros] * (sign * lever)[:, None, :]], axis=2) / fitted.sigma_m
        r = off(p, sag, every) / fitted.sigma_m
        weight = np.minimum(1.0, 4.0 / np.maximum(np.linalg.norm(r, axis=1), 1e-9))
        H = np.einsum("m,mki,mkj->ij", weight, A, A) + np.diag(prior + 1e-6)
        g = np.einsum("m,mki,mk->i", weight, A, r) + prior * np.concatenate([_own(model, p, index), sag])
        if last:
            break
        p, sag = moved(-np.linalg.solve(H, g))
    out, fold = np.empty(m), points.group % FOLDS
    for k in range(int(fold.max()) + 1):
        rows = np.flatnonzero(fold == k)
        w, B, own = weight[rows], A[rows], r[rows]
        rest = H - np.einsum("m,mki,mkj->ij", w, B, B)
        step = -np.linalg.solve(rest, g - np.einsum("m,mki,mk->i", w, B, own))
        out[rows] = np.linalg.norm(off(*moved(step), rows), axis=1)
    return out


def _own(model: ArmModel, p: Array, index: list[int]) -> Array:
    """Return the changes to the nominal arm among the parameters fitted; 0 for base and tools."""
    return np.array([p[k] if k < model.n_geometry else 0.0 for k in index])
