"""A path as a Python object: a module that makes it again."""

from __future__ import annotations

import numpy as np

from armsight.records import TaughtPath


def python_module(path: TaughtPath, name: str = "PATH") -> str:
    """Return the source of a module whose NAME is this path, number for number."""
    T = ",\n        ".join(repr(rows) for rows in path.T_world_tip.tolist())
    head = f"A path of the tool's tip: {len(path)} poses in {path.parent}, {path.length_m[-1]:.4f} m."
    return f'''"""{head} Written by armsight."""

import numpy as np
from numpy import nan

from armsight.records import TaughtPath

{name} = TaughtPath(
    T_world_tip=np.array([
        {T},
    ]),
    t_s=np.array({_numbers(path.t_s)}),
    speed_m_s=np.array({_numbers(path.speed_m_s)}),
    tags={path.tags!r},
    parent={path.parent!r},
)
'''


def _numbers(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return f"[{', '.join(repr(value) for value in values.tolist())}]"
