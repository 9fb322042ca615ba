"""Follows the README and the guides as a reader does: every command of every block, in order, one folder for a page.

python tools/follow_guides.py [--page NAME ...] [-o FOLDER]

Blocks marked `text` hold output too; their commands are told by their first word. Servers, twins and live cameras run
until what follows them on the page is done, and are ended by Ctrl-C. STAND_INS says what stands for devices that are
not here, NOT_HERE what cannot run here and why. Exits 1 where a command fails.
"""

from __future__ import annotations

import argparse
import os
import pty
import re
import signal
import ssl
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WORDS = "armsight|python|pip|apt-get|make|openssl|cat|cd|cp|echo|export|ls|printf|sed"
COMMAND = re.compile(rf"(?:\$ )?(\(?(?:{WORDS}) .*)")
HEREDOC = re.compile(r"<<-?\s*['\"]?(\w+)")
PYTHON_BEGINS = re.compile(r"(?:import|from) \w")

SERVERS = re.compile(r"armsight (?:twin|console|serve)\b(?!.*--(?:add-token|make-certificate))")
LIVE = re.compile(r"armsight (?:measure|record|teach|verify)\b(?!.*--(?:frames|seconds)\b).*camera:", re.DOTALL)
"""Measures or records until Ctrl-C."""
LIVE_S = 40.0
"""A live run is ended after so long: a simulated camera in Python is slower than its pace, and begins late."""
LIMIT_S = 300.0
"""No command may take longer."""
ADDRESS = re.compile(r"(?:http|ws)(s?://[^\s/,;]+:\d+)")
DEVICE = re.compile(r"^(?:rsi|alter|egm|rtde):\S+$", re.MULTILINE)

CAMERAS: Mapping[str, str] = {
    "camera:0": "camera:sim:webcam-cell:left",
    "camera:1": "camera:sim:webcam-cell:right",
    "camera:2": "camera:sim:webcam-cell:right",
}
STAND_INS: Mapping[str, Mapping[str, str]] = {
    "docs/guide/live.md": CAMERAS,
    "docs/guide/record.md": CAMERAS,
    "docs/guide/console.md": {
        "--folder my-cell --left camera:0": "--folder my-cell --left camera:sim:webcam-cell:left",
        "camera:0": "camera:sim:pachidis2005-static:image",
        "camera:2": "camera:sim:webcam-cell:right",
        "rtde:192.168.1.10": "rtde:127.0.0.1",
    },
    "docs/guide/serve.md": {"rtde:192.168.1.20": "rtde:127.0.0.1"},
    "docs/guide/verify-live.md": {"--robot rtde:192.168.0.10": "--robot sim:webcam-cell --play", **CAMERAS},
    "docs/guide/servo.md": {
        "--robot rsi:49152 --arm arm.yaml": "--robot sim:pachidis2005-static",
        "--left camera:0 --right camera:1": "",
    },
    "docs/guide/teach.md": {
        "--robot rsi:49152 --arm arm.yaml --left camera:0 --right camera:1": "--robot sim:pachidis2005-static "
        "--hand circle",
        **CAMERAS,
    },
    "docs/guide/play.md": {
        "--robot rsi:49152 --arm arm.yaml --tip tip.yaml --path taught/path.csv": "--robot sim:webcam-cell "
        "--path path.csv --keep-rotation",
        "--left camera:0 --right camera:1": "",
    },
}
"""Page -> what it says of hardware -> what stands for it here, as the page itself tells its reader."""

NOT_HERE: Mapping[str, str] = {
    "make test": "the test suite, which itself runs every bash and python block of these pages",
    "apt-get install": "changes the system; the packages are named for the reader",
    "pip install": "changes the environment; what it adds is there after `make install` and `.ci/genicam`",
    "camera:aravis:192.168": "two GigE cameras that share a trigger; the emulated one answers as one",
    "--white-balance": "a camera that takes exposure, gain, focus and white balance; simulated ones take none",
    "--with gamepad": "a gamepad",
    "broker.example": "a broker of the plant",
    "/dev/ttyACM0": "an arm of bus servos",
    "--touch touch.csv": "an arm whose tip is put on spikes; simulated ones touch in tests/truth/touch_world.py",
    "--target-height": "an arm that cannot tilt its hand",
}
"""Part of a command -> what it needs that is not here."""

