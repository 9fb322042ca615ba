"""Trackers over loopback: packets laid out as the makers' protocols say, taken by their public libraries."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import SystemClock
from armsight.drivers.trackers.source import open_tracker
from armsight.errors import DeviceLost, DeviceNotFound, UsageError
from armsight.kinematics import presets
from armsight.ops.verification.supervising import Supervised
from armsight.ops.verify import supervise
from armsight.records import JointReading, PoseStatus
from armsight.store.rigs import World, write_world
from refusals import refuses
from tracker_servers import LOST, T_M, Motive, N, Qtm, R

STD = {"std_m": 3e-4, "std_rad": 5e-3}


SERVERS = {
    "qtm": (Qtm, {}, ""),
    "natnet, unicast": (Motive, {}, ":unicast"),
    "natnet, multicast": (Motive, {"multicast": True}, ""),
}


@pytest.fixture(params=SERVERS)
def tracker(request):
    """A maker's server, and what names it."""
    server, how, end = SERVERS[request.param]
    maker = request.param.partition(",")[0]
    pytest.importorskip({"qtm": "qtm_rt", "natnet": "natnet"}[maker])
    server = server(**how)
    server.start()
    yield server, f"{maker}:127.0.0.1:{server.port}{end}"
    server.ending.set()
    server.join(10.0)
    server.socket.close()


def test_a_body_comes_as_its_tracker_sends_it(tracker, monkeypatch):
    server, text = tracker
    seen = {}
    with open_tracker(text, body="Flange", **STD) as stream, pytest.raises(DeviceLost, match="tracker") as ended:
        monkeypatch.setattr("armsight.drivers.trackers.source.SILENT_S", 60.0)
        for frame in stream:
            seen[frame.sequence] = frame.pose
            if isinstance(server, Motive):
                server.heard.set()
                if len(seen) == N:  # it has ended, and will say nothing more
                    monkeypatch.setattr("armsight.drivers.trackers.source.SILENT_S", 0.1)
    assert isinstance(server, Motive) or "QTM ended" in str(ended.value)
    assert list(seen) == list(range(N))
    for k, pose in seen.items():
        assert abs(pose.t_s - (1.0 + 0.01 * k)) < 1e-9
        assert (pose.status is PoseStatus.LOST) == (k in LOST)
        if k not in LOST:
            assert np.abs(pose.T_parent_target[:3, 3] - T_M[k]).max() < 1e-6
            assert np.abs(pose.T_parent_target[:3, :3] - R[k].as_matrix()).max() < 1e-6
            np.testing.assert_allclose(np.sqrt(np.diag(pose.covariance)), [3e-4] * 3 + [5e-3] * 3)


@pytest.mark.parametrize("body", ["", "Hand"])
def test_a_body_that_is_not_meant_or_not_there_is_asked_for(tracker, body):
    with refuses(UsageError, "Base, Flange", "--body"), open_tracker(tracker[1], body=body, **STD):
        pass


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("qtm", UsageError, "qtm:HOST"),
        ("vicon:host", DeviceNotFound, "natnet, qtm"),
        ("qtm:127.0.0.1:none", UsageError, "port"),
        ("qtm:127.0.0.1:1", DeviceNotFound, "QTM at 127.0.0.1:1"),
    ],
)
def test_what_names_no_tracker_is_refused(text, kind, words):
    pytest.importorskip("qtm_rt")
    with refuses(kind, words), open_tracker(text, body="", **STD):
        pass


@pytest.mark.parametrize(
    ("further", "end", "to"), [(1, ":unicast", "this computer"), (2, "", "the group 239.255.42.99")]
)
def test_motive_that_sends_elsewhere_is_refused_with_where_frames_were_awaited(further, end, to, monkeypatch):
    pytest.importorskip("natnet")
    monkeypatch.setattr("armsight.drivers.trackers.natnet.ANSWER_S", 2.0)
    server = Motive(multicast=True)
    server.group = server.group[0], server.port + further
    server.start()
    try:
        text = f"natnet:127.0.0.1:{server.port}{end}"
        with refuses(DeviceNotFound, "no frame", to, ":unicast"), open_tracker(text, body="Flange", **STD):
            pass
    finally:
        server.ending.set()
        server.join(10.0)
        server.socket.close()


class Still:
    """A robot that stands, read from a second ago on."""

    name, n_joints, cycle_s = "still", 6, 0.01
    q = np.array([0.3, -1.2, 1.4, -0.6, 1.1, 0.2])

    def __init__(self):
        self.k, self.begun_s, self.stopped = 0, SystemClock().now_s() - 1.0, 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def read(self):
        self.k += 1
        return JointReading(q=self.q, t_s=self.begun_s + 0.01 * self.k, sequence=self.k, source=self.name)

    def stop(self):
        self.stopped += 1


@pytest.mark.parametrize(("off_mm", "level"), [(0.0, "good"), (4.0, "stop")])
def test_a_tracker_watches_an_arm(tmp_path, off_mm, level):
    pytest.importorskip("qtm_rt")
    arm, robot = presets.ur10(), Still()
    place = RigidTransform.from_components([0.7, -0.2, 0.4], Rotation.from_rotvec([0.2, 0.1, 1.5]))  # of the tracker
    write_world(tmp_path / "world.yaml", World(parent="base", T_parent_rig=place))
    seen = place.inv() * RigidTransform.from_matrix(arm.fk(robot.q))
    server = Qtm(
        Rotation.concatenate([seen.rotation] * N),
        np.tile(seen.translation + np.array([1e-3 * off_mm, 0.0, 0.0]), (N, 1)),
    )
    server.start()
    devices = Supervised(
        robot=robot,
        pairs=open_tracker(f"qtm:127.0.0.1:{server.port}", body="Flange", **STD),
        on_step=lambda poll: [poll() for _ in range(1500)],  # as far as 14 s ahead
    )
    done = supervise(
        *("here", None, None, None, None, arm, tmp_path / "world.yaml"),
        tracker="qtm:here",
        body="Flange",
        warn_m=1.5e-3,
        stop_m=3e-3,
        frames=N,
        devices=devices,
        latency_s=0.0,
        out=tmp_path / "out",
    )
    server.join(10.0)
    server.socket.close()
    assert done.level == level
    assert done.stopped == (robot.stopped > 0) == (level == "stop")
    assert done.errors.max_m == pytest.approx(1e-3 * off_mm, abs=1e-6)
    assert any("--tracker-std" in doubt for doubt in done.doubts)
    assert (tmp_path / "out" / "live.mcap").exists()


def test_cameras_and_a_tracker_are_not_both_eyes(tmp_path):
    write_world(tmp_path / "world.yaml", World(parent="base", T_parent_rig=RigidTransform.identity()))
    world, arm = tmp_path / "world.yaml", presets.ur10()
    with refuses(UsageError, "rig", "beside tracker"):
        supervise("rtde:host", tmp_path / "rig.yaml", None, None, None, arm, world, tracker="qtm:host")
    with refuses(UsageError, "tracker"):
        supervise("rtde:host", None, None, None, None, arm, world)
    with refuses(UsageError, "body", "goes with tracker"):
        supervise("rtde:host", world, world, None, None, arm, world, body="Flange")
