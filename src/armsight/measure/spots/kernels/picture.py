"""What all kernels of spots share: the picture that they read, and small loops.

Rows are copied by loops: assigning slices would compile numba's formatting of shape errors into every kernel.
Constants and first values of counters are passed on as np.int64: a plain 0 would compile the callee a second time, for
that value.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from armsight._numba import lean_kernel


class Picture(NamedTuple):
    """An image: grey (h, w) uint8, contiguous, whose levels are grey ^ flip: flip 255 where lights are dark.

    saturation: the level from which a pixel is clipped. mask (h, w) uint8: 0 where pixels do not count; (0, 0): all do.
    """

    grey: Any
    flip: Any
    saturation: Any
    mask: Any


@lean_kernel
def copy_to(a, b):
    """Copy a (n,) to the first n entries of b."""
    for i in range(a.shape[0]):
        b[i] = a[i]


@lean_kernel
def insertion_sort(a, n):
    """Sort the first n entries of a in place (short lists only)."""
    for i in range(1, n):
        v = a[i]
        j = i - 1
        while j >= 0 and a[j] > v:
            a[j + 1] = a[j]
            j -= 1
        a[j + 1] = v