KEYS: Mapping[str, str] = {"--with keyboard": "y\nqqq...x", "--wait": "y\n.... "}
"""Part of a command -> the keys that its reader presses, one a second, once it has asked."""
QUESTION = b"[y/N]"


@dataclass(frozen=True, slots=True)
class Step:
    """One command of a page: line, from 1, in its file; kind: shell or python."""

    page: str
    line: int
    kind: str
    text: str

    @property
    def short(self) -> str:
        """The command in one line."""
        first = " ".join(re.sub(r"\\\n\s*", "", self.text).split("\n", 1)[0].split())
        return first if self.kind == "shell" else f"(python) {first}"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a step; what: run, failed or not here."""

    step: Step
    what: str
    told: str


def pages() -> list[Path]:
    """Return the pages of the site's table of contents that are files, in its order; the start page is the README."""

    def files(entry: object) -> Iterator[str]:
        if isinstance(entry, str):
            yield entry
        for child in entry if isinstance(entry, list) else entry.values() if isinstance(entry, dict) else ():
            yield from files(child)

    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    found = [ROOT / "README.md" if name == "index.md" else ROOT / "docs" / name for name in files(nav)]
    return [page for page in found if page.exists()]


def steps(page: Path) -> list[Step]:
    """Return the commands of a page in their order."""
    text = page.read_text(encoding="utf-8")
    name = str(page.relative_to(ROOT))
    found: list[Step] = []
    for block in FENCE.finditer(text):
        kind, content = block[1], block[2]
        line = text.count("\n", 0, block.start()) + 2
        if kind == "python" or (kind == "text" and PYTHON_BEGINS.match(content)):
            found.append(Step(page=name, line=line, kind="python", text=content))
        elif kind in {"bash", "text"}:
            found += shell_steps(name, line, content, everything=kind == "bash")
    return found


def shell_steps(page: str, line: int, content: str, *, everything: bool) -> Iterator[Step]:
    """Yield the commands of a block whose first line has this number; everything: no line of it is output."""
    lines = iter(enumerate(content.splitlines(), start=line))
    for number, row in lines:
        told = COMMAND.fullmatch(row)
        if not row.strip() or row.startswith("#") or not (told or everything):
            continue
        whole = [told[1] if told else row]
        end = HEREDOC.search(row)
        while whole[-1].endswith("\\") or (end and whole[-1] != end[1]):
            following = next(lines, None)
            if following is None:
                break
            whole.append(following[1])
        yield Step(page=page, line=number, kind="shell", text="\n".join(whole))


