"""Every kind of file that a command converts or takes, joined of the tables that each reader keeps, and which of them
an unknown file is nearest to.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from armsight.errors import BadFile
from armsight.store.atomic import read_bytes
from armsight.store.foreign import FORMATS
from armsight.store.interpret import ROBOT_FORMATS
from armsight.store.interpret.trackers.formats import TRACKERS
from armsight.store.programs.kinds import PROGRAMS
from armsight.store.yamls import MAX_BYTES

CAMERAS, TABLES, ARMS = "convert camera, convert rig", "convert table", "convert arm"
READ, WRITTEN, BOTH = "read", "written", "read and written"
HEAD = 4000
"""Characters in which a file says what it is."""
MOST = 3
"""Kinds that an unknown file is answered with."""
SURE = 2
"""Signs from which on a file that cannot be read to its end is called one of a kind."""
UNREADABLE = "Correct it there"
"""The cure of a file that breaks its syntax."""
HINTS = {"Camera-system parameters": "This is what Kalibr prints for people: give its camchain.yaml. "}
"""Beginnings of files that stand beside those that are wanted."""
CELL = r"[^\n,;\t]*[,;\t]"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileKind:
    """A kind of file: the commands that take it, its name for --to, its use (read or written), title, what it needs.

    signs: patterns of what stands in its first lines and in few others.
    """

    commands: str
    name: str
    use: str
    title: str
    needs: str = ""
    signs: tuple[str, ...] = ()


OTHERS = (
    FileKind(
        commands=TABLES,
        name="table",
        use=BOTH,
        title="CSV, TXT, JSON, YAML, MATLAB .mat, or a folder with a file a pose: joints, poses, points, pairs",
        needs="--units, --euler, --columns where it leaves them open; also taken by verify, identify, calibrate",
        signs=(rf"\A\ufeff?{CELL}{CELL}", rf"^[ \d.eE+-]*\d{CELL}[ \d.eE+-]*\d{CELL}", r"^Format Version,"),
    ),
    FileKind(
        commands=TABLES,
        name="robot",
        use=READ,
        title=f"tables of poses as makers of robots write them: {', '.join(ROBOT_FORMATS)}",
        needs="--robot-format",
    ),
    FileKind(commands="convert poses", name="tum", use=BOTH, title="TUM poses (.tum, .txt), as evo reads them"),
    FileKind(commands=ARMS, name="armsight", use=BOTH, title="arm.yaml", needs="--convention", signs=("armsight/arm",)),
    FileKind(
        commands=ARMS,
        name="urdf",
        use=BOTH,
        title="URDF (.urdf)",
        needs="--tip and --base where it holds more than the arm",
        signs=(r"<robot\b", "<joint", "<link"),
    ),
    FileKind(commands=ARMS, name="mjcf", use=WRITTEN, title="MJCF for MuJoCo (.mjcf)"),
    FileKind(
        commands=ARMS,
        name="factory",
        use=READ,
        title="a Universal Robot's calibration.conf or driver's kinematics YAML, an xArm's YAML, a Techman's tables",
        needs="--nominal of a .conf",
        signs=(r"^\[mounting\]", r"^delta_theta\s*=", r"^kinematics:", r"\b(?:DHTable|DeltaDH)\s*="),
    ),
    FileKind(
        commands=ARMS,
        name="controller",
        use=WRITTEN,
        title="what is typed into its controller: --to kuka, ur, fanuc, abb, staubli",
        needs="--nominal",
    ),
    FileKind(commands="convert handeye", name="easy_handeye", use=WRITTEN, title="easy_handeye, easy_handeye2"),
    FileKind(commands="convert handeye", name="tf", use=WRITTEN, title="a launch file of ROS 2 with the transforms"),
    FileKind(commands="convert recording", name="mcap", use=READ, title="a recording of armsight or ROS (.mcap)"),
    FileKind(commands="convert recording", name="rosbag2", use=WRITTEN, title="a bag of ROS 2"),
)


def file_kinds() -> Iterator[FileKind]:
    """Yield every kind, those of one command together."""
    ours = ("format: armsight/(camera|rig)",)
    yield FileKind(commands=CAMERAS, name="armsight", use=BOTH, title="camera.yaml, rig.yaml", signs=ours)
    for name, one in FORMATS.items():
        use = (BOTH if one.write_rig else READ) if one.rig else WRITTEN
        yield FileKind(commands=CAMERAS, name=name, use=use, title=one.title, needs=one.needs, signs=one.signs)
    for name, tracker in TRACKERS.items():
        yield FileKind(commands=TABLES, name=name, use=READ, title=tracker.title, needs=tracker.needs)
    for name, program in PROGRAMS.items():
        use = BOTH if program.written else READ
        yield FileKind(
            commands=TABLES, name=name, use=use, title=program.title, needs=program.needs, signs=(program.told,)
        )
    yield from OTHERS


def listing() -> Iterator[str]:
    """Yield the lines of convert --list."""
    commands = ""
    for kind in file_kinds():
        if kind.commands != commands:
            commands = kind.commands
            yield f"armsight {commands.replace(', ', ', armsight ')}"
        yield f"  {kind.name:13} {kind.use:16} {kind.title}" + (f"; {kind.needs}" if kind.needs else "")


def unknown(path: Path, command: str, error: BadFile | None = None) -> BadFile:
    """Return why a file is of no kind that a command takes: what its first lines are nearest to, and what takes that.

    error: where reading it ended, which is said of a file that does look like one that the command takes.
    """
    head = _head(path)
    count, kinds = _nearest(head)
    here = [kind for kind in kinds if command in kind.commands]
    if here and error is not None and count >= SURE:
        if error.cure not in ("", UNREADABLE):
            return error
        why = error.cause.removeprefix(str(path)).lstrip(":, ")
        return BadFile(
            f"{path} looks like {here[0].title}, and is damaged or cut off: {why}",
            cure="Copy it anew from the program or device that wrote it, or correct it there",
        )
    first = " ".join(head.split())[:60]
    said = "; ".join(f"{kind.title} (armsight {kind.commands.split(', ')[-1]})" for kind in kinds)
    cure = next((hint for begins, hint in HINTS.items() if first.startswith(begins)), "")
    cure += f"Its first lines are nearest to {said}. " if said else ""
    return BadFile(
        f"{path} begins with {first!r}, as no file does that armsight {command} takes",
        consequence="It cannot be converted",
        cure=f"{cure}All kinds are in armsight convert --list",
    )


@contextmanager
def pointed_elsewhere(path: Path, command: str) -> Iterator[None]:
    """Answer a file that a command cannot read, and that looks like another's, with that command."""
    try:
        yield
    except BadFile as error:
        _, kinds = _nearest(_head(path)) if path.is_file() else (0, [])
        if kinds and not any(command in kind.commands for kind in kinds):
            raise unknown(path, command) from error
        raise


def _head(path: Path) -> str:
    return read_bytes(path, limit=MAX_BYTES)[: 4 * HEAD].decode("utf-8", errors="replace")[:HEAD]


def _nearest(head: str) -> tuple[int, list[FileKind]]:
    """Return how many signs of a kind stand in a file's first lines, at most, and the kinds that so many stand of."""
    found = [(sum(re.search(sign, head, re.M) is not None for sign in kind.signs), kind) for kind in file_kinds()]
    most = max(count for count, _ in found)
    return most, [kind for count, kind in found if count == most][:MOST] if most else []
