"""Run an emulated controller, here or in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, cast

from armsight import errors
from armsight.clock import SystemClock
from armsight.drivers import TWINS, load
from armsight.errors import ArmsightError, DeviceFailed
from armsight.kinematics import in_convention
from armsight.ops.arm_files import load_arm
from armsight.ops.robot.recorder import run_with_progress
from armsight.store.arm_file import arm_mapping

END_S = 5.0
"""Longest wait for a twin's process to end, before it is killed."""


def run_twin(
    name: str,
    *,
    port: str | None,
    connect: str | None,
    arm: str | None,
    cycle_s: float | None,
    on: Callable[[], bool],
    ready: Callable[[str], None],
    warn: Callable[[str], None],
) -> None:
    """Run the twin of a driver in real time as long as on() holds; ready is called with the address that opens it.

    arm: a file or a preset's name. warn is answer why the twin stopped its arm or fell silent. A controller has its own
    computer: its twin goes before other work of this one where the system allows that. Raises UsageError,
    DeviceNotFound with the twins there are, DeviceFailed.
    """
    with _made(name, port, connect, arm, cycle_s) as twin:
        ready(twin.address)

        def show_messages() -> None:
            while twin.messages:
                warn(f"{name} twin: {twin.messages.pop(0)}")

        run_with_progress(lambda: twin.run(on), show_messages)
        show_messages()


@contextmanager
def twin_beside(
    name: str, *, port: str | None, connect: str | None, arm: str | None, cycle_s: float | None
) -> Iterator[str]:
    """Run a twin in a process of its own while the block runs; gives its address.

    In a thread of this process it would wait for the interpreter's lock, and its driver with it. Its warnings go to
    stderr. Raises as run_twin, DeviceFailed where the process ended by itself.
    """
    _made(name, port, connect, arm, cycle_s)  # what is wrong with it is answer at once
    begin = "import sys; sys.path.insert(0, sys.argv[1]); from armsight.ops.robot.twin import serve_twin; serve_twin()"
    command = [sys.executable, "-c", begin, str(Path(__file__).parents[3])]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )  # a session of its own: Ctrl-C is for this process, which ends the other
    orders, answers = cast(IO[bytes], process.stdin), cast(IO[bytes], process.stdout)
    given = {"name": name, "port": port, "connect": connect, "arm": arm, "cycle_s": cycle_s}
    try:
        with suppress(BrokenPipeError):
            orders.write(json.dumps(given).encode() + b"\n")
            orders.flush()
        yield _address_from(answers)
        if process.poll() is not None:
            _address_from(answers)
    finally:
        with suppress(BrokenPipeError):
            orders.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        answers.close()


def serve_twin() -> None:
    """Run the twin that stdin tells of until stdin ends; tell its address, or what went wrong, on stdout."""
    given, ended = json.loads(sys.stdin.buffer.readline()), threading.Event()

    def wait() -> None:
        sys.stdin.buffer.read()
        ended.set()

    def send(answer: object) -> None:
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()

    def warn(text: str) -> None:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()

    threading.Thread(target=wait, daemon=True).start()
    try:
        run_twin(**given, on=lambda: not ended.is_set(), ready=send, warn=warn)
    except ArmsightError as error:
        send({"kind": type(error).__name__, "of": [error.cause, error.consequence, error.cure]})


def _made(name: str, port: str | None, connect: str | None, arm: str | None, cycle_s: float | None) -> Any:
    maker: Any = load(TWINS, name)
    mapping = (
        None if arm is None else arm_mapping(in_convention(load_arm(arm), getattr(maker, "convention", "standard")))
    )
    return maker(port=port, connect=connect, arm=mapping, cycle_s=cycle_s, clock=SystemClock())


def _address_from(pipe: IO[bytes]) -> str:
    """Return the address that a twin's process tells. Raises what it raised, DeviceFailed where it tells nothing."""
    line = pipe.readline()
    if not line:
        raise DeviceFailed("the twin's process ended by itself", consequence="There is no twin")
    answer = json.loads(line)
    if isinstance(answer, str):
        return answer
    cause, consequence, cure = answer["of"]
    raise getattr(errors, answer["kind"], DeviceFailed)(cause, consequence=consequence, cure=cure)