def recipe(target: str) -> str:
    """Return what `make target` does after the installation, as a command line."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.search(rf"^{re.escape(target)}:.*\n((?:\t.*\n)+)", text, re.MULTILINE)
    if found is None:
        return f"make {target}"
    return "\n".join(row.strip().lstrip("@").replace("$(BIN)/", "") for row in found[1].splitlines())


@dataclass
class Reader:
    """Follows one page in a folder of its own; services are what runs beside the page's commands."""

    folder: Path
    place: Path = field(init=False)
    services: list[tuple[Step, subprocess.Popen[bytes]]] = field(default_factory=list)
    log: Path = field(init=False)

    def __post_init__(self) -> None:
        """Begin in an empty folder, with the output beside it."""
        self.folder.mkdir(parents=True)
        self.place = self.folder
        self.log = self.folder.with_suffix(".log")

    def follow(self, step: Step) -> Outcome:
        """Do what a step says and return what became of it."""
        for part, why in NOT_HERE.items():
            if part in step.text:
                return Outcome(step, "not here", why)
        text = step.text
        for said, stands in STAND_INS.get(step.page, {}).items():
            text = text.replace(said, stands)
        began = time.monotonic()
        if step.kind == "shell" and SERVERS.match(text):
            trouble = self.serve(step, text)
        elif step.kind == "shell":
            trouble = self.run(step, text)
        else:
            script = self.folder / f"block_{step.line}.py"
            script.write_text(text, encoding="utf-8")
            trouble = self.run(step, f"python -W error {script}")
        took = f"{time.monotonic() - began:.1f} s"
        if text != step.text:
            took += ", with stand-ins"
        return Outcome(step, "failed" if trouble else "run", trouble or took)

    def run(self, step: Step, text: str) -> str:
        """Run a command to its end and return what went wrong, or nothing."""
        if text.startswith("make "):
            text = recipe(text.split()[1])
        live = LIVE.search(step.text) is not None
        after = self.folder.with_suffix(".place")
        begins = self.log.stat().st_size if self.log.exists() else 0
        with self.typed(text, lambda: QUESTION in self.log.read_bytes()[begins:]) as keyboard:
            running = self.begin(step, f"set -euo pipefail\n{text}\npwd > {after}", keyboard)
            try:
                code = _end_of(running, LIVE_S if live else LIMIT_S, interrupt=live)
            finally:
                if running.poll() is None:  # this tool itself is being stopped
                    os.killpg(running.pid, signal.SIGKILL)
        if after.exists():
            self.place = Path(after.read_text(encoding="utf-8").strip())
            after.unlink()
        if code is None:
            return f"not done after {LIMIT_S:g} s"
        return "" if code == 0 or (live and code == 130) else f"exit code {code}"

    def serve(self, step: Step, text: str) -> str:
        """Begin a server or a twin, in place of one of the same kind, and ask it once."""
        kind = text.split()[1]
        trouble = "".join(self.end(service) for service in list(self.services) if service[0].text.split()[1] == kind)
        begins = self.log.stat().st_size if self.log.exists() else 0
        running = self.begin(step, f"exec {text}", subprocess.DEVNULL)
        self.services.append((step, running))
        return "; ".join(filter(None, (trouble, self.asked(running, begins))))  # what follows needs it in any case

    def asked(self, running: subprocess.Popen[bytes], begins: int) -> str:
        """Return what is wrong with a server that has just been begun, or nothing once it answered."""
        until_s = time.monotonic() + LIMIT_S
        while time.monotonic() < until_s:
            told = self.log.read_bytes()[begins:].decode("utf-8", "replace")
            if running.poll() is not None:
                return f"ended by itself with exit code {running.returncode}"
            address = ADDRESS.search(told)
            if address:
                return answer_of("http" + address[1].replace("0.0.0.0", "127.0.0.1"))
            if DEVICE.search(told):
                return ""
            time.sleep(0.25)
        return "does not say where it serves"

    def end(self, service: tuple[Step, subprocess.Popen[bytes]]) -> str:
        """End a server as its reader does, by Ctrl-C, and return what went wrong."""
        self.services.remove(service)
        step, running = service
        if running.poll() is not None:
            return f"{step.short} had ended by itself with exit code {running.returncode}"
        code = _end_of(running, 0.0, interrupt=True)
        return "" if code in {0, 130} else f"{step.short} ended with exit code {code} on Ctrl-C"

    def finish(self) -> str:
        """End all that still runs and return what went wrong with it."""
        return "; ".join(trouble for service in list(self.services) if (trouble := self.end(service)))

    def begin(self, step: Step, script: str, keyboard: int) -> subprocess.Popen[bytes]:
        """Begin a script of bash, its output in the page's log."""
        with self.log.open("ab") as log:
            log.write(f"\n##### line {step.line}: {step.text}\n".encode())
            log.flush()
            return subprocess.Popen(
                ["bash", "-c", script],
                cwd=self.place,
                env=environment(),
                stdin=keyboard,
                stdout=log,
                stderr=log,
                start_new_session=True,
                preexec_fn=_hears_ctrl_c,
            )

    @contextmanager
    def typed(self, text: str, asked: Callable[[], bool]) -> Iterator[int]:
        """Give what a reader types: the keys of KEYS on a terminal once asked() holds, else `y` to all questions."""
        keys = "".join(keys for part, keys in KEYS.items() if part in text)
        if not keys:
            answers = self.folder.with_suffix(".answers")
            answers.write_text("y\n" * 20, encoding="utf-8")
            with answers.open("rb") as opened:
                yield opened.fileno()
            return
        reader, terminal = pty.openpty()
        done = threading.Event()
        typist = threading.Thread(target=_type, args=(reader, keys, asked, done))
        typist.start()
        try:
            yield terminal
        finally:
            done.set()
            typist.join()
            os.close(terminal)
            os.close(reader)


