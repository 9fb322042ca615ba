"""The figures of ISO 9283 on small point sets, against numbers worked out by hand in the comments."""

from math import pi, sqrt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.verify.iso9283 import ArrivalTest, CommandedPath, Iso9283Test, PathRun, PathTest, PoseVisits, evaluate

MM = 1e-3
MRAD = 1e-3
APPROX = {"rel": 1e-9, "abs": 1e-12}


def visits(pose, xyz_mm, **more):
    return PoseVisits(pose=pose, xyz_m=np.array(xyz_mm) * MM, visit=np.arange(len(xyz_mm)), **more)


def figures(**test):
    return evaluate(Iso9283Test(**test))


# Six visits. Offsets from the barycentre are +-1 mm in x, +-2 mm in y, +-3 mm in z; the barycentre is (3, 4, 0) mm from
# the command; the turns about z are 5 mrad and +-1, +-2, +-3 mrad about that.
OFFSETS = np.array([[1, 0, 0], [-1, 0, 0], [0, 2, 0], [0, -2, 0], [0, 0, 3], [0, 0, -3]])
TURNS = 5.0 + np.array([1, -1, 2, -2, 3, -3])


def six_visits(**more):
    quat = Rotation.from_rotvec(np.outer(TURNS * MRAD, [0, 0, 1])).as_quat()
    return visits(
        "P1",
        OFFSETS + np.array([103.0, 54.0, 20.0]),
        quat_xyzw=quat,
        approach=("x",) * 6,
        commanded_xyz_m=np.array([100.0, 50.0, 20.0]) * MM,
        commanded_quat_xyzw=[0, 0, 0, 1],
        **more,
    )


def test_pose_accuracy():
    found = figures(poses=[six_visits()])
    # AP = sqrt(3^2 + 4^2) = 5 mm
    assert found["AP_m"].value == pytest.approx(5 * MM, **APPROX)
    assert [found[f"AP_{axis}_m"].value for axis in "xyz"] == pytest.approx([3 * MM, 4 * MM, 0.0], **APPROX)
    assert [found[f"AP_{turn}_rad"].value for turn in "abc"] == pytest.approx([0, 0, 5 * MRAD], **APPROX)
    # sample variances 2/5, 8/5, 18/5 mm^2; of the mean a sixth; along (0.6, 0.8, 0): (0.36*0.4 + 0.64*1.6) / 6
    assert found["AP_m"].std == pytest.approx(sqrt((0.36 * 0.4 + 0.64 * 1.6) / 6) * MM, **APPROX)
    assert (found["AP_m"].n, found["AP_m"].wanted) == (6, 30)


def test_pose_accuracy_with_the_cameras_covariance():
    systematic = np.diag([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]) ** 2 * 1e-6
    found = figures(poses=[six_visits(covariance=np.tile(systematic, (6, 1, 1)), systematic=systematic)])
    # to the visits' part along (0.6, 0.8, 0) comes 0.36*0.01 + 0.64*0.04
    total = (0.36 * 0.4 + 0.64 * 1.6) / 6 + 0.36 * 0.01 + 0.64 * 0.04
    assert found["AP_m"].std == pytest.approx(sqrt(total) * MM, **APPROX)
    # turns: sum of squares 2 * (1 + 4 + 9) = 28, variance 28/5, of the mean 28/30; with (0.6 mrad)^2
    assert found["AP_c_rad"].std == pytest.approx(sqrt(28 / 30 + 0.36) * MRAD, **APPROX)


def test_pose_repeatability():
    found = figures(poses=[six_visits()])
    # l = 1, 1, 2, 2, 3, 3 mm: mean 2, S = sqrt(4 / 5); RP = 2 + 3 sqrt(0.8) = 4.683 mm
    assert found["RP_m"].value == pytest.approx((2 + 3 * sqrt(0.8)) * MM, **APPROX)
    # S_c = sqrt(28 / 5) mrad, RP_c = 7.099 mrad
    assert found["RP_c_rad"].value == pytest.approx(3 * sqrt(28 / 5) * MRAD, **APPROX)
    # c4(6)^2 = (2/5) Gamma(3)^2 / Gamma(5/2)^2 = (2/5) 4 / (9 pi / 16) = 25.6 / (9 pi)
    assert found["RP_c_rad"].std == pytest.approx(3 * sqrt(28 / 5) * sqrt(9 * pi / 25.6 - 1) * MRAD, **APPROX)
    assert [found[f"RP_{turn}_rad"].value for turn in "ab"] == pytest.approx([0, 0], abs=1e-12)


def test_noise_of_the_camera_is_taken_out_in_squares():
    noise = np.diag([1e-12, 1e-12, 1e-12, 1e-12, 1e-12, (2 * MRAD) ** 2])
    found = figures(poses=[six_visits(covariance=np.tile(noise, (6, 1, 1)))])
    # without its bias S_c^2 = (28 / 5) 9 pi / 25.6 = 6.185; less 4: corrected 3 sqrt(2.185) = 4.435 mrad
    kept = 3 * sqrt(28 / 5 * 9 * pi / 25.6 - 4)
    assert found["RP_c_rad"].corrected == pytest.approx(kept * MRAD, rel=1e-9)
    assert found["RP_c_rad"].value == pytest.approx(3 * sqrt(28 / 5) * MRAD, rel=1e-9)


