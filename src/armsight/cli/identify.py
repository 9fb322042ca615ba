"""armsight identify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli.face import Face
from armsight.cli.options import SRC, AsJson
from armsight.cli.tables import figure

MM, DEG = 1e3, 57.29577951308232


def identify(
    out: Annotated[Path, typer.Option("-o", "--out", help="arm.yaml to write.")],
    sweep: Annotated[
        Path | None, typer.Option(help="sweep.csv: joint,q1..qn and places (x_m,y_m,z_m), pixels, or both.")
    ] = None,
    target: Annotated[
        Path | None, typer.Option(help="Instead of a sweep: target.yaml of the beacon, with frames.")
    ] = None,
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    joints: Annotated[Path | None, typer.Option(help="sweep_joints.csv: frame,joint,q1..qn of those frames.")] = None,
    rig: Annotated[Path | None, typer.Option(help="rig.yaml: fit pixels instead of places.")] = None,
    world: Annotated[Path | None, typer.Option(help="world.yaml: where the rig stands to the arm's base.")] = None,
    method: Annotated[str, typer.Option(help="ml (maximum likelihood) or paper (triples, Chauvenet, means).")] = "ml",
    increments: Annotated[
        str, typer.Option(help="known: commanded values are exact; order: only their order.")
    ] = "known",
    sigma: Annotated[
        float | None,
        typer.Option(min=1e-9, help="Noise: px of a pixel with --rig, else m of a place; else it is found."),
    ] = None,
    nominal: Annotated[
        str | None, typer.Option(metavar="ARM", help="arm.yaml, .urdf or preset to put beside, in the report.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Find an unknown arm's joints, axes and table from a beacon's places while one joint after the other moves."""
    with Face(as_json=json) as face:
        from armsight.app.identify import IdentifyJob, run_identify

        job = IdentifyJob(
            out=out,
            sweep=sweep,
            target=target,
            left=left,
            right=right,
            joints=joints,
            rig=rig,
            world=world,
            method=method,
            increments=increments,
            sigma=sigma,
            nominal=nominal,
        )
        content = run_identify(job, face.progress("identifying"))
        rows = []
        for joint in content["joints"]:
            cells = [f"{joint['index']}", joint["type"]]
            for key, factor in (("a_m", MM), ("alpha_rad", DEG), ("d_m", MM), ("theta_rad", DEG)):
                doubt = joint["std"][key]
                shown = figure(factor * joint[key], 5)
                cells.append(shown if doubt is None else f"{shown} +- {figure(factor * doubt, 2)}")
            rows.append([*cells, figure(MM * joint["residual_rms_m"])])
        face.table("Arm, mm and degrees", ["joint", "type", "a", "alpha", "d", "theta", "residual"], rows)
        face.say("Entries without a deviation are chosen, not measured.")
        for note in content["notes"]:
            face.say(f"- {note}")
        face.say(f"Result: {out}; open {out.with_suffix('.report.html')}")
        face.result(content)
