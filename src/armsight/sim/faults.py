"""What a simulated cell plans to go wrong, so that a report has something to show."""

from __future__ import annotations

from armsight.sim.scene import Event, Ghost

LEAST_FRAMES = 25
"""Below this nothing goes wrong: the shortest fault would be a large part of the run."""


def planned_events(frames: int, names: tuple[str, ...], size_px: tuple[int, int], sigma_px: float) -> tuple[Event, ...]:
    """Return the faults of a run over a target of three lights or more; none in runs below LEAST_FRAMES.

    At 15 % of the run the third light is covered in the left view for 3 % of the frames (two lights left: position
    only), at 35 % the second in both for 2 %, at 50 % all in both for 2 % (lost), at 65 % the first two in the
    right for 1 % (one light left); at 80 % a reflection stands in the right view for 4 % (nothing is lost by it).
    Each lasts one frame at least.
    """
    if frames < LEAST_FRAMES:
        return ()
    first, second, third = names[:3]
    width, height = size_px
    ghost = Ghost(uv_px=(0.17 * width, 0.22 * height), level=140.0, sigma_px=sigma_px)
    plan = (
        (0.15, 0.03, "left", (third,), (), f"light {third} covered in the left view"),
        (0.35, 0.02, "both", (second,), (), f"light {second} covered in both views"),
        (0.50, 0.02, "both", names, (), "all lights covered in both views"),
        (0.65, 0.01, "right", (first, second), (), f"lights {first} and {second} covered in the right view"),
        (0.80, 0.04, "right", (), (ghost,), "a reflection in the right view"),
    )
    events = []
    for start, share, side, hidden, ghosts, note in plan:
        at = int(start * frames)
        last = at + max(1, round(share * frames))
        events.append(Event(first=at, last=last, side=side, note=note, hidden=hidden, ghosts=ghosts))
    return tuple(events)
