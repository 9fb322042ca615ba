"""Build the project's environment from a lock file, on a machine that may have no pip and no venv yet.

Usage: python3 tools/make_environment.py FOLDER LOCK

The packages are put in place by uv, which takes seconds where pip takes minutes; uv itself comes by pip, with the hash
that requirements.lock has of it. Where uv does not run or does not get through, pip installs the same packages.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 11)


def main(folder: str, lock: str) -> int:
    """Create the environment in folder and install the locked packages, armsight itself and its other distributions."""
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
    locked = ["--require-hashes", "-r", str(ROOT / lock)]
    print("installing the locked packages ...", flush=True)
    if not by_uv(pip, str(python), locked):
        print("pip installs them (a few minutes the first time) ...", flush=True)
        if run([*pip, *locked]) != 0:
            print("The packages could not be installed: see pip's message above.", file=sys.stderr)
            return 1
    ours = [word for folder in ("", "sim", "plant", "lab") for word in ("--editable", str(ROOT / folder))]
    return run([*pip, "--no-deps", "--no-build-isolation", *ours])


def by_uv(pip: list[str], python: str, locked: list[str]) -> bool:
    """Install the locked packages by uv, from where pip would take them; tell whether that worked."""
    pinned = "".join(entry for entry in entries(ROOT / "requirements.lock") if entry.startswith("uv=="))
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder) / "uv.lock"
        alone.write_text(pinned, encoding="utf-8")
        if run([*pip, "--require-hashes", "-r", str(alone)]) != 0:
            return False
    index = subprocess.run(
        [python, "-m", "pip", "config", "get", "global.index-url"], capture_output=True, text=True, check=False
    ).stdout.strip()
    environment = dict(os.environ)
    if index:
        environment.setdefault("UV_DEFAULT_INDEX", index)
    if "PIP_CERT" in environment:
        environment.setdefault("SSL_CERT_FILE", environment["PIP_CERT"])
    command = [python, "-m", "uv", "pip", "install", "--quiet", "--python", python, *locked]
    return run(command, environment=environment) == 0


def entries(lock: Path) -> list[str]:
    """Return the packages of a lock file, each with its hashes."""
    out: list[str] = []
    for line in lock.read_text(encoding="utf-8").splitlines(keepends=True):
        if line[0].isspace() and out:
            out[-1] += line
        else:
            out.append(line)
    return out


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


def run(command: list[str], *, quiet: bool = False, environment: dict[str, str] | None = None) -> int:
    """Run a command and return its exit code."""
    out = subprocess.DEVNULL if quiet else None
    return subprocess.run(command, stdout=out, stderr=out, env=environment, check=False).returncode


if __name__ == "__main__":
    raise SystemExit(main(*(sys.argv[1:] or [".venv", "requirements.lock"])))
