"""Options that several commands share."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand

from armsight.errors import UsageError
from armsight.units import read_value

SRC = (
    "a folder of images, a quoted 'pattern*.png', a video, a recording.mcap, bag:FILE:/topic, or camera:0, "
    "camera:aravis:NAME"
)
BOARD = (
    "checkerboard:9x6:0.025 (inner corners, square in m), circles:, acircles:, "
    "charuco:8x5:0.04:0.03:DICT_4X4_50, aprilgrid:6x6:0.088:0.3 or a file: target.yaml, Kalibr's aprilgrid.yaml"
)
KNOWN_ARM = "arm.yaml, .urdf or a known arm's name such as ur5e"

AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")]
Board: TypeAlias = Annotated[str, typer.Option("--board", metavar="BOARD", help=BOARD)]
OutFolder: TypeAlias = Annotated[Path, typer.Option("-o", "--out", metavar="FOLDER", help="Where the results go.")]
Seed: TypeAlias = Annotated[int, typer.Option("--seed", help="The same seed gives the same frames.", min=0)]
Every: TypeAlias = Annotated[int, typer.Option("--every", min=1, help="Use every n-th frame, for videos.")]
Limit: TypeAlias = Annotated[int | None, typer.Option("--frames", min=1, help="Stop after so many.")]
Fps: TypeAlias = Annotated[
    float | None, typer.Option("--fps", min=1e-6, help="Frames a second, where none brings its time. [default: 30]")
]
Threshold: TypeAlias = Annotated[
    float | None,
    typer.Option("--threshold", min=0.0, max=255.0, help="Grey level that counts as light. [default: automatic]"),
]
Inverted: TypeAlias = Annotated[bool, typer.Option("--inverted", help="Look for dark spots on a bright ground.")]
Workers: TypeAlias = Annotated[
    int | None, typer.Option("--workers", min=1, help="Threads that read and search images. [default: all cores]")
]
Bits: TypeAlias = Annotated[
    int | None, typer.Option("--bits", metavar="N", help="Bits that carry the light in 16-bit image files, such as 12.")
]
Strict: TypeAlias = Annotated[
    bool, typer.Option("--strict", help="Stop at an image file that cannot be read, in place of going on without it.")
]
Tip: TypeAlias = Annotated[
    str | None, typer.Option("--tip", metavar="LINK", help="Of a URDF that branches: the last link of the arm.")
]
Base: TypeAlias = Annotated[
    str | None, typer.Option("--base", metavar="LINK", help="Of a URDF: the arm's base link. [default: the root]")
]


MOST = {"m": 20.0, "m/s": 20.0, "rad or m": 2.0 * math.pi}
"""Largest number without a unit: cells are metres wide, joints turn once. What is beyond was meant in mm or degrees."""
UNITS_OF = {"m": ("m", "mm"), "m/s": ("m/s", "mm/s"), "rad or m": ("rad", "deg", "m", "mm")}


class Quantity:
    """Reads an option in a unit, SI where none is written behind it; refuses what another was meant by."""

    def __init__(self, unit: str, least: float = -math.inf) -> None:
        self._unit, self._least = unit, least
        self.__name__ = unit

    def __call__(self, given: str | float) -> float:
        """Return the number in SI; a default is one already. Raises typer.BadParameter, with the ways to write it."""
        text = str(given)
        units = UNITS_OF[self._unit]
        try:
            value, unit = read_value(text)
        except ValueError:
            raise typer.BadParameter(
                f"{text!r} is no number of {self._unit}; its units are {', '.join(units)}"
            ) from None
        if unit and unit not in units:
            raise typer.BadParameter(f"{text!r} is not in {' or '.join(units)}")
        if not unit and abs(value) > MOST[self._unit]:
            raise typer.BadParameter(
                f"{text} {self._unit} cannot be meant: write {' or '.join(text + unit for unit in units)}"
            )
        if not value >= self._least:
            raise typer.BadParameter(f"{text} is less than {self._least:g} {self._unit}")
        return value


def quantity(unit: str, least: float = -math.inf) -> dict[str, Any]:
    """Return what an option is given that takes a length (m), a speed (m/s) or a joint's way (rad or m)."""
    return {"parser": Quantity(unit, least), "metavar": "|".join(UNITS_OF[unit]).upper()}


class FiniteCommand(TyperCommand):
    """A command whose numbers are finite: nan is below no limit and above none, and passes every range."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # typer's own copy of click has the type
        """Return what is left of the arguments. Raises typer.BadParameter for nan and inf."""
        left = super().parse_args(ctx, args)
        parameters: list[Any] = self.get_params(ctx)
        for one in parameters:
            given = ctx.params.get(one.name or "")
            for value in given if isinstance(given, list | tuple) else [given]:
                if isinstance(value, float) and not math.isfinite(value):
                    raise typer.BadParameter(f"{value} is no finite number", ctx=ctx, param=one)
        return left


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Return (width, height) of '640x480'. Raises UsageError."""
    if text is None:
        return None
    match = re.fullmatch(r"([1-9][0-9]{0,5})[xX]([1-9][0-9]{0,5})", text)
    if match is None:
        raise UsageError(f"the size {text!r} is not WIDTHxHEIGHT", cure="Write for instance 640x480")
    return int(match[1]), int(match[2])
