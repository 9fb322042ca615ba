"""Naming the spots: extra, missing and hidden ones, one epipolar line, symmetry, swapped views, predictions."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Inconsistent, Unseen
from armsight.geometry import pose_difference
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Measured, Setup, Track
from armsight.optics import Camera, Rig, converged_rig, parallel_rig
from armsight.records import PoseStatus, Spots, Target, spot_target, unmeasured_target
from refusals import refuses

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
SCALENE = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.035, 0.0), "C": (0.015, -0.03, 0.0)}
ISOSCELES = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.03, 0.0), "C": (0.03, -0.03, 0.0)}
R3 = np.sqrt(3.0) / 2.0
EQUILATERAL = {"A": (-0.05, 0.0, 0.0), "B": (0.025, 0.05 * R3, 0.0), "C": (0.025, -0.05 * R3, 0.0)}
SIX = {**SCALENE, "D": (0.06, 0.0, 0.02), "E": (-0.02, 0.05, 0.01), "F": (-0.05, -0.04, 0.0)}
POSE = RigidTransform.from_components([0.02, -0.01, 0.6], Rotation.from_rotvec([0.2, -0.3, 0.1]))


def spots(uv: np.ndarray, seed: int = 1, sigma_px: float = 0.05) -> Spots:
    rng, n = np.random.default_rng(seed), len(uv)
    return Spots(
        uv_px=(uv + rng.normal(0.0, sigma_px, uv.shape))[rng.permutation(n)],
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def points_of(places: dict[str, tuple[float, float, float]], T: RigidTransform = POSE) -> np.ndarray:
    return np.asarray(T.apply(np.array(list(places.values()))))


def measure(
    target: Target,
    left_points: np.ndarray,
    right_points: np.ndarray | None = None,
    *,
    rig: Rig = RIG,
    track: Track | None = None,
    t_s: float = 0.0,
) -> Measured:
    left = rig.project(left_points)[0]
    right = rig.project(left_points if right_points is None else right_points)[1]
    return measure_spots(Setup(rig, target), t_s, spots(left, 1), spots(right, 2), track)


def assert_pose(measured: Measured, T: RigidTransform, n: int = 3) -> None:
    assert measured.pose.status is PoseStatus.OK, measured.pose.why
    assert measured.pose.pose is not None and len(measured.names) == n
    difference = pose_difference(measured.pose.pose, T)
    assert np.linalg.norm(difference[:3]) < 1e-3 and np.linalg.norm(difference[3:]) < 0.03


def test_six_lights_among_ten_reflections() -> None:
    ghosts = np.random.default_rng(3).uniform([-0.15, -0.1, 0.5], [0.15, 0.1, 0.8], (10, 3))
    points = points_of(SIX)
    measured = measure(spot_target(SIX), np.vstack([ghosts[:5], points, ghosts[5:]]), np.vstack([points, ghosts]))
    assert_pose(measured, POSE, 6)
    assert len(measured.left_seen) == 16 and len(measured.left) == 6


def test_hidden_lights_are_left_out_by_name() -> None:
    points = points_of(SIX)
    measured = measure(spot_target(SIX), points[[0, 1, 3, 4, 5]], points[[0, 1, 2, 3, 5]])
    assert_pose(measured, POSE, 4)
    assert measured.names == ("A", "B", "D", "F")
    assert [note[0] for note in measured.notes] == ["C", "E"]


def test_two_lights_on_one_epipolar_line_are_told_apart_by_the_geometry() -> None:
    rig = parallel_rig(Camera.pinhole(1280, 720, 1131.0, 1131.0, 640.0, 360.0), 0.12)
    level = {"A": (-0.04, 0.0, 0.0), "B": (0.04, 0.0, 0.03), "C": (0.01, -0.05, 0.0)}
    T = RigidTransform.from_components([0.06, 0.0, 0.6], Rotation.identity())
    left, right = rig.project(points_of(level, T))
    assert abs(left[0, 1] - left[1, 1]) < 1e-9 and abs(right[0, 1] - left[1, 1]) < 1e-9
    assert_pose(measure(spot_target(level), points_of(level, T), rig=rig), T)


def test_equilateral_triangle_gives_all_hypotheses_and_no_guess() -> None:
    measured = measure(spot_target(EQUILATERAL), points_of(EQUILATERAL))
    assert measured.pose.status is PoseStatus.POSITION_ONLY
    assert "ambiguous: 3" in measured.pose.why
    assert len(measured.alternatives) == 3 and measured.track is None
    assert all(pose.status is PoseStatus.OK for pose in measured.alternatives)
    assert measured.pose.pose is not None
    np.testing.assert_allclose(measured.pose.pose.translation, POSE.translation, atol=1e-3)
    nearest = min(np.linalg.norm(pose_difference(a.pose, POSE)[3:]) for a in measured.alternatives)  # type: ignore[arg-type]
    assert nearest < 0.03


def test_a_track_resolves_the_equilateral_triangle() -> None:
    target, places = spot_target(EQUILATERAL), points_of(EQUILATERAL)
    track = Track(
        t_s=0.0,
        whole_t_s=0.0,
        names=("A", "B", "C"),
        xyz_m=places,
        velocity_m_s=np.zeros((3, 3)),
        half_window_px=20,
        complete=True,
    )
    moved = RigidTransform.from_components([0.024, -0.008, 0.603], Rotation.from_rotvec([0.22, -0.28, 0.13]))
    assert_pose(measure(target, points_of(EQUILATERAL, moved), track=track, t_s=0.03), moved)


@pytest.mark.parametrize("about_rad", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
def test_a_light_hidden_by_another_in_one_view_is_not_given_its_spot(about_rad: float) -> None:
    eye, first = RIG.T_rig_left.translation, np.array([0.0, 0.0, 0.6])
    sight = (first - eye) / np.linalg.norm(first - eye)
    places = np.array(list(SCALENE.values()))
    way = (places[1] - places[0]) / np.linalg.norm(places[1] - places[0])
    R, _ = Rotation.align_vectors([sight], [way])  # from A to B along the left camera's line of sight
    R = Rotation.from_rotvec(about_rad * sight) * R
    points = points_of(SCALENE, RigidTransform.from_components(first - R.apply(places[0]), R))
    measured = measure(spot_target(SCALENE), points[[0, 2]], points)
    assert measured.pose.status is not PoseStatus.OK


def test_isosceles_triangle_out_of_the_plane_of_z_is_not_guessed() -> None:
    upright = {name: (z, x, y) for name, (x, y, z) in ISOSCELES.items()}
    T = RigidTransform.from_components([0.02, -0.01, 0.6], Rotation.from_rotvec([0.1, np.pi / 2, 0.0]))
    measured = measure(spot_target(upright), points_of(upright, T))
    assert measured.pose.status is PoseStatus.POSITION_ONLY and len(measured.alternatives) == 2


def test_a_target_whose_file_mirrors_it_is_refused() -> None:
    mirrored = {name: (x, -y, z) for name, (x, y, z) in SCALENE.items()}
    measured = measure(spot_target(mirrored), points_of(SCALENE))
    assert measured.pose.status is PoseStatus.LOST and measured.cause is Unseen.WRONG_TARGET
    assert "from behind" in measured.pose.why


def test_isosceles_triangle_is_seen_from_its_front() -> None:
    measured = measure(spot_target(ISOSCELES), points_of(ISOSCELES))
    assert_pose(measured, POSE)


@pytest.mark.parametrize("rig", [RIG, parallel_rig(CAMERA, 0.12)], ids=["converged", "parallel"])
@pytest.mark.parametrize("target", [spot_target(SCALENE), unmeasured_target()], ids=["measured", "unmeasured"])
def test_swapped_views_are_recognised(rig: Rig, target: Target) -> None:
    T = RigidTransform.from_components([0.13, -0.09, 0.55], Rotation.from_rotvec([0.2, -0.3, 0.1]))
    left, right = rig.project(points_of(SCALENE, T))
    with refuses(Inconsistent, "swapped"):
        measure_spots(Setup(rig, target), 0.0, spots(right), spots(left))
    assert measure_spots(Setup(rig, target), 0.0, spots(left), spots(right)).pose.status is PoseStatus.OK


@pytest.mark.parametrize("seed", range(6))
def test_swapped_views_of_which_some_lights_still_meet_are_recognised(seed: int) -> None:
    """Of cameras that look at one point a light near it pairs exchanged as well, and gave a position."""
    rng = np.random.default_rng(seed)
    place = rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.8])
    T = RigidTransform.from_components(place, Rotation.from_rotvec(rng.normal(0.0, 0.25, 3)))
    left, right = RIG.project(points_of(EQUILATERAL, T))
    with refuses(Inconsistent, "swapped"):
        measure_spots(Setup(RIG, spot_target(EQUILATERAL)), 0.0, spots(right), spots(left))


def test_unmeasured_target_is_named_by_position() -> None:
    T = RigidTransform.from_components([0.02, -0.01, 0.6], Rotation.from_rotvec([0.1, -0.1, 0.1]))
    points = points_of(ISOSCELES, T)
    measured = measure(unmeasured_target(), points)
    assert measured.pose.status is PoseStatus.OK and measured.names == ("A", "B", "C")
    np.testing.assert_allclose(measured.points.xyz_m, points, atol=2e-3)
    assert measured.pose.pose is not None
    assert measured.pose.pose.rotation.as_matrix()[2, 2] > 0.9  # w points away from the cameras


def test_unmeasured_target_without_clear_order_is_not_guessed() -> None:
    level = np.array([[0.0, 0.03, 0.6], [0.0, -0.03, 0.6], [0.05, 0.0, 0.6]])
    rig = parallel_rig(Camera.pinhole(1280, 720, 1131.0, 1131.0, 640.0, 360.0), 0.12)
    measured = measure(unmeasured_target(), level, rig=rig)
    assert measured.pose.status is PoseStatus.LOST and "no clear order" in measured.pose.why


def test_two_candidates_for_a_beacon_are_not_guessed_but_a_track_knows() -> None:
    target, points = spot_target({"A": (0.0, 0.0, 0.0)}), np.array([[0.0, 0.0, 0.6], [0.08, 0.04, 0.65]])
    measured = measure(target, points)
    assert measured.pose.status is PoseStatus.LOST and "2 lights" in measured.pose.why
    first = measure(target, points[:1])
    assert first.track is not None
    again = measure(target, points, track=first.track, t_s=0.03)
    assert again.pose.status is PoseStatus.POSITION_ONLY and again.names == ("A",)


def test_a_track_names_the_two_lights_that_are_left() -> None:
    target = spot_target(SCALENE)
    before = measure(target, points_of(SCALENE))
    now = measure(target, points_of(SCALENE)[1:], track=before.track, t_s=0.03)
    assert now.pose.status is PoseStatus.POSITION_ONLY and now.names == ("B", "C")
    assert now.track is not None and set(now.track.names) == {"A", "B", "C"} and not now.track.complete
