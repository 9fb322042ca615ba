"""Simulated cells: frames as cameras would give them, and the truth beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.api.arrays import Array, Image
from armsight.app.simulate.cells import load_cell, room_choice
from armsight.app.simulate.run import CELL_FRAMES
from armsight.app.simulate.scenarios import build_world, load_scenario, scenario_names
from armsight.drivers import CELLS, known
from armsight.optics import Rig
from armsight.records import Target, require_count, require_kind
from armsight.store import rig_from_mapping, target_from_mapping


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedFrame:
    """What the cameras see at t_s, and where the target truly is: T_rig_target (4, 4). right: None for a mirror rig."""

    t_s: float
    left: Image
    right: Image | None
    T_rig_target: Array


class Simulation:
    """A simulated cell: iterate for its frames. rig, target: as a perfect calibration would give them."""

    def __init__(self, world: Any, name: str) -> None:
        self._world = world
        self.name = name
        self.rig: Rig = rig_from_mapping(world.rig, f"{name}'s rig")
        self.target: Target = target_from_mapping(world.target, f"{name}'s target")

    def __len__(self) -> int:
        return len(self._world.truth)

    def __repr__(self) -> str:
        return f"Simulation of {self.name}: {len(self)} frames"

    def __iter__(self) -> Iterator[SimulatedFrame]:
        for seen, (t_s, xyz_m, quat_xyzw) in zip(self._world.frames(), self._world.truth, strict=True):
            T = RigidTransform.from_components(xyz_m, Rotation.from_quat(quat_xyzw)).as_matrix()
            right = seen[1].image if len(seen) == 2 else None
            yield SimulatedFrame(t_s=float(t_s), left=seen[0].image, right=right, T_rig_target=np.asarray(T))


def simulate(
    scenario: str = "webcam-cell", *, frames: int | None = None, seed: int | None = None, room: str | None = None
) -> Simulation:
    """Return a simulated cell, to be iterated over for its frames.

    Parameters
    ----------
    scenario
        A built-in scenario or cell (see `scenarios`), or a scenario file (.yaml).
    frames
        How many; its own number if not given.
    seed
        Of everything random in it; its own if not given.
    room
        'workshop', 'office', 'plain', 'dark', or a picture's path; its own if not given.

    Raises
    ------
    DeviceNotFound
        There is no such scenario; the message names those that are.
    BadFile
        A scenario file's key cannot be as it is.
    UsageError
        A number of frames below 1, or what is no number or no text.
    """
    require_kind("scenario", scenario, str, cure="Give one of scenarios(), or a scenario file's path")
    require_kind("room", room, str, NoneType, cure="Give a room's name, or a picture's path")
    if seed is not None:
        require_count("seed", seed)
    if frames is not None:
        require_count("frames", frames, least=1)
    if scenario in known(CELLS) and scenario not in scenario_names():
        return Simulation(load_cell(scenario, seed=seed or 0, frames=frames or CELL_FRAMES, room=room), scenario)
    model = load_scenario(scenario)[0]
    chosen = None if room is None else room_choice(room)
    return Simulation(build_world(scenario, model, seed=seed, frames=frames, room=chosen), scenario)


def scenarios() -> tuple[str, ...]:
    """Return the names of the built-in scenarios and cells."""
    return tuple(sorted({*scenario_names(), *known(CELLS)}))
