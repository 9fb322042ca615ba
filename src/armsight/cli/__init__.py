"""The command line: parse, call one app function, print."""

import atexit
import gc
import os
import sys
from pathlib import Path
from typing import TextIO

FIRST_OBJECTS, NEW_OBJECTS = 400_000, 10_000
"""Before the first look for garbage, and between two from then on: a start makes 200,000 to 300,000 objects that stay.
They are never looked through, which took a twentieth of a short command."""


def main() -> None:
    """Run the command line.

    Linear algebra keeps to one thread, where the user's own OPENBLAS_NUM_THREADS does not say otherwise: our matrices
    are small, and OpenBLAS's threads wait for each other by spinning, on a busy machine longer than they work.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is imported
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # it looks for them among all that is installed
    gc.set_threshold(FIRST_OBJECTS)
    gc.callbacks.append(_started)
    atexit.register(gc.freeze)  # Python looks twice more when it ends, which took a sixth of a measurement of ten pairs
    try:
        _open_streams()
        from armsight.cli.commands import app  # imported here so that `import armsight.cli` costs nothing

        app(prog_name="armsight")
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        sys.exit(130)
    except OSError as error:  # help on a full disk: what commands do is told by themselves
        discard(sys.stdout)
        sys.stderr.write(f"error: the output cannot be written ({error.strerror or error})\n")
        sys.exit(4)


def _started(_phase: str, _found: dict[str, int]) -> None:
    """Leave what there is out of the first look for garbage, which begins, and of all later ones."""
    gc.callbacks.remove(_started)
    gc.freeze()
    gc.set_threshold(NEW_OBJECTS)


def discard(stream: TextIO) -> None:
    """Let what waits for a stream that takes nothing go nowhere, or Python would try it again at its end."""
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


def _open_streams() -> None:
    """Open the standard streams that the caller closed: else the next file has their number, and what is printed."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            while os.open(os.devnull, os.O_RDWR) < number:
                pass
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
