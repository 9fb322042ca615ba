"""How all kernels are compiled: nothing else in the package names numba's njit.

error_model numpy: a division by zero gives inf or NaN, which callers test for, in place of a branch that raises: exact
data must never raise from within compiled code, and the branches cost half of the time to compile. cache: compiled
once per machine. nogil: threads may run beside each other.
"""

from numba import njit, prange

kernel = njit(cache=True, nogil=True, error_model="numpy")
"""For everything: results are the same on every machine with the same numba."""

fast_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
"""Products and sums may be fused: for the hottest paths, where the last digit does not matter."""

sum_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
"""Sums may also be reordered into vector lanes: for sums over pixels and residuals."""

inline_kernel = njit(cache=True, nogil=True, error_model="numpy", inline="always")
"""Put into its callers whole: for functions of a few lines in the innermost loop."""

parallel_kernel = njit(cache=True, nogil=True, error_model="numpy", parallel=True)
"""Runs on all cores, with prange."""

__all__ = ["fast_kernel", "inline_kernel", "kernel", "parallel_kernel", "prange", "sum_kernel"]
