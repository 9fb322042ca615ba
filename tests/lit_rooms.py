"""The rooms of simulated cells are furnished, lit and drawn once for all processes of one run of tests.

A room takes seconds of computing, and hundreds of tests stand in a dozen rooms. What each is made of is the key, so
that another one is never taken for it. tests/unit/sim/test_rooms.py makes its own anew: `apart`.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

MODULE = "armsight_sim.backdrops"
OWN: dict[str, Any] = {}
"""What the simulation has in place of what is shared, by name."""


def share(folder: Path) -> None:
    """Keep in a folder what the simulation's cameras see of rooms and take it from there, once it is imported."""
    backdrops: Any = sys.modules.get(MODULE)
    if OWN or backdrops is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    OWN.update(furnished=backdrops.furnished, _standing=backdrops._standing)
    for name, own in OWN.items():
        setattr(backdrops, name, lru_cache(own.cache_parameters()["maxsize"])(kept(own.__wrapped__, folder)))


def kept(make: Callable[..., Any], folder: Path) -> Callable[..., Any]:
    """Return what takes from the folder what was made of the same before."""

    def found(*asked: Any) -> Any:
        path = folder / hashlib.sha256(pickle.dumps((make.__name__, asked))).hexdigest()
        known = path.exists()
        made = path.read_bytes() if known else b""
        if not made:
            made = pickle.dumps(make(*asked), protocol=5)
            own = path.with_suffix(f".{os.getpid()}")
            own.write_bytes(made if known else b"")  # 80 MB: only of what was asked for before
            own.rename(path)
        return pickle.loads(made)  # also what was made here: its key is the same then

    return found


def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make rooms anew, for this test."""
    for name, own in OWN.items():
        monkeypatch.setattr(f"{MODULE}.{name}", own)
