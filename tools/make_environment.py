"""Build the project's environment from the lock file, on a machine that may have no pip and no venv yet.

Usage: python3 tools/make_environment.py FOLDER
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 11)


def main(folder: str) -> int:
    """Create the environment in folder and install the locked packages and armsight itself."""
    if sys.version_info < OLDEST:
        have = ".".join(map(str, sys.version_info[:3]))
        print(f"armsight needs Python {OLDEST[0]}.{OLDEST[1]} or newer; this is {have}.", file=sys.stderr)
        print("Call `make PYTHON=/path/to/a/newer/python3`.", file=sys.stderr)
        return 2
    target = ROOT / folder
    python = target / "bin" / "python"
    if not python.exists() or run([str(python), "-m", "pip", "--version"], quiet=True) != 0:
        ensure_venv()
        shutil.rmtree(target, ignore_errors=True)
        if run([sys.executable, "-m", "venv", str(target)]) != 0:
            return 1
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    lock = str(ROOT / "requirements.lock")
    print("installing the locked packages (a few minutes the first time) ...", flush=True)
    if run([*pip, "--require-hashes", "-r", lock]) != 0:
        print("The packages could not be installed: see pip's message above.", file=sys.stderr)
        return 1
    return run([*pip, "--no-deps", "--no-build-isolation", "--editable", str(ROOT)])


def ensure_venv() -> None:
    """Make `python -m venv` work: Debian ships it apart, in the package python3-venv."""
    if run([sys.executable, "-c", "import ensurepip, venv"], quiet=True) == 0:
        return
    apt = shutil.which("apt-get")
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    if apt is None or (sudo and shutil.which("sudo") is None):
        print("Python's venv module is missing, so no environment can be built.", file=sys.stderr)
        print("Install it (Debian: `apt-get install python3-venv`) and call make again.", file=sys.stderr)
        raise SystemExit(1)
    print("installing python3-venv ...", flush=True)
    run([*sudo, apt, "update", "-q"], quiet=True)
    if run([*sudo, apt, "install", "-y", "-q", "python3-venv"]) != 0:
        raise SystemExit(1)


def run(command: list[str], *, quiet: bool = False) -> int:
    """Run a command and return its exit code."""
    out = subprocess.DEVNULL if quiet else None
    return subprocess.run(command, stdout=out, stderr=out, check=False).returncode


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1] if len(sys.argv) > 1 else ".venv"))
