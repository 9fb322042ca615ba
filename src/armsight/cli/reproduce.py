"""armsight reproduce."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import AsJson, OutFolder
from armsight.cli.tables import figure

if TYPE_CHECKING:
    from armsight.app.reproduce.run import ReproducedTable, ReproduceOutput


def reproduce(
    paper: Annotated[str, typer.Argument(help="korayem2018, pachidis2005 or kapucu2005.")],
    out: OutFolder,
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated frames' noise.")] = 1,
    frames: Annotated[
        int | None, typer.Option(min=1, help="Fewer frames than the paper took, to try it. [default: the paper's]")
    ] = None,
    json: AsJson = False,
) -> None:
    """Run a paper's experiment on emulated hardware; put print, the paper's method and armsight side by side."""
    with CommandUI(as_json=json) as face:
        from armsight.app.reproduce.run import reproduce as run

        done = run(paper, out, seed=seed, frames=frames, progress=face.progress(f"reproducing {paper}"))
        _tell(done, face)
        face.say(f"Result: open {out / 'report.html'}")
        face.result(done)


def _tell(done: ReproduceOutput, face: CommandUI) -> None:
    head = ["m, rad or px", "paper", "its method", "armsight", "truth", "share of print", "of method"]
    for item in done.tables.values():
        face.table(item.title, head, [_row(item, name) for name in item.rows])
    for note in done.missing:
        face.say(f"- not reproduced: {note}")
    if done.n_compared:
        face.say(
            f"armsight's error is at most a third of the paper's in {done.n_reached} of {done.n_compared} rows that "
            "can be compared" + (f"; not in {', '.join(done.missed)}" if done.missed else "")
        )


def _row(item: ReproducedTable, name: str) -> list[str]:
    values = (item.paper[name], item.paper_method[name], item.armsight[name], item.truth[name])
    share = "-" if item.share[name] is None else figure(item.share[name], 2)
    shown = share if item.credible[name] or share == "-" else f"({share})"
    return [name, *(figure(value, 4) for value in values), shown, figure(item.share_of_method[name], 2)]
