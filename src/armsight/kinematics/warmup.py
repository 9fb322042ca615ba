"""Compiling ahead of time, so that no control loop waits for it."""

from __future__ import annotations

import numpy as np

from armsight.kinematics.derivatives import parameter_jacobian
from armsight.kinematics.forward_kinematics import fk, fk_jacobian, link_frames
from armsight.kinematics.inverse_kinematics import ik, ik_many, in_range
from armsight.kinematics.numeric import Method, solve_numeric, solve_numeric_many
from armsight.kinematics.presets import ur10


def warm_up() -> None:
    """Compile, or load from the cache, everything that this package runs but the kernels for all cores.

    Half a minute the first time, a second from the cache. Kernels do not depend on the arm.
    """
    arm = ur10()
    q = np.array([0.3, -1.0, 1.2, 0.4, 0.9, 0.1])
    T = fk(arm, q)
    fk(arm, q[None])
    fk_jacobian(arm, q)
    fk_jacobian(arm, q[None])
    link_frames(arm, q)
    parameter_jacobian(arm, q)
    ik(arm, T, q)
    ik_many(arm, T)
    in_range(arm, q, q)
    solve_numeric_many(arm, T, q[None])
    for method in Method:
        solve_numeric(arm, T, q, method=method)
