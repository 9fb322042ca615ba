"""Carries connections from ur-rtde's fixed ports to those of a controller behind a forwarded port.

A program of its own, with the standard library only: ur-rtde's constructors hold the interpreter's lock while they
wait for the controller, so no thread of the same process could carry their bytes. It ends when its input closes, with
the process that started it.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys

PORTS = (30004, 29999, 30003)
"""RTDE, dashboard, programs: where ur-rtde goes to."""


async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Carry bytes one way until one side closes."""
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
    writer.close()


async def join(near: tuple[asyncio.StreamReader, asyncio.StreamWriter], host: str, port: int) -> None:
    """Join one connection to the controller's port."""
    reader, writer = near
    try:
        far_reader, far_writer = await asyncio.open_connection(host, port)
    except OSError:
        writer.close()
        return
    for end in (writer, far_writer):
        end.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    await asyncio.gather(carry(reader, far_writer), carry(far_reader, writer))


async def relay(own: str, host: str, port: int) -> None:
    """Listen at own (an address of this computer) until standard input closes."""
    servers = []
    for fixed in PORTS:
        far = port + fixed - PORTS[0]
        servers.append(
            await asyncio.start_server(lambda r, w, far=far: join((r, w), host, far), own, fixed)  # type: ignore[misc]
        )
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    for server in servers:
        server.close()


def main() -> None:
    """Run as a program: own address, host, port."""
    own, host, port = sys.argv[1:4]
    try:
        asyncio.run(relay(own, host, int(port)))
    except OSError as error:
        sys.stdout.write(f"{error}\n")


if __name__ == "__main__":
    main()
