"""A camera and a detector of one's own: any iterable of Frame is a source of frames, OpenCV's blobs make a pose."""

import cv2
import numpy as np

import armsight

cell = armsight.simulate("hand-cell", frames=6, room="dark")


class MyCamera:
    """What a device gives; with __enter__ and __exit__ it would be opened and closed."""

    def __init__(self, side):
        self.side = side

    def __iter__(self):
        for number, frame in enumerate(cell):
            yield armsight.Frame(image=getattr(frame, self.side), t_s=frame.t_s, sequence=number, source=self.side)


def my_spots(image):
    """Return what OpenCV finds, +- 0.2 px by my own guess."""
    mask = cv2.threshold(image, 80, 255, cv2.THRESH_BINARY)[1]
    centres_px = cv2.connectedComponentsWithStats(mask)[3][1:]  # the first is the background
    return armsight.Spots.of_centres(centres_px, 0.2**2 * np.eye(2))


print(armsight.measure(cell.rig, cell.target, MyCamera("left"), MyCamera("right")).poses)
for left, right, T in zip(MyCamera("left"), MyCamera("right"), cell.T_rig_target, strict=True):
    pose = armsight.estimate_pose_from_spots(my_spots(left.image), my_spots(right.image), cell.rig, cell.target)
    error_mm, std_mm = 1e3 * (pose.xyz_m - T[:3, 3]), 1e3 * np.sqrt(np.diag(pose.covariance)[:3])
    print(f"by my detector: {pose.status}, off the truth by {error_mm.round(2)} +- {std_mm.round(2)} mm")
    assert (abs(error_mm) < 4.0 * std_mm).all()
