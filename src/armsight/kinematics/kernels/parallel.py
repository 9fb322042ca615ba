"""The batched kernels on all cores. They stand apart: they take longer to compile, and only big batches need them."""

from __future__ import annotations

from armsight._numba import parallel_kernel, prange
from armsight.kinematics.kernels.chain import many_poses, many_poses_jacobians

CHUNK = 4096
"""Poses handed to a core at a time: about a quarter of a millisecond of work."""


@parallel_kernel
def many_poses_on_all_cores(chain, q, T):
    """Fill T (m, 4, 4) with T_world_tool at each row of q (m, n), chunks spread over the cores."""
    m = q.shape[0]
    for k in prange((m + CHUNK - 1) // CHUNK):
        stop = min(m, (k + 1) * CHUNK)
        many_poses(chain, q[k * CHUNK : stop], T[k * CHUNK : stop])


@parallel_kernel
def many_poses_jacobians_on_all_cores(chain, q, T, J):
    """Fill T (m, 4, 4) and J (m, 6, n) in world axes at each row of q (m, n), chunks spread over the cores."""
    m = q.shape[0]
    for k in prange((m + CHUNK - 1) // CHUNK):
        stop = min(m, (k + 1) * CHUNK)
        many_poses_jacobians(chain, q[k * CHUNK : stop], T[k * CHUNK : stop], J[k * CHUNK : stop])
