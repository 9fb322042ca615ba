"""Arms calibrated by touch against a world with kinematics of its own: deviations hold, what is open stays open."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.calibrate.arm import ArmModel, Tolerance
from armsight.calibrate.arm.touch import Kind, KnownLength, Touches, calibrate_touched
from armsight.errors import Inconsistent, NotEnoughData
from armsight.kinematics import Convention, preset
from refusals import refuses

sys.path.insert(0, str(Path(__file__).parent))
from touch_world import NEAR, TIP, World, bound, true_rows, two_spikes

LENGTH_M, ANGLE_RAD, APART_M, KNOWN_M = 1e-3, 5e-3, 0.27, 2e-5
TOLERANCE = Tolerance(length_m=LENGTH_M, angle_rad=ANGLE_RAD)


def drawn(name, rng, share=1.0):
    """Return a nominal arm, the true one, and by what it is off."""
    arm = preset(name)
    names = ArmModel(arm=arm, labels=("",), turned=False).geometry
    rows, off = true_rows(arm, rng, names, share * LENGTH_M, share * ANGLE_RAD)
    sense = np.array([joint.sign for joint in arm.joints])
    return arm, World(rows, sense, arm.convention is Convention.CRAIG, TIP), off


def touched(q, feature, kind=None, lengths=(), reading_m=None):
    m = len(q)
    return Touches(
        q=q,
        feature=tuple(feature),
        kind=tuple(kind) if kind is not None else (Kind.POINT,) * m,
        reading_m=np.zeros(m) if reading_m is None else reading_m,
        sigma_m=np.zeros(m),
        lengths=lengths,
        row=np.arange(m),
    )


KNOWN = (KnownLength(a="a", b="b", length_m=APART_M, sigma_m=KNOWN_M),)


def of_spikes(name="irb120", seed=0, lengths=KNOWN, share=1.0):
    rng = np.random.default_rng([seed, len(name)])
    arm, world, off = drawn(name, rng, share)
    spikes, q, which = two_spikes(world, rng, NEAR[name], APART_M)
    return arm, world, off, touched(q, ["ab"[k] for k in which], lengths=lengths), (spikes, which)


def test_two_spikes_tell_zeros_and_lengths_as_well_as_can_be_and_deviations_hold():
    by_bound, by_claim = [], []
    for name, seed in (("irb120", 0), ("iiwa14", 2)):
        arm, world, off, touches, (spikes, which) = of_spikes(name, seed)
        done = calibrate_touched(arm, touches, tolerance=TOLERANCE)
        assert done.gain
        assert len(done.free) >= 12
        joints = [joint.name for joint in arm.joints]
        names = list(off)
        least, _ = bound(world, touches.q, which, spikes, off, joints, LENGTH_M, ANGLE_RAD, KNOWN_M)
        error = np.array([done.corrections[one] - off[one] for one in done.free])
        by_bound.append(error / least[[names.index(one) for one in done.free]])
        by_claim.append(error / [done.deviations[one] for one in done.free])
        claimed = np.array([done.deviations[one] for one in done.free])
        assert np.all(claimed > 0.75 * least[[names.index(one) for one in done.free]])
    k = sum(map(len, by_bound))
    # correlated errors of some 30 parameters: three standard deviations of their mean square
    assert np.sqrt(np.mean(np.concatenate(by_bound) ** 2)) < 1.0 + 3.0 / np.sqrt(k)
    assert np.sqrt(np.mean(np.concatenate(by_claim) ** 2)) < 1.0 + 3.0 / np.sqrt(k)


def test_several_tips_are_fitted_each_by_its_rows_and_deviations_hold():
    rng, other = np.random.default_rng(21), np.array([-0.06, 0.05, 0.16])
    arm, world, off = drawn("irb120", rng)
    spikes, q, which = two_spikes(world, rng, NEAR["irb120"], APART_M)
    bent = replace(world, tip=other)
    q = np.concatenate([q, bent.touched(rng, spikes[which], NEAR["irb120"])])
    touches = touched(q, ["ab"[k] for k in (*which, *which)], lengths=KNOWN)
    named = replace(touches, tip=("long",) * len(which) + ("bent",) * len(which))
    done = calibrate_touched(arm, named, tolerance=TOLERANCE)
    assert done.gain
    z = np.array([(done.corrections[one] - off[one]) / done.deviations[one] for one in done.free])
    assert len(z) >= 12
    assert np.sqrt(np.mean(z**2)) < 1.0 + 3.0 / np.sqrt(len(z))
    assert done.after.rms_m < 3e-4
    places = {one.name: one.xyz_m for one in done.arm.tool_points}
    # the last joint's zero turns both about its axis, and stays as it was
    assert np.linalg.norm(places["bent"]) == pytest.approx(np.linalg.norm(other), abs=2e-3)
    assert np.linalg.norm(places["bent"] - places["long"]) == pytest.approx(np.linalg.norm(other - TIP), abs=1e-3)
    assert done.arm.T_flange_tool.translation == pytest.approx(places["bent"])
    with refuses(Inconsistent, "scatter"):  # taken as one tip, 0.1 m apart
        calibrate_touched(arm, touches, tolerance=TOLERANCE)


def test_a_tip_that_hardly_touched_is_refused():
    arm, *_, touches, _ = of_spikes()
    with refuses(NotEnoughData, "bent", "5 times"):
        calibrate_touched(arm, replace(touches, tip=("bent",) * 5 + ("long",) * 45))


def test_what_no_touch_tells_gets_no_number_and_its_cure_is_named():
    arm, *_, touches, _ = of_spikes(lengths=())
    done = calibrate_touched(arm, touches, tolerance=TOLERANCE)
    why = dict(done.fixed)
    assert "base" in why["j1.theta_rad"] and "base" in why["j1.d_m"]
    assert "orientation" in why["j6.theta_rad"]
    long = {"j2.a_m", "j3.a_m", "j4.d_m"}
    assert not long & set(done.free)
    assert all("--length" in why[name] for name in long)
    assert {"j3.theta_rad", "j4.theta_rad"} <= set(done.free)
    assert not set(why) & set(done.corrections)
    measured = replace(touches, lengths=KNOWN)
    assert long <= set(calibrate_touched(arm, measured, tolerance=TOLERANCE).free)


def test_flats_balls_and_gauges_tell_too():
    rng = np.random.default_rng(5)
    arm, world, off = drawn("irb120", rng)
    near = np.array(NEAR["irb120"])
    here = world.there(near)[0]
    n = 25
    normal = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    flat = here + rng.uniform(-0.15, 0.15, (n, 3))
    flat -= np.outer((flat - here) @ normal, normal)
    away = rng.normal([0.0, 0.0, 1.0], 1.0, (n, 3))
    ball = here + [0.1, 0.1, 0.0] + 0.05 * away / np.linalg.norm(away, axis=1, keepdims=True)
    spike = np.tile(here - [0.05, 0.1, 0.0], (n, 1))
    along, travel = np.array([1.0, 0.2, 0.1]) / np.linalg.norm([1.0, 0.2, 0.1]), rng.uniform(0.0, 0.02, n)
    anvil = here + rng.uniform(-0.08, 0.08, (n, 3))
    anvil += np.outer(travel - (anvil - here) @ along, along)
    q = world.touched(rng, np.concatenate([flat, ball, spike, anvil]), near)
    kinds = [kind for kind in (Kind.PLANE, Kind.SPHERE, Kind.POINT, Kind.GAUGE) for _ in range(n)]
    radius = (KnownLength(a="sphere", length_m=0.05, sigma_m=5e-6),)
    readings = np.concatenate([np.zeros(3 * n), travel])
    touches = touched(q, [kind.value for kind in kinds], kinds, radius, readings)
    done = calibrate_touched(arm, touches, tolerance=TOLERANCE)
    assert done.gain
    z = np.array([(done.corrections[one] - off[one]) / done.deviations[one] for one in done.free])
    assert len(z) >= 10
    assert np.sqrt(np.mean(z**2)) < 1.0 + 3.0 / np.sqrt(len(z))
    found = {one.name: one for one in done.features}
    assert found["sphere"].radius_m == pytest.approx(0.05, abs=3e-5)
    assert abs(np.array(found["plane"].normal) @ normal) > np.cos(0.02)
    assert all(one.rms_m < 3e-4 for one in done.features)


@pytest.mark.parametrize("what", ["scale", "sag"])
def test_scales_and_sag_are_taken_where_touches_left_out_prove_them(what):
    arm, world, off, touches, _ = of_spikes(seed=6)
    names = [f"j{k}.{what}" for k in range(1, 7)]
    if what == "scale":
        true = np.array([0.004, -0.01, 0.012, -0.015, 0.01, 0.006])
        read = touches.q / (1.0 + true)
    else:  # as far as a weight at the flange has its lever out, whose torques its height's slopes are
        true = np.array([0.0, 0.03, 0.02, 0.0, 0.0, 0.0])
        read = touches.q + true * replace(world, tip=np.zeros(3)).there(touches.q)[1][:, 2]
    done = calibrate_touched(arm, replace(touches, q=read), tolerance=TOLERANCE)
    assert done.level == f"zeros, lengths and {what if what == 'sag' else 'joint scales'}"
    off = off | dict(zip(names, true, strict=True))
    z = np.array([(done.corrections[one] - off[one]) / done.deviations[one] for one in done.free])
    assert {names[1], names[2]} <= set(done.free)
    assert np.sqrt(np.mean(z**2)) < 1.0 + 3.0 / np.sqrt(len(z))
    assert done.cross_after.rms_m < 0.2 * done.cross_before.rms_m


def test_a_right_arm_is_left_as_it_is():
    arm, *_, touches, _ = of_spikes(share=0.0)
    done = calibrate_touched(arm, touches)
    assert not done.gain
    assert not done.free
    assert {one.name for one in done.fixed} >= {"j2.theta_rad", "j3.a_m"}
    assert done.after.rms_m < 3e-4


def test_a_touch_of_the_wrong_spike_is_named_and_does_no_harm():
    arm, _, off, touches, _ = of_spikes(seed=3)
    called = list(touches.feature)
    called[7] = "b"
    done = calibrate_touched(arm, touched(touches.q, called, lengths=KNOWN), tolerance=TOLERANCE)
    assert [one.row for one in done.outliers] == [8]
    assert any("Row 8 is called b and fits a" in note for note in done.notes)
    z = [(done.corrections[one] - off[one]) / done.deviations[one] for one in done.free]
    assert np.abs(z).max() < 4.5


def test_a_spike_that_was_moved_is_refused_with_the_row():
    rng = np.random.default_rng(8)
    arm, world, _ = drawn("irb120", rng)
    near = np.array(NEAR["irb120"])
    here = world.there(near)[0]
    places = np.tile(here, (40, 1))
    places[::2] += [0.0, 0.27, 0.0]
    places[25::2] += [6e-4, 0.0, 0.0]
    touches = touched(world.touched(rng, places, near), ["ba"[i % 2] for i in range(40)], lengths=KNOWN)
    with refuses(Inconsistent, "two places", "row 25") as caught:
        calibrate_touched(arm, touches, tolerance=TOLERANCE)
    assert "from row 26" in caught.value.cure
    called = [*touches.feature[:25], *("c" if name == "a" else name for name in touches.feature[25:])]
    assert calibrate_touched(arm, touched(touches.q, called, lengths=KNOWN), tolerance=TOLERANCE).gain


def test_a_length_typed_wrong_is_refused():
    arm, *_, touches, _ = of_spikes()
    wrong = (replace(KNOWN[0], length_m=0.275),)
    with refuses(Inconsistent, "distance of a and b", "275 mm", "--tolerance-mm"):
        calibrate_touched(arm, replace(touches, lengths=wrong), tolerance=TOLERANCE)
    assert calibrate_touched(arm, touches, tolerance=TOLERANCE).gain
    wide = Tolerance(length_m=5.0 * LENGTH_M, angle_rad=ANGLE_RAD)
    assert calibrate_touched(arm, replace(touches, lengths=wrong), tolerance=wide).gain


def test_a_joint_that_runs_the_other_way_is_named_and_the_cure_works():
    arm, _, _, touches, _ = of_spikes(seed=4)
    signs, zero = np.array([1, -1, 1, 1, -1, 1]), np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    wrong = replace(touches, q=(touches.q - zero) * signs)
    with refuses(
        Inconsistent, "j2, j5", "the other way", "sign: -1", "(j3)", "touched points", "with j1, j2, j4, j5, j6 counted"
    ):
        calibrate_touched(arm, wrong)
    joints = [
        replace(joint, sign=joint.sign * float(s), theta_rad=joint.theta_rad + float(z))
        for joint, s, z in zip(arm.joints, signs, zero, strict=True)
    ]
    cured = replace(arm, joints=tuple(joints))
    assert calibrate_touched(cured, wrong, tolerance=TOLERANCE).after.rms_m < 3e-4


def test_gauges_read_in_millimetres_and_columns_exchanged_are_refused():
    rng = np.random.default_rng(5)
    arm, world, _ = drawn("irb120", rng)
    near, n = np.array(NEAR["irb120"]), 20
    here, travel = world.there(near)[0], rng.uniform(0.0, 0.02, n)
    anvil = here + rng.uniform(-0.08, 0.08, (n, 3)) * [1.0, 1.0, 0.0] + np.outer(travel, [0.0, 0.0, 1.0])
    q = world.touched(rng, np.concatenate([np.tile(here, (n, 1)), anvil]), near)
    named, kinds = ["spike"] * n + ["dial"] * n, [Kind.POINT] * n + [Kind.GAUGE] * n
    read = np.concatenate([np.zeros(n), 1e3 * travel])
    with refuses(Inconsistent, "dial", "reading_m in m"):
        calibrate_touched(arm, touched(q, named, kinds, (), read), tolerance=TOLERANCE)
    assert calibrate_touched(arm, touched(q, named, kinds, (), 1e-3 * read), tolerance=TOLERANCE).free
    with refuses(Inconsistent, "exchanged columns"):
        calibrate_touched(arm, touched(q[:, [0, 2, 1, 3, 4, 5]], named, kinds, (), 1e-3 * read), tolerance=TOLERANCE)


def test_too_few_touches_are_refused():
    arm, *_, touches, _ = of_spikes()
    with refuses(NotEnoughData, "touches"):
        calibrate_touched(arm, touches.take(np.arange(8)))
