"""A path played from the page is held against what the measuring station shows."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.operator.path_editor import watcher_of
from armsight.app.operator.robot_cell import prepare_simulated
from armsight.clock import ManualClock
from armsight.ops.requests.motion import RobotJob
from armsight.records import PoseStatus, TargetPose
from armsight.store import World, write_world
from armsight.store.cell_file import read_cell
from armsight.store.handeye_file import read_handeye

FLANGE = RigidTransform.from_components([-0.9, -0.1, 0.3], Rotation.from_euler("y", 90.0, degrees=True))
"""T_base_flange of the test."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("watched") / "cell"
    prepare_simulated(RobotJob(robot="sim:webcam-cell"), made)
    return made


def view(T: RigidTransform, t_s: float, status: str = "ok", covariance=None) -> SimpleNamespace:
    known = {"T_parent_target": T.as_matrix(), "covariance": 1e-8 * np.eye(6) if covariance is None else covariance}
    pose = TargetPose(
        t_s=t_s,
        status=PoseStatus(status),
        parent="rig",
        why="a hand is before it",
        **({} if status == "lost" else known),
    )
    return SimpleNamespace(pose=pose, view=SimpleNamespace(t_s=t_s))


def watched(folder, station, act, cell=None):
    """Return what was seen while the station did something."""
    seen, told = [], []
    clock = ManualClock(100.0)
    watcher = watcher_of(folder, cell or read_cell(folder), station, clock)
    assert watcher is not None
    waiting = threading.Semaphore(0)

    def take(pose, exposed_s):
        seen.append((watcher.sight, pose, exposed_s))
        waiting.release()

    with ExitStack() as stack:
        watcher.open(stack, SimpleNamespace(pose=told.append), take)
        act(station, clock, lambda: waiting.acquire(timeout=10.0))
    return watcher, seen, told


def test_in_the_rigs_axes_the_covariance_is_turned_with_the_pose_and_doubtful_is_not_ok(folder):
    handeye = read_handeye(folder / "handeye.yaml")
    T_rig_target = handeye.T_parent_camera.inv() * FLANGE * handeye.T_parent_target
    T_rig_parent = RigidTransform.from_components([0.3, -0.2, 0.1], Rotation.from_rotvec([0.4, -0.7, 1.1]))
    A = np.random.default_rng(4).standard_normal((6, 6)) * 1e-4
    C = A @ A.T

    def act(station, clock, wait):
        for t_s, status in ((99.9, "ok"), (99.95, "doubtful")):
            station.shown = view(T_rig_parent.inv() * T_rig_target, t_s, status, C)
            assert wait()

    write_world(folder / "world.yaml", World(parent="world", T_parent_rig=T_rig_parent.inv()))
    station = SimpleNamespace(shown=None, failure="", job=SimpleNamespace(rig="rig.yaml"))
    cell = read_cell(folder).model_copy(update={"world": "world.yaml"})
    watcher, seen, _ = watched(folder, station, act, cell)
    turned = np.kron(np.eye(2), T_rig_parent.rotation.as_matrix())
    pose = seen[0][1]
    assert np.allclose(pose.T_parent_target, T_rig_target.as_matrix(), atol=1e-9)
    assert np.abs(pose.covariance - turned @ C @ turned.T).max() < 1e-12 * np.abs(C).max() * 100
    assert [pose.status for _, pose, _ in seen] == [PoseStatus.OK, PoseStatus.DOUBTFUL]
    assert watcher.counts()[PoseStatus.DOUBTFUL] == 1


def test_the_flange_is_seen_where_it_is_and_lost_frames_are_counted(folder):
    handeye = read_handeye(folder / "handeye.yaml")
    T_rig_target = handeye.T_parent_camera.inv() * FLANGE * handeye.T_parent_target

    def act(station, clock, wait):
        for t_s, status in ((99.9, "ok"), (99.95, "lost"), (99.98, "ok")):
            station.shown = view(T_rig_target, t_s, status)
            assert wait()

    station = SimpleNamespace(shown=None, failure="", job=SimpleNamespace(rig="rig.yaml"))
    watcher, seen, told = watched(folder, station, act)
    assert [exposed for _, _, exposed in seen] == [99.9, 99.95, 99.98] == [pose.t_s for pose in told]
    assert watcher.counts()[PoseStatus.OK] == 2 and watcher.counts()[PoseStatus.LOST] == 1
    sight, pose, _ = seen[-1]
    found = sight.flange(RigidTransform.from_matrix(pose.T_parent_target))
    assert np.asarray(found.as_matrix()) == pytest.approx(FLANGE.as_matrix(), abs=1e-9)
    assert watcher.failed() is None


@pytest.mark.parametrize("how", ["camera", "silent"])
def test_cameras_that_go_end_the_watching_with_the_reason(folder, how):
    def act(station, clock, wait):
        if how == "camera":
            station.failure = "the left camera is gone"
        else:
            clock.advance(10.0)
        while all(thread.name != "watching" for thread in threading.enumerate()) is False:
            threading.Event().wait(0.005)

    station = SimpleNamespace(shown=None, failure="", job=SimpleNamespace(rig="rig.yaml"))
    watcher, _, _ = watched(folder, station, act)
    said = str(watcher.failed())
    assert ("left camera is gone" if how == "camera" else "no pictures come") in said
    assert "nobody watched it" in said


def test_nothing_watches_without_cameras_rig_or_hand_eye(folder):
    cell, clock = read_cell(folder), ManualClock()
    aiming = SimpleNamespace(job=SimpleNamespace(rig=None))
    assert watcher_of(folder, cell, None, clock) is None
    assert watcher_of(folder, cell, aiming, clock) is None
    unplaced = cell.model_copy(update={"handeye": ""})
    assert watcher_of(folder, unplaced, SimpleNamespace(job=SimpleNamespace(rig="r")), clock) is None
