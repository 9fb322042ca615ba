"""Positions that are known unequally well: an arm and the rig's place from rows weighed by their covariances.

A pair of cameras at one side: depth worse with its square, across it less. Arm and cameras are of the test's own.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints, Tolerance, calibrate_arm, calibrate_world
from armsight.calibrate.arm.fit import fit_arm, start
from armsight.calibrate.arm.model import ArmModel
from armsight.store.arm_points import read_arm_points

sys.path.insert(0, str(Path(__file__).parent))
from arm_streams import JUDGED, LINKS, NOMINAL, TOOL_M, place

Array = NDArray[np.float64]
T_rig_base = RigidTransform.from_components([0.0, 0.1, 0.9], Rotation.from_rotvec([1.2, -0.7, 0.4]))
NEAREST_M = 0.25


def seen(rows: Array, q: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the tool's places in rig axes (m, 3) with errors, and their covariances (m, 3, 3)."""
    x = T_rig_base.apply(place(rows, q))
    ray = x / np.linalg.norm(x, axis=1)[:, None]
    z = np.linalg.norm(x, axis=1)[:, None, None]
    along = ray[:, :, None] * ray[:, None, :]
    C = (1e-4 * z) ** 2 * (np.eye(3) - along) + (1.5e-3 * z**2) ** 2 * along
    return x + np.einsum("mij,mj->mi", np.linalg.cholesky(C), rng.normal(size=x.shape)), C


def readings(rng: np.random.Generator, rows: Array, m: int) -> Array:
    """Return m joint positions that put the tool in front of the cameras."""
    q = rng.uniform(-1.4, 1.4, (40 * m, len(rows)))
    return q[np.linalg.norm(T_rig_base.apply(place(rows, q)), axis=1) > NEAREST_M][:m]


def arm_case(seed: int, m: int = 60) -> tuple[Array, ArmPoints]:
    """Return the true rows of an arm whose zeros are off by half a degree, and measurements of it."""
    rng = np.random.default_rng(seed)
    rows = LINKS.copy()
    rows[1:4, 0] += 0.01 * rng.normal(size=3)
    q = readings(rng, rows, m)
    xyz, C = seen(rows, q, rng)
    return rows, ArmPoints(q=q, xyz_m=xyz, covariance=C)


def alike(points: ArmPoints) -> ArmPoints:
    return replace(points, covariance=None)


def boast(points: ArmPoints) -> ArmPoints:
    C = np.array(points.covariance)
    C[::10] *= 1e-4
    return replace(points, covariance=C)


@cache
def zeros(change: Callable[[ArmPoints], ArmPoints], seeds: int = 12) -> tuple[float, Array]:
    """Return the RMS error of the judged zeros in rad, and all of them over their claimed deviations."""
    errors, z = [], []
    for seed in range(100, 100 + seeds):
        rows, points = arm_case(seed)
        points = change(points)
        model = ArmModel(arm=NOMINAL, labels=points.labels, turned=False)
        fitted = fit_arm(model, points, start(model, points), JUDGED, Tolerance())
        assert fitted.fit.covariance is not None
        std = fitted.fit.covariance.std()
        for name in JUDGED:
            k = int(name[1]) - 1
            errors.append(fitted.p[model.names.index(name)] - (rows[k, 0] - LINKS[k, 0]))
            z.append(errors[-1] / std[name])
    return float(np.sqrt(np.mean(np.square(errors)))), np.array(z)


def test_an_arm_is_found_better_and_claimed_truly_where_rows_weigh_by_their_covariances() -> None:
    weighed, z = zeros(lambda points: points)
    assert weighed < 0.6 * zeros(alike)[0]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2)  # of 300 seeds 1.00


def test_rows_that_claim_too_much_do_not_take_an_arm_over() -> None:
    assert zeros(boast)[0] < zeros(alike)[0]


def world_error(seed: int, change: Callable[[ArmPoints], ArmPoints]) -> tuple[Array, Array, ArmPoints]:
    rng = np.random.default_rng(seed)
    q = readings(rng, LINKS, 40)
    xyz, C = seen(LINKS, q, rng)
    arm = replace(NOMINAL, T_flange_tool=RigidTransform.from_translation(TOOL_M))
    found = calibrate_world(arm, change(ArmPoints(q=q, xyz_m=xyz, covariance=C)))
    want = T_rig_base.inv()
    turn = (found.pose.rotation * want.rotation.inv()).as_rotvec()
    return (np.append(found.pose.translation - want.translation, turn), found.covariance.matrix, found.rejected_rows)


def test_the_rigs_place_from_rows_weighed_by_their_covariances() -> None:
    cases = {
        name: [world_error(s, change) for s in range(5)] for name, change in (("own", lambda p: p), ("alike", alike))
    }
    sizes = {name: np.sqrt(np.mean([e[:3] ** 2 for e, _, _ in found])) for name, found in cases.items()}
    assert sizes["own"] < 0.6 * sizes["alike"]
    chi2 = [e @ np.linalg.solve(C, e) / 6.0 for e, C, _ in cases["own"]]
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.5)
    assert not any(rejected for _, _, rejected in cases["own"])  # far rows are no outliers


def test_files_with_covariances_weigh_and_what_is_not_used_is_told(tmp_path: Path) -> None:
    _, points = arm_case(0, 20)
    C = np.array(points.covariance)
    s = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    table = np.column_stack([points.q, points.xyz_m, s, C[:, 0, 1], C[:, 0, 2], C[:, 1, 2]])
    head = ["q1", "q2", "q3", "q4", "q5", "x_m", "y_m", "z_m", "sx_m", "sy_m", "sz_m", "cov_x_y", "cov_x_z", "cov_y_z"]

    def read(last: int, spoil: bool = False) -> ArmPoints:
        lines = [[*map(repr, map(float, row[:last]))] for row in table]
        if spoil:
            lines[3][9] = ""
        file = tmp_path / "points.csv"
        file.write_text("\n".join(map(",".join, [head[:last], *lines])) + "\n")
        return read_arm_points(file)

    whole = read(14)
    assert whole.covariance is not None and np.abs(whole.covariance - C).max() < 1e-15
    notes = calibrate_arm(NOMINAL, whole).notes
    assert [n for n in notes if "weighed" in n] and not [n for n in notes if "uncorrelated" in n]
    deviations, partial = (" ".join(one.weight_notes(1e-4)) for one in (read(11), read(14, spoil=True)))
    assert "uncorrelated" in deviations and "weighed" in deviations
    assert "not used" in partial and "weighed" not in partial
