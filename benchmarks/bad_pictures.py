"""Bad pictures: what the product makes of them, how long it takes, and whether it gives a pose that misleads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from armsight.measure.poses.pipeline import Setup
from bench import table
from composites import Composite, composite
from verdicts import SIDES, Verdict, blob_detector, judge, near, reason
from webcam import Picture

REACH_PX = 2.0
FIELD_STEP_M = np.array([9e-4, 4e-4, 0.0])
"""Half of what the target moves between the fields of an interlaced picture: 3 px in all at 0.6 m."""


@dataclass(frozen=True, eq=False)
class Bad:
    """One kind of bad picture: what is pinned, and what is done to the finished composite."""

    name: str
    pinned: Mapping[str, object] = field(default_factory=dict)
    change: Callable[[Composite], Composite] = lambda made: made


def halved(made: Composite) -> Composite:
    """Return the composite as if taken at half the size and enlarged."""

    def small(picture: Picture) -> Picture:
        size = picture.shape[1], picture.shape[0]
        half = cv2.resize(picture, (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(half, size, interpolation=cv2.INTER_LINEAR), np.uint8)

    return replace(made, left=small(made.left), right=small(made.right))


def interlaced(made: Composite) -> Composite:
    """Return the composite with every other row taken a little before its moment, the rest a little after."""
    fields = []
    for sign in (-1.0, 1.0):
        T = made.T_rig_target.copy()
        T[:3, 3] += sign * FIELD_STEP_M
        pinned = {key: value for key, value in made.settings.items() if key != "T_rig_target"}
        fields.append(composite(made.seed, **pinned, T_rig_target=T))
    pictures = []
    for side in SIDES:
        first, second = (getattr(f, side) for f in fields)
        woven = first.copy()
        woven[1::2] = second[1::2]
        pictures.append(woven)
    return replace(made, left=pictures[0], right=pictures[1])


EASY = {"hidden": False, "width": 1280}
BAD = (
    Bad("no target: a photographed room", {**EASY, "lit": False, "decoys": 0}),
    Bad("no target: only lamps", {**EASY, "lit": False, "background": "lamps", "decoys": 3}),
    Bad("no target: a grid of lights", {**EASY, "lit": False, "background": "grid", "decoys": 0}),
    Bad("target among lamps", {**EASY, "background": "lamps", "decoys": 3}),
    Bad("target before a grid of equal lights", {**EASY, "background": "grid", "plate": False}),
    Bad("target before a screen of bright squares", {**EASY, "background": "screen", "plate": False}),
    Bad("room over-exposed thirtyfold", {**EASY, "exposure": 30.0, "plate": True}),
    Bad("255 everywhere", {**EASY, "background": "white", "plate": False, "vignetting": 0.0}),
    Bad("dark, noise of a high gain", {**EASY, "exposure": 0.1, "full_well": 200.0, "read_noise": 8.0}),
    Bad("JPEG of quality 20", {**EASY, "jpeg": 20}),
    Bad("enlarged from half the size", EASY, halved),
    Bad("interlaced, moving", {**EASY, "motion_px": 0.0}, interlaced),
    Bad("motion blur of 10 px", {**EASY, "motion_px": 10.0}),
)


def bad_pictures(n: int) -> None:
    """Print what becomes of n pairs of each kind."""
    detect, rows, listed = blob_detector(), [], []
    for kind in BAD:
        verdicts, wrong, blobs, lights_in_all = [], 0, 0, 0
        for seed in range(n):
            made = kind.change(composite(50_000 + seed, **kind.pinned))
            lights = {(light.side, light.name): light.uv_disc for light in made.lights if light.visible}
            setup = Setup(made.rig, made.target)
            verdict = judge(setup, made.frames(), made.T_rig_target, lights, reach_px=REACH_PX)
            misled = verdict.wrong or verdict.misplaced if lights else verdict.status in ("ok", "position_only")
            if misled:
                off = np.nanmax([verdict.position_mm, verdict.place_mm])
                listed.append([kind.name, made.seed, verdict.status, float(off), verdict.orientation_deg])
            at = {side: detect(picture) for side, picture in zip(SIDES, (made.left, made.right), strict=True)}
            verdicts.append(verdict)
            wrong += misled
            lights_in_all += len(lights)
            blobs += sum(near(at[side], uv, REACH_PX) for (side, _), uv in lights.items())
        rows.append([kind.name, n, *row_of(verdicts, lights_in_all, blobs), wrong])
    head = ["pictures", "pairs", "lights found", "blobs: found", "ok", "position only", "lost", "raised"]
    head += ["ms an image", "largest", "commonest reason", "wrong"]
    table("Bad pictures (wrong: a pose where no target is, or one that misleads)", head, rows)
    if listed:
        table("Wrong poses of bad pictures", ["pictures", "seed", "status", "mm", "deg"], listed)


def row_of(verdicts: list[Verdict], lights: int, blobs: int) -> list[object]:
    """Return what became of the pairs of one kind."""
    states = Counter(v.status for v in verdicts)
    why = Counter(reason(v.why) for v in verdicts if not v.ok)
    ms = np.array([v.ms for v in verdicts]) / 2.0
    return [
        f"{sum(len(v.found) for v in verdicts)} of {lights}",
        f"{blobs} of {lights}",
        *(states[status] for status in ("ok", "position_only", "lost", "raised")),
        float(np.median(ms)),
        float(ms.max()),
        why.most_common(1)[0][0] if why else "",
    ]


def shown(name: str, seed: int) -> Composite:
    """Return one bad picture by its kind's name, to look at."""
    kind = next(kind for kind in BAD if kind.name == name)
    return kind.change(composite(seed, **kind.pinned))
