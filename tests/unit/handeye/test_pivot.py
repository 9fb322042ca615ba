"""A tip recorded on the fly: from a stream of poses, and from rendered frames through the command."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.tooltip import TipRecording
from armsight.ops.calibration.pivot import pivoted
from armsight.records import PoseStatus, TargetPose

TIP = np.array([0.0, 0.02, 0.15])
POINT = np.array([0.05, -0.1, 0.7])


class Heard:
    """Progress that keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def update(self, done: float, total: float, note: str = "") -> None:
        self.notes.append(note)

    def cancelled(self) -> bool:
        return False


def stream(rng: np.random.Generator, n: int, *, spread_rad: float = 0.4) -> Iterator[TargetPose]:
    """Poses of a target whose tip rests on POINT, each twice (the operator holds still), some frames without any."""
    for i in range(n):
        turn = Rotation.from_rotvec(rng.uniform(-spread_rad, spread_rad, 3))
        place = POINT - turn.apply(TIP) + rng.normal(0.0, 1e-4, 3)
        pose = RigidTransform.from_components(place, turn)
        yield TargetPose(t_s=2.0 * i, status=PoseStatus.LOST, parent="rig", why="hidden")
        for t_s in (2.0 * i, 2.0 * i + 1.0):
            yield TargetPose(
                t_s=t_s,
                status=PoseStatus.OK,
                parent="rig",
                spots=("A", "B", "C"),
                T_parent_target=pose.as_matrix(),
                covariance=1e-8 * np.eye(6),
            )


def test_poses_are_taken_until_the_tip_is_known_well_enough() -> None:
    heard = Heard()
    recording, taken = pivoted(stream(np.random.default_rng(0), 200), TipRecording(good_m=1e-4), heard)
    assert recording.good_enough and recording.latest is not None
    assert 6 <= len(taken) < 200
    assert len({pose.t_s for pose in taken}) == len(taken) and all(pose.t_s % 2.0 == 0.0 for pose in taken)
    error = np.abs(recording.latest.tip_m - TIP)
    assert (error < 5.0 * recording.std_m).all()
    assert "good enough" in heard.notes[-1] and "mm" in heard.notes[-1]
