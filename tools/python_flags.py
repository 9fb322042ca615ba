"""Make the page of flags: every flag of the command line with the Python name that does it. `make docs` builds it.

A flag is a parameter of the command's function where that has one of its name (api.commands.parameter); what is done
otherwise stands in OTHERWISE, and what is not done at all in WHY_NOT, with the reason. Exits 1 for a flag without
either, and for an entry that no flag needs any more; run as a program it prints the page.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping
from functools import reduce

import typer

import armsight
from armsight.cli.commands import app
from armsight.fields import Flag, marks
from armsight.ops.commands import commands, parameter

HEAD = """\
# Flags in Python

Every flag and argument of the command line with the Python name that does it, or the reason why there is none.
[From Python](python.md) says how the functions are used.
"""

FUNCTIONS: Mapping[str, tuple[str, ...]] = {
    "verify": ("verify", "supervise", "plan_verification", "propose_mastering_poses", "check_mastering"),
    "identify": ("identify_arm", "identify_arm_live"),
    "simulate": ("write_simulation", "simulate"),
    "record": ("record", "repair_recording"),
    "calibrate camera": ("calibrate_camera", "calibrate_noise"),
    "calibrate mirrors": ("calibrate_mirrors", "check_mirrors"),
    "convert camera": ("convert", "read_camera"),
    "convert rig": ("convert", "read_rig"),
    "convert table": ("convert", "read_table"),
    "convert arm": ("convert", "read_arm"),
    "kinematics ik": ("Arm.ik_many", "Arm.ik"),
    "path from-picks": ("paths.from_picks",),
    "history add": ("history.add",),
    "history list": ("history.runs",),
    **{f"history {name}": (f"history.{name}",) for name in ("show", "compare", "trend", "export")},
}
"""Commands that several functions do, or others than `commands` names."""

CAMERA = {
    "--exposure": "exposure_s",
    "--gain": "gain",
    "--focus": "focus",
    "--white-balance": "white_balance_k",
    "--trigger": "trigger",
    "--pixel-format": "pixel_format",
}
TABLE = {
    "--euler": "euler",
    "--columns": "columns",
    "--robot-format": "robot",
    "--units": "units",
    "--as-stated": "as_stated",
    "--pulses-per-degree": "pulses",
    "--body": "body",
}
ANYWHERE: Mapping[str, str] = {
    "--json": "results are objects: `to_dict()` gives what this prints",
    "--cell": "`history.add(result, cell)` of what is returned",
    "--history": "`history.add(history)`",
    "--check": "the exit code of a command; the result says what it is of",
    "--overwrite": "the folder `out` is written to as it is",
    **{flag: f"`camera_settings=CameraSettings({name}=...)`" for flag, name in CAMERA.items()},
    **{flag: f"`table=TableFormat({name}=...)`, here or in `read_table`" for flag, name in TABLE.items()},
    "--tip": "`read_arm(path, tip=...)`",
    "--base": "`read_arm(path, base=...)`",
    "--workers": "all cores are used",
    "--strict": "an image that cannot be read raises BadImage",
    "--every": "`images[::k]`",
    "--frames": "`images[:n]`",
    "-o": "`save(path)` of what is returned",
    "--set-zoom": "`camera_settings=CameraSettings(zoom=...)`",
}
"""What is done otherwise wherever a command's functions have no such parameter."""

OTHERWISE: Mapping[tuple[str, str], str] = {
    ("verify", "--plan"): "`plan_verification`",
    ("verify", "--side"): "`plan_verification(side_m)`",
    ("verify", "--speed"): "`plan_verification(speed_m_s)`",
    ("verify", "--live"): "`supervise`",
    ("verify", "--mastering"): "`propose_mastering_poses`, then `check_mastering`",
    ("record", "--repair"): "`repair_recording(path)`",
    ("calibrate mirrors", "--check"): "`check_mirrors`",
    ("convert arm", "-o"): "`convert(out)`, or `Arm.save(path)`: the ending decides",
    ("convert arm", "--rigid"): "`Arm.save(path)` of a `.urdf` or `.mjcf` writes it",
    ("convert rig", "--name"): "`read_rig(names=(...))`",
    ("convert handeye", "--base"): "`convert(names=FrameNames(base=...))`",
    ("convert handeye", "--flange"): "`convert(names=FrameNames(flange=...))`",
    ("convert handeye", "--camera-frame"): "`convert(names=FrameNames(camera=...))`",
    ("convert handeye", "--target"): "`convert(names=FrameNames(target=...))`",
    ("convert table", "--arm"): "`table=TableFormat(joints=...)`, the joints' names",
    ("kinematics fk", "--arm"): "`read_arm(path)`, `presets`",
    ("kinematics fk", "--joints"): "`Arm.fk(q)` of `read_joints(path)`",
    ("kinematics fk", "-o"): "`write_table(path, (t_s, T))`",
    ("kinematics ik", "--arm"): "`read_arm(path)`, `presets`",
    ("kinematics ik", "--poses"): "`Arm.ik_many(T_world_tool)` of `read_poses(path)`",
    ("kinematics ik", "-o"): "`write_table(path, columns)`",
    ("kinematics ik", "--all"): "each entry holds all solutions, nearest first",
    ("kinematics jacobian", "--arm"): "`read_arm(path)`, `presets`",
    ("kinematics jacobian", "--joints"): "`Arm.jacobian(q)` of `read_joints(path)`",
    ("kinematics jacobian", "-o"): "`write_table(path, columns)`",
    ("kinematics path", "--arm"): "`read_arm(path)`, `presets`",
    ("kinematics path", "--poses"): "`Arm.track(T_world_tool, t_s)` of `read_poses(path)`",
    ("kinematics path", "--start"): "`Arm.track(near)`",
    ("kinematics path", "-o"): "`write_joints(path, t_s, track.q)`",
    ("batch", "--each"): "`{path.stem: {...} for path in folder.glob(...)}`",
    ("batch", "--name"): "the keys of `batch(jobs)`",
}
"""What a flag of one command is in Python, where that is no parameter of its name."""

