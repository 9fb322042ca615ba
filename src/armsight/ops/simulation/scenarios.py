"""Scenario files: the built-in ones by name, others by path."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from armsight.clock import Clock, SystemClock
from armsight.drivers import AUTOMATIC, CELLS, SCENARIOS, SETS, CameraSettings, FrameSource, folder, known, load
from armsight.errors import DeviceNotFound
from armsight.kinematics import in_convention
from armsight.ops.arm_files import load_arm, refuse_file_called
from armsight.ops.kinematics_results import reading_values
from armsight.store.arm_file import arm_mapping
from armsight.store.atomic import read_bytes
from armsight.store.codec import named, validated
from armsight.store.yamls import MAX_BYTES, dump_yaml, parse_yaml

MODEL = "scenario"
FILES, WORLD, LIVE, VIEW, WITH_ARM = "files", "world", "live", "view", "with-arm"

ROOM_BLOCK = re.compile(r"^room:.*\n(?:[ \t]+.*\n|#.*\n(?=[ \t]))*", re.MULTILINE)
"""The key `room` of a scenario's text, with the lines that belong to it."""


def scenario_names() -> tuple[str, ...]:
    """Return the names of the built-in scenarios, sorted; none where the simulation is not installed."""
    if FILES not in known(SCENARIOS):
        return ()
    return tuple(sorted(path.stem for path in folder(SCENARIOS, FILES).glob("*.yaml")))


def scenario_text(name: str) -> tuple[bytes, str] | None:
    """Return the content of a built-in scenario or of a file, and what to call it; None where it is neither.

    Raises DeviceNotFound for a name where the simulation is not installed, UsageError for one of both.
    """
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return read_bytes(path, limit=MAX_BYTES), name
    inside = folder(SCENARIOS, FILES) / f"{name}.yaml"
    if name not in scenario_names():
        return None
    refuse_file_called(name, "a built-in scenario")
    return read_bytes(inside, limit=MAX_BYTES), f"the scenario {name}"


def load_scenario(name: str) -> tuple[Any, str]:
    """Return a scenario, checked, and its text. Raises DeviceNotFound with the known names; BadFile naming the key."""
    found = scenario_text(name)
    if found is None:
        written = (*known(CELLS), *known(SETS))
        raise DeviceNotFound(
            f"{name} is no scenario: it can be written, and not run live"
            if name in written
            else f"there is no scenario {name!r}",
            consequence="There is nothing to simulate",
            cure=f"Known are: {', '.join(scenario_names())}; or give a scenario file (.yaml). For armsight simulate "
            f"alone: {', '.join(written)}",
        )
    data, where = found
    content = parse_yaml(data, where)
    return scenario_model(content, where), data.decode("utf-8")


def scenario_model(content: Mapping[str, Any], where: str) -> Any:
    """Return a scenario of what its file holds, checked. Raises BadFile naming the key."""
    return validated(load(SCENARIOS, MODEL), content, where)


def with_arm(name: str, arm: str, home: str | None) -> tuple[Any, str]:
    """Return a scenario with another arm, of load_arm, before its cameras, and its text.

    home: readings at which the cameras see it, as text or in a file; None: where a twin of it stands first. Raises
    UsageError for an arm that cannot be simulated, Inconsistent where its lights cannot be seen.
    """
    model, _ = load_scenario(name)
    known = in_convention(load_arm(arm), "standard")
    stand = None if home is None else reading_values(known, home).tolist()
    keys = load(SCENARIOS, WITH_ARM)(model, arm_mapping(known), stand)
    made = scenario_model(keys, f"the scenario {name} with {arm}")
    return made, dump_yaml(keys)


def build_world(
    name: str, model: Any, *, seed: int | None, frames: int | None, room: Any = None, zoom: float | None = None
) -> Any:
    """Return a scenario's world; BadFile, naming the scenario and the key, for a geometry that cannot be.

    room: instead of the scenario's own, as its key takes it. zoom: of its zoom lenses.
    """
    with named(f"the scenario {name}"):
        return load(SCENARIOS, WORLD)(model, seed=seed, frames=frames, room=room, zoom=zoom)


def live_cell(
    name: str, clock: Clock, *, play: bool = False, cameras: Sequence[str] | None = None, **asked: Any
) -> Any:
    """Return the robot of a scenario and the cameras that watch it or that it carries, on one clock.

    play: the robot goes the scenario's way. cameras: those of a rig, in its order; None: all. asked: hand, speed_m_s,
    seed, fps, room, as the simulation takes them. Raises Inconsistent for cameras that the scenario has not.
    """
    cell = load(SCENARIOS, LIVE)(load_scenario(name)[0], clock, play=play, **asked)
    if cameras is not None:
        cell.pairs.see_by(cameras)
    return cell


def sim_camera(
    device: str,
    *,
    colour: bool,
    clock: Clock | None,
    origin_s: float | None,
    settings: CameraSettings = AUTOMATIC,
) -> FrameSource:
    """Return one camera of a scenario, live; device: SCENARIO:left (or its name), of a mirror rig SCENARIO:image.

    Its stamps are the scenario's own, so that left and right agree. Of settings it takes the zoom. Raises
    UsageError for others, DeviceNotFound, BadFile as load_scenario.
    """
    name, _, view = device.rpartition(":")
    if not (view and name):
        raise DeviceNotFound(
            f"the simulated camera {device!r} has no view",
            consequence="There is no frame to read",
            cure="Write camera:sim:SCENARIO:VIEW, with left, right or another camera's name, or image",
        )
    settings.require_only(("zoom",), f"camera:sim:{device}")
    world = build_world(name, load_scenario(name)[0], seed=None, frames=None, zoom=settings.zoom)
    if view not in world.views:
        raise DeviceNotFound(
            f"{name} has no view {view!r}",
            consequence="There is no frame to read",
            cure=f"It has {', '.join(world.views)}",
        )
    source: FrameSource = load(SCENARIOS, VIEW)(world, clock or SystemClock(), view)
    return source


def settled_text(text: str, *, seed: int, frames: int, room: Any = None, zoom: float | None = None) -> str:
    """Return a scenario's text with this seed, number of frames, room and zoom, so that it makes the same run again."""
    if room is not None:
        text = ROOM_BLOCK.sub("", text).rstrip("\n") + f"\nroom: {json.dumps(room)}\n"
    for key, value in (("seed", seed), ("frames", frames), *((("zoom", zoom),) if zoom is not None else ())):
        line = re.compile(rf"^{key}:[ \t]*[^\s#]+", re.MULTILINE)
        if line.search(text):
            text = line.sub(f"{key}: {value}", text, count=1)
        else:
            text = text.rstrip("\n") + f"\n{key}: {value}\n"
    return text
