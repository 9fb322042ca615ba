"""Run the bridge, or print its HAL lines."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent


def main() -> None:
    """Do what the command line says."""
    sys.path.insert(0, str(FOLDER.parent))
    from linuxcnc_bridge.ini import PORT, hal_lines  # type: ignore[import-not-found]  # wherever this folder was copied
    from linuxcnc_bridge.link import run  # type: ignore[import-not-found]

    parser = argparse.ArgumentParser(prog="linuxcnc_bridge", description="LinuxCNC's side of armsight's link")
    parser.add_argument("what", choices=("hal", "run"))
    parser.add_argument("ini", type=Path)
    parser.add_argument("--bind", default="127.0.0.1", help="address to listen at; without it this computer alone")
    parser.add_argument("--port", type=int, default=PORT)
    args = parser.parse_args()
    if args.what == "run":
        run(args.ini, args.bind, args.port)
    else:
        sys.stdout.write(hal_lines(args.ini.resolve(), f"{FOLDER}", args.bind, args.port))


if __name__ == "__main__":
    main()
