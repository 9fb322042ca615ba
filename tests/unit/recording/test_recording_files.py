"""Recordings: what goes in comes out, what is cut off or damaged is told and mended, what cannot be is refused."""

import errno
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import ManualClock
from armsight.errors import BadFile, DeviceFailed, Inconsistent, NotEnoughData
from armsight.records import Frame, JointReading, PoseStatus, Spots, TargetPose
from armsight.store import write_poses
from armsight.store.recording import Recording, RecordingWriter, mcapfile, repair
from refusals import refuses

ORIGIN_NS = 1_700_000_000_000_000_000


def frame(number: int, *, colour: bool = False, size: tuple[int, int] = (12, 20), t_s: float | None = None) -> Frame:
    shape = (*size, 3) if colour else size
    image = np.random.default_rng(number).integers(0, 256, shape, dtype=np.uint8)
    return Frame(
        image=image, t_s=number / 60.0 if t_s is None else t_s, sequence=number, source="camera", exposure_s=0.004
    )


def write(path: Path, n: int = 40, *, chunk_bytes: int = 2000, close: bool = True) -> RecordingWriter:
    writer = RecordingWriter(path, origin_ns=ORIGIN_NS, clock=ManualClock(), chunk_bytes=chunk_bytes)
    for i in range(n):
        writer.moment({"left": frame(2 * i), "right": frame(2 * i + 1)})
    if close:
        writer.close()
    return writer


def test_records_come_back_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    pose = RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))
    cov = np.diag(rng.uniform(1e-9, 1e-6, 6))
    poses = [
        TargetPose(t_s=0.1, status=PoseStatus.OK, parent="rig", spots=("A", "B"),
                   T_parent_target=pose.as_matrix(), covariance=cov, residual_px=rng.normal(size=4)),
        TargetPose(t_s=0.2, status=PoseStatus.LOST, parent="rig", why="no light"),
    ]  # fmt: skip
    spots = Spots(
        uv_px=rng.normal(size=(2, 2)),
        covariance_px2=rng.normal(size=(2, 2, 2)),
        peak=np.array([200.0, 90.0]),
        size_px=np.array([2.0, 3.0]),
        model=("gaussian", "ellipse"),
        rejected=((1.0, 2.0, "saturated"),),
    )
    reading = JointReading(q=rng.normal(size=6), t_s=0.15, sequence=7, source="robot")
    with RecordingWriter(tmp_path / "a.mcap", origin_ns=ORIGIN_NS) as writer:
        for each in poses:
            writer.pose(each)
        writer.spots("left", 0.1, ("A", "B"), spots)
        writer.joints(reading)
        writer.command(0.12, "joints", {"q": [0.1, 0.2]})
        writer.event(0.3, "3 pairs dropped", level="warning")
    with Recording(tmp_path / "a.mcap") as recording:
        one, two = recording.poses()
        assert one.pose is not None
        np.testing.assert_array_equal(one.pose.translation, pose.translation)
        np.testing.assert_allclose(one.pose.rotation.as_matrix(), pose.rotation.as_matrix(), atol=1e-15)
        np.testing.assert_array_equal(one.covariance, cov)
        assert (one.t_s, one.spots, two.status, two.why) == (0.1, ("A", "B"), PoseStatus.LOST, "no light")
        (seen,) = recording.spots("left")
        np.testing.assert_array_equal(seen.spots.uv_px, spots.uv_px)
        np.testing.assert_array_equal(seen.spots.covariance_px2, spots.covariance_px2)
        assert (seen.names, seen.spots.rejected, seen.spots.model) == (("A", "B"), spots.rejected, spots.model)
        (joints,) = recording.joints()
        np.testing.assert_array_equal(joints.q, reading.q)
        assert (joints.sequence, joints.source) == (7, "robot")
        (command,) = recording.commands()
        assert (command.kind, command.values) == ("joints", {"q": [0.1, 0.2]})
        (event,) = recording.events()
        assert (event.level, event.message) == (3, "3 pairs dropped")
        assert event.t_s == pytest.approx(0.3, abs=1e-9)