def test_multi_directional_variation():
    # three visits from each direction; barycentres (0, 0, 0), (3, 0, 0), (3, 4, 0) mm: distances 3, 4 and 5
    spread = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 0]])
    points = np.concatenate([spread + np.array(at) for at in ([0, 0, 0], [3, 0, 0], [3, 4, 0])])
    found = figures(poses=[visits("P1", points, approach=tuple("xxxyyyzzz"))])
    assert found["vAP_m"].value == pytest.approx(5 * MM, **APPROX)
    # each barycentre's variance in x is (2 / 2) / 3; the pair has 2/3 in x, and 0.6 of the direction is x
    assert found["vAP_m"].std == pytest.approx(0.6 * sqrt(2 / 3) * MM, **APPROX)
    assert found["vAP_m"].n == 3


def test_distance_accuracy_and_repeatability():
    # P4 lies 100.1 to 100.5 mm from P2 along (0.6, 0.8, 0); commanded 100 mm
    d = np.array([100.1, 100.2, 100.3, 100.4, 100.5])
    along = np.array([0.6, 0.8, 0.0])
    one = visits("P2", np.zeros((5, 3)), commanded_xyz_m=np.zeros(3))
    other = visits("P4", np.outer(d, along), commanded_xyz_m=100.0 * along * MM)
    found = figures(poses=[one, other])
    # mean 100.3: AD = 0.3 mm; S = sqrt((0.04 + 0.01 + 0 + 0.01 + 0.04) / 4) = sqrt(0.025); RD = 3 S = 0.474 mm
    assert found["AD_m"].value == pytest.approx(0.3 * MM, rel=1e-9)
    assert found["AD_m"].std == pytest.approx(sqrt(0.025 / 5) * MM, rel=1e-9)
    assert found["RD_m"].value == pytest.approx(3 * sqrt(0.025) * MM, rel=1e-9)
    assert [found[f"AD_{axis}_m"].value for axis in "xyz"] == pytest.approx([0.18 * MM, 0.24 * MM, 0.0], **APPROX)
    assert found["RD_x_m"].value == pytest.approx(3 * 0.6 * sqrt(0.025) * MM, rel=1e-9)


def test_exchangeability():
    # barycentres of three robots at x = 0, 6 and y = 8 mm: distances 6, 8, 10
    spread = np.array([[0, 0, 1], [0, 0, -1], [0, 0, 0]])
    places = {"A": [0, 0, 0], "B": [0, 8, 0], "C": [6, 0, 0]}
    robots = [visits("P1", spread + np.array(at), robot=name) for name, at in places.items()]
    found = figures(poses=robots)
    assert found["E_m"].value == pytest.approx(10 * MM, **APPROX)
    assert (found["E_m"].n, found["E_m"].wanted) == (3, 5)


def line_runs(offsets_mm, slope=0.0):
    x = np.linspace(-1.0, 101.0, 103)
    return [PathRun(xyz_m=np.stack([x, k * (1 + slope * (x / 100 - 1)), 0 * x], axis=1) * MM) for k in offsets_mm]


def test_path_accuracy_and_repeatability():
    path = CommandedPath(xyz_m=np.array([[0, 0, 0], [100, 0, 0]]) * MM)
    found = figures(paths=[PathTest(name="line", runs=line_runs([1, 2, 3, 4, 5]), commanded=path)])
    # the mean run lies 3 mm off; l = 2, 1, 0, 1, 2: mean 1.2, S = sqrt((0.64 + 0.04 + 1.44 + 0.04 + 0.64) / 4)
    assert found["AT_m"].value == pytest.approx(3 * MM, rel=1e-9)
    assert found["AT_m"].std == pytest.approx(sqrt(2.5 / 5) * MM, rel=1e-9)
    assert found["RT_m"].value == pytest.approx((1.2 + 3 * sqrt(0.7)) * MM, rel=1e-9)


def test_path_accuracy_is_that_of_the_worst_plane():
    # runs that leave the line evenly: the last of 50 planes is at 99 mm, where the mean run is 2.97 mm off
    path = CommandedPath(xyz_m=np.array([[0, 0, 0], [100, 0, 0]]) * MM)
    found = figures(paths=[PathTest(name="line", runs=line_runs([1, 2, 3, 4, 5], slope=1.0), commanded=path)])
    assert found["AT_m"].value == pytest.approx(2.97 * MM, rel=1e-9)
    assert found["RT_m"].value == pytest.approx(0.99 * (1.2 + 3 * sqrt(0.7)) * MM, rel=1e-9)


