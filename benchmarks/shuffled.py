"""Stills in random order: nothing moves from one to the next, so a track handed on may not cost a pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armsight.measure.poses.outcome import Track
from armsight.measure.poses.pipeline import Setup
from armsight.records import Frame
from armsight.store import read_rig, read_target
from bench import table
from composites import composite
from room_stills import ROOMS, read_stills
from verdicts import Array, Verdict, judge

REACH_PX = 1.5
INTERVAL_S = 1.0 / 30.0

ONE_RIG = {"rig_seed": 1, "target_seed": 1, "width": 1280, "target": "scalene", "diameter_m": 0.006, "hidden": False}
"""One rig and one target; room, camera and pose differ from still to still."""

Moment = tuple[tuple[Frame, Frame], Array, dict[tuple[str, str], Array]]


def shuffled(n: int) -> None:
    """Print the poses of stills measured alone and one after the other."""
    rows = []
    first = composite(70_000, **ONE_RIG)
    rows.append(["composites", *compare(Setup(first.rig, first.target), far_apart(n))])
    if ROOMS.exists():
        setup = Setup(read_rig(ROOMS / "rig.yaml"), read_target(ROOMS / "target.yaml"))
        moments = [(timed(s.frames(), i), s.T, s.lights) for i, s in enumerate(read_stills())]
        rows.append(["rooms", *compare(setup, moments)])
    head = ["stills", "n", "ok alone", "ok with the track before", "in one way only", "wrong alone", "wrong with track"]
    table("Stills in random order, alone and with the track of the one before", [*head, "ms alone", "ms with"], rows)


def far_apart(n: int) -> list[Moment]:
    """Return n composites of one rig and target."""
    out: list[Moment] = []
    for i in range(n):
        made = composite(70_000 + i, **ONE_RIG)
        lights = {(light.side, light.name): light.uv_disc for light in made.lights if light.visible}
        out.append((made.frames(i * INTERVAL_S, i), made.T_rig_target, lights))
    return out


def timed(frames: tuple[Frame, Frame], number: int) -> tuple[Frame, Frame]:
    """Return frames as if they had been taken one after the other."""
    left, right = (Frame(image=f.image, t_s=number * INTERVAL_S, sequence=number, source=f.source) for f in frames)
    return left, right


def compare(setup: Setup, moments: Sequence[Moment]) -> list[object]:
    """Return the row of a series."""
    alone, handed, track = [], [], None
    for frames, T, lights in moments:
        alone.append(judge(setup, frames, T, lights, reach_px=REACH_PX))
        handed.append(judge(setup, frames, T, lights, reach_px=REACH_PX, track=track))
        track = track_of(handed[-1])
    return [
        len(moments),
        sum(v.ok for v in alone),
        sum(v.ok for v in handed),
        sum(a.ok != b.ok for a, b in zip(alone, handed, strict=True)),
        sum(v.wrong for v in alone),
        sum(v.wrong for v in handed),
        *(float(np.median([v.ms for v in series])) for series in (alone, handed)),
    ]


def track_of(verdict: Verdict) -> Track | None:
    """Return the track that the next moment is handed."""
    return None if verdict.measured is None else verdict.measured.track
