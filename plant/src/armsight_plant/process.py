"""The publishers' process, and the side that feeds it: the newest state one way, notes and acknowledgements the other.

Nothing here waits for a client. The state goes through memory in which the newest replaces what was there; whoever
floods or stalls a publisher takes time of that process, which gives way to all other work.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import pickle
import signal
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from armsight.control.session.channels import Newest, Queue
from armsight.errors import ArmsightError, DeviceFailed
from armsight.priority import BEHIND, give_way
from armsight_plant.certificates import missing
from armsight_plant.options import ENDS, PlantOptions
from armsight_plant.state import PlantState, Request, Tell, decode, encode

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

POLL_S = 0.01
"""How often the publishers' process looks for a newer state."""
BEGIN_S = 120.0
"""Longest wait until all of them listen, on a machine that may be busy."""
END_S = 3.0
STATE_BYTES = 1 << 16


class Publisher(Protocol):
    """One way to tell the plant; for one event loop."""

    async def start(self) -> None:
        """Listen, or begin to connect. Raises ArmsightError."""
        ...

    async def show(self, state: PlantState | None, now_s: float) -> None:
        """Tell the newest state as it may be used at now_s of time.monotonic; None before the first."""
        ...

    async def stop(self) -> None:
        """End."""
        ...


@dataclass(frozen=True, slots=True)
class PlantChannels:
    """What both processes share. begun: pickled, what the start came to: the ports, or the error that kept it."""

    state: Newest = field(default_factory=lambda: Newest(STATE_BYTES))
    requests: Queue = field(default_factory=lambda: Queue(256, 4096))
    begun: Newest = field(default_factory=lambda: Newest(8192))


class PlantProcess:
    """Runs the publishers while it is open. Raises, on entering, what keeps one of them from starting.

    ports: where OPC UA and Foxglove listen.
    """

    def __init__(self, options: PlantOptions) -> None:
        """Nothing is started."""
        self._options = options
        self._channels = PlantChannels()
        self._process: BaseProcess | None = None
        self.ports: dict[str, int] = {}

    def __enter__(self) -> PlantProcess:
        self._begin()
        try:
            self._wait()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._end()

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process is not None and self._process.is_alive()

    @property
    def came(self) -> dict[str, int] | ArmsightError | None:
        """What its start came to: the ports, or what kept it from starting; None before that is known."""
        data = self._channels.begun.read()
        return None if data is None else pickle.loads(data)

    def show(self, state: PlantState) -> None:
        """Replace what is published; never waits."""
        self._channels.state.write(pickle.dumps(state, protocol=5))

    def requests(self) -> list[Request]:
        """Return what came back since this was last asked."""
        found = []
        while (data := self._channels.requests.get()) is not None:
            found.append(decode(data))
        return found

    def restart(self) -> None:
        """Start it anew after it ended by itself; whether it serves again is not waited for."""
        self._channels = PlantChannels()
        self._begin()

    def _begin(self) -> None:
        self._process = multiprocessing.get_context("spawn").Process(
            target=run_publishers, args=(self._channels, self._options, os.getpid()), name="armsight-plant", daemon=True
        )
        self._process.start()

    def _wait(self) -> None:
        until_s = time.monotonic() + BEGIN_S
        while (came := self.came) is None:
            if time.monotonic() > until_s or not self.alive:
                raise DeviceFailed("the process that publishes did not begin", consequence=ENDS)
            time.sleep(POLL_S)
        if isinstance(came, ArmsightError):
            raise came
        self.ports = came

    def _end(self) -> None:
        if self._process is None:
            return
        self._process.terminate()
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def publishers(options: PlantOptions, tell: Tell) -> dict[str, Publisher]:
    """Return what options ask for, nothing opened. Raises DeviceNotFound for a package that is missing, BadFile."""
    found: dict[str, Publisher] = {}
    if options.opcua is not None:
        try:
            from armsight_plant.opcua.publisher import OpcUaPublisher
        except ImportError as error:
            raise missing("plant", "asyncua") from error
        found["opcua"] = OpcUaPublisher(options.opcua, options.stale_s, tell)
    if options.mqtt is not None:
        try:
            from armsight_plant.mqtt import MqttPublisher
        except ImportError as error:
            raise missing("plant", "paho-mqtt") from error
        found["mqtt"] = MqttPublisher(options.mqtt, options.stale_s, tell)
    if options.foxglove is not None:
        try:
            from armsight_plant.foxglove import FoxglovePublisher
        except ImportError as error:
            raise missing("foxglove", "foxglove-sdk") from error
        found["foxglove"] = FoxglovePublisher(options.foxglove, options.stale_s, tell)
    return found


def run_publishers(channels: PlantChannels, options: PlantOptions, parent: int) -> None:
    """Publish until told to end, or until the process that started this one is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the other ends this one in order
    if asyncio.run(_publish(channels, options, parent)):
        os._exit(1)  # without a word to anybody: the broker then tells our last will


async def _publish(channels: PlantChannels, options: PlantOptions, parent: int) -> bool:
    """Run all publishers; return whether the parent was lost."""
    end = asyncio.Event()
    with contextlib.suppress(NotImplementedError):  # Windows ends processes without a word
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, end.set)

    def tell(request: Request) -> bool:
        return channels.requests.put(encode(request))

    begun: list[Publisher] = []
    try:
        made = publishers(options, tell)
        for one in made.values():
            await one.start()
            begun.append(one)
    except ArmsightError as error:
        channels.begun.write(pickle.dumps(error))
        return False
    channels.begun.write(pickle.dumps({name: one.port for name, one in made.items() if hasattr(one, "port")}))
    give_way(BEHIND)  # not before: whoever starts it waits for it
    last: bytes | None = None
    state: PlantState | None = None
    while not end.is_set():
        if os.getppid() != parent:
            return True
        data = channels.state.read()
        if data is not None and data != last:
            last, state = data, pickle.loads(data)
        for one in begun:
            await one.show(state, time.monotonic())
        await asyncio.sleep(POLL_S)
    for one in begun:
        await one.stop()
    return False