def test_corner_round_off_and_overshoot():
    path = CommandedPath(xyz_m=np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0]]) * MM)
    cut = np.array([[0, 0, 0], [90, 0, 0], [100, 10, 0], [100, 100, 0]]) * MM  # passes the corner at 10 / sqrt(2) mm
    over = np.array([[0, 0, 0], [104, 0, 0], [104, 10, 0], [100, 20, 0], [100, 100, 0]]) * MM  # through it, 4 mm beyond
    found = figures(paths=[PathTest(name="L", runs=[PathRun(xyz_m=cut), PathRun(xyz_m=over)], commanded=path)])
    assert found["CR_m"].value == pytest.approx(10 / sqrt(2) * MM, rel=1e-9)
    assert found["CR_m"].std == pytest.approx(5 * MM, rel=1e-9)  # of 0 and 7.07: their difference over sqrt(2)
    assert found["CO_m"].value == pytest.approx(4 * MM, rel=1e-9)


def speed_runs(speeds_m_s):
    t = np.arange(201) * 0.01
    return [PathRun(t_s=t, xyz_m=np.outer(v * t, [1.0, 0.0, 0.0])) for v in speeds_m_s]


def test_velocity():
    path = CommandedPath(xyz_m=np.array([[0, 0, 0], [0.2, 0, 0]]), speed_m_s=0.1)
    runs = speed_runs([0.101, 0.102, 0.103, 0.104, 0.105])
    found = figures(paths=[PathTest(name="line", runs=runs, commanded=path)])
    # mean 0.103: AV = 3 %; S = sqrt(2.5e-6) m/s; RV = 3 S / 0.1 = 4.74 %; no run fluctuates
    assert found["AV_ratio"].value == pytest.approx(0.03, rel=1e-9)
    assert found["AV_ratio"].std == pytest.approx(sqrt(2.5e-6 / 5) / 0.1, rel=1e-6)
    assert found["RV_ratio"].value == pytest.approx(3 * sqrt(2.5e-6) / 0.1, rel=1e-6)
    assert found["FV_m_s"].value == pytest.approx(0.0, abs=1e-12)


def test_velocity_fluctuation():
    # two runs at 0.1 m/s; in a third the middle 0.4 s are run at 0.12 m/s: 20 mm/s between fastest and slowest
    t = np.arange(201) * 0.01
    x = np.cumsum(np.concatenate([[0.0], np.where(np.abs(t[1:] - 1.0) < 0.2, 0.12, 0.1) * 0.01]))
    third = PathRun(t_s=t, xyz_m=np.outer(x, [0.0, 0.6, 0.8]))
    found = figures(paths=[PathTest(name="line", runs=[*speed_runs([0.1, 0.1]), third])])
    assert found["FV_m_s"].value == pytest.approx(0.02, rel=1e-9)


def test_stabilisation_time_and_overshoot():
    # distances from rest in mm every 0.1 s; the band is 1 mm
    over = [10, 5, 0, -3, *[0] * 20]  # enters at 0.18 s, is 3 mm beyond at 0.3 s, comes back in at 0.3667 s
    plain = [10, 5, 0, 0, *[0] * 20]  # enters once and stays: 0 s
    traces = [PathRun(t_s=0.1 * np.arange(24), xyz_m=np.outer(x, [0.0, 0.0, MM])) for x in (over, plain)]
    found = figures(arrivals=[ArrivalTest(pose="P1", traces=traces, band_m=1 * MM)])
    time = 0.1 * (3 + 2 / 3) - 0.1 * (1 + 4 / 5)
    assert found["t_s"].value == pytest.approx(time / 2, rel=1e-9)
    # the two differ by time: variance time^2 / 2; two instants each even over 0.1 s: 2 * 0.01 / 12
    assert found["t_s"].std == pytest.approx(sqrt((time**2 / 2 + 0.01 / 6) / 2), rel=1e-9)
    assert found["OV_m"].value == pytest.approx(3 * MM, rel=1e-9)
    assert (found["OV_m"].n, found["OV_m"].wanted) == (2, 3)


def test_visits_that_drift_have_no_deviation_and_the_drift_is_a_figure():
    # 40 visits move by 0.01 mm each along x, with +-0.01 mm in y: the last ten lie 0.30 mm from the first ten
    points = np.array([[0.01 * k, 0.01 * (-1) ** k, 0.0] for k in range(40)])
    drifting = figures(poses=[visits("P1", points, commanded_xyz_m=[-1e-3, 0.0, 0.0])])
    assert drifting["dAP_m"].value == pytest.approx(0.30 * MM, rel=1e-6)
    assert drifting["dRP_m"].value == pytest.approx(0.0, abs=1e-9)
    for name in ("AP_m", "RP_m"):
        assert drifting[name].std is None
        assert "0.36 mm" in drifting[name].note  # 4 of 40 at each end
    mixed = points[np.random.default_rng(0).permutation(40)]
    assert figures(poses=[visits("P1", mixed)])["RP_m"].std > 0.0
