"""armsight compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import AsJson, quantity
from armsight.cli.tables import figure
from armsight.units import DEG, MM


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A result: a folder of measure or verify, or a calibration.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another of the same kind.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FOLDER", help="Write compare.json and report.html here.")
    ] = None,
    distance: Annotated[
        float | None,
        typer.Option(help="Distance at which rigs are compared. [default: 8 baselines]", **quantity("m", 0.01)),
    ] = None,
    json: AsJson = False,
) -> None:
    """Tell whether two results of one kind agree within their uncertainty, and what the difference comes to."""
    with CommandUI(as_json=json) as face:
        from armsight.app.compare.run import CompareJob
        from armsight.app.compare.run import compare as run

        done = run(CompareJob(a=a, b=b, out=out, distance_m=distance))
        shown = {"m": (MM, "mm"), "rad": (DEG, "deg"), "m/s": (MM, "mm/s"), "1": (1.0, "")}
        rows = []
        for one in done.parameters:
            factor, unit = shown.get(one.unit, (1.0, one.unit))
            std = None if one.std is None else one.std / factor
            sigmas = "-" if one.sigmas is None else f"{one.sigmas:+.1f}"
            name = one.name.replace("_rad", "").replace("_m_s", "").replace("_m", "")
            rows.append(
                [name, figure(one.a / factor, 6), figure(one.difference / factor), figure(std, 2), sigmas, unit]
            )
        face.say(done.verdict)
        face.table(f"B less A, {done.kind}", ["", "A", "B less A", "+-", "sigma", "unit"], rows)
        for effect in done.effects:
            factor, unit = shown.get(effect.unit, (1.0, effect.unit))
            face.say(f"  {effect.name}: {figure(effect.value / factor)} {unit}".rstrip())
        for text in done.notes:
            face.say(f"Note: {text}")
        if done.report is not None:
            face.say(f"Results: {out}; open {done.report}")
        face.result(done)
