"""Answers are believed as far as regions of the rows agree on them."""

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.correlation import widened
from armsight.fitting.groups import regions

Array = NDArray[np.float64]


def fitted(seed: int, wrong: float, rows: int = 60) -> tuple[Array, Array, Array]:
    """Return the covariance of a line's two values, the same widened, and its errors; wrong: a term left out."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, rows)
    J = np.stack([x, np.ones(rows)], axis=1)[:, None]
    y = rng.normal(0.0, 1.0, rows) + wrong * np.sin(3.0 * x)
    covariance = np.linalg.inv(np.einsum("mrk,mrl->kl", J, J))
    found = covariance @ np.einsum("mrk,m->k", J, y)
    e = (J @ found)[:, 0] - y
    scale = float(e @ e) / (rows - 2)
    noise = np.full((rows, 1, 1), scale)
    covariance = covariance * scale
    return covariance, widened(covariance, J, noise, e[:, None], regions(x[:, None])), found


def test_independent_rows_are_believed_as_they_are() -> None:
    pairs = [fitted(seed, 0.0)[:2] for seed in range(100)]
    assert sum(np.array_equal(*pair) for pair in pairs) > 80
    assert np.mean([np.sqrt(b[0, 0] / a[0, 0]) for a, b in pairs]) < 1.15


def test_what_a_model_leaves_out_widens_what_is_believed() -> None:
    ratio = [np.sqrt(b[0, 0] / a[0, 0]) for a, b, _ in (fitted(seed, 6.0) for seed in range(20))]
    assert np.median(ratio) > 1.3
