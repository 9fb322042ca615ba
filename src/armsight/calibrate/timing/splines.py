"""Paths of lights as quintic B-splines over a uniform grid, found from rays by banded least squares.

With rays given, a path's coefficients are linear: a point X seen along the ray (x, y) of a camera fulfils
(R1 - x R3) X = x t3 - t1 and the like for y; over the depth this is the reprojection residual in px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from armsight.calibrate.timing import kernels

Array = NDArray[np.float64]

DEGREE = 5
ORDER = DEGREE + 1
RIDGE = 1e-14
"""Of the largest diagonal: keeps rounding from making a coefficient's pivot negative where nothing is seen."""


def _pieces() -> Array:
    """Return the polynomials (ORDER, ORDER): value of local basis j is sum_k pieces[j, k] u^k, u from 0 to 1."""
    bump = BSpline.basis_element(np.arange(ORDER + 1.0))
    u = np.linspace(0.1, 0.9, ORDER)
    values = np.stack([bump(DEGREE - j + u) for j in range(ORDER)], axis=1)
    return np.ascontiguousarray(np.linalg.solve(np.vander(u, increasing=True), values).T)


PIECES = _pieces()


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """n_cells cells of spacing_s from begin_s on; n_cells + DEGREE coefficients."""

    begin_s: float
    spacing_s: float
    n_cells: int

    @classmethod
    def over(cls, begin_s: float, end_s: float, spacing_s: float) -> Grid:
        """Return the grid that covers a span."""
        return cls(begin_s=begin_s, spacing_s=spacing_s, n_cells=int(np.ceil((end_s - begin_s) / spacing_s)))

    @property
    def n_coefficients(self) -> int:
        """For each coordinate."""
        return self.n_cells + DEGREE

    @property
    def middles(self) -> Array:
        """Middles of the cells in s."""
        return np.asarray(self.begin_s + (np.arange(self.n_cells) + 0.5) * self.spacing_s, dtype=np.float64)

    def inside(self, t_s: Array) -> bool:
        """Tell whether all times lie on it."""
        return bool(((t_s >= self.begin_s) & (t_s <= self.begin_s + self.n_cells * self.spacing_s)).all())

    def basis(self, t_s: Array, derivative: int = 0) -> tuple[NDArray[np.intp], Array]:
        """Return the first coefficient (m,) that counts at each time, and the weights (m, ORDER)."""
        x = (t_s - self.begin_s) / self.spacing_s
        cell = np.clip(np.floor(x).astype(np.intp), 0, self.n_cells - 1)
        u = x - cell
        powers = np.zeros((len(x), ORDER))
        for k in range(derivative, ORDER):
            factor = np.prod(np.arange(k, k - derivative, -1.0)) if derivative else 1.0
            powers[:, k] = factor * u ** (k - derivative)
        return cell, powers @ PIECES.T / self.spacing_s**derivative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Linear equations values . coefficients = right (m,).

    columns, values (m, k): unknowns that each row touches, ascending.
    """

    columns: NDArray[np.intp]
    values: Array
    right: Array


class Band:
    """Normal equations of rows, factorised; width: how far columns of a row are apart at most."""

    def __init__(self, parts: Sequence[Rows], size: int, width: int) -> None:
        band, self._b = np.zeros((width + 1, size)), np.zeros(size)
        for rows in parts:
            kernels.add_rows(rows.columns, rows.values, rows.right, band, self._b)
        band[0] += RIDGE * band[0].max()
        self._factor = cholesky_banded(band, lower=True, check_finite=False)

    def solution(self) -> Array:
        """Return the coefficients (size,)."""
        return self.solve(self._b)

    def solve(self, right: Array) -> Array:
        """Return the solution for right-hand sides (size,) or (size, q)."""
        return np.asarray(cho_solve_banded((self._factor, True), right, check_finite=False))


def times(rows: Rows, x: Array) -> Array:
    """Return the rows times x (size, q): (m, q)."""
    out = np.empty((len(rows.right), x.shape[1]))
    kernels.rows_times(rows.columns, rows.values, np.ascontiguousarray(x), out)
    return out


def transposed_times(parts: Sequence[Rows], y: Sequence[Array], size: int) -> Array:
    """Return the transposed rows of all parts times y (m, q) of each: (size, q)."""
    out = np.zeros((size, y[0].shape[1]))
    for rows, each in zip(parts, y, strict=True):
        kernels.transposed_times(rows.columns, rows.values, np.ascontiguousarray(each), out)
    return out
