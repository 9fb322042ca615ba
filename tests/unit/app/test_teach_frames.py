"""In which frame a taught path is, and how sure its targets are: said as it is, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight
from armsight.control.teach import PathRecorder, StandingRig
from armsight.errors import UsageError
from armsight.ops.sources.pace import pace_of
from armsight.ops.teach import teach
from armsight.ops.teaching import AS_MEASURED
from armsight.records import PoseStatus, TargetPose, spot_target
from armsight.store import read_poses, write_poses, write_text
from refusals import refuses
from robot_runs import acted

VARIANCES = np.array([1e-8, 4e-8, 9e-8, 1e-6, 4e-6, 9e-6])
WORLD = "format: armsight/world\nversion: 1\nT_base_rig: {xyz_m: [0.0, 0.0, 0.5], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}\n"


def seen(k: int) -> TargetPose:
    T = RigidTransform.from_translation([0.01 * k, 0.0, 0.6]).as_matrix()
    return TargetPose(t_s=0.1 * k, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=np.diag(VARIANCES))


def test_cameras_whose_place_is_not_told_teach_nothing(tmp_path: Path) -> None:
    cell = armsight.simulate("hand-cell", frames=1, room="dark")
    with refuses(UsageError, "cameras stand") as refused:
        acted(teach, rig=cell.rig, target=cell.target, left="left", right="right", out=tmp_path / "out")
    assert "--world" in str(refused.value) and not (tmp_path / "out").exists()


def test_one_light_teaches_nothing(tmp_path: Path) -> None:
    cell = armsight.simulate("hand-cell", frames=1, room="dark")
    one = spot_target({"A": (0.0, 0.0, 0.0)})
    given = {"rig": cell.rig, "target": one, "left": "left", "right": "right", "out": tmp_path / "out"}
    with refuses(UsageError, "1 light", "rotation", "Nothing is taught"):
        acted(teach, world=np.eye(4), **given)
    assert not (tmp_path / "out").exists()


def test_poses_without_a_world_are_not_called_world(tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.csv", [seen(k) for k in range(3)])
    write_text(tmp_path / "world.yaml", WORLD)
    done = acted(teach, poses=tmp_path / "poses.csv", out=tmp_path / "out")
    assert done.parent == AS_MEASURED
    done = acted(teach, poses=tmp_path / "poses.csv", out=tmp_path / "out", world=tmp_path / "world.yaml")
    assert done.parent == "base"
    targets = read_poses(tmp_path / "out" / "targets.csv")
    assert [float(np.diag(pose.covariance)[1]) for pose in targets] == pytest.approx([4e-8] * 3)


@pytest.mark.parametrize("mean", [False, True])
def test_targets_are_as_sure_as_the_cameras_are(mean: bool) -> None:
    quarter = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.0, np.pi / 2]))
    recorder = PathRecorder(StandingRig(T_world_rig=quarter), RigidTransform.identity(), every=2, mean=mean)
    recorder.start()
    for k in range(4):
        recorder.observe(seen(k), 0.1 * k)
    for pose in recorder.targets():
        assert np.diag(pose.covariance) == pytest.approx(
            VARIANCES[[1, 0, 2, 4, 3, 5]]
        )  # x of the rig is y of the world


def test_only_before_a_camera_somebody_waits() -> None:
    assert pace_of("camera:0", None, "left").live and not pace_of("left", None, "right").live