def test_a_recording_keeps_of_a_pose_what_poses_csv_keeps(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)

    def covariance(n: int) -> np.ndarray:
        L = 1e-4 * rng.normal(size=(n, n))
        return L @ L.T

    shared, T = covariance(6), RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng)).as_matrix()
    place = np.eye(4)
    place[:3, 3] = rng.normal(size=3)
    poses = [
        TargetPose(t_s=0.1, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=covariance(6) + shared,
                   systematic_covariance=shared),
        TargetPose(t_s=0.2, status=PoseStatus.DOUBTFUL, parent="rig", T_parent_target=T, covariance=covariance(6)),
        TargetPose(t_s=0.3, status=PoseStatus.POSITION_ONLY, parent="rig", T_parent_target=place,
                   covariance=covariance(3) + shared[:3, :3], systematic_covariance=shared[:3, :3]),
        TargetPose(t_s=0.4, status=PoseStatus.POSITION_ONLY, parent="rig", T_parent_target=place,
                   covariance=covariance(3), origin_known=True),
        TargetPose(t_s=0.5, status=PoseStatus.LOST, parent="rig"),
    ]  # fmt: skip
    with RecordingWriter(tmp_path / "a.mcap", origin_ns=ORIGIN_NS) as writer:
        for each in poses:
            writer.pose(each)
    with Recording(tmp_path / "a.mcap") as recording:
        recorded = list(recording.poses())
    write_poses(tmp_path / "direct.csv", poses)
    write_poses(tmp_path / "recorded.csv", recorded)
    assert (tmp_path / "recorded.csv").read_text() == (tmp_path / "direct.csv").read_text()
    for one, other in zip(poses, recorded, strict=True):
        for name in ("covariance", "systematic_covariance"):
            a, b = getattr(one, name), getattr(other, name)
            assert (a is None) == (b is None) and (a is None or np.array_equal(a, b))


def test_cut_off_anywhere_it_is_readable_up_to_there_and_can_be_mended(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path)
    data = path.read_bytes()
    starts = [0]
    last = -1
    for size in [*range(400, len(data), 997), len(data) - 1, len(data) - 9]:
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:size])
        with Recording(cut) as recording:
            assert not recording.finished
            frames = list(recording.frames("left")) if recording.cameras else []
        assert [it.sequence for it in frames] == [2 * i for i in range(len(frames))]
        assert len(frames) >= last
        last = len(frames)
        starts.append(last)
        mended = tmp_path / "mended.mcap"
        if frames:
            done = repair(cut, mended, overwrite=True)
            assert done.messages["/left/image"] == done.messages["/right/image"] == len(frames)
            with Recording(mended) as recording:
                assert recording.finished
                assert len(list(recording.frames("right"))) == len(frames)
        else:
            with refuses(NotEnoughData, "message"):
                repair(cut, mended, overwrite=True)
    assert last == 40
    assert len(set(starts)) > 10  # it did grow with the size


def test_damage_within_is_told_and_costs_one_chunk(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with Recording(path) as recording, refuses(BadFile, "damaged"):
        list(recording.frames("left"))
    done = repair(path, tmp_path / "b.mcap")
    assert done.damaged_chunks == 1
    assert 30 <= done.messages["/left/image"] < 40


@pytest.mark.parametrize(("content", "named"), [(b"", "empty"), (b"\x89PNG\r\n\x1a\n" + bytes(100), "MCAP")])
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, named: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with refuses(BadFile, "a.mcap", named):
        Recording(path)
    with refuses(BadFile, "a.mcap", named):
        repair(path, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_time_that_runs_backwards_is_refused_and_what_was_there_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        writer.frame("left", frame(0, t_s=2.0))
        with refuses(Inconsistent, "0.5", "backwards"):
            writer.frame("left", frame(1, t_s=1.5))
    with Recording(path) as recording:
        assert len(list(recording.frames("left"))) == 1


class SmallDisk(FileIO):
    """A file on a disk with room for so many bytes."""

    room = 20_000

    def write(self, data: object) -> int:  # type: ignore[override]  # the test hands in bytes-like objects only
        view = memoryview(data).cast("B")  # type: ignore[arg-type]  # as above
        fits = max(0, min(len(view), self.room - self.tell()))
        if not fits:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(view[:fits])


@pytest.mark.parametrize("room", [20_000, 30_001])
def test_a_full_disk_leaves_a_complete_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    monkeypatch.setattr(SmallDisk, "room", room)
    monkeypatch.setattr(mcapfile, "FileIO", SmallDisk)
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path, origin_ns=ORIGIN_NS, clock=ManualClock(), chunk_bytes=2000)
    with refuses(DeviceFailed, "No space", "readable") as caught:
        for i in range(1000):
            writer.moment({"left": frame(2 * i), "right": frame(2 * i + 1)})
    assert caught.value.exit_code == 4
    writer.close()
    assert path.stat().st_size <= room
    with Recording(path) as recording:
        assert recording.finished
        n = len(list(recording.frames("left")))
        assert n == len(list(recording.frames("right")))
    assert n > 0.5 * room / (2 * frame(0).image.size + 200)
