"""A command's flags are those of the requests that it takes, with the unit that people write."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer._coercion import build_runtime_param
from typer.testing import CliRunner

from armsight.cli.command import Group, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.commands import app
from armsight.cli.examples import every_command
from armsight.cli.flags import PartialRequest
from armsight.cli.lazy import _Conversion
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import Table
from armsight.store.interpret import TableFormat
from armsight.units import DEG, MM


@dataclasses.dataclass(frozen=True, kw_only=True)
class Asking:
    """A request with a field of every kind."""

    source: Annotated[Path, Doc("What."), Flag(positional=True, metavar="SRC")]
    wait_s: Annotated[float, Doc("How long."), Bounds(least=0.0)] = 1.5
    length_m: Annotated[float, Doc("How far."), Bounds(least=0.0), Flag(quantity="m")] = 0.6
    plate_m: Annotated[float, Doc("How thick."), Bounds(least=1.0 * MM), Flag(unit=MM)] = 3.0 * MM
    turn_rad: Annotated[float | None, Doc("How much."), Bounds(above=0.0, most=180.0 * DEG), Flag(unit=DEG)] = None
    speed_m_s: Annotated[float, Doc("How fast, m/s.")] = 0.1
    quiet: Annotated[bool, Doc("Say nothing.")] = False
    names: Annotated[tuple[str, ...], Doc("Which."), Flag("--named", read=lambda text: tuple(text.split(",")))] = ()
    table: Table = dataclasses.field(default_factory=TableFormat)
    untold: int = 7


@dataclasses.dataclass(frozen=True, kw_only=True)
class Other:
    """What the same command can be asked instead."""

    robot: Annotated[str, Doc("Which robot.")]
    wait_s: Annotated[float, Doc("Another text.")] = 2.5


def taken(*words: str) -> tuple[Any, Any, Any]:
    """Run a command of both requests; return its result, the first request, and the other as it was asked."""
    app = typer.Typer(cls=Group)
    seen: list[Any] = []

    @command(app)
    def work(face: CommandUI, job: Asking, other: PartialRequest[Other]) -> None:
        """Work."""
        seen.extend((job, other))
        if other.value("robot") == "none":
            raise UsageError("there is no such robot")

    @command(app)
    def rest(face: CommandUI) -> None:
        """Rest."""

    work.__annotations__ |= {"job": Asking, "other": PartialRequest[Other]}
    done = CliRunner().invoke(app, ["work", *words])
    return done, *(seen or (None, None))


def test_a_request_is_made_of_its_flags() -> None:
    done, job, other = taken("a.csv")
    assert done.exit_code == 0, done.output
    assert (job.source, job.wait_s, job.length_m, job.plate_m, job.untold) == (Path("a.csv"), 1.5, 0.6, 3.0 * MM, 7)
    assert (job.turn_rad, job.names, job.quiet, job.table.euler) == (None, (), False, "")
    assert other.given == () and other.missing == ("--robot",)
    words = ["a.csv", "--wait", "2", "--length", "200mm", "--plate-mm", "5", "--turn-deg", "180", "--speed-m-s", "0.3"]
    done, job, other = taken(*words, "--named", "a,b", "--quiet", "--euler", "zyx", "--robot", "sim")
    assert done.exit_code == 0, done.output
    assert (job.wait_s, job.length_m, job.plate_m, job.turn_rad) == (2.0, 0.2, 5.0 * MM, 180.0 * DEG)
    assert (job.speed_m_s, job.names, job.quiet, job.table.euler) == (0.3, ("a", "b"), True, "zyx")
    assert other.given == ("--robot", "--wait") and other.missing == ()
    assert (other.made().robot, other.made().wait_s, other.made(robot="x").robot) == ("sim", 2.0, "x")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "Missing argument 'SRC'"),
        (("a", "--wait", "-1"), "'--wait'"),
        (("a", "--speed-m-s", "nan"), "no finite number"),
        (("a", "--length", "600"), "write 600m or 600mm"),
        (("a", "--length", "3s"), "its units are m, mm"),
        (("a", "--plate-mm", "0.5"), "'--plate-mm'"),
        (("a", "--turn-deg", "0"), "--turn-deg is 0, which must be above 0 and at most 180"),
        (("a", "--turn-deg", "181"), "'--turn-deg'"),
        (("a", "--length=-10mm"), "--length is -0.01, which must be at least 0"),
        (("a", "--untold", "3"), "No such option"),
        (("a", "--robot", "none"), "there is no such robot"),
    ],
)
def test_what_cannot_be_is_refused(words: tuple[str, ...], told: str) -> None:
    done, *_ = taken(*words)
    assert done.exit_code == 2
    assert told in done.output


def test_the_help_tells_meaning_unit_and_default_and_the_first_text_of_a_flag_of_two() -> None:
    text = " ".join(taken("--help")[0].output.split())
    assert "--plate-mm" in text and "[default: 3.0]" in text and "M|MM" in text
    assert "How long." in text and "Another text." not in text and "untold" not in text


def outcome(conversion: Any, value: Any, param: Any) -> tuple[type, str]:
    try:
        made = conversion.coerce(value, param=param, ctx=None)
    except Exception as error:  # whatever it is, typer ends with the same
        return type(error), str(error)
    return type(made), repr(made)


def test_flags_are_read_as_typer_reads_them() -> None:
    """Whether or not pydantic is loaded for it."""
    given, read = ("", "x", "3", "-1.5", "2 mm", "camera:0", "likelihood", "-"), 0
    for name, _ in every_command(app):
        with typer.main.get_command(app).make_context("armsight", name.split()[:1], resilient_parsing=True) as ctx:
            found: Any = ctx.command
            for word in name.split():
                found = found.get_command(ctx, word)
        for one in found.params:
            many = one.multiple or one.nargs != 1
            for value in (None, *([text] if many else text for text in given)):
                expected = outcome(build_runtime_param(one.type_descriptor), value, one)
                assert outcome(one.get_runtime_param(), value, one) == expected, (name, one.name, value)
                read += isinstance(one.get_runtime_param(), _Conversion)
    assert read > 1000
