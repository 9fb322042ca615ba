"""Run an emulated controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from armsight.app.kinematics import load_arm
from armsight.clock import SystemClock
from armsight.drivers import load
from armsight.kinematics import in_convention
from armsight.store.arm_file import arm_mapping

TWINS = "armsight.twins"
"""Group of callables (*, port, connect, arm, cycle_s, clock) -> Twin; see sim/twins/base.py."""


def run_twin(
    name: str,
    *,
    port: str | None = None,
    connect: str | None = None,
    arm: str | None = None,
    cycle_s: float | None = None,
    on: Callable[[], bool],
    tell: Callable[[str], None],
) -> None:
    """Run the twin of a driver in real time as long as on() holds; tell the address that opens it.

    arm: a file or a preset's name. Raises UsageError, DeviceNotFound with the twins there are, DeviceFailed.
    """
    maker: Any = load(TWINS, name)
    mapping = None if arm is None else arm_mapping(in_convention(load_arm(arm), "standard"))
    with maker(port=port, connect=connect, arm=mapping, cycle_s=cycle_s, clock=SystemClock()) as twin:
        tell(twin.address)
        twin.run(on)
