"""A whole cell in one bundle on a real set: the pitch by the robot's motion, pictures left out, what stays open."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import cell_real_set as real

pytestmark = pytest.mark.skipif(not real.FOLDER.exists(), reason="the recording dots_10x10_handeye is not here")
EACH = 3
"""One picture of so many is left out."""


@pytest.fixture(scope="module")
def given() -> real.RealSet:
    return real.read_set()


@pytest.fixture(scope="module")
def some(given: real.RealSet) -> tuple[real.Bundle, real.CellFit]:
    bundle = real.bundle_of(given, [k for k in range(len(given.views)) if k % EACH])
    return bundle, real.fit_bundle(bundle)


def test_the_virtual_arm_takes_the_robots_poses_exactly(
    some: tuple[real.Bundle, real.CellFit], given: real.RealSet
) -> None:
    bundle, _ = some
    model, x = bundle.model, bundle.x
    log = model.recording.log
    at_s = real.APART_S * np.arange(len(given.views))
    T = model.flange(x, log.at(at_s)[0])
    assert np.abs(log.at(at_s)[1]).max() < 1e-9
    dots = bundle.chain.T_base_board.apply(bundle.target.xyz_m)
    for k, pose in enumerate(given.robot):
        at_wrist = model.lights_m(x) @ T[k, :3, :3].T + T[k, :3, 3]
        assert np.abs(at_wrist - pose.inv().apply(dots)).max() < 1e-9


def test_the_pitch_is_the_robots_and_not_the_configurations(some: tuple[real.Bundle, real.CellFit]) -> None:
    bundle, found = some
    pitch_m, slope = bundle.pitch_m(found.x)
    std_m = float(np.sqrt(slope @ found.covariance(bundle.model) @ slope))
    assert std_m < 1e-4
    assert abs(pitch_m - real.ROBOT_M) < 3.0 * np.hypot(std_m, real.ROBOT_STD_M)
    assert abs(pitch_m - real.CONFIG_M) > 5.0 * std_m


def test_what_standing_pictures_do_not_tell_is_named(some: tuple[real.Bundle, real.CellFit]) -> None:
    told = {one.name: one for one in real.told(*some)}
    open_ = {name for name, one in told.items() if one.bits is not None and one.bits < 0.2}
    assert {"left.drift_ppm", "left.readout_s"} <= open_
    assert told["left.fx"].bits is None
    for name in ("left.cx", "left.k1", "left.p1", "pitch_m"):
        bits = told[name].bits
        assert bits is not None
        assert bits > 1.0


def test_pictures_left_out_are_predicted_no_worse_than_by_the_chain(
    some: tuple[real.Bundle, real.CellFit], given: real.RealSet
) -> None:
    bundle, found = some
    out = range(0, len(given.views), EACH)
    chains = bundle.chain, real.chain_of(given.take(bundle.pictures), bundle.chain.pitch_found_m)
    ours = [real.missed(bundle.predict(found.x, k), given.views[k]) for k in out]
    told, advised = ([real.missed(chain.predict(given.robot[k]), given.views[k]) for k in out] for chain in chains)
    ours_rms, told_rms, advised_rms = (np.sqrt(np.square(each).mean(axis=0)) for each in (ours, told, advised))
    assert (ours_rms < 0.7 * told_rms).all()
    assert (ours_rms < 1.1 * advised_rms).all()
