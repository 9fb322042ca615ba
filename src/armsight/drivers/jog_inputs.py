"""What a person moves an arm by: the keys of a terminal, or a gamepad by Linux's joystick interface."""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from armsight.errors import DeviceFailed, DeviceNotFound, UsageError

GAMEPAD = "/dev/input/js0"
EVENT = struct.Struct("IhBB")
"""struct js_event of linux/joystick.h: time in ms, value, type, number."""
BUTTON, AXIS, INITIAL = 1, 2, 0x80
FULL = 32767.0
ENABLE_BUTTONS = frozenset({4, 5})
"""The shoulder buttons, as the kernel numbers those of common gamepads: one of them held is the enable."""
END_BUTTONS = frozenset({7, 9})
"""Start, with the numbers of two families of gamepads."""
STICKS = ((1, -1.0), (0, -1.0), (4, -1.0), (3, -1.0), (7, -1.0), (6, -1.0))
"""Axis and sign of each direction: left stick forward and left, right stick up and left, cross up and left."""
PLUS, MINUS = "qwertyui", "asdfghjk"
OTHER_LAYOUT = {"z": "y"}
"""Where y and z have changed places."""


@dataclass(frozen=True, slots=True)
class JogAxes:
    """Axes from -1 to 1, whether the enable is held, and whether the person is done."""

    axes: tuple[float, ...]
    enabled: bool
    ended: bool = False


class JogInput(Protocol):
    """A person's hand, seen n axes wide."""

    def help(self) -> str:
        """Say what to press."""

    def wait(self, timeout_s: float) -> JogAxes | None:
        """Return what is pressed, after timeout_s at the latest; None where nothing new is known."""


class KeyboardInput:
    """Keys of a terminal (fd), two for each of n axes; one counts while it repeats: no release is told."""

    def __init__(self, fd: int, n: int) -> None:
        if not 1 <= n <= len(PLUS):
            raise UsageError(f"{n} axes have no keys, 1 to {len(PLUS)} do", cure="Use --joint and --by")
        self._fd = fd
        self._n = n

    def help(self) -> str:
        """Say what to press."""
        return (
            f"Hold {', '.join(PLUS[: self._n])} to move forward, {', '.join(MINUS[: self._n])} to move back, one pair "
            "for each axis; any other key stops, x ends."
        )

    def wait(self, timeout_s: float) -> JogAxes | None:
        """Return the axis of the key that repeats now; None where none does."""
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return None
        pressed = os.read(self._fd, 64).decode("ascii", "replace")
        rest = (0.0,) * self._n
        # Escape alone is a hand that wants out; with more behind it, an arrow key
        if not pressed or pressed == "\x1b" or pressed[-1] == "x":
            return JogAxes(rest, enabled=False, ended=True)
        key = OTHER_LAYOUT.get(pressed[-1].lower(), pressed[-1].lower())
        for keys, sign in ((PLUS, 1.0), (MINUS, -1.0)):
            i = keys[: self._n].find(key)
            if i >= 0 and not pressed.startswith("\x1b"):
                return JogAxes(tuple(sign if k == i else 0.0 for k in range(self._n)), enabled=True)
        return JogAxes(rest, enabled=False)


class GamepadInput:
    """A gamepad: sticks and cross are six axes, a held shoulder button is the enable, Start ends.

    It counts as let go of while it cannot be read. fd: of the open device; n: axes, the first of the six.
    """

    def __init__(self, fd: int, n: int) -> None:
        self._fd = fd
        self._n = n
        self._axes: dict[int, float] = {}
        self._held: set[int] = set()

    def help(self) -> str:
        """Say what to press."""
        return (
            "Hold a shoulder button and push: left stick forward/back is axis 1, left/right 2, right stick 3 and 4, "
            "cross 5 and 6; Start ends."
        )

    def wait(self, timeout_s: float) -> JogAxes | None:
        """Return how the sticks stand. Raises DeviceFailed where the gamepad is gone."""
        if select.select([self._fd], [], [], timeout_s)[0]:
            try:
                data = os.read(self._fd, 64 * EVENT.size)
            except OSError as error:
                raise gone() from error
            # the driver gives whole events: anything else is a device that is being pulled out
            if not data or len(data) % EVENT.size:
                raise gone()
            for _, value, kind, number in EVENT.iter_unpack(data):
                self._take(kind & ~INITIAL, number, value)
        values = [sign * self._axes.get(axis, 0.0) for axis, sign in STICKS[: self._n]]
        values += [0.0] * (self._n - len(values))
        return JogAxes(tuple(values), bool(self._held & ENABLE_BUTTONS), bool(self._held & END_BUTTONS))

    def _take(self, kind: int, number: int, value: int) -> None:
        if kind == AXIS:
            self._axes[number] = max(-1.0, value / FULL)
        elif kind == BUTTON:
            (self._held.add if value else self._held.discard)(number)


def gone() -> DeviceFailed:
    """Return the error of a gamepad that was pulled out."""
    return DeviceFailed(
        "the gamepad is gone", consequence="The robot came to rest", cure="Plug it in again and begin anew"
    )


@contextmanager
def open_jog_input(name: str, n: int) -> Iterator[JogInput]:
    """Open `keyboard` or `gamepad[:DEVICE]` for n axes; the terminal stays. Raises UsageError, DeviceNotFound."""
    kind, _, device = name.partition(":")
    if kind == "keyboard" and not device:
        with single_keys() as fd:
            yield KeyboardInput(fd, n)
    elif kind == "gamepad":
        fd = _open(device or GAMEPAD)
        try:
            yield GamepadInput(fd, n)
        finally:
            os.close(fd)
    else:
        raise UsageError(
            f"{name!r} is nothing to move a robot by", cure="Give keyboard, gamepad or gamepad:/dev/input/jsN (--with)"
        )


def _open(device: str) -> int:
    try:
        return os.open(device, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise DeviceNotFound(
            f"no gamepad at {device}: {error.strerror}",
            consequence="Nothing is moved",
            cure="Plug it in, look for /dev/input/js*, and give it (--with gamepad:/dev/input/jsN)",
        ) from error


@contextmanager
def single_keys() -> Iterator[int]:
    """Let the terminal give each key at once, and not write it; yields its descriptor. Raises UsageError."""
    import termios
    import tty

    if not sys.stdin.isatty():
        raise UsageError(
            "there is no keyboard: the input is no terminal", cure="Run it in a terminal, or give --joint and --by"
        )
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    try:
        yield fd
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(fd, termios.TCSADRAIN, before)


KEYS_S = 0.1


@contextmanager
def listening(actions: Mapping[str, Callable[[], object]]) -> Iterator[None]:
    """Call the action of each key that is pressed, from a thread, until it ends. Without a terminal nothing happens."""
    if not sys.stdin.isatty():
        yield
        return
    end = threading.Event()

    def look(fd: int) -> None:
        while not end.is_set():
            if not select.select([fd], [], [], KEYS_S)[0]:
                continue
            for key in os.read(fd, 64).decode("ascii", "ignore"):
                action = actions.get(key)
                if action is not None:
                    action()

    with single_keys() as fd:
        thread = threading.Thread(target=look, args=(fd,), name="keys", daemon=True)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()
