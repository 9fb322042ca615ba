"""A loop in a thread of its own, while this one tells the person how far it is."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from armsight.priority import bound_control, control_first

Result = TypeVar("Result")

TOLD_S = 0.2
"""Time between two tellings."""


def run_with_progress(work: Callable[[], Result], tell: Callable[[], None]) -> Result:
    """Return what work returns, or raise what it raises; tell is called now and then meanwhile, from this thread.

    work runs before other work of the machine where the system allows that. No cycle of a loop within it waits for the
    screen that tell writes to.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        control_first()
        try:
            results.append(work())
        except BaseException as error:  # raised again below, where somebody hears it
            errors.append(error)

    bound_control()
    thread = threading.Thread(target=run, name="control loop")
    thread.start()
    while thread.is_alive():
        thread.join(TOLD_S)
        tell()
    if errors:
        raise errors[0]
    return results[0]
