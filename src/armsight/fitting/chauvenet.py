"""Chauvenet's criterion for readings that do not belong to the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

Array = NDArray[np.float64]


def chauvenet(values: Array) -> NDArray[np.bool_]:
    """Return which of the values (n,) or rows (n, k) Chauvenet's criterion keeps, applied once, column by column.

    Holman, Experimental Methods for Engineers (1994): a reading goes where fewer than half a reading as far away is
    expected of n normal ones.
    """
    rows = values.reshape(len(values), -1)
    spread = rows.std(axis=0, ddof=1)
    away = np.abs(rows - rows.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    return np.asarray((len(values) * erfc(away / np.sqrt(2.0)) >= 0.5).all(axis=1))
