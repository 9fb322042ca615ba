"""The columns of poses and of covariances: standard deviations, and beside them the upper triangle of the matrix."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from armsight.arrays import Array
from armsight.columns import POSE6_STD, POSITION, QUATERNION
from armsight.errors import BadFile, Inconsistent
from armsight.store.codec import LARGEST, named
from armsight.store.tables import Table

AXES = ("x", "y", "z", "rx", "ry", "rz")
SYSTEMATIC = tuple(f"sys_{name}" for name in POSE6_STD)
LIGHTS = ("lights_x_m", "lights_y_m", "lights_z_m")
LIGHTS_STD = tuple(f"s{name}" for name in LIGHTS)
COVARIANCE = tuple(f"cov_{a}_{b}" for a, b in combinations(AXES, 2))
"""Of a pose, row by row above the diagonal; m and rad, in the axes of sx_m .. srz_rad."""
_ABOVE = tuple(combinations(range(len(AXES)), 2))
SYSTEMATIC_COVARIANCE = tuple(f"sys_{name}" for name in COVARIANCE)
VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
VELOCITY_STD = tuple(f"s{name}" for name in VELOCITY)
POSE_COLUMNS = ("t_s", *POSITION, *QUATERNION, *POSE6_STD, "status", "spots")
"""Of every poses.csv; behind them those of POSE_EXTRAS that the poses have."""
POSE_EXTRAS = (*SYSTEMATIC, *LIGHTS, *LIGHTS_STD, *VELOCITY, *VELOCITY_STD, *COVARIANCE, *SYSTEMATIC_COVARIANCE)
POINT_COVARIANCE = tuple(f"cov_{a}_{b}" for a, b in combinations(AXES[:3], 2))
"""Of a position."""

POSITION_COVARIANCE = (*POSE6_STD[:3], *POINT_COVARIANCE)
"""Of a position measured of an arm."""
CAMERA_COVARIANCE = tuple(f"camera_target_{name}" for name in (*POSE6_STD, *COVARIANCE))
"""Of the camera's pose in a pairs.csv."""

NOT_POSITIVE = 1e-9
"""Least eigenvalue of a correlation matrix, below zero, that rounding explains (of one written in full: 1e-15)."""
UNCORRELATED = "holds standard deviations only: its errors are taken as uncorrelated between the axes"


def above_diagonal(covariance: Array | None) -> list[float]:
    """Return the 15 cells of a covariance (6, 6); of a (3, 3) those of the position, NaN for the rest."""
    rows = [] if covariance is None else covariance.tolist()
    return [rows[i][j] if j < len(rows) else math.nan for i, j in _ABOVE]


def has_correlations(names: Mapping[str, object], lead: str = "") -> bool:
    """Whether a table with these columns tells how the errors of a position are related."""
    return f"{lead}{POINT_COVARIANCE[0]}" in names


def covariances(table: Table, std: Array, rows: Sequence[int], lead: str = "") -> Array:
    """Return the covariances (n, k, k) of rows of a table with standard deviations (n, k), k 3 or 6.

    Cells that are empty, or columns that are not there, are correlations of nought. lead: of the columns' names. Raises
    BadFile where a matrix is no covariance, or where only some of its columns are there.
    """
    k = std.shape[1]
    out = np.zeros((len(std), k, k))
    out[:, range(k), range(k)] = std**2
    pairs = list(combinations(range(k), 2))
    names = [f"{lead}cov_{AXES[i]}_{AXES[j]}" for i, j in pairs]
    there = [name for name in names if name in table.numbers]
    if not there or not len(std):
        return out
    if len(there) < len(names):
        missing = next(name for name in names if name not in table.numbers)
        raise BadFile(
            f"{table.location(rows[0])}: the column {missing} is missing beside {there[0]}",
            cure="Give the whole upper triangle of the covariance, or standard deviations only",
        )
    at = np.asarray(rows, dtype=np.intp)
    for (i, j), name in zip(pairs, names, strict=True):
        cells = np.nan_to_num(table.numbers[name][at])
        out[:, i, j] = out[:, j, i] = cells
    _require_positive(table, out, std, rows)
    return out


