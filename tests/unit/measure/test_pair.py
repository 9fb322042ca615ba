"""Two frames in, pose out: sizes, windows around predictions, what is handed from call to call, boards."""

import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Inconsistent, Unseen
from armsight.geometry import pose_difference
from armsight.measure.poses.board_pose import pose_of_views
from armsight.measure.poses.moments import TargetTracker
from armsight.measure.poses.pipeline import Measured, Setup, Track, measure_pair
from armsight.measure.settings import LIVE_S, Pace
from armsight.ops.sources.pace import SideBySide
from armsight.optics import Camera, converged_rig
from armsight.records import BoardView, Frame, PoseStatus, TargetKind, board_target, spot_target
from refusals import names_it, refuses

CAMERA = Camera.pinhole(640, 480, 560.0, 562.0, 322.0, 236.0, distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))
RIG = converged_rig(CAMERA, CAMERA, 0.1, 0.08, -0.08)
TRIANGLE = {"A": (-0.05, 0.0, 0.0), "B": (0.04, 0.045, 0.0), "C": (0.02, -0.04, 0.0)}
X = np.array(list(TRIANGLE.values()))
SETUP = Setup(RIG, spot_target(TRIANGLE))
STARS = np.zeros((2, 480, 640), np.uint8)
"""What else is bright in each image."""
for v, u in np.random.default_rng(5).integers(8, 470, (60, 2)):
    STARS[u % 2, v : v + 3, u : u + 3] = 120


def pixels(points: np.ndarray) -> list[np.ndarray]:
    out = []
    for T in (RIG.T_rig_left.inv(), RIG.T_rig_right.inv()):
        uv, _ = cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, CAMERA.matrix, CAMERA.distortion
        )
        out.append(uv[:, 0])
    return out


def frames(points: np.ndarray, number: int, *, width: int = 640) -> tuple[Frame, Frame]:
    """Gaussian spots of 2 px, 150 grey levels high, with noise of 2, at the pixels of the points."""
    rng = np.random.default_rng(number)
    y, x = np.mgrid[0:480, 0:width]
    made = []
    for source, uv in zip(("left", "right"), pixels(points), strict=True):
        image = 20.0 + rng.normal(0.0, 2.0, x.shape)
        for u, v in uv:
            image += 150.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8.0)
        made.append(
            Frame(image=image.round().clip(0, 255).astype(np.uint8), t_s=number / 30.0, sequence=number, source=source)
        )
    return made[0], made[1]


def pose_at(number: int, speed: float = 0.006) -> RigidTransform:
    return RigidTransform.from_components(
        [0.01 + speed * number, -0.01, 0.6], Rotation.from_rotvec([0.2, -0.2, 0.01 * number])
    )


def assert_pose(measured: Measured, T: RigidTransform) -> None:
    assert measured.pose.status is PoseStatus.OK, measured.pose.why
    assert measured.pose.pose is not None and measured.pose.covariance is not None
    d = pose_difference(measured.pose.pose, T)
    assert d @ np.linalg.solve(measured.pose.covariance, d) < 40.0


def test_a_moving_target_is_tracked_in_windows() -> None:
    track: Track | None = None
    for number in range(6):
        measured = measure_pair(SETUP, *frames(pose_at(number).apply(X), number), track)
        assert_pose(measured, pose_at(number))
        assert measured.tracked is (number > 0)
        assert measured.pose.t_s == pytest.approx(number / 30.0)
        track = measured.track
    assert track is not None
    assert track.half_window_px < 32  # the velocity is known: the windows are smaller than the first ones
    np.testing.assert_allclose(track.velocity_m_s[:, 0], 0.18, atol=0.05)


LIVE = replace(SETUP, pace=Pace(deadline_s=LIVE_S))


def with_plank(frame: Frame, at: np.ndarray) -> Frame:
    """The frame with a rough bright thing that touches a light at a pixel (2,)."""
    u, v = at.round().astype(int)
    image = frame.image.astype(int)
    image[v - 3 : v + 4, u + 5 : u + 14] += np.random.default_rng(7).integers(40, 90, (7, 9))
    return replace(frame, image=image.clip(0, 255).astype(np.uint8))


