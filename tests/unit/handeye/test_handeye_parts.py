"""The pieces of hand-eye calibration: derivatives, closed forms, the compiled fit against the engine, variances."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import PosePairs, Setup, solve_pairs
from armsight.calibrate.handeye.kernels import fit as kernels
from armsight.calibrate.handeye.kernels import noise as noise_kernels
from armsight.calibrate.handeye.known_noise import restricted_variances
from armsight.fitting import Evaluation, Problem, solve
from armsight.geometry.kernels import rotvec_of

SETUPS = (Setup.EYE_IN_HAND, Setup.EYE_TO_HAND)


def world(rng: np.random.Generator, n: int, setup: Setup, sigma_m: float = 0.0, sigma_rad: float = 0.0) -> PosePairs:
    """Pairs from composed poses: no formula of the product is used."""
    T_parent_camera = RigidTransform.from_components(rng.normal(0, 0.2, 3), Rotation.from_rotvec(rng.normal(0, 1, 3)))
    T_parent_target = RigidTransform.from_components(rng.normal(0, 0.5, 3), Rotation.from_rotvec(rng.normal(0, 1, 3)))
    seen = RigidTransform.from_components(
        rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.8], (n, 3)), Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (n, 3)))
    )
    robots = {
        Setup.EYE_IN_HAND: T_parent_target
        * seen.inv()
        * T_parent_camera.inv(),  # base_target = base_flange flange_camera camera_target
        Setup.EYE_TO_HAND: T_parent_camera
        * seen
        * T_parent_target.inv(),  # base_camera camera_target = base_flange flange_target
    }
    robot = robots[setup]
    noise = Rotation.from_rotvec(rng.normal(0, 1, (n, 3)) * sigma_rad)
    seen = RigidTransform.from_components(seen.translation + rng.normal(0, 1, (n, 3)) * sigma_m, noise * seen.rotation)
    return PosePairs(T_base_flange=robot, T_camera_target=seen, names=tuple(f"row {i + 1}" for i in range(n)))


def raw(arrays: tuple[np.ndarray, ...], x: np.ndarray, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (6 n,) and derivatives (6 n, 13) of the kernels at x = tX, rotvec X, tZ, rotvec Z."""
    RX, RZ = (np.ascontiguousarray(Rotation.from_rotvec(x[k : k + 3]).as_matrix()) for k in (3, 9))
    n = len(arrays[0])
    e, J = np.empty((n, 6)), np.empty((n, 6, 13))
    kernels.derivatives(((RX, x[:3]), (RZ, x[6:9]), gamma), arrays, e, J)
    return e.ravel(), J.reshape(-1, 13)


def moved(x: np.ndarray, step: np.ndarray) -> np.ndarray:
    out = x + step
    for k in (3, 9):
        out[k : k + 3] = (Rotation.from_rotvec(step[k : k + 3]) * Rotation.from_rotvec(x[k : k + 3])).as_rotvec()
    return out


@pytest.mark.parametrize("setup", SETUPS)
def test_derivatives_are_those_of_finite_differences(setup: Setup) -> None:
    rng = np.random.default_rng(1)
    arrays = world(rng, 5, setup, 0.05, 0.3).arrays(setup)  # large residuals: the exact derivative is wanted
    x, h = rng.normal(0, 0.5, 12), 1e-6
    _, J = raw(arrays, x, 1.1)
    for k in range(13):
        step = np.zeros(13)
        step[k] = h
        high, low = (raw(arrays, moved(x, s * step[:12]), 1.1 + s * step[12])[0] for s in (1.0, -1.0))
        assert J[:, k] == pytest.approx((high - low) / (2 * h), abs=2e-8)


def test_the_logarithm_holds_up_to_half_a_turn() -> None:
    rng = np.random.default_rng(2)
    out = np.empty(3)
    for angle in (0.0, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-7):
        axis = rng.normal(size=3)
        for w in (angle * axis / np.linalg.norm(axis), -angle * axis / np.linalg.norm(axis)):
            rotvec_of(Rotation.from_rotvec(w).as_matrix(), out)
            assert out == pytest.approx(w, abs=1e-8)


