"""Coupled readings that `identify` suggests, and the paper's method where it is of no use; arms of the test's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from armsight.calibrate.identify import Identification, Sweeps, even_ones, identify
from armsight.calibrate.identify.sweeps import step_of
from armsight.errors import Inconsistent
from armsight.kinematics import Joint
from armsight.ops.identification.solve import solve_sweeps
from armsight.optics import Camera, Rig, parallel_rig
from armsight.optics.parallelism import moved_rig
from armsight.records import NamedCovariance
from refusals import names_it, refuses

ROWS = np.array([[0.3, 0.2, 0.2, 1.4], [-0.4, 0.1, 0.3, 0.7], [0.6, -0.1, 0.15, 1.9], [0.1, 0.2, 0.25, 1.1]])
"""theta, d, a, alpha of four turning joints."""


def swept(share: float, noise_m: float, arc: float = 2.0) -> Sweeps:
    """Return sweeps of 12 readings; joint 3 moves along by a share of joint 2's reading."""
    joint = np.repeat(np.arange(4), 12)
    q = np.tile([0.2, -0.3, 0.1, 0.3], (48, 1))
    q[np.arange(48), joint] = np.tile(np.linspace(-0.5 * arc, 0.5 * arc, 12), 4)
    values = q.copy()
    values[:, 2] += share * q[:, 1]
    xyz = np.empty((48, 3))
    for k, row in enumerate(values):
        x = np.zeros(3)
        for (theta, d, a, alpha), value in zip(ROWS[::-1], row[::-1], strict=True):
            c, s, ca, sa = np.cos(value + theta), np.sin(value + theta), np.cos(alpha), np.sin(alpha)
            x = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]]) @ x + [a * c, a * s, d]
        xyz[k] = x
    return Sweeps(joint=joint, q=q, xyz_m=xyz + np.random.default_rng(1).normal(0.0, noise_m, xyz.shape))


@pytest.mark.parametrize("share", [0.01, 0.02])
def test_a_planted_coupling_is_suggested(share: float) -> None:
    try:
        told = " ".join(identify(swept(share, 2e-4)).notes)
    except Inconsistent as refusal:  # the larger one: no arm explains all sweeps
        told = str(refusal)
    assert names_it(told, "coupled", "joint 3", "joint 2")


def test_no_coupling_is_suggested_without_one() -> None:
    result = identify(swept(0.0, 2e-4))
    assert not [note for note in result.notes if "coupled" in note or "times its readings" in note]
    assert result.misfit == pytest.approx(1.0, abs=0.25)


def test_the_method_of_the_paper_is_refused_where_it_is_useless() -> None:
    noisy = swept(0.0, 1e-3, arc=0.3)
    with refuses(Inconsistent, "readings", "--method ml") as refusal:
        solve_sweeps(noisy, method="paper")
    assert refusal.value.exit_code == 3
    assert solve_sweeps(noisy).misfit < 2.0
    clean = identify(swept(0.0, 1e-6), method="paper")
    assert not clean.useless


def test_readings_before_an_edge_are_left_out_and_told() -> None:
    sweeps = swept(0.0, 2e-4)
    std_px = np.random.default_rng(3).uniform(0.09, 0.13, len(sweeps))
    std_px[[17, 19]] = 0.3, 0.45
    kept, notes = even_ones(replace(sweeps, std_px=std_px))
    assert len(kept) == len(sweeps) - 2 and 0.3 not in (kept.std_px if kept.std_px is not None else ())
    assert [note.split(" left")[0] for note in notes] == ["reading 18 (joint 2)", "reading 20 (joint 2)"]
    assert even_ones(sweeps) == (sweeps, [])


