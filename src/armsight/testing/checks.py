"""How a contract says that it is broken."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


def check(holds: bool, what: str) -> None:
    """Raise AssertionError that says what is broken, unless it holds."""
    if not holds:
        raise AssertionError(f"the driver breaks its contract: {what}")


@contextmanager
def refused(kinds: type[Exception] | tuple[type[Exception], ...], what: str) -> Iterator[None]:
    """Expect the block to raise one of kinds; another error or none breaks the contract."""
    try:
        yield
    except kinds:
        return
    except Exception as error:
        raise AssertionError(f"the driver breaks its contract: {what}, but {type(error).__name__}: {error}") from error
    raise AssertionError(f"the driver breaks its contract: {what}, but nothing was raised")


def contract_tests(contract: type) -> tuple[str, ...]:
    """Return the names of a contract's tests, in the order they are written."""
    return tuple(
        name for name in dict.fromkeys(n for c in contract.__mro__ for n in vars(c)) if name.startswith("test_")
    )
