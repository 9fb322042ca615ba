"""A target followed live: frames come one by one from any iterator, a pose goes out for each."""

import numpy as np

import armsight

cell = armsight.simulate("webcam-cell", frames=15, room="dark")


def frames():
    """Yield two images and a time: here a simulation's, else what your cameras give."""
    for frame in cell:
        yield frame.left, frame.right, frame.t_s


tracker = armsight.PoseTracker(cell.rig, cell.target)
for left, right, t_s in frames():
    pose = tracker.update(left, right, t_s)
    print(f"{t_s:.3f} s", f"{1e3 * pose.xyz_m.round(4)} +- {1e3 * pose.std['z_m']:.2f} mm" if pose.ok else pose.why)

error_mm = 1e3 * np.linalg.norm(tracker.track.T_parent_target[:, :3, 3] - cell.T_rig_target[:, :3, 3], axis=1)
print(f"residuals: {tracker.consistency.verdict}; off the truth by {error_mm.max():.2f} mm at most")
assert tracker.track.ok.all() and error_mm.max() < 5.0
