"""A recording (.mcap) made by `armsight record`, read frame by frame."""

import subprocess
import tempfile
from pathlib import Path

import armsight

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "run.mcap"
    subprocess.run(["armsight", "record", "--cell", "hand-cell", "--frames", "5", "-o", str(path)], check=True)
    with armsight.open_recording(path) as recording:
        print(recording.cameras, recording.topics)
        for left, right in zip(recording.frames("left"), recording.frames("right"), strict=True):
            print(f"{left.t_s:.3f} s: images of {left.image.shape} and {right.image.shape}")
