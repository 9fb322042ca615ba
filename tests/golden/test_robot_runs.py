"""What is sent to a robot in each cycle of every way to run it, and what comes of it, is what it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robot_runs import CASES, STEP, figures, kept, made

WITHIN = 100
"""Multiples of STEP by which sums of another machine may differ: 1e-7 rad, m or s."""


@pytest.mark.parametrize("name", CASES)
def test_a_run_of_a_robot_sends_what_it_always_sent(name: str, tmp_path: Path) -> None:
    found = figures(made(name, tmp_path))
    with np.load(kept(name)) as before:
        assert set(found) == set(before.files)
        for table, rows in found.items():
            assert rows.shape == before[table].shape, table
            off = np.abs(np.cumsum(rows, axis=0) - np.cumsum(before[table], axis=0))
            assert not off.size or off.max() <= WITHIN, f"{table}: {off.max() * STEP:g}"
