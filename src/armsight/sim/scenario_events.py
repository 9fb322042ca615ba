"""What goes wrong in a scenario, in frames and in joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.sim.event_schema import EventKeys
from armsight.sim.scenario_schema import Scenario
from armsight.sim.scene import Event, Ghost

Array = NDArray[np.float64]


def events_of(scenario: Scenario, kinds: tuple[str, ...]) -> tuple[Event, ...]:
    """Return the events of these kinds, by the frames that they are in."""

    def made(event: EventKeys) -> Event:
        first = int(np.ceil(event.at_s * scenario.fps - 1e-9))
        last = max(first + 1, int(np.ceil((event.at_s + event.for_s) * scenario.fps - 1e-9)))
        ghosts: tuple[Ghost, ...] = ()
        if event.kind == "reflection" and event.uv_px is not None:
            uv = (event.uv_px[0], event.uv_px[1])
            ghosts = (Ghost(uv_px=uv, level=event.level, sigma_px=scenario.target.sigma_px),)
        hidden = tuple(event.lights) if event.kind == "occluded" else ()
        return Event(first=first, last=last, side=event.side, note=event.kind, hidden=hidden, ghosts=ghosts)

    return tuple(made(event) for event in scenario.events if event.kind in kinds)


def zero_jumps(scenario: Scenario, units: Array) -> tuple[tuple[float, float, Array], ...]:
    """Return when encoders jump: from, to in s, and by how much (n,) in rad or m."""
    jumps = []
    for event in scenario.events:
        if event.kind == "encoder_jump" and event.joint is not None and event.by is not None:
            by = np.zeros(len(units))
            by[event.joint - 1] = units[event.joint - 1] * event.by
            jumps.append((event.at_s, event.at_s + event.for_s, by))
    return tuple(jumps)
