"""A picture of an arm at given joint values, in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.kinematics import Arm, JointType, link_frames, near_singularities, singularity_distance
from armsight.records.result_parts import Verdict
from armsight.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, Figure, Plot, axis, layout, spread
from armsight.report.html import Card, Page, page_unit, table, text
from armsight.units import DEG, MM, displayed, figure_of

ARROW = 0.08
"""Length of a frame's axes as a share of the arm's size in the picture."""

NO_DISTANCE = 1e-9
"""Scaled singular value that is zero but for rounding."""

BACK = "Do not go there: choose joint values within the limits below."
AWAY = "Do not move straight through here: joints race near a singularity. Bend the arm away from it first."
FREE = "Nothing stands against these joint values; the arm's body and the cell are not checked."

MAX_POSTURES = 30
"""Postures drawn of a track; more of them hide each other."""


def arm_report(arm: Arm, q: ArrayLike) -> str:
    """Return a page with the arm at q (n,), or along a track q (m, n), as HTML text that needs no other file."""
    values = np.atleast_2d(arm.checked(q))
    first = values[0]
    frames = link_frames(arm, first)
    names = near_singularities(arm, first)
    inside = bool(arm.within_limits(values).all())
    page = Page(
        title=arm.name,
        subtitle=f"{arm.n} joints, {arm.convention} Denavit-Hartenberg convention. {arm.source}",
        verdict=_verdict(inside, names),
        cards=_cards(arm, first, frames[-1]),
    )
    page.add(
        "The arm",
        "Links, joint axes (grey), and the frames of base and tool (x red, y green, z blue). Drag to turn, scroll to "
        "zoom." + (" The line is the tool's way." if len(values) > 1 else ""),
        page.plot(arm_figure(arm, values)),
    )
    page.add("Joints", "", _joint_table(arm, first))
    return page.html()


def _verdict(inside: bool, names: Sequence[str]) -> Verdict:
    if not inside:
        return Verdict(
            level="bad", headline="beyond limits", reasons=["At least one joint is beyond its limit."], next=[BACK]
        )
    if names:
        return Verdict(
            level="care", headline="singular", reasons=[f"Close to a singularity: {', '.join(names)}."], next=[AWAY]
        )
    return Verdict(level="good", headline="free", reasons=["Within limits and away from singularities."], next=[FREE])


def _cards(arm: Arm, q: Array, T: Array) -> list[Card]:
    x, y, z = (f"{value / MM:.2f} mm" for value in T[:3, 3])
    nearness = float(singularity_distance(arm, q))
    distance = figure_of(nearness if nearness > NO_DISTANCE else 0.0)
    return [
        Card("tool x", x),
        Card("tool y", y),
        Card("tool z", z),
        Card("distance to singularity", distance, "smallest singular value, scaled"),
    ]


def _joint_table(arm: Arm, q: Array) -> str:
    rows = []
    for joint, value in zip(arm.joints, q, strict=True):
        turns = joint.type is JointType.REVOLUTE
        unit, scale = displayed("rad" if turns else "m")
        ends = [figure_of(end / scale, page_unit(unit), digits=6) for end in (joint.lower, joint.upper)]
        geometry = (joint.a_m / MM, joint.alpha_rad / DEG, joint.d_m / MM, joint.theta_rad / DEG, joint.beta_rad / DEG)
        rows.append(
            [
                joint.name,
                joint.type.value,
                figure_of(float(value) / scale, page_unit(unit), digits=6),
                *ends,
                *(figure_of(number, digits=7) for number in geometry),
            ]
        )
    header = ["joint", "type", "value", "lower", "upper", "a, mm", "α, °", "d, mm", "θ, °", "β, °"]
    return table(header, rows, numbers=range(2, len(header)))


def arm_figure(arm: Arm, q: Array) -> Figure:
    """Return the picture of the arm along q (m, n), m >= 1; a track's postures are thinned and faint."""
    shown = spread(q, MAX_POSTURES) if len(q) > MAX_POSTURES else np.arange(len(q))
    postures = [link_frames(arm, q[row]) for row in shown]
    data: list[Plot] = [line_mm(_skeleton(arm, frames), GREY, 3, "posture", opacity=0.35) for frames in postures[1:]]
    frames = postures[0]
    bones = _skeleton(arm, frames)
    size = max(float(np.ptp(bones, axis=0).max()), 1e-3)
    half = 0.5 * ARROW * size
    ends = [np.array([T[:3, 3] - half * T[:3, 2], T[:3, 3] + half * T[:3, 2]]) for T in frames[:-2]]
    data += [line_mm(axis, GREY, 2, "axis") for axis in ends]
    data.append(line_mm(bones, INK, 9, text(arm.name), mode="lines+markers", marker={"size": 4, "color": ORANGE}))
    for T, name in ((frames[0], "base"), (frames[-1], "tool")):
        for k, colour in enumerate((RED, GREEN, BLUE)):
            tip = T[:3, 3] + ARROW * size * T[:3, k]
            data.append(line_mm(np.array([T[:3, 3], tip]), colour, 5, f"{name} {'xyz'[k]}"))
    if len(postures) > 1:
        data.append(line_mm(np.array([T[-1][:3, 3] for T in postures]), BLUE, 4, "tool's way"))
    scene: Plot = {f"{name}axis": axis(f"{name}, mm", ticks="") for name in "xyz"}
    scene["aspectmode"] = "data"
    return Figure(
        data=data,
        layout=layout(scene=scene, margin={"l": 0, "r": 0, "t": 8, "b": 0}, showlegend=False),
        height_px=620,
    )


def _skeleton(arm: Arm, frames: Array) -> Array:
    """Return the corners (k, 3) of the links: along each joint's axis by d, then across by a."""
    corners = [frames[0][:3, 3]]
    rows = arm.chain[1:-1]
    for i in range(arm.n):
        here, there = frames[i], frames[i + 1]
        z = here[:3, 2]
        along = z @ (there[:3, 3] - here[:3, 3])
        if rows[i, 4] != 0.0:
            corners.append(here[:3, 3] + along * z)
        corners.append(there[:3, 3])
    corners.append(frames[-1][:3, 3])
    return np.array(corners)


def line_mm(points_m: Array, colour: str, width: int, name: str, **more: Any) -> Plot:
    """Return a line through points (n, 3), m, in a scene in mm."""
    x, y, z = (points_m / MM).T
    return {
        "type": "scatter3d",
        "mode": "lines",
        "x": x,
        "y": y,
        "z": z,
        "line": {"color": colour, "width": width},
        "name": name,
        **more,
    }
