"""What workers run in tests of batches: functions of a module that their processes can import."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from armsight.errors import DeviceFailed, NotEnoughData
from armsight_lab.batch.jobs import Ended, Job


def work(job: Job, folder: Path) -> Ended:
    """Do what the job's arguments say."""
    (folder / "half.txt").write_text("begun")
    told = job.arguments
    if "count" in told:  # how often each job was run, whatever became of it
        with Path(str(told["count"])).open("a") as file:
            file.write(job.name + "\n")
    crowded = told.get("kill") == "crowded" and int(Path(str(told["mark"])).read_text()) > 1
    if crowded or (told.get("kill") == "once" and not Path(str(told["mark"])).exists()):
        if told["kill"] == "once":
            Path(str(told["mark"])).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if "refuse" in told:
        raise NotEnoughData("too few rows", consequence="No arm", cure="Measure more")
    if "lose" in told:
        raise DeviceFailed("the camera is gone", cure="Plug it in")
    if "crash" in told:
        raise ValueError("nobody knows")
    if "full" in told:
        raise DeviceFailed(f"{folder}: cannot be written ({os.strerror(28)})")
    (folder / "half.txt").rename(folder / "whole.txt")
    return Ended(figures=dict(told) | {"out": str(folder)})
