"""Small loops that many kernels share.

Rows are copied by loops: assigning slices would compile numba's formatting of shape errors into every kernel.
Constants and first values of counters are passed on as np.int64: a plain 0 would compile the callee a second time, for
that value.
"""

from armsight._numba import inner_kernel


@inner_kernel
def copy_to(a, b):
    """Copy a (n,) to the first n entries of b."""
    for i in range(a.shape[0]):
        b[i] = a[i]


@inner_kernel
def insertion_sort(a, n):
    """Sort the first n entries of a in place (short lists only)."""
    for i in range(1, n):
        v = a[i]
        j = i - 1
        while j >= 0 and a[j] > v:
            a[j + 1] = a[j]
            j -= 1
        a[j + 1] = v
