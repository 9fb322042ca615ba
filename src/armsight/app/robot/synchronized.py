"""Methods that one thread at a time is in."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import RLock
from typing import Concatenate, ParamSpec, Protocol, TypeVar, cast


class HasLock(Protocol):
    """An object with a lock of its own, or one that it shares with others."""

    lock: RLock


Params = ParamSpec("Params")
Result = TypeVar("Result")
Owner = TypeVar("Owner", bound=HasLock)


def synchronized(method: Callable[Concatenate[Owner, Params], Result]) -> Callable[Concatenate[Owner, Params], Result]:
    """Return the method, which waits until no other thread is in one under the same lock."""

    @wraps(method)
    def locked(self: Owner, *args: Params.args, **kwargs: Params.kwargs) -> Result:
        with self.lock:
            return method(self, *args, **kwargs)

    return cast(Callable[Concatenate[Owner, Params], Result], locked)