def test_what_is_behind_the_beacon_is_in_the_table() -> None:
    """Six readings shifted alike in both views, by as much as their spots claim: the deviations tell of them."""
    clean, uv, rig = in_pixels()
    truth, inside = joints_of(clean), {True: [], False: []}
    std_px = np.full(len(clean), 0.05)
    std_px[[12, 14, 17, 23, 29, 35]] = 0.085
    for seed in range(15):
        rng = np.random.default_rng(seed)
        noisy = uv + rng.normal(0.0, 0.03, uv.shape)
        beyond = np.sqrt(std_px**2 - 0.05**2)[:, None] * rng.normal(size=(len(uv), 2))
        for told in inside:
            seen = replace(clean, uv_px=noisy + beyond[:, None], std_px=std_px if told else None)
            inside[told] += within(identify(even_ones(seen)[0], rig=rig), truth)
    assert np.mean(inside[True]) > 0.9
    assert np.mean(inside[False]) < np.mean(inside[True]) - 0.05


FX, BASELINE = 750.0, 0.3
CAMERA = Camera.pinhole(640, 480, FX, FX, 319.5, 239.5)
CALIBRATED = np.array([0.3, 0.3, 0.3, 0.3, 0, 3e-4, 0, 0, 0, 0] * 2 + [5e-5, 5e-5, 1e-4, 2e-4, 2e-4, 1e-4])
"""Standard deviations of a rig's parameters."""


def in_pixels() -> tuple[Sweeps, np.ndarray, Rig]:
    """Return exact sweeps before a parallel rig, their pixels (m, 2, 2), and the rig."""
    clean = swept(0.0, 0.0, 2.6)
    clean = replace(clean, xyz_m=clean.xyz_m + np.array([0.0, -0.3, 2.2]))
    x, y, z = clean.xyz_m.T
    left = np.stack([FX * x / z + 319.5, FX * y / z + 239.5], axis=1)
    uv = np.stack([left, left - [1.0, 0.0] * (FX * BASELINE / z)[:, None]], axis=1)
    return clean, uv, parallel_rig(CAMERA, BASELINE)


def joints_of(clean: Sweeps) -> tuple[Joint, ...]:
    """Return the table of the arm that made exact sweeps."""
    noise = np.random.default_rng(0).normal(0.0, 1e-7, clean.xyz_m.shape)
    return identify(replace(clean, xyz_m=clean.xyz_m + noise)).arm.joints


def within(found: Identification, truth: Sequence[Joint]) -> list[bool]:
    """Tell of every measured entry whether it is within two of its standard deviations."""
    return [
        abs(getattr(joint, k) - getattr(true, k)) < 2.0 * s
        for joint, true, one in zip(found.arm.joints, truth, found.joints, strict=True)
        for k, s in one.std.items()
        if s > 0.0
    ]


def test_what_a_rig_does_not_know_is_in_the_table() -> None:
    """Of 15 rigs calibrated anew, entries within two standard deviations; taken as exact a quarter of them is not."""
    clean, uv, rig = in_pixels()
    truth = joints_of(clean)
    names, inside = tuple(rig.parameters), {True: [], False: []}
    for seed in range(15):
        rng = np.random.default_rng(seed)
        seen = replace(clean, uv_px=uv + rng.normal(0.0, 0.05, uv.shape))
        wrong = moved_rig(rig, CALIBRATED * rng.normal(size=len(names)))
        for known in inside:
            covariance = NamedCovariance(names=names, matrix=np.diag(CALIBRATED**2)) if known else None
            inside[known] += within(identify(seen, rig=replace(wrong, covariance=covariance)), truth)
    assert np.mean(inside[True]) > 0.9
    assert np.mean(inside[False]) < 0.85


def test_whole_steps_of_coarse_encoders_are_named_and_count_as_noise() -> None:
    exact, step = swept(0.0, 2e-5), 2.0 * np.pi / 360.0
    coarse = replace(exact, q=np.round(exact.q / step) * step)
    with refuses(Inconsistent, f"{step:.3g} rad", "--sigma") as refusal:
        identify(coarse)
    sigma = float(str(refusal.value).split("--sigma ")[1].split(")")[0])
    result = identify(coarse, sigma=sigma)
    rms_m = np.sqrt(np.mean((result.predicted_m - exact.xyz_m) ** 2))
    assert all(one.decided for one in result.joints) and rms_m < 0.3 * step
    assert [step_of(values) for values in (exact.q[:12, 0], np.arange(5) * 0.3)] == [0.0, 0.0]
