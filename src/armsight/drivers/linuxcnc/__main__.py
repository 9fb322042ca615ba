"""Put the bridge and its HAL file beside an INI file: python -m armsight.drivers.linuxcnc INI [--bind A] [--port N]."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from armsight.drivers import linuxcnc_bridge

BRIDGE = Path(linuxcnc_bridge.__file__).parent
"""The folder to copy to the computer that LinuxCNC runs on."""

HAL_FILE = "armsight.hal"


def set_up(ini: Path, *, bind: str, port: int) -> Path:
    """Copy the bridge beside an INI file, write the HAL file that starts it, and return that file."""
    from armsight.drivers.linuxcnc_bridge.ini import hal_lines

    there = ini.resolve().parent / BRIDGE.name
    shutil.copytree(BRIDGE, there, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    hal = there.parent / HAL_FILE
    hal.write_text(hal_lines(ini.resolve(), str(there), bind, port), encoding="utf-8")
    return hal


def main() -> None:
    """Do what the command line says."""
    import argparse

    from armsight.drivers.linuxcnc_bridge.ini import PORT

    parser = argparse.ArgumentParser(prog="python -m armsight.drivers.linuxcnc", description=__doc__)
    parser.add_argument("ini", type=Path)
    parser.add_argument("--bind", default="127.0.0.1", help="address of that computer that armsight sends to")
    parser.add_argument("--port", type=int, default=PORT)
    args = parser.parse_args()
    if not args.ini.is_file():
        parser.error(f"{args.ini} is no file: give the INI file of the machine")
    hal = set_up(args.ini, bind=args.bind, port=args.port)
    sys.stdout.write(
        f"{hal} and {hal.parent / BRIDGE.name} are there. Add to [HAL] of {args.ini}, behind its other files:\n"
        f"HALFILE = {hal.name}\nHALUI = halui\n"
    )


if __name__ == "__main__":
    main()
