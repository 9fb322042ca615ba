"""The check of a run's residuals against an independent world (OpenCV's projection): every fault planted is named."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi2_law

from armsight.geometry import pose_difference
from armsight.measure.consistency.causes import causes_of
from armsight.measure.consistency.check import RunCheck, advice, sentence
from armsight.measure.consistency.evidence import StillLights, target_basis
from armsight.measure.consistency.findings import Consistency, Finding
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.kernels.rig_covariance import misfit_factor
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.ops.measurement.outputs import consistency_output
from armsight.optics import RIG_PARAMETERS, Camera, Rig, converged_rig
from armsight.optics.parallelism import moved_rig
from armsight.records import NamedCovariance, PoseStatus, Spots, Target, spot_target
from refusals import names_it

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.12, 0.05, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
LIGHTS = {"A": (-0.045, 0.0, 0.0), "B": (0.035, 0.04, 0.0), "C": (0.018, -0.034, 0.012), "D": (0.06, 0.0, 0.03)}
X = np.array(list(LIGHTS.values()))
TARGET = spot_target(LIGHTS)
FPS = 30.0


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """The truth: a rig, the lights' places, the right camera's delay; another rig from the moment change_s on."""

    rig: Rig = RIG
    lights: np.ndarray = field(default_factory=lambda: X)
    delay_s: float = 0.0
    change_s: float = np.inf
    later: Rig = RIG

    def see(self, t_s: float, motion: Motion) -> list[np.ndarray]:
        rig = self.later if t_s >= self.change_s else self.rig
        out = []
        for camera, T, dt in ((rig.left, rig.T_rig_left, 0.0), (rig.right, rig.T_rig_right, self.delay_s)):
            points, V = np.ascontiguousarray(motion.at(t_s + dt).apply(self.lights)), T.inv()
            out.append(
                cv2.projectPoints(
                    points, V.rotation.as_rotvec(), V.translation, camera.matrix, camera.distortion
                )[0][:, 0]
            )  # fmt: skip
        return out


@dataclass(frozen=True, eq=False)
class Motion:
    """A smooth path of the target through the volume; speed 0: it stands still."""

    seed: int = 0
    speed: float = 1.0

    def at(self, t_s: float) -> RigidTransform:
        rng = np.random.default_rng([self.seed, 7])
        rate, phase = rng.uniform(0.15, 0.6, (2, 6)), rng.uniform(0.0, 2.0 * np.pi, (2, 6))
        wave = (np.sin(2.0 * np.pi * rate * self.speed * t_s + phase) * [[0.7], [0.3]]).sum(axis=0)
        place = np.array([0.0, 0.0, 0.62]) + np.array([0.1, 0.07, 0.13]) * wave[:3]
        return RigidTransform.from_components(place, Rotation.from_rotvec(0.5 * wave[3:]))


def spots(uv: np.ndarray, rng: np.random.Generator, sigma_px: float, noise_px: float) -> Spots:
    n = len(uv)
    order = rng.permutation(n)
    return Spots(
        uv_px=(uv + rng.normal(0.0, noise_px, uv.shape))[order],
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def run(
    world: World,
    *,
    rig: Rig = RIG,
    target: Target = TARGET,
    seed: int = 0,
    frames: int = 90,
    sigma_px: float = 0.05,
    noise: float = 1.0,
    motion: Motion | None = None,
    bias_px: float = 0.0,
    strays: dict[int, float] | None = None,
) -> tuple[Consistency, list[tuple[RigidTransform, Measured]]]:
    """Return the verdict, and the true pose and the measured one (as widened) of every frame.

    strays: px by which a spot of the right view is off in v, by frame.
    """
    rng, motion = np.random.default_rng([seed, 1]), motion or Motion(seed)
    setup, track, out = Setup(rig, target), None, []
    check, bias = RunCheck(setup), bias_px * np.random.default_rng(seed).standard_normal((2, len(world.lights), 2))
    for i in range(frames):
        seen = world.see(i / FPS, motion)
        seen[1][1, 1] += (strays or {}).get(i, 0.0)
        views = [spots(uv + b, rng, sigma_px, noise * sigma_px) for uv, b in zip(seen, bias, strict=True)]
        measured = measure_spots(setup, i / FPS, *views, track)
        track = measured.track
        out.append((motion.at(i / FPS), check.add(measured)))
    return check.finish(), out


def light(name: str, x: float, y: float, z: float) -> np.ndarray:
    moved = X.copy()
    moved[list(LIGHTS).index(name)] += [x, y, z]
    return moved


def rig_with(**by: float) -> Rig:
    """The rig with parameters moved, names as left_fx for left.fx."""
    step = np.zeros(26)
    for name, value in by.items():
        step[RIG_PARAMETERS.index(name.replace("_", ".", 1))] = value
    return moved_rig(RIG, step)


RIGHT_AXES = RIG.T_rig_right.rotation.as_matrix()


def turned(*rotation: float) -> Rig:
    w = RIGHT_AXES @ np.array(rotation)
    return rig_with(right_rx=w[0], right_ry=w[1], right_rz=w[2])


BASE = np.asarray(RIG.T_rig_right.translation) - np.asarray(RIG.T_rig_left.translation)
SMALL = {
    "scale": (World(lights=1.0005 * X), [5e-4]),
    "scale by the baseline": (World(rig=rig_with(right_tx=5e-4 * BASE[0])), [-5e-4]),
    "light B": (World(lights=light("B", 1e-5, -2e-5, 3e-5)), [1e-5, -2e-5, 3e-5]),
    "turned": (World(rig=turned(1e-4, 2e-4, -1e-4)), [1e-4, 2e-4, -1e-4]),
    "displaced": (World(rig=rig_with(right_ty=2e-5, right_tz=-4e-5)), None),
    "focal": (World(rig=rig_with(left_fx=0.2262, left_fy=0.2254, right_fx=-0.1131, right_fy=-0.1127)), [2e-4, -1e-4]),
    "distortion": (World(rig=rig_with(left_k1=5e-4, right_k1=-2e-4)), [5e-4, -2e-4]),
    "timing": (World(delay_s=1e-4), [1e-4]),
}


@pytest.mark.parametrize("fault", SMALL)
def test_derivative_of_every_fault(fault: str) -> None:
    """Exact spots of a world a little wrong: the estimate is the fault, sign and unit included, to 2 %."""
    world, expected = SMALL[fault]
    found, _ = run(world, sigma_px=2e-3, noise=0.0)
    best = {f.cause.key: f for f in found.findings}[fault.split(" by ")[0]]
    assert found.findings[0] is best
    if expected is None:
        assert np.linalg.norm(best.estimate) == pytest.approx(np.hypot(2e-5, 4e-5), rel=0.02)
    else:
        np.testing.assert_allclose(best.estimate, expected, rtol=0.02, atol=0.02 * np.abs(expected).max())


LARGE = {
    "scale": World(lights=1.01 * X),
    "light C": World(lights=light("C", 0.0, 1e-3, 5e-4)),
    "turned": World(rig=turned(1e-3, 1e-3, 0.0)),
    "focal": World(rig=rig_with(right_fx=11.3, right_fy=11.3)),
    "distortion": World(rig=rig_with(left_k1=0.05, right_k1=0.05)),
    "timing": World(delay_s=3e-3),
    "moved": World(change_s=1.4, later=turned(1.5e-3, 0.0, 5e-4)),
}


@pytest.mark.parametrize("fault", LARGE)
def test_planted_fault_is_named_with_its_size_and_effect(fault: str) -> None:
    found, poses = run(LARGE[fault], seed=3)
    assert found.verdict in ("doubtful", "inconsistent")
    assert found.findings[0].cause.key == fault, sentence(found)
    words = sentence(found)
    assert fault == "timing" or found.findings[0].cause.words[:10].lower() in words.lower()
    assert "claimed" in words and advice(found)
    if fault == "moved":
        assert abs(found.findings[0].since_s - 1.4) < 0.3 and "from about 1." in words
    told = consistency_output(found)
    assert told.cause == fault and told.estimate == found.findings[0].size
    errors = [
        pose_difference(measured.pose.pose, T)[:3] for T, measured in poses if measured.pose.status is PoseStatus.OK
    ]
    if fault not in ("scale", "moved"):  # of the scale's two readings the larger effect is told; moved: frames are lost
        rms = float(np.sqrt(np.mean(np.square(errors)) * 3.0))
        assert 0.4 < found.findings[0].effect_m / rms < 2.5


def test_a_frame_refused_tells_the_cause_as_well() -> None:
    found, poses = run(World(lights=1.03 * X), seed=4)
    assert all(measured.pose.status is PoseStatus.LOST for _, measured in poses)
    assert found.verdict == "inconsistent" and found.refused == 1.0
    best = found.findings[0]
    assert best.cause.key == "scale" and best.estimate[0] == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("noise", [0.7, 1.4])
def test_no_alarm_where_rig_and_target_are_as_good_as_they_say(noise: float) -> None:
    """6 rigs and targets drawn from their own covariances; noise that the spots claim too small or too large."""
    sigma = dict.fromkeys(RIG_PARAMETERS, 0.0)
    sigma |= {f"right.t{a}": 5e-5 for a in "xyz"} | {f"right.r{a}": 1e-4 for a in "xyz"}
    sigma |= {
        f"{side}.{a}": s for side in ("left", "right") for a, s in (("fx", 0.4), ("fy", 0.4), ("cx", 0.1), ("cy", 0.1))
    }
    covariance = NamedCovariance(names=RIG_PARAMETERS, matrix=np.diag([sigma[n] ** 2 for n in RIG_PARAMETERS]))
    rig, target = replace(RIG, covariance=covariance), spot_target(LIGHTS, covariance=1e-10 * np.eye(12))
    for seed in range(6):
        rng = np.random.default_rng([seed, 3])
        true = moved_rig(RIG, rng.normal(0.0, [sigma[name] for name in RIG_PARAMETERS]))
        world = World(rig=true, lights=X + rng.normal(0.0, 1e-5, X.shape))
        found, _ = run(world, rig=rig, target=target, seed=seed, noise=noise, frames=40, sigma_px=0.1)
        assert found.verdict == "ok", (seed, sentence(found))
        assert found.noise_scale == pytest.approx(noise, rel=0.25)


def test_a_stray_spot_is_no_fault() -> None:
    """One spot of 240 off by 50 times its claim, before any frame is usual: nothing is blamed for it."""
    lights = replace(TARGET, names=TARGET.names[:3], xyz_m=X[:3])
    for seed in range(4):
        for off in (-1.0, 1.0):
            found, _ = run(World(lights=X[:3]), target=lights, seed=seed, frames=20, sigma_px=0.02, strays={2: off})
            assert found.verdict == "ok" and not advice(found), (seed, off, sentence(found))


def test_a_sentence_quotes_what_stands_out() -> None:
    """The finding of a real run whose turn of 0.094 +- 0.053 deg was told as the reason: its z was what stood out."""
    setup = Setup(RIG, TARGET)
    cause = next(c for c in causes_of(setup, target_basis(setup)) if c.key == "moved")
    std = np.array([1.06e-3, 9.8e-4, 3.7e-4, 8.3e-4, 9.0e-4, 3.3e-4])
    found = Finding(
        cause=cause,
        estimate=np.array([-7.8e-4, -1.37e-3, -4.8e-4, 9.0e-4, -7.4e-4, 2.05e-3]),
        covariance=np.diag(std**2),
        gain=85.0,
        evidence=25.0,
        effect_m=4e-4,
        effect_rad=1e-3,
        significant=True,
        second_moment=np.zeros((1, 1)),
        since_s=0.1,
    )
    assert (found.size, found.std, found.unit, found.label) == (2.05e-3, std[5], "m", "z_m")
    told = Consistency(verdict="doubtful", frames=20, claimed_m=5e-4, claimed_rad=1e-3, findings=(found,), equal=1)
    assert "2.05 ± 0.33 mm" in sentence(told)
    output = consistency_output(told)
    assert (output.estimate, output.std, output.unit) == (2.05e-3, std[5], "m")
    weak = replace(found, estimate=found.estimate * np.array([1, 1, 1, 1, 1, 0.3]))
    assert not weak.quotable and "±" not in sentence(replace(told, findings=(weak,)))


@pytest.mark.parametrize(("sigma_px", "noise", "bias_px"), [(0.03, 1.0, 0.02), (0.1, 0.3, 0.07)])
def test_a_target_that_stands_still_proves_little(sigma_px: float, noise: float, bias_px: float) -> None:
    """Its spots keep their errors in every frame, which may be most of what is claimed: no fault, and no more proof."""
    for seed in range(3):
        spots = {"sigma_px": sigma_px, "noise": noise, "bias_px": bias_px, "motion": Motion(seed, speed=0.0)}
        found, _ = run(World(), seed=seed, frames=200, **spots)
        assert found.verdict == "ok", sentence(found)
        found, _ = run(World(rig=turned(0.008, 0.0, 0.0)), seed=seed, frames=20, **spots)
        assert found.verdict != "ok" or found.refused > 0.9


def test_a_light_that_comes_and_goes_makes_no_new_look_of_the_others() -> None:
    uv, still = np.random.default_rng(0).uniform(100.0, 900.0, (4, 2, 2)), StillLights(4, 2)
    C = np.tile(0.01 * np.eye(2), (4, 2, 1, 1))
    worth = [still.weight(np.arange(n), uv[:n], C[:n]) for n in [3, 4] * 20]
    assert worth[0] == 1.0 and sum(worth) < 2.0
    strays = uv.copy()
    strays[3, :, 0] += 30.0
    wide = np.concatenate([C[:3], 1e4 * C[3:]])
    assert still.weight(np.arange(4), strays, wide) < 0.1  # a light half hidden, claimed so
    assert still.weight(np.arange(4), strays + 2.0, C) == 1.0


def test_poses_are_widened_once_the_residuals_prove_a_fault() -> None:
    """Claims before the first look are those of the spots; after it nine of ten 95 % ellipsoids hold the truth."""
    found, poses = run(World(lights=1.006 * X), seed=5)
    assert found.verdict == "inconsistent"
    q, std = [], []
    for T, measured in poses:
        if measured.pose.covariance is None:
            continue
        d = pose_difference(measured.pose.pose, T)
        q.append(d @ np.linalg.solve(measured.pose.covariance, d))
        std.append(np.sqrt(np.trace(measured.pose.covariance[:3, :3])))
    assert poses[5][1].pose.systematic_covariance is None and poses[-1][1].pose.systematic_covariance is not None
    assert np.mean(np.array(q[45:]) < chi2_law.ppf(0.95, 6)) > 0.9
    assert np.mean(np.array(q[:5]) < chi2_law.ppf(0.95, 6)) < 0.5
    assert np.median(std[45:]) > 3.0 * np.median(std[:5])


def test_noise_beyond_the_claim_widens_the_spots_part() -> None:
    found, poses = run(World(), seed=6, noise=1.8)
    assert found.verdict == "ok" and found.noise_scale == pytest.approx(1.8, rel=0.15)
    assert names_it(sentence(found), "1.8 times", "noise")
    plain = measure_spots(
        Setup(RIG, TARGET),
        0.0,
        *(spots(uv, np.random.default_rng(0), 0.05, 0.05) for uv in World().see(2.9, Motion(6))),
    )
    ratio = np.trace(poses[87][1].pose.covariance) / np.trace(plain.pose.covariance)
    assert ratio == pytest.approx(1.8**2, rel=0.35)


def test_total_covariance_of_a_calibration_and_a_target_drawn_from_theirs() -> None:
    """400 rigs and targets, the parameters depending on each other; the ellipsoids hold 95 %, and the parts add up."""
    rng, q = np.random.default_rng(8), []
    sigma = np.array([0.5] * 4 + [1e-9] + [2e-3, 2e-3, 1e-4, 1e-4, 2e-3])
    sigma = np.concatenate([sigma, sigma, [5e-5] * 3, [4e-4] * 3])
    mixing = np.eye(26) + 0.25 * rng.normal(size=(26, 26))
    mixing /= np.linalg.norm(mixing, axis=1, keepdims=True)
    C = (sigma[:, None] * mixing) @ (sigma[:, None] * mixing).T
    D = 4e-5 * (np.eye(12) + 0.3 * rng.normal(size=(12, 12)))
    rig = replace(RIG, covariance=NamedCovariance(names=RIG_PARAMETERS, matrix=C))
    setup = Setup(rig, spot_target(LIGHTS, covariance=D @ D.T), slack_px=1.0)
    for seed in range(400):
        true = moved_rig(RIG, sigma * (mixing @ rng.normal(size=26)))
        world, motion = World(rig=true, lights=X + (D @ rng.normal(size=12)).reshape(-1, 3)), Motion(seed)
        views = [spots(uv, rng, 0.05, 0.05) for uv in world.see(0.0, motion)]
        pose = measure_spots(setup, 0.0, *views).pose
        assert pose.status is PoseStatus.OK and pose.covariance is not None and pose.systematic_covariance is not None
        assert np.linalg.eigvalsh(pose.covariance - pose.systematic_covariance)[0] > 0.0
        d = pose_difference(pose.pose, motion.at(0.0))
        q.append(d @ np.linalg.solve(pose.covariance, d))
    assert abs(np.mean(np.array(q) < chi2_law.ppf(0.95, 6)) - 0.95) < 0.036
    assert abs(np.mean(q) / 6.0 - 1.0) < 0.2


def test_residuals_of_one_frame_widen_its_pose() -> None:
    assert misfit_factor(6.0, 6) == 1.0 and misfit_factor(12.0, 6) == 1.0
    assert misfit_factor(chi2_law.ppf(0.99, 6), 6) == pytest.approx(1.0, abs=0.01)
    assert misfit_factor(10.0 * chi2_law.ppf(0.99, 10), 8) == pytest.approx(10.0, rel=0.01)
    setup = Setup(RIG, TARGET)
    views = [spots(uv, np.random.default_rng(9), 0.05, 0.05) for uv in World(lights=1.005 * X).see(0.0, Motion(9))]
    good = [spots(uv, np.random.default_rng(9), 0.05, 0.05) for uv in World().see(0.0, Motion(9))]
    wide, plain = (measure_spots(setup, 0.0, *v).pose.covariance for v in (views, good))
    assert wide is not None and plain is not None and np.trace(wide) > 3.0 * np.trace(plain)
