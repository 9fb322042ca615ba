"""A loop in a thread of its own, while this one shows the person how far it is."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from armsight.priority import bound_control, control_first

Result = TypeVar("Result")

SHOW_S = 0.2
"""Time between two calls of show, in s."""


def run_with_progress(target: Callable[[], Result], show: Callable[[], None]) -> Result:
    """Return what target returns, or raise what it raises; show is called now and then meanwhile, from this thread.

    target goes before all else on the machine where the system allows that. No cycle of a loop within it waits for the
    screen that show writes to.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        control_first()
        try:
            results.append(target())
        except BaseException as error:  # raised again below, where somebody hears it
            errors.append(error)

    bound_control()
    thread = threading.Thread(target=run, name="control loop")
    thread.start()
    while thread.is_alive():
        thread.join(SHOW_S)
        show()
    if errors:
        raise errors[0]
    return results[0]
