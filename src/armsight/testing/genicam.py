"""A GigE Vision camera on loopback that Aravis plays: its own fake camera, or one that shows pictures of yours.

Run as a program (python -m armsight.testing.genicam PICTURE...) it is the second one.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import fcntl
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.drivers.aravis import load_aravis
from armsight.drivers.images import read_image
from armsight.errors import DeviceNotFound

ADDRESS = "127.0.0.1"
"""Where it answers: the only loopback address that Aravis's fake camera can take, so there is one at a time."""

PROGRAM = "arv-fake-gv-camera-0.8"
LIBRARY = "aravis-0.8"
WIDTH, HEIGHT = 0x100, 0x104
"""Registers of the fake camera."""
ATTEMPTS = 100
"""Connections tried until it answers, each of a tenth of a second or more."""


def missing() -> str:
    """Return what is missing on this machine to play a camera and to read it; '' where nothing is."""
    try:
        load_aravis()
    except DeviceNotFound as error:
        return error.cause
    if shutil.which(PROGRAM) is None:
        return f"{PROGRAM} (Debian: aravis-tools) is not installed"
    return "" if ctypes.util.find_library(LIBRARY) else f"the library {LIBRARY} is not installed"


@contextmanager
def fake_genicam_camera(pictures: Sequence[Path] = ()) -> Iterator[subprocess.Popen[bytes]]:
    """Play a camera at ADDRESS until the block ends; killing the process given is pulling its plug.

    pictures: grey image files of one size that it shows in turn, over and over; none: Aravis's test pattern, Mono8,
    512x512. Waits while another test of this machine plays one. Raises DeviceNotFound where it does not answer.
    """
    command = [PROGRAM, "-i", ADDRESS]
    if pictures:
        command = [sys.executable, "-m", "armsight.testing.genicam", *map(str, pictures)]
    with Path(tempfile.gettempdir(), "armsight-fake-genicam.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            try:
                _await_answer(process)
                yield process
            finally:
                process.kill()


def _await_answer(process: subprocess.Popen[bytes]) -> None:
    api = load_aravis()
    for _ in range(ATTEMPTS):
        if process.poll() is not None:
            break
        try:
            api.Camera.new(ADDRESS)
        except Exception:  # GLib's own error, whose class is known only once the binding is loaded
            continue
        return
    raise DeviceNotFound(f"the fake camera does not answer at {ADDRESS}", cure="End other programs that play one")


def show(pictures: Sequence[NDArray[np.uint8]]) -> None:
    """Play the camera that shows grey pictures of one size in turn, until the process is killed."""
    library = ctypes.CDLL(ctypes.util.find_library(LIBRARY))
    for name in ("arv_gv_fake_camera_new", "arv_gv_fake_camera_get_fake_camera", "arv_buffer_get_data"):
        getattr(library, name).restype = ctypes.c_void_p
    server = ctypes.c_void_p(library.arv_gv_fake_camera_new(ADDRESS.encode(), b"GV01"))
    camera = ctypes.c_void_p(library.arv_gv_fake_camera_get_fake_camera(server))
    height, width = pictures[0].shape
    for register, value in ((WIDTH, width), (HEIGHT, height)):
        library.arv_fake_camera_write_register(camera, ctypes.c_uint32(register), ctypes.c_uint32(value))
    following = cycle([picture.tobytes() for picture in pictures])

    def fill(buffer: int, _data: Any, _exposure_us: int, _gain: int, _format: int) -> None:
        size = ctypes.c_size_t()  # stays 0 until the buffer is sent; it holds an image of the registers' size
        buffer_data = library.arv_buffer_get_data(ctypes.c_void_p(buffer), ctypes.byref(size))
        picture = next(following)
        ctypes.memmove(buffer_data, picture, len(picture))

    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
    callback = kind(fill)
    library.arv_fake_camera_set_fill_pattern(camera, callback, None)
    parent = os.getppid()
    while os.getppid() == parent:  # a test that is killed leaves no camera behind
        time.sleep(0.1)


if __name__ == "__main__":
    show([read_image(Path(name)) for name in sys.argv[1:]])
