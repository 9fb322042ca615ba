"""The rooms of simulated cells: bare for most tests, else furnished, lit and drawn once for all processes of one run.

A room takes five to nine seconds of computing, and another number of frames is another room. What each is made of is
the key, so that another one is never taken for it. tests/unit/sim/test_rooms.py makes its own anew: `apart`. What
lights and boards look like among other things is for tests/truth and tests/golden to tell, and a few named in LIT.
"""

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

LIT = ("tests/truth/", "tests/golden/", "tests/unit/sim/", "tests/unit/app/test_mirrors.py",
       "tests/unit/app/test_other_scale.py")  # fmt: skip
"""Where tests begin that stand in furnished rooms."""
MODULE = "armsight_sim.backdrops"
OWN: dict[str, Any] = {}
"""What the simulation has in place of what is shared, by name."""
SHARED: dict[str, Any] = {}


def drawing() -> Any:
    """Return the simulation's module of rooms, None where no test of this process simulates."""
    return import_module(MODULE) if "armsight.ops.simulation.run" in sys.modules else sys.modules.get(MODULE)


def share(folder: Path) -> None:
    """Keep in a folder what the simulation's cameras see of rooms and take it from there, once it is imported."""
    backdrops = drawing()
    if backdrops is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    OWN.update({} if OWN else {"furnished": backdrops.furnished, "_standing": backdrops._standing})
    if not SHARED:
        for name, own in OWN.items():
            SHARED[name] = lru_cache(own.cache_parameters()["maxsize"])(kept(own.__wrapped__, folder))
    for name, shared in SHARED.items():
        setattr(backdrops, name, shared)


class Bare:
    """What stands for a room: nothing in it, and a little light everywhere."""

    def light(self, view: Any, T_room_camera: object, channels: int, samples: int = 4) -> Any:
        """Return the light (h, w, channels) on a camera."""
        return np.full((view.lens.height, view.lens.width, channels), 9.0, np.float32)

    def seen_indicators(self, eye_m: object) -> tuple[()]:
        """Return nothing: there are none."""
        return ()


def bare() -> None:
    """Put cells into bare rooms from here on, once the simulation is imported."""
    backdrops = drawing()
    if backdrops is not None:
        OWN.update({} if OWN else {"furnished": backdrops.furnished, "_standing": backdrops._standing})
        backdrops.furnished, backdrops._standing = (lambda *_: Bare()), OWN["_standing"]


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
