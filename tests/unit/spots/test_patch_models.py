"""The lights' models over a patch: derivatives against finite differences, the normal distribution against scipy."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from armsight.measure.spots.kernels import light_models
from armsight.measure.spots.kernels.gaussian_axes import gaussian_line, normal
from armsight.measure.spots.kernels.light_models import ELLIPSE, JOINT, STREAK, grid_of

Array = NDArray[np.float64]
SHAPE = (17, 14)
MODELS = {
    "one light": (JOINT, [9.0, 0.3, 105.2, 57.9, 90.0]),
    "two lights": (JOINT, [9.0, 0.3, 105.2, 57.9, 90.0, 108.1, 60.3, 50.0]),
    "streak": (STREAK, [9.0, 106.2, 58.4, 80.0, 1.3, 0.4, 2.2]),
    "ellipse": (ELLIPSE, [9.0, 106.2, 58.4, 120.0, 0.9, 0.09, 0.02, 0.07]),
}


def light(kind: int, p: Array) -> tuple[Array, Array]:
    """Return the light of a patch with its background, and the derivatives."""
    ny, nx = SHAPE
    m, J, grid = np.empty(nx * ny), np.empty((len(p), nx * ny)), grid_of(100, 50, nx, ny)
    light_models.light(kind, p, len(p), grid, J, m)
    light_models.slopes(kind, p, len(p), grid, J)
    return m + p[0], J


@pytest.mark.parametrize("centre", [103.3, 100.0, 99.2, 60.0, -1e200, 117.5, 131.0, 400.0, 1e200])
@pytest.mark.parametrize("w", [0.002, 0.3, 25.0])
def test_a_line_of_a_gaussian_is_as_exact_as_its_exponentials(centre: float, w: float) -> None:
    e = np.full(19, 7.0)
    gaussian_line(100.0, 18, centre, w, e)
    with np.errstate(over="ignore"):
        wanted = np.exp(-0.5 * w * (100.0 + np.arange(18) - centre) ** 2)
    np.testing.assert_allclose(e[:18], wanted, rtol=1e-11, atol=1e-300)
    assert e[18] == 7.0


@pytest.mark.parametrize("name", MODELS)
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    kind, start = MODELS[name]
    p = np.array(start)
    _, J = light(kind, p)
    for i in range(len(p)):
        step = np.zeros(len(p))
        step[i] = 1e-5 * max(abs(p[i]), 0.1)
        difference = (light(kind, p + step)[0] - light(kind, p - step)[0]) / (2.0 * step[i])
        near = np.abs(J[i] - difference) < 1e-5 * max(np.abs(J[i]).max(), 1.0)
        assert near.mean() > 0.98  # an ellipse's light jumps by 1e-7 where it becomes flat


def test_the_table_of_the_normal_distribution_is_exact() -> None:
    z = np.linspace(-9.5, 9.5, 20001)
    density, probability = np.empty(len(z)), np.empty(len(z))
    normal(z, density, probability)
    np.testing.assert_allclose(density, norm.pdf(z), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(probability, norm.cdf(z), rtol=0.0, atol=1e-15)
