"""A target followed over many pairs; the track saved, and read again."""

import tempfile
from pathlib import Path

import armsight

cell = armsight.simulate("webcam-cell", frames=12)
tracker = armsight.PoseTracker(cell.rig, cell.target)
for frame in cell:
    tracker.update(frame.left, frame.right, frame.t_s)

print(tracker.track)
print("the residuals fit rig and target:", tracker.consistency.verdict)

with tempfile.TemporaryDirectory() as folder:
    path = tracker.track.save(Path(folder) / "poses.csv")
    print(armsight.read_poses(path).table()["x_m"])
figure = tracker.track.plot()  # in a notebook it shows itself; figure.write_html("track.html") keeps it