WHY_NOT: Mapping[str | tuple[str, str], str] = {
    "console": "a page for an operator: run the command",
    "report": "a browser's work on a file: run the command",
    "serve": "a process that outlives a script: run the command, and `connect` to it",
    "demo": "`simulate` and `measure` do it; the command is for a first look",
    "calibrate cell-plan": "a plan for one recording, which is a file: run the command",
    "robot run": "a motion from a file, once: run the command",
    **{
        ("verify", flag): "for the plant's systems, which want a process that stays: run the command"
        for flag in (
            *("--opcua", "--opcua-certificate", "--opcua-key", "--opcua-trusted", "--opcua-users", "--opcua-anonymous"),
            *("--mqtt", "--mqtt-ca", "--mqtt-user", "--mqtt-password-file", "--foxglove", "--stale-after"),
        )
    },
}
"""Commands and flags without a Python name, and why."""


def flags() -> Iterator[tuple[str, str]]:
    """Yield every command with each of its flags and arguments."""

    def walk(command: object, name: str) -> Iterator[tuple[str, str]]:
        inner = getattr(command, "commands", None)
        if inner is not None:
            for key, one in inner.items():
                yield from walk(one, f"{name} {key}".strip())
            return
        for one in command.params:  # type: ignore[attr-defined]  # a click command
            opts = [opt for opt in one.opts if opt.startswith("-")]
            yield name, opts[0] if opts else str(one.name)

    yield from walk(typer.main.get_command(app), "")


def functions(command: str) -> tuple[str, ...]:
    """Return the public names that do a command."""
    if command.startswith("path ") and command not in FUNCTIONS:
        return (f"paths.{command.removeprefix('path ')}",)
    return FUNCTIONS.get(command) or ((commands()[command],) if command in commands() else ())


def in_python(command: str, flag: str) -> str:
    """Return what a flag is in Python, or ''."""
    if command in WHY_NOT:
        return WHY_NOT[command]
    if (command, flag) in OTHERWISE:
        return OTHERWISE[command, flag]
    wanted = parameter(flag) if flag.startswith("-") else flag
    for name in functions(command):
        call = reduce(getattr, name.split("."), armsight)
        if (done := getattr(call, "action", None)) is not None:
            wanted = next((one for one in done.hints if _written(done.hints[one], one) == flag), wanted)
        if wanted in inspect.signature(call).parameters:  # type: ignore[arg-type]  # a function, or a method
            return f"`{name}({wanted})`"
    return ANYWHERE.get(flag) or WHY_NOT.get((command, flag), "")


def _written(hint: object, name: str) -> str:
    return next(iter(marks(hint, Flag)), Flag()).written(name)


def table() -> str:
    """Return the table. Raises SystemExit for a flag without a name or a reason, and for entries of no flag."""
    rows, missing = ["| command | flag | in Python |", "|---|---|---|"], []
    seen: set[object] = set()
    for command, flag in flags():
        told = in_python(command, flag)
        seen |= {command, (command, flag)}
        if not told:
            missing.append(f"{command} {flag}")
        rows.append(f"| {command} | `{flag}` | {told} |")
    unneeded = [str(key) for key in (*OTHERWISE, *WHY_NOT) if key not in seen]
    if missing or unneeded:
        sys.exit(f"no Python name or reason: {missing}; not needed: {unneeded}")
    return "\n".join(rows)


def page() -> str:
    """Return the page."""
    return f"{HEAD}\n{table()}\n"


if __name__ == "__main__":
    print(page())
