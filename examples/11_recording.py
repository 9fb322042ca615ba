"""Frames recorded into one file, cut, opened, and measured again: to the same poses."""

import tempfile
from pathlib import Path

import armsight

cell = armsight.simulate("hand-cell", frames=8, room="dark")
frames = list(cell)
left, right = [f.left for f in frames], [f.right for f in frames]
first = armsight.measure(cell.rig, cell.target, left, right, stills=True).poses
with tempfile.TemporaryDirectory() as folder:
    run, part = Path(folder) / "run.mcap", Path(folder) / "part.mcap"
    print(armsight.record(run, left, right, rig=cell.rig, target=cell.target, fps=30))
    armsight.cut_recording(run, part, 0.05, 0.21)
    with armsight.open_recording(part) as recording:
        print(recording.cameras, recording.target.names, [round(f.t_s, 3) for f in recording.frames("left")])
        again = armsight.measure(recording.rig, recording.target, part, stills=True).poses

difference_m = abs(first.T_parent_target[2:7, :3, 3] - again.T_parent_target[:, :3, 3]).max()
print(f"{again.ok.sum()} poses again, different by {1e3 * difference_m:.1e} mm at most")
assert again.ok.sum() == 5 and difference_m < 1e-9
