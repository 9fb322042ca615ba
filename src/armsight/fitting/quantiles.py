"""Chances and quantiles of the chi-squared, F and Student distributions, as scipy.stats gives them.

From scipy.special: to import scipy.stats takes longer than most commands need to begin. Arguments are numbers or
arrays, whose shapes broadcast to that of what is returned; without degrees of freedom it is NaN.
"""

from __future__ import annotations

import numpy as np
import scipy  # loads its special functions where they are used
from numpy.typing import ArrayLike

from armsight.arrays import Array, Mask


def chi2_sf(x: ArrayLike, dof: ArrayLike) -> Array:
    """Return the chance of more than x."""
    return _array(scipy.special.chdtrc(_array(dof), np.maximum(_array(x), 0.0)))


def chi2_isf(chance: ArrayLike, dof: ArrayLike) -> Array:
    """Return what is exceeded with this chance."""
    return _array(np.where(_array(dof) > 0.0, scipy.special.chdtri(_array(dof), _array(chance)), np.nan))


def chi2_ppf(part: ArrayLike, dof: ArrayLike) -> Array:
    """Return what this part stays below."""
    return _array(2.0 * scipy.special.gammaincinv(_array(dof) / 2.0, _array(part)))


def f_sf(x: ArrayLike, dof1: ArrayLike, dof2: ArrayLike) -> Array:
    """Return the chance of more than x."""
    return _array(scipy.special.fdtrc(_array(dof1), _array(dof2), np.maximum(_array(x), 0.0)))


def f_isf(chance: ArrayLike, dof1: ArrayLike, dof2: ArrayLike) -> Array:
    """Return what is exceeded with this chance."""
    return _array(scipy.special.fdtri(_array(dof1), _array(dof2), 1.0 - _array(chance)))


def t_sf(x: ArrayLike, dof: ArrayLike) -> Array:
    """Return the chance of more than x, of Student's t."""
    return _array(scipy.special.stdtr(_array(dof), -_array(x)))


def t_ppf(part: ArrayLike, dof: ArrayLike) -> Array:
    """Return what this part stays below, of Student's t; dof may be infinite."""
    return _array(scipy.special.stdtrit(_array(dof), _array(part)))


def student_factor(dof: ArrayLike) -> Array:
    """Return by how much a 95 % interval of Student's t is wider than a Gaussian's."""
    return t_ppf(0.975, dof) / NORMAL_95


def _array(values: ArrayLike) -> Array:
    return np.asarray(values, dtype=np.float64)


# Chauvenet's criterion for readings that do not belong to the rest.


def chauvenet(values: Array) -> Mask:
    """Return which of the values (n,) or rows (n, k) Chauvenet's criterion keeps, applied once, column by column.

    Holman, Experimental Methods for Engineers (1994): a reading goes where fewer than half a reading as far away is
    expected of n normal ones.
    """
    rows = values.reshape(len(values), -1)
    spread = rows.std(axis=0, ddof=1)
    away = np.abs(rows - rows.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    return np.asarray((len(values) * scipy.special.erfc(away / np.sqrt(2.0)) >= 0.5).all(axis=1))


MEDIAN_3 = 2.3659738843753377
"""Median of a squared length of three unit normals, chi2_ppf(0.5, 3): the noise comes from the median,
which gross errors leave alone."""
NORMAL_95 = 1.959964
"""Half-width of a Gaussian's 95 % interval in standard deviations."""