@pytest.mark.parametrize("setup", [SETUP, LIVE], ids=["file", "live"])
def test_a_light_that_touches_something_bright_is_measured_in_its_window_where_somebody_waits(setup: Setup) -> None:
    track: Track | None = None
    for number in range(8):
        T = pose_at(number)
        seen = frames(T.apply(X), number)
        if number > 4:
            seen = tuple(with_plank(frame, uv[0]) for frame, uv in zip(seen, pixels(T.apply(X)), strict=True))
        measured = measure_pair(setup, *seen, track)
        assert_pose(measured, T)
        assert measured.tracked is (0 < number <= 4 or (number > 4 and setup is LIVE))
        track = measured.track


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside another"])
@pytest.mark.parametrize("setup", [SETUP, LIVE], ids=["file", "live"])
def test_a_knock_is_told_by_what_is_nearby_where_somebody_waits(setup: Setup, beside: bool) -> None:
    track: Track | None = None
    for number in range(10):
        T = pose_at(number, 0.001)
        if number == 9:
            T = RigidTransform.from_components(np.add(T.translation, [0.0, 0.004, 0.0]), T.rotation)
        points = T.apply(X)
        if beside and number == 9:
            points = np.vstack([points, points[0] + [0.012, 0.0, 0.05]])
        measured = measure_pair(setup, *frames(points, number), track)
        assert_pose(measured, T)
        assert measured.tracked is (0 < number < 9 or (number == 9 and setup is LIVE))
        track = measured.track


@pytest.mark.parametrize("setup", [SETUP, LIVE], ids=["file", "live"])
def test_a_light_that_was_hidden_for_a_moment_is_looked_for_in_its_window_where_somebody_waits(setup: Setup) -> None:
    track: Track | None = None
    for number in range(6):
        T = pose_at(number)
        points = T.apply(X[:2] if number == 4 else X)
        measured = measure_pair(setup, *frames(points, number), track)
        track = measured.track
        if number == 4:
            assert measured.pose.status is PoseStatus.POSITION_ONLY
        else:
            assert_pose(measured, T)
            assert measured.tracked is (0 < number < 4 or (number == 5 and setup is LIVE))


def test_a_jump_out_of_the_windows_falls_back_to_the_whole_frame() -> None:
    first = measure_pair(SETUP, *frames(pose_at(0).apply(X), 0))
    jumped = RigidTransform.from_components([-0.1, 0.06, 0.7], Rotation.from_rotvec([-0.1, 0.3, 1.0]))
    measured = measure_pair(SETUP, *frames(jumped.apply(X), 1), first.track)
    assert not measured.tracked
    assert_pose(measured, jumped)


def test_lights_exchanged_in_the_windows_are_noticed() -> None:
    """Half a turn of an arrangement whose lights land in each other's windows: the fit refuses, the search finds it."""
    first = measure_pair(SETUP, *frames(pose_at(0).apply(X), 0))
    assert first.track is not None
    order = [1, 0, 2]
    wrong = Track(
        t_s=0.0,
        whole_t_s=0.0,
        names=("A", "B", "C"),
        xyz_m=first.track.xyz_m[order],
        velocity_m_s=np.zeros((3, 3)),
        half_window_px=20,
        complete=True,
    )
    measured = measure_pair(SETUP, *frames(pose_at(1).apply(X), 1), wrong)
    assert not measured.tracked
    assert_pose(measured, pose_at(1))


def test_a_dark_moment_is_lost_and_the_track_survives_it_for_a_while() -> None:
    first = measure_pair(SETUP, *frames(pose_at(0).apply(X), 0))
    dark = measure_pair(SETUP, *frames(np.array([[9.0, 9.0, 10.0]]), 1), first.track)
    assert dark.pose.status is PoseStatus.LOST and dark.cause is Unseen.NO_SPOT
    assert dark.track is first.track
    again = measure_pair(SETUP, *frames(pose_at(2).apply(X), 2), dark.track)
    assert again.tracked
    late = measure_pair(SETUP, *frames(pose_at(0).apply(X), 60), dark.track)
    assert not late.tracked
    assert_pose(late, pose_at(0))


def among_lamps(number: int, lamps: int = 40) -> tuple[Frame, Frame]:
    rng = np.random.default_rng(7)
    around = rng.uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 1.6], (lamps, 3))
    return frames(np.vstack([pose_at(number).apply(X), around]), number)


def test_what_a_deadline_leaves_no_time_to_look_at_is_refused_with_its_reason() -> None:
    pair = among_lamps(0)
    assert_pose(measure_pair(SETUP, *pair), pose_at(0))
    assert_pose(measure_pair(replace(SETUP, pace=Pace(deadline_s=LIVE_S)), *pair), pose_at(0))
    for deadline_s in (1e-9, 1e-5, 1e-3):
        measured = measure_pair(replace(SETUP, pace=Pace(deadline_s=deadline_s)), *pair)
        assert measured.pose.status is PoseStatus.LOST
        assert measured.cause is Unseen.DEADLINE
        assert names_it(measured.pose.why, "time", "mask")
    quiet = measure_pair(replace(SETUP, pace=Pace(deadline_s=1e-3)), *frames(pose_at(0).apply(X), 0))
    assert_pose(quiet, pose_at(0))


