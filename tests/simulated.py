"""Sets of `armsight simulate` that many tests read: each made once for all processes of a run; none is written into."""

from pathlib import Path
from typing import Any

from warm_python import once


def simulated(scenario: str, **asked: Any) -> Path:
    """Return the folder of a set of files; asked: as `simulate` takes it."""
    from armsight.ops.simulation.run import simulate

    name = "-".join([scenario, *(f"{key}={value}" for key, value in asked.items())])
    return once(name, lambda folder: simulate(scenario, folder, **asked))
