"""Qualisys Track Manager, live, by qtm-rt: `qtm:HOST[:PORT]`.

Bodies come in the order of the 6D settings: mm, the matrix column by column, NaN where one is lost (the maker's Python
SDK, qtm_rt; Bitcraze's crazyflie-lib-python, examples/mocap). The time is the frame's, us of the measuring computer.
"""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import Any
from xml.etree import ElementTree

import numpy as np

from armsight.drivers.trackers.source import BodyStream, host_and_port, not_there
from armsight.errors import DeviceNotFound, UsageError
from armsight.units import MM

PORT = 22223
ANSWER_S = 5.0
US = 1e-6


class QtmStream(BodyStream):
    """A body of QTM in real time."""

    def __init__(self, device: str, *, body: str, std_m: float, std_rad: float) -> None:
        super().__init__(device, body=body, std_m=std_m, std_rad=std_rad)
        self._host, self._port = host_and_port(device, PORT)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._connection: Any = None
        self._index = 0

    def _opened(self) -> None:
        try:
            import qtm_rt
        except ImportError as error:
            raise not_there("qtm-rt") from error
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"tracker {self.name}", daemon=True)
        self._thread.start()
        begun: Future[None] = asyncio.run_coroutine_threadsafe(self._begin(qtm_rt), self._loop)
        try:
            begun.result(4.0 * ANSWER_S)
        except UsageError:
            raise
        except Exception as error:
            raise DeviceNotFound(
                f"QTM at {self._host}:{self._port} does not stream: {error or type(error).__name__}",
                consequence="Nothing was done",
                cure="Start QTM's real-time output (its Python SDK's port, little endian, 22223), and see the firewall",
            ) from error

    async def _begin(self, qtm_rt: Any) -> None:
        self._connection = await qtm_rt.connect(
            self._host,
            self._port,
            timeout=ANSWER_S,
            loop=self._loop,
            on_disconnect=lambda _: self.end("QTM ended the connection"),
        )
        if self._connection is None:
            raise ConnectionError("there is no answer")
        settings = await self._connection.get_parameters(parameters=["6d"])
        names = [(name.text or "").strip() for name in ElementTree.fromstring(settings).findall("*/Body/Name")]
        self._index = self.chosen(names)
        await self._connection.stream_frames(components=["6d"], on_packet=self._take)

    def _take(self, packet: Any) -> None:
        found = packet.get_6d()
        bodies = [] if found is None else found[1]
        t_s, sequence = US * packet.timestamp, packet.framenumber
        if self._index >= len(bodies):
            self.put(t_s, sequence, None, None, why="the frame has no such body")
            return
        (x, y, z), rotation = bodies[self._index]
        # column by column
        self.put(t_s, sequence, MM * np.array([x, y, z]), np.reshape(rotation.matrix, (3, 3)).T)

    def _closed(self) -> None:
        loop, self._loop = self._loop, None
        if loop is None:
            return
        with suppress(Exception):  # whatever happens to the link, the thread ends
            asyncio.run_coroutine_threadsafe(self._end(), loop).result(ANSWER_S)
        loop.call_soon_threadsafe(loop.stop)
        if self._thread is not None:
            self._thread.join(timeout=ANSWER_S)
        if not loop.is_running():
            loop.close()

    async def _end(self) -> None:
        if self._connection is not None and self._connection.has_transport():
            self._connection.disconnect()
        await asyncio.sleep(0.0)  # the link closes in the loop's next round
        await asyncio.sleep(0.0)
