"""Figures that the data do not carry are withheld with the reason and the number needed; wrong input is refused."""

import numpy as np
import pytest

from armsight.verify.iso9283 import (
    ArrivalTest,
    CommandedPath,
    Iso9283Test,
    PathRun,
    PathTest,
    PoseVisits,
    Stamps,
    evaluate,
)
from refusals import names_it


def visits(n=10, *, pose="P1", seed=0, **more):
    xyz = np.random.default_rng(seed).normal(0.0, 1e-4, (n, 3))
    return PoseVisits(pose=pose, xyz_m=xyz, visit=np.arange(n), **more)


def figure(key, **test):
    return evaluate(Iso9283Test(**test))[key]


def line(n_runs=5, samples=60, t=True):
    x = np.linspace(0.0, 0.2, samples)
    times = np.linspace(0.0, 2.0, samples) if t else None
    offsets = np.random.default_rng(0).normal(0.0, 1e-4, n_runs)
    return [PathRun(xyz_m=np.stack([x, 0 * x + y, 0 * x], axis=1), t_s=times) for y in offsets]


LINE = CommandedPath(xyz_m=[[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]], speed_m_s=0.1)


def test_without_a_command_accuracy_is_withheld_and_repeatability_given():
    for poses in ([visits()], [visits(commanded_xyz_m=[0.1, 0, 0], in_measuring_frame=False)]):
        accuracy = figure("AP_m", poses=poses)
        assert accuracy.value is None
        assert "command" in accuracy.withheld
        assert figure("RP_m", poses=poses).value > 0.0


def test_of_several_directions_variation_is_given_and_repeatability_withheld():
    poses = [visits(12, approach=tuple("xyz" * 4))]
    assert "3 directions (x, y, z)" in figure("RP_m", poses=poses).withheld
    assert figure("vAP_m", poses=poses).value > 0.0
    assert "1 of the 2" in figure("vAP_m", poses=[visits(approach=("x",) * 10)]).withheld
    assert "not known" in figure("vAP_m", poses=[visits()]).withheld


def test_too_few_repeats_name_the_number_needed():
    assert names_it(figure("RP_m", poses=[visits(2)]).withheld, "2 of the 5", "30")
    assert "2 of the 3" in figure("AP_m", poses=[visits(2, commanded_xyz_m=np.zeros(3))]).withheld
    assert "4 of the 5" in figure("RT_m", paths=[PathTest(name="line", runs=line(4))]).withheld
    pair = [visits(4, pose="A"), visits(4, pose="B", seed=1)]
    assert "4 of the 5" in figure("RD_m", poses=pair).withheld
    apart = [visits(4, pose="A"), PoseVisits(pose="B", xyz_m=np.zeros((4, 3)), visit=np.arange(4, 8))]
    assert names_it(figure("RD_m", poses=apart).withheld, "0 of the 3", "A and B")
    robots = [visits(5, robot="one"), visits(2, robot="two")]
    assert names_it(figure("E_m", poses=robots).withheld, "robot two", "2 of the 3")


@pytest.mark.parametrize(
    ("stamps", "times", "why"),
    [(Stamps.ARRIVAL, True, "arrival times"), (Stamps.ABSENT, True, "no times"), (Stamps.SAMPLING, False, "no times")],
)
def test_velocity_and_stabilisation_need_sampling_times(stamps, times, why):
    runs = line(t=times)
    test = PathTest(name="line", runs=runs, commanded=LINE, stamps=stamps)
    for key in ("AV_ratio", "RV_ratio", "FV_m_s"):
        assert why in figure(key, paths=[test]).withheld
    assert figure("AT_m", paths=[test]).value is not None
    arrivals = [ArrivalTest(pose="P1", traces=runs, band_m=1e-3, stamps=stamps)]
    assert why in figure("t_s", arrivals=arrivals).withheld


def test_path_repeatability_without_a_command_is_square_to_the_first_run():
    found = figure("RT_m", paths=[PathTest(name="line", runs=line())])
    given = figure("RT_m", paths=[PathTest(name="line", runs=line(), commanded=LINE)])
    assert "first run" in found.note
    assert given.note == ""


def test_speed_on_a_small_circle_is_that_of_the_arc():
    t = np.arange(120) / 60
    angle = 0.1 * t / 0.0125
    runs = [PathRun(t_s=t, xyz_m=0.0125 * np.stack([np.cos(angle), np.sin(angle), 0 * t], axis=1))] * 3
    found = figure("AV_ratio", paths=[PathTest(name="circle", runs=runs, commanded=LINE)])
    assert found.value == pytest.approx(0.0, abs=1e-4)  # the chord of two steps is 0.3 % shorter than the arc


def test_noise_as_large_as_the_scatter_is_said():
    noise = np.tile(np.eye(3) * 4e-8, (10, 1, 1))
    found = figure("RP_m", poses=[visits(covariance=noise)])
    assert found.corrected == 0.0
    assert "robot's part" in found.note
    assert found.corrected_std > 0.0
    assert "covariance" in figure("RP_m", poses=[visits()]).note


def test_turns_across_half_a_turn_are_small():
    """Euler angles of these orientations jump by a whole turn between visits."""
    angles = np.pi + np.array([-2, -1, 0, 1, 2]) * 1e-3
    quat = np.stack([np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)], axis=1)
    found = figure("RP_a_rad", poses=[visits(5, quat_xyzw=quat)])
    assert found.value == pytest.approx(3 * np.sqrt(2.5) * 1e-3, rel=1e-6)
