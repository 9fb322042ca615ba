"""The options of tables that are not ours, the same for every command that reads tables."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

if TYPE_CHECKING:
    from armsight.cli.command_ui import CommandUI
    from armsight.store.interpret import TableFormat

PANEL = "Tables that are not armsight's own (see the guide: tables)"


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOptions:
    """What was given on the command line; None where nothing was."""

    euler: str | None = None
    columns: str | None = None
    robot_format: str | None = None
    units: str | None = None
    as_stated: bool = False

    def format(self, face: CommandUI) -> TableFormat:
        """Return them as the readers take them; what was understood is said to the person."""
        from armsight.store.interpret import TableFormat

        return TableFormat(
            euler=self.euler or "",
            columns=self.columns or "",
            robot=self.robot_format or "",
            units=self.units or "",
            as_stated=self.as_stated,
            tell=face.say,
        )


NOTHING_STATED = TableOptions()


def _option(*flags: str, metavar: str | None = None, text: str) -> Any:
    return typer.Option(*flags, metavar=metavar, help=text, rich_help_panel=PANEL)


OPTIONS: dict[str, tuple[Any, Any]] = {
    "euler": (
        None,
        Annotated[
            str | None, _option("--euler", metavar="ORDER", text="Order of Euler angles: xyz-fixed, zyx, zyz ...")
        ],
    ),
    "columns": (
        None,
        Annotated[
            str | None,
            _option("--columns", metavar="NAMES", text="Names where no header is: q1..q6_deg,xyz_mm,quat_wxyz,-"),
        ],
    ),
    "robot_format": (
        None,
        Annotated[
            str | None,
            _option(
                "--robot-format",
                metavar="MAKER",
                text="The robot's poses and joints are written as by abb, fanuc, kuka, staubli, ur, yaskawa ...",
            ),
        ],
    ),
    "units": (
        None,
        Annotated[str | None, _option("--units", metavar="UNITS", text="Where the header states none: mm,deg")],
    ),
    "as_stated": (
        False,
        Annotated[
            bool, _option("--as-stated", text="Take units and orders as stated though the numbers look otherwise.")
        ],
    ),
}


def takes_tables(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of tables; it gets them as one argument, table_options, its last."""
    own = inspect.signature(command)
    kinds = get_type_hints(command, include_extras=True)
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (default, kind) in OPTIONS.items()
    ]
    kept = [
        one.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kinds[name])
        for name, one in own.parameters.items()
        if name != "table_options"
    ]

    @functools.wraps(command)
    def run(**given: Any) -> None:
        options = TableOptions(**{name: given.pop(name) for name in OPTIONS})
        command(**given, table_options=options)

    run.__signature__ = own.replace(parameters=kept + added)  # type: ignore[attr-defined]  # a wrapper's own parameters
    run.__annotations__ = {one.name: one.annotation for one in kept + added}
    return run
