"""Quantiles and chances against scipy.stats."""

import numpy as np
import pytest
from scipy import stats

from armsight.fitting import quantiles
from armsight.measure.poses.tracking import MOST_MAHALANOBIS2

DOF = np.array([1.0, 2.5, 3.0, 6.0, 40.0, 1000.0])
CHANCES = np.array([1e-9, 1e-6, 0.01, 0.3, 0.5, 0.975, 1.0 - 1e-7])


@pytest.mark.parametrize("chance", CHANCES)
def test_quantiles_are_those_of_scipy_stats(chance: float) -> None:
    np.testing.assert_allclose(quantiles.chi2_isf(chance, DOF), stats.chi2.isf(chance, DOF), rtol=1e-12)
    np.testing.assert_allclose(quantiles.chi2_ppf(chance, DOF), stats.chi2.ppf(chance, DOF), rtol=1e-12)
    np.testing.assert_allclose(quantiles.f_isf(chance, 3, DOF), stats.f.isf(chance, 3, DOF), rtol=1e-9)
    np.testing.assert_allclose(quantiles.t_ppf(chance, DOF), stats.t.ppf(chance, DOF), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("x", [-1.0, 0.0, 0.3, 4.0, 90.0, np.inf])
def test_chances_are_those_of_scipy_stats(x: float) -> None:
    np.testing.assert_allclose(quantiles.chi2_sf(x, DOF), stats.chi2.sf(x, DOF), rtol=1e-12)
    np.testing.assert_allclose(quantiles.f_sf(x, 3, DOF), stats.f.sf(x, 3, DOF), rtol=1e-9)
    np.testing.assert_allclose(quantiles.t_sf(x, DOF), stats.t.sf(x, DOF), rtol=1e-9)


def test_the_quantiles_that_stand_as_numbers_are_those_that_are_said() -> None:
    assert float(quantiles.chi2_ppf(0.5, 3)) == quantiles.MEDIAN_3
    assert float(quantiles.chi2_isf(1e-6, 6)) == MOST_MAHALANOBIS2


def test_no_degrees_of_freedom_say_nothing_and_infinitely_many_are_the_normal_law() -> None:
    said = [quantiles.chi2_isf(0.01, 0), quantiles.chi2_ppf(0.5, 0), quantiles.t_ppf(0.9, 0), quantiles.f_sf(1.0, 3, 0)]
    assert np.isnan(said).all()
    assert quantiles.t_ppf(0.975, np.inf) == pytest.approx(stats.norm.ppf(0.975), rel=1e-12)
