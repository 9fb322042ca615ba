"""What all papers share: their frames simulated into a folder, and where each number of the hardware is from."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from armsight.errors import Cancelled, UsageError
from armsight.ops.action import action_of
from armsight.ops.measure import measure
from armsight.ops.simulation.run import simulate
from armsight.ops.simulation.scenarios import load_scenario
from armsight.records import Progress

SOURCED = re.compile(r"^\s*(?:- )?(?P<text>[^#]*\S)\s*#\s*(?P<source>(?:paper|derived|chosen)[:;].*)$")

FRAME = "[0-9]" * 6 + ".png"
"""How frames are named."""


@dataclass(slots=True, kw_only=True)
class Stage:
    """Where a reproduction puts its files, its seed, and how it tells of itself. frames: None for the paper's own."""

    out: Path
    seed: int
    progress: Progress
    frames: int | None = None
    scenarios: list[str] = field(default_factory=list)
    settings: list[tuple[str, str, str]] = field(default_factory=list)

    def simulate(self, scenario: str, *, least: int = 1, most: int | None = None, room: str | None = None) -> Path:
        """Return the folder into which a scenario's frames, files and truth were written.

        Frames that an earlier run left there are removed, since they would be measured too. room: instead of the
        scenario's own. Raises UsageError for fewer frames than `least` or more than `most`, Cancelled.
        """
        wanted = self.frames
        if wanted is not None and most is not None and wanted > most:
            raise UsageError(
                f"{scenario} has {most} frames, not {wanted}",
                consequence="Beyond them nothing moves",
                cure=f"Give --frames {most}, or leave it away",
            )
        if wanted is not None and wanted < least:
            raise UsageError(
                f"{wanted} frames of {scenario} do not hold the experiment",
                consequence="There is nothing to compare",
                cure=f"Give --frames {least} or more, or leave it away",
            )
        folder = self.out / scenario
        for earlier in list(folder.glob(f"*/{FRAME}")):
            earlier.unlink()
        simulate(scenario, folder, seed=self.seed, frames=wanted, room=room, progress=self.progress)
        self.scenarios.append(scenario)
        self.settings += sourced_settings(load_scenario(scenario)[1])
        self.check()
        return folder

    def measure(self, **given: object) -> None:
        """Measure as the command does, whose flags errors then name. given: of ops.measure. Raises what it does."""
        action_of(measure).run({**given, "progress": self.progress})
        self.check()

    def check(self) -> None:
        """Raise Cancelled where the person wants to stop."""
        if self.progress.cancelled():
            raise Cancelled(
                "the paper was not reproduced to the end", consequence=f"What there is stands in {self.out}"
            )


def sourced_settings(text: str) -> list[tuple[str, str, str]]:
    """Return key, value and source of each line of a scenario that says where its number is from."""
    rows = []
    for line in text.splitlines():
        match = SOURCED.match(line)
        if match is not None:
            key, _, value = match["text"].partition(":")
            whole = match["text"].startswith(("{", "["))
            rows.append(("" if whole else key.strip(), match["text"] if whole else value.strip(), match["source"]))
    return rows
