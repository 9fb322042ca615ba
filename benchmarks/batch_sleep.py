"""What workers run in benchmarks/batch.py --overhead."""

from __future__ import annotations

import time
from pathlib import Path

from armsight.app.batch.jobs import Ended, Job


def sleep(job: Job, folder: Path) -> Ended:
    """Sleep for as long as the job says, and give a few figures."""
    time.sleep(float(str(job.arguments["s"])))
    return Ended(figures={"slept_s": job.arguments["s"], "at": {"x_m": 1.0, "y_m": 2.0}})