def all_covariances(table: Table, path: Path, k: int, what: str, lead: str = "") -> tuple[Array | None, str]:
    """Return the covariances (n, k, k) of a table's rows, None where not every row has them; and what to say of that.

    what: they are of, in words. lead: of the columns' names.
    """
    names = [f"{lead}{name}" for name in POSE6_STD[:k]]
    if not any(name in table.numbers for name in names):
        return None, ""
    std = np.column_stack([table.numbers.get(name, np.full(len(table), np.nan)) for name in names])
    without = ~(std > 0.0).all(axis=1)  # an empty cell is NaN
    if without.any():
        rows = f"{without.sum()} of {len(table)} rows have not all {'three' if k == 3 else 'six'} of them"
        return None, f"{path.name}: the standard deviations of {what} are not used: {rows}"
    related = has_correlations(table.numbers, lead)
    return covariances(table, std, range(len(table)), lead), "" if related else f"{path.name} {UNCORRELATED}"


def pose_covariances(table: Table, sizes: Sequence[int], of_lights: set[int]) -> dict[int, tuple[Array, Array | None]]:
    """Return by row of a poses.csv the covariance, and the part of it that repeats where that is told.

    sizes: what is known of each row (PoseStatus.size); of_lights: the rows whose position is that of the lights. Raises
    BadFile.
    """
    out: dict[int, tuple[Array, Array | None]] = {}
    kinds: dict[tuple[int, bool], list[int]] = {}
    for row, size in enumerate(sizes):
        if size:
            kinds.setdefault((size, row in of_lights), []).append(row)
    for (size, lights), rows in kinds.items():
        std, shared = (
            np.column_stack([table.numbers.get(name, np.full(len(sizes), np.nan))[rows] for name in names[:size]])
            for names in (LIGHTS_STD if lights else POSE6_STD, SYSTEMATIC)
        )
        for part in (std, shared):
            bad = ((part < 0.0) | (part > LARGEST)).any(axis=1)
            if bad.any():
                with named(table.location(rows[int(np.argmax(bad))])):
                    raise Inconsistent(f"a standard deviation is negative or larger than {LARGEST:g}")
        whole = covariances(table, np.nan_to_num(std), rows)
        given = [i for i, row in enumerate(shared) if not np.isnan(row).any()]
        repeats = dict(zip(given, covariances(table, shared[given], [rows[i] for i in given], "sys_"), strict=True))
        out |= {row: (whole[i], repeats.get(i)) for i, row in enumerate(rows)}
    return out


def _require_positive(table: Table, covariance: Array, std: Array, rows: Sequence[int]) -> None:
    related = np.flatnonzero(np.abs(covariance).sum(axis=(1, 2)) > (std**2).sum(axis=1))  # any cell beside the diagonal
    if not related.size:
        return
    C, s = covariance[related], std[related]
    scale = np.where(s > 0.0, s, 1.0)
    with np.errstate(over="ignore"):
        correlation = C / (scale[:, :, None] * scale[:, None, :])
    impossible = ((s == 0.0)[:, :, None] & (C != 0.0)).any(axis=(1, 2)) | ~(np.abs(correlation) <= 1.0 + 1e-9).all(
        axis=(1, 2)
    )
    safe = np.where(impossible[:, None, None], 0.0, correlation)
    impossible |= np.linalg.eigvalsh(safe)[:, 0] < -NOT_POSITIVE
    if impossible.any():
        row = rows[int(related[int(np.argmax(impossible))])]
        raise BadFile(
            f"{table.location(row)}: its columns cov_... are no covariance beside its standard deviations",
            cure="Write covariances in m and rad, in the axes of the standard deviations",
        )


def uncorrelated_note(path: Path, covariances: Array | None) -> str:
    """Return what is to be said of a file's covariances (n, 6, 6) that hold standard deviations alone."""
    uncorrelated = covariances is not None and not (covariances * (1.0 - np.eye(6))).any()
    return f"{path.name} {UNCORRELATED}" if uncorrelated else ""
