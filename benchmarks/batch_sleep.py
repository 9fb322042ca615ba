"""What workers run in benchmarks/batch.py --overhead."""

from __future__ import annotations

import time
from collections.abc import Sequence

from armsight_lab.batch.jobs import Job, Status
from armsight_lab.batch.work import Finished


def group(jobs: Sequence[Job]) -> list[Finished]:
    """Sleep for as long as each job says."""
    done = []
    for job in jobs:
        slept_s = float(str(job.arguments["s"]))
        time.sleep(slept_s)
        done.append(Finished(job.name, Status.DONE, False, slept_s, ""))
    return done
