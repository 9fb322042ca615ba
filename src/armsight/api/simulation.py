"""Simulated cells: frames as cameras would give them, and the truth beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import NoneType
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Image
from armsight.drivers import CELLS, known
from armsight.kinematics import Arm
from armsight.ops.checks import speaks_python
from armsight.ops.machine import Frames, Seed
from armsight.ops.simulation.cells import load_cell, room_choice
from armsight.ops.simulation.run import CELL_FRAMES
from armsight.ops.simulation.scenarios import build_world, load_scenario, scenario_model, scenario_names
from armsight.optics import Rig
from armsight.records import ByValue, Target, require_kind
from armsight.store import rig_from_mapping, target_from_mapping
from armsight.store.arm_file import arm_from_mapping


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedFrame(ByValue):
    """What the cameras see at t_s, and where the target truly is: T_rig_target (4, 4). right: None for a mirror rig."""

    t_s: float
    left: Image
    right: Image | None
    T_rig_target: Array


class Simulation:
    """A simulated cell: iterate for its frames. rig, target: as a perfect calibration would give them.

    What is true is there as arrays over the frames: t_s (n,), T_rig_target (n, 4, 4); of a cell with a robot also
    arm_true, arm (as its data sheet has it), q_true (n, joints), joints, what the encoders tell, as (t_s, q), and where
    the rig is: T_base_rig of one that stands, T_flange_rig of one on the arm; None where it is not so.
    """

    def __init__(self, world: Any, name: str, scenario: Any = None) -> None:
        self._world = world
        self.name = name
        self.scenario = scenario
        self.rig: Rig = rig_from_mapping(world.rig, f"{name}'s rig")
        self.target: Target = target_from_mapping(world.target, f"{name}'s target")

    def __len__(self) -> int:
        return len(self._world.truth)

    def __repr__(self) -> str:
        return f"Simulation of {self.name}: {len(self)} frames"

    @property
    def t_s(self) -> Array:
        """Times (n,) of the frames in s."""
        return np.array([t_s for t_s, _, _ in self._world.truth])

    @property
    def T_rig_target(self) -> Array:
        """True poses (n, 4, 4) of the target in the rig."""
        xyz = np.array([xyz_m for _, xyz_m, _ in self._world.truth])
        quat = np.array([quat_xyzw for _, _, quat_xyzw in self._world.truth])
        return np.asarray(RigidTransform.from_components(xyz, Rotation.from_quat(quat)).as_matrix())

    @property
    def arm(self) -> Arm | None:
        """The arm as its data sheet has it; None in a cell without one."""
        return self._arm("nominal")

    @property
    def arm_true(self) -> Arm | None:
        """The arm as it is."""
        return self._arm("true")

    @property
    def joints(self) -> tuple[Array, Array] | None:
        """What the encoders tell: times (m,) in s and readings (m, joints) in rad or m."""
        read = getattr(self._world, "joints", ())
        return (np.array([t_s for t_s, _ in read]), np.array([q for _, q in read])) if len(read) else None

    @property
    def T_base_rig(self) -> Array | None:
        """Where a rig that stands truly is."""
        return self._placement("T_base_rig")

    @property
    def T_flange_rig(self) -> Array | None:
        """Where a rig on the arm truly is."""
        return self._placement("T_flange_rig")

    def _arm(self, which: str) -> Arm | None:
        arm = getattr(self._world, which, None)
        if arm is None:
            return None
        content = {"format": "armsight/arm", "version": 1, **arm.mapping(self._world.T_flange_tool)}
        return arm_from_mapping(content, f"{self.name}'s arm")

    def _placement(self, which: str) -> Array | None:
        T = getattr(self._world, which, None)
        return None if T is None else np.asarray(T.as_matrix())

    def __iter__(self) -> Iterator[SimulatedFrame]:
        for seen, t_s, T in zip(self._world.frames(), self.t_s, self.T_rig_target, strict=True):
            right = seen[1].image if len(seen) == 2 else None
            yield SimulatedFrame(t_s=float(t_s), left=seen[0].image, right=right, T_rig_target=T)


@speaks_python()
def simulate(
    scenario: str | Mapping[str, Any] = "webcam-cell",
    *,
    frames: Frames = None,
    seed: Seed = None,
    room: str | None = None,
    zoom: float | None = None,
) -> Simulation:
    """Return a simulated cell, to be iterated over for its frames.

    Parameters
    ----------
    scenario
        A built-in scenario or cell (see `scenarios`), a scenario file (.yaml), or what such a file holds (see
        `read_scenario`), changed as wanted.
    frames
        How many; its own number if not given.
    seed
        Of everything random in it; its own if not given.
    room
        'workshop', 'office', 'plain', 'dark', or a picture's path; its own if not given. To light a workshop takes some
        seconds each time, 'dark' none.
    zoom
        Zoom lenses before the cameras, at this setting.

    Raises
    ------
    DeviceNotFound
        There is no such scenario; the message names those that are.
    BadFile
        A scenario file's key cannot be as it is.
    UsageError
        A number of frames below 1, or what is no number or no text.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=2)
    >>> [frame.left.shape for frame in cell], cell.T_rig_target.shape
    ([(720, 1280), (720, 1280)], (2, 4, 4))
    """
    require_kind("scenario", scenario, str, Mapping, cure="Give one of scenarios(), or a scenario file's path")
    require_kind("room", room, str, NoneType, cure="Give a room's name, or a picture's path")
    if isinstance(scenario, str) and scenario in known(CELLS) and scenario not in scenario_names():
        cell = load_cell(scenario, seed=seed or 0, frames=frames or CELL_FRAMES, room=room, zoom=zoom)
        return Simulation(cell, scenario)
    name = scenario if isinstance(scenario, str) else str(scenario.get("name", "the scenario"))
    model = load_scenario(scenario)[0] if isinstance(scenario, str) else scenario_model(scenario, name)
    chosen = None if room is None else room_choice(room)
    world = build_world(name, model, seed=seed, frames=frames, room=chosen, zoom=zoom)
    return Simulation(world, name, model.model_dump(mode="json"))


def read_scenario(scenario: str) -> dict[str, Any]:
    """Return what a built-in scenario or a scenario file holds, for `simulate`. Raises DeviceNotFound, BadFile.

    Examples
    --------
    >>> plain = armsight.read_scenario("webcam-cell")
    >>> armsight.simulate({**plain, "seed": 7}, frames=1).name
    'webcam-cell'
    """
    require_kind("scenario", scenario, str, cure="Give one of scenarios(), or a scenario file's path")
    content: dict[str, Any] = load_scenario(scenario)[0].model_dump(mode="json", exclude_unset=True)
    return content


def scenarios() -> tuple[str, ...]:
    """Return the names of the built-in scenarios and cells.

    Examples
    --------
    >>> "webcam-cell" in armsight.scenarios()
    True
    """
    return tuple(sorted({*scenario_names(), *known(CELLS)}))