def _type(keyboard: int, keys: str, asked: Callable[[], bool], done: threading.Event) -> None:
    """Press one key after the other, the first once the command has asked, and all again until it ends."""
    while not asked():
        if done.wait(0.25):
            return
    for key in cycle(keys):
        os.write(keyboard, key.encode())
        if done.wait(1.0):
            return


def _hears_ctrl_c() -> None:
    """For a new process: what a shell began in the background has Ctrl-C ignored, and so has all that it begins."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _end_of(running: subprocess.Popen[bytes], limit_s: float, *, interrupt: bool) -> int | None:
    """Return a command's exit code; after the limit it gets Ctrl-C where that is its end; None where it did not end."""
    try:
        return running.wait(limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(running.pid, signal.SIGINT)
    try:
        code = running.wait(60.0)
    except subprocess.TimeoutExpired:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        return None
    return code if interrupt else None


def environment() -> dict[str, str]:
    """Return the environment with this Python's commands first."""
    here = str(Path(sys.executable).parent)
    return {**os.environ, "PATH": os.pathsep.join([here, os.environ.get("PATH", "")])}


def answer_of(address: str) -> str:
    """Ask a server once over HTTP and return what is wrong; that it wants a token is an answer."""
    unproved = ssl.create_default_context()
    unproved.check_hostname, unproved.verify_mode = False, ssl.CERT_NONE
    try:
        with urllib.request.urlopen(f"{address}/", timeout=20.0, context=unproved) as answer:
            return "" if answer.status == 200 else f"{address} answers {answer.status}"
    except urllib.error.HTTPError as answer:
        return "" if answer.code in {401, 404} else f"{address} answers {answer.code}"
    except OSError as error:
        return f"{address} does not answer: {error}"


def follow(page: Path, folder: Path) -> Iterator[Outcome]:
    """Follow one page and yield what became of each command."""
    reader = Reader(folder / str(page.relative_to(ROOT).with_suffix("")).replace("/", "_"))
    last = None
    try:
        for last in steps(page):
            yield reader.follow(last)
    finally:
        trouble = reader.finish()
    if trouble and last is not None:
        yield Outcome(last, "failed", trouble)


def table(outcomes: Sequence[Outcome]) -> str:
    """Return how many commands of each page ran, and all that did not with the reason."""
    rows = ["| page | commands | run | failed | not here |", "|---|---|---|---|---|"]
    for page in [*dict.fromkeys(outcome.step.page for outcome in outcomes), "all"]:
        own = [outcome for outcome in outcomes if page in {outcome.step.page, "all"}]
        counts = [sum(outcome.what == what for outcome in own) for what in ("run", "failed", "not here")]
        rows.append(f"| {page} | {len(own)} | " + " | ".join(str(count) for count in counts) + " |")
    left = [outcome for outcome in outcomes if outcome.what != "run"]
    return "\n".join([*rows, *(line_of(outcome) for outcome in left)])


def line_of(outcome: Outcome) -> str:
    """Return an outcome as one line: page, line, command, what became of it."""
    step = outcome.step
    return f"{step.page}:{step.line}: {step.short[:120]}: {outcome.what} ({outcome.told})"


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow the pages, print each command as it is done, then the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", action="append", help="only pages whose path holds this; may be repeated")
    parser.add_argument("-o", "--out", type=Path, help="where the pages' folders and logs go; else they are not kept")
    parser.add_argument("--list", action="store_true", help="name the commands and run none")
    options = parser.parse_args(arguments)
    chosen = [page for page in pages() if not options.page or any(part in str(page) for part in options.page)]
    if options.list:
        for step in (step for page in chosen for step in steps(page)):
            print(f"{step.page}:{step.line}: {step.short}")
        return 0
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # where this began in the background its children would ignore Ctrl-C
    outcomes = []
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(tempfile.mkdtemp(dir=options.out)) if options.out else Path(kept)
        for page in chosen:
            for outcome in follow(page, folder):
                outcomes.append(outcome)
                print(line_of(outcome), flush=True)
        print(f"\n{table(outcomes)}")
        if options.out:
            print(f"What the commands wrote and printed is in {folder}")
    return int(any(outcome.what == "failed" for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
