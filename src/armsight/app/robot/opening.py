"""A robot by what the person calls it: DRIVER:DEVICE."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from armsight.app.simulate.scenarios import load_scenario
from armsight.clock import Clock
from armsight.drivers import ROBOTS, Robot, known, load
from armsight.errors import UsageError

SIM = "sim"


def open_robot(text: str, clock: Clock, settings: Mapping[str, Any] | None = None) -> Robot:
    """Return the robot that DRIVER:DEVICE names; nothing is opened yet.

    sim:SCENARIO is a scenario's robot by itself; where cameras watch it too, take live_cell, which puts all on one
    clock. ws://HOST:PORT is a robot server's. settings: what the driver takes beyond its device. Raises UsageError,
    DeviceNotFound with the drivers there are, BadFile for a scenario.
    """
    driver, colon, device = text.partition(":")
    if not (driver and colon and device):
        raise UsageError(
            f"{text!r} is not DRIVER:DEVICE",
            consequence="There is no robot",
            cure=f"Give for instance sim:webcam-cell; drivers are: {', '.join(known(ROBOTS))}",
        )
    maker = load(ROBOTS, "ws" if driver == "wss" else driver)
    if driver == SIM:
        model, _ = load_scenario(device)
        return cast(Robot, maker("", settings=model.model_dump(), clock=clock))
    name = text if driver in ("ws", "wss") else device
    return cast(Robot, maker(name, settings=dict(settings or {}), clock=clock))
