"""A world's cell as armsight calibrates it, and how far its cameras are off."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from cell_cameras import Track, WebCam
from cell_world import CellWorld
from scipy.spatial.transform import Rotation

from armsight.calibrate.cell import CellOptions, CellPriors, CellResult, calibrate_cell
from armsight.records import Motion, SpotTrack, spot_target
from armsight.store.arm_file import arm_from_mapping


def track_of(track: Track) -> SpotTrack:
    """Return a camera's recording as armsight has it, without names."""
    return SpotTrack(
        t_s=track.t_s,
        frame=track.frame,
        names=("",) * len(track.frame),
        uv_px=track.uv_px,
        covariance_px2=track.covariance_px2,
    )


def calibrated(
    world: CellWorld, tracks: Mapping[str, Track] | None = None, priors: CellPriors | None = None
) -> CellResult:
    """Return the cell by some cameras' tracks by name; by the world's pair where none are given."""
    tracks = tracks or {"left": world.left, "right": world.right}
    return calibrate_cell(
        arm_from_mapping(world.nominal),
        Motion(t_s=world.log_t_s, q=world.log_q),
        [track_of(one) for one in tracks.values()],
        spot_target(world.target),
        sizes=[one.size for one in tracks.values()],
        names=list(tracks),
        options=CellOptions(tip_m=world.truth.tip_target_m, priors=priors),
    )


def camera_squares(cameras: Mapping[str, WebCam], done: CellResult) -> list[float]:
    """Return chi-square (6 degrees of freedom) of the pose in base axes of each camera of a result."""
    model, out = done.solved.model, []
    for side, name in enumerate(done.rig.names):
        T, true = model.T_base_camera(done.solved.fit.x, side).as_matrix(), cameras[name].T_base_camera
        turn = Rotation.from_matrix(T[:3, :3]) * Rotation.from_matrix(true[:3, :3]).inv()
        e = np.concatenate([T[:3, 3] - true[:3, 3], turn.as_rotvec()])
        at = [model.names.index(f"{name}.{key}") for key in ("tx", "ty", "tz", "rx", "ry", "rz")]
        out.append(float(e @ np.linalg.solve(done.covariance[np.ix_(at, at)], e)))
    return out