def test_both_views_beside_each_other_give_the_same_answer() -> None:
    for pair in (among_lamps(0), frames(pose_at(0).apply(X), 0)):
        one, two = (measure_pair(replace(SETUP, pace=pace), *pair) for pace in (Pace(), Pace(each=SideBySide())))
        np.testing.assert_array_equal(one.pose.T_parent_target, two.pose.T_parent_target)
        np.testing.assert_array_equal(one.left_seen.uv_px, two.left_seen.uv_px)
        np.testing.assert_array_equal(one.right_seen.uv_px, two.right_seen.uv_px)


def test_no_view_waits_for_a_thread_that_does_not_begin() -> None:
    beside, hold = SideBySide(), threading.Event()
    beside._pool.submit(hold.wait)  # as on a machine without a free core
    here = threading.current_thread()
    assert beside(lambda side: (side, threading.current_thread()), 3) == [(0, here), (1, here), (2, here)]
    hold.set()


def test_a_tracker_goes_on_after_what_shows_nothing() -> None:
    """Views exchanged once, a frame that cannot be read: lost with the reason, and the next pair is measured."""
    tracker = TargetTracker(SETUP)
    left, right = frames(pose_at(1).apply(X), 1)
    exchanged = tracker.take(right, left)
    assert exchanged.pose.status is PoseStatus.LOST and exchanged.cause is Unseen.SWAPPED
    assert tracker.swapped is not None and "swapped" in tracker.swapped.cause
    broken = tracker.take(replace(left, unreadable="cut off"), right)
    assert broken.cause is Unseen.UNREADABLE and broken.pose.why.endswith("cut off") and tracker.swapped is None
    assert_pose(tracker.take(left, right), pose_at(1))
    lost = TargetTracker(SETUP)
    busy = [replace(one, image=np.maximum(one.image, STARS[side])) for side, one in enumerate((left, right))]
    assert measure_pair(SETUP, *busy).busy
    assert lost.take(*busy[::-1]).cause is Unseen.SWAPPED and lost.swapped is not None
    assert_pose(lost.take(*busy), pose_at(1))
    with refuses(Inconsistent, "650x480", "left camera", "640x480"):
        tracker.take(*frames(pose_at(0).apply(X), 0, width=650))


BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
BOARD_SETUP = Setup(RIG, BOARD)
BOARD_POSE = RigidTransform.from_components([-0.1, -0.06, 0.7], Rotation.from_rotvec([0.2, -0.25, 0.05]))


def views(seed: int, keep: list[np.ndarray] | None = None) -> list[BoardView]:
    rng, out = np.random.default_rng(seed), []
    for side, uv in enumerate(pixels(BOARD_POSE.apply(BOARD.xyz_m))):
        index = np.arange(54) if keep is None else keep[side]
        out.append(
            BoardView(
                uv_px=(uv + rng.normal(0.0, 0.1, uv.shape))[index],
                index=index,
                sigma_px=0.1,
                width=640,
                height=480,
                source=f"view{side}",
            )
        )
    return out


def test_a_board_seen_in_parts_uses_the_common_points() -> None:
    keep = [np.arange(0, 40), np.arange(20, 54)]
    measured = pose_of_views(BOARD_SETUP, *views(2, keep), 0.0)
    assert_pose(measured, BOARD_POSE)
    assert measured.names == BOARD.names[20:40]
    few = pose_of_views(BOARD_SETUP, *views(2, [np.arange(0, 20), np.arange(18, 54)]), 0.0)
    assert few.pose.status is PoseStatus.LOST and "2 points" in few.pose.why


def test_a_wrong_corner_is_left_out_by_name() -> None:
    left, right = views(3)
    uv = right.uv_px.copy()
    uv[17] += [9.0, -4.0]
    wrong = BoardView(uv_px=uv, index=right.index, sigma_px=0.1, width=640, height=480, source="right")
    measured = pose_of_views(BOARD_SETUP, left, wrong, 0.0)
    assert_pose(measured, BOARD_POSE)
    assert measured.notes == (f"{BOARD.names[17]} left out: it does not fit the others",)


def test_a_hot_pixel_on_the_epipolar_line_of_a_single_light_is_told_by_the_light_s_size() -> None:
    where = np.array([[0.01, 0.02, 0.6]])
    left, right = frames(where, 1)
    eye = RIG.T_rig_right.translation
    u, v = pixels(eye + 1.2 * (where - eye))[0][0]  # on the right image's ray of the light
    y, x = np.mgrid[0:480, 0:640]
    dot = 150.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * 0.55**2))
    left = replace(left, image=np.clip(left.image + dot, 0, 255).astype(np.uint8))
    for diameter_m, seen in ((None, False), (0.0055, True)):
        target = replace(spot_target({"A": (0.0, 0.0, 0.0)}), diameter_m=diameter_m)
        measured = measure_pair(Setup(RIG, target), left, right)
        assert (len(measured.points) == 1) is seen
        if seen:
            assert np.abs(measured.points.xyz_m[0] - where[0]).max() < 0.002