@pytest.mark.parametrize("setup", SETUPS)
def test_the_compiled_fit_is_the_engines(setup: Setup) -> None:
    rng = np.random.default_rng(5)
    arrays = world(rng, 12, setup, 3e-4, 1e-3).arrays(setup)
    variances = np.array([1e-7, 1e-6, 0.0])
    fast = solve_pairs(arrays, setup, variances=variances)
    sigma = np.tile(np.sqrt(np.repeat(variances[:2], 3)), 12)

    def evaluate(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        e, J = raw(arrays, np.array(shared), 1.0)
        J = J[:, :12] / sigma[:, None]
        return Evaluation(residuals=(e / sigma)[None], shared=J[None], local=np.zeros((1, len(e), 0)))

    start = np.concatenate(
        [fast.t_x, Rotation.from_matrix(fast.R_X).as_rotvec(), fast.t_z, Rotation.from_matrix(fast.R_Z).as_rotvec()]
    )
    problem = Problem(
        names=tuple(f"p{i}" for i in range(12)),
        guess=moved(start, rng.normal(0, 0.01, 12)),
        evaluate=evaluate,
        n_residuals=72,
        retract=lambda s, lo, ds, dl: (moved(np.array(s), ds), lo),
    )
    slow = solve(problem)
    assert slow.covariance is not None
    std = np.sqrt(np.diag(slow.covariance.matrix))
    assert np.abs(start - slow.shared).max() < 0.01 * std.min()
    assert np.sqrt(np.diag(fast.C)) == pytest.approx(std, rel=1e-3)


@pytest.mark.parametrize("setup", SETUPS)
def test_the_noise_at_the_target_is_what_a_shaken_robot_makes(setup: Setup) -> None:
    """Whitened residuals of a robot turned and shifted at random have unit covariance, seen through the exact truth."""
    rng = np.random.default_rng(6)
    s_t, s_r = 2e-4, 1e-3
    pairs = world(rng, 3000, setup)
    robot = pairs.T_base_flange
    shaken = RigidTransform.from_components(
        robot.translation + rng.normal(0, s_t, (3000, 3)),
        Rotation.from_rotvec(rng.normal(0, s_r, (3000, 3))) * robot.rotation,
    )
    exact = solve_pairs(pairs.take(range(10)).arrays(setup), setup, variances=np.array([1e-12, 1e-12, 0.0]))
    arrays = PosePairs(T_base_flange=shaken, T_camera_target=pairs.T_camera_target, names=pairs.names).arrays(setup)
    e, J, lever = np.empty((3000, 6)), np.empty((3000, 6, 12)), np.empty(3000)
    theta = np.array([s_t**2, 1e-14, s_r**2])
    X, Z = (exact.R_X, exact.t_x), (exact.R_Z, exact.t_z)
    kernels.weigh((X, Z, 1.0), (arrays, np.ones(3000, bool), setup is Setup.EYE_TO_HAND), theta, e, J, lever)
    # the scatter of a covariance of n samples is sqrt(2 / n) on the diagonal; five of those
    assert e.T @ e / 3000 == pytest.approx(np.eye(6), abs=5 * np.sqrt(2 / 3000))


def test_the_whitened_shapes_are_the_derivatives_of_the_noise() -> None:
    w, q = np.empty(5), np.empty((3, 5))
    theta, length, h = np.array([2e-7, 3e-6, 1e-6]), 0.7, 1e-12
    noise_kernels.shapes(length, theta, w, q)

    def logdet(t: np.ndarray) -> float:
        return float(noise_kernels.whitener(length, t, np.empty(5)))

    for k in range(3):
        step = np.zeros(3)
        step[k] = h
        slope = (logdet(theta + step) - logdet(theta - step)) / (2 * h)
        trace = 2 * (q[k, 0] + q[k, 2]) + q[k, 3] + q[k, 4]  # d log det V = tr V^-1 dV
        assert trace == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("seed", [8, 12])
def test_two_ways_to_the_same_variances(seed: int) -> None:
    """The compiled scoring and the general one find the same maximum where the first finds no noise of the robot's."""
    rng = np.random.default_rng(seed)
    setup = Setup.EYE_IN_HAND
    pairs = world(rng, 25, setup, 3e-4, 1e-3)
    s = solve_pairs(pairs.arrays(setup), setup)
    e, J = raw(
        s.arrays,
        np.concatenate(
            [s.t_x, Rotation.from_matrix(s.R_X).as_rotvec(), s.t_z, Rotation.from_matrix(s.R_Z).as_rotvec()]
        ),
        1.0,
    )
    Q = np.zeros((2, 25, 6, 6))
    Q[0, :, :3, :3] = Q[1, :, 3:, 3:] = np.eye(3)
    known = np.tile(1e-14 * np.eye(6), (25, 1, 1))
    used = np.ones(25, bool)
    found = restricted_variances(e.reshape(25, 6), J[:, :12].reshape(25, 6, 12), known, Q, used, np.full(2, 1e-14))
    two = solve_pairs(s.arrays, setup, variances=np.array([*found.variances, 0.0]))
    assert two.log_likelihood <= s.log_likelihood + 1e-6  # the third variance can only help
    assert s.variances[2] < 1e-12
    assert found.variances == pytest.approx(s.variances[:2], rel=0.02)


def test_a_pair_left_out_by_downdate_is_a_pair_left_out() -> None:
    rng = np.random.default_rng(9)
    setup = Setup.EYE_TO_HAND
    pairs = world(rng, 10, setup, 3e-4, 1e-3)
    arrays = pairs.arrays(setup)
    whole = solve_pairs(arrays, setup)
    fast, _ = whole.left_out()
    for i in (0, 4):
        keep = np.arange(10) != i
        slow = solve_pairs(arrays, setup, keep=keep, variances=whole.variances).residuals()[i]
        assert fast[i] == pytest.approx(slow, abs=2e-6)
