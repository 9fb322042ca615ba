"""A path taught by showing: what is recorded of which frame, and where."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.teach import CarriedRig, PathRecorder, StandingRig, Teaching
from armsight.errors import StaleData
from armsight.kinematics import presets
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.records.motion import JointHistory

T_WORLD_RIG = RigidTransform.from_components([1.0, 2.0, 0.5], Rotation.from_rotvec([0.0, 0.0, np.pi / 2]))
TIP = RigidTransform.from_translation([0.0, 0.0, 0.1])


def seen(t_s: float, xyz, *, status: PoseStatus = PoseStatus.OK, turn=(0.0, 0.0, 0.0)) -> TargetPose:
    if status is PoseStatus.LOST:
        return TargetPose(t_s=t_s, status=status, parent="rig")
    T = RigidTransform.from_components(xyz, Rotation.from_rotvec(turn)).as_matrix()
    return TargetPose(t_s=t_s, status=status, parent="rig", T_parent_target=T, covariance=1e-8 * np.eye(status.size))


def led(recorder: PathRecorder, times, **more) -> None:
    for t_s in times:
        recorder.observe(seen(t_s, [t_s, 0.0, 0.6], **more), t_s)


def standing(**more) -> PathRecorder:
    return PathRecorder(StandingRig(T_world_rig=T_WORLD_RIG), TIP, **more)


def test_the_tip_is_told_in_world() -> None:
    recorder = standing()
    recorder.start()
    led(recorder, [0.0, 0.1])
    path = recorder.path(speed_m_s=0.02)
    assert np.allclose(path.xyz_m, [[1.0, 2.0, 1.2], [1.0, 2.1, 1.2]])  # x of the rig is y of the world, tip 0.1 on
    assert path.t_s.tolist() == [0.0, 0.1]
    assert path.speed_m_s.tolist() == [0.02, 0.02]
    assert path.parent == "world"
    assert np.allclose(recorder.targets()[1].T_parent_target[:3, 3], [1.0, 2.1, 1.1])
    assert np.allclose(recorder.tip.translation, [1.0, 2.1, 1.2])


def test_a_vector_is_the_last_of_its_frames_or_their_mean_and_spans_no_lost_one() -> None:
    last, mean = standing(every=3), standing(every=3, mean=True)
    for recorder in (last, mean):
        recorder.start()
        led(recorder, [0.0, 0.1])
        led(recorder, [0.2], status=PoseStatus.LOST)
        led(recorder, [0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    assert last.path().t_s.tolist() == [0.5, 0.8]
    assert np.allclose(mean.path().t_s, [0.4, 0.7])
    assert np.allclose(mean.path().xyz_m[:, 1], [2.4, 2.7])


def test_undo_forgets_the_last_stretch_only() -> None:
    told: list[str] = []
    recorder = standing(notify=told.append)
    recorder.start()
    led(recorder, [0.0, 0.1])
    recorder.pause()
    led(recorder, [0.2])
    recorder.start()
    led(recorder, [0.3, 0.4, 0.5])
    assert recorder.undo() == 3
    assert recorder.state is Teaching.PAUSED
    recorder.start()
    led(recorder, [0.6])
    assert recorder.path().t_s.tolist() == [0.0, 0.1, 0.6]
    assert recorder.stretches == 2
    assert told == ["recording", "paused after 2 poses", "recording", "the last 3 poses forgotten", "recording"]
    assert (recorder.undo(), recorder.undo(), recorder.undo()) == (1, 2, 0)
    assert recorder.state is Teaching.WAITING


def test_tags_are_of_the_row_where_the_tip_is() -> None:
    recorder = standing()
    recorder.start()
    led(recorder, [0.0])
    recorder.tag("weld_on")
    led(recorder, [0.1, 0.2])
    recorder.tag("weld_off")
    recorder.pause()  # no row follows: it is of the last one
    recorder.tag("next")
    recorder.start()
    led(recorder, [0.3, 0.4])
    recorder.tag("end")
    assert recorder.path().tags == ("", "weld_on", "weld_off", "next", "end")


def test_a_carried_rig_is_where_the_joints_were_at_the_exposure() -> None:
    arm, history = presets.ur10(), JointHistory(0.01)
    q, speed = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0]), np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    place = CarriedRig(arm=arm, history=history, T_flange_rig=RigidTransform.from_translation([0.0, 0.0, 0.06]))
    recorder = PathRecorder(place, RigidTransform.identity())
    recorder.start()
    led(recorder, [0.005])
    assert recorder.counts.unplaced == 1
    for k in range(6):
        history.add(JointReading(q=q + 0.01 * k * speed, t_s=0.01 * k, sequence=k, source="test"))
    led(recorder, [0.024, 0.037])
    with pytest.raises(StaleData):
        place(1.0)
    for row, t_s in enumerate((0.024, 0.037)):
        flange = RigidTransform.from_matrix(arm.fk(arm.values(q + t_s * speed))) * arm.T_flange_tool.inv()
        expected = flange * RigidTransform.from_translation([t_s, 0.0, 0.66])
        assert np.allclose(recorder.path().T_world_tip[row], expected.as_matrix(), atol=1e-12)
