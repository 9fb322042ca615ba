"""The page of a hand-eye calibration: verdict, poses in space, residuals, how the hand turned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import HandEyeResult, ImageComparison, Part
from armsight.columns import POSITION, ROTATION_VECTOR
from armsight.report.figures import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    Figure,
    Plot,
    axis,
    bars,
    layout,
    named_ticks,
    short_names,
    subplot,
)
from armsight.report.html import FILES_SHOWN, NOTHING, Card, Given, Page, page_unit, table
from armsight.report.scene import add_boards
from armsight.units import DEG, MM, displayed_name, figure_of, with_deviation

AXIS_COLOURS = (RED, GREEN, BLUE)
AXIS_SHARE = 0.06
"""Length of a drawn axis over the size of the scene."""


def handeye_report(result: HandEyeResult, files: Sequence[Path] = (), given: Given = NOTHING) -> str:
    """Return the page as HTML text that needs no other file. files: that went in."""
    page = Page(
        title="Hand-eye calibration",
        subtitle=f"{result.setup}, {result.n_used} of {len(result.pairs)} poses",
        verdict=result.verdict_,
        cards=_cards(result),
    )
    page.add_notes(result.advice, "What to know, and to do")
    if result.comparison is not None:
        page.add("From poses or from corners", result.comparison.why, _comparison(result.comparison))
    page.add(
        "Result",
        "Position in mm, orientation as a rotation vector in degrees, in the axes of the frame named first. "
        "Standard deviations allow for the noise being estimated: 1.96 of them hold 95 %.",
        *_poses(result),
    )
    page.add(
        "Poses in space",
        "In the base's axes: flange, camera and target as the calibration sees them. Axes are x red, y green, z blue.",
        page.plot(scene_figure(result)),
    )
    if result.boards is not None:
        add_boards(page, result.boards)
    page.add(
        "Residuals",
        "Measured target against the fit, and against the prediction from the other poses, at the target. "
        "A single bar that stands out is a wrong pose or image; all alike is noise.",
        page.plot(residual_figure(result)),
    )
    lead = "Rotation vectors about the mean orientation. Points on one line would leave the camera's place open."
    page.add("Turns of the hand", lead, page.plot(turning_figure(result)))
    _add_background(page, result, [("file", item.name) for item in files[:FILES_SHOWN]])
    return page.html()


def _add_background(page: Page, result: HandEyeResult, inputs: Sequence[tuple[str, str]]) -> None:
    """Add whose noise it is, what was left out, and what went in."""
    page.add("Whose noise it is", "Standard deviations of one component of one pose.", _noise(result))
    if result.rejected_pairs:
        page.add("Left out", "", table(["pose", "why"], [[one.name, one.why] for one in result.rejected_pairs]))
    page.add_inputs(inputs)


def _cards(result: HandEyeResult) -> list[Card]:
    std = result.std
    position_m = max(std[name] for name in POSITION)
    turn_rad = max(std[name] for name in ROTATION_VECTOR)
    cards = [
        Card("camera's place, 95 %", figure_of(1.96 * position_m / MM, "mm"), "weakest direction"),
        Card("camera's orientation, 95 %", figure_of(1.96 * turn_rad / DEG, "°"), "weakest axis"),
        Card(
            "pose left out",
            figure_of(result.loo_rms_m / MM, "mm"),
            f"{figure_of(result.loo_rms_rad / DEG, '°')}, RMS at the target",
        ),
        Card("second turn", figure_of(result.rotation_excitation.rms_rad[1] / DEG, "°"), "RMS, 8° and more is fine"),
    ]
    if result.scale is not None:
        cards.append(
            Card(
                "target's size, true over given",
                f"{result.scale.factor:.4f}",
                f"+- {result.scale.std:.4f}, from the robot's motion",
            )
        )
    if result.reprojection_rms_px is not None:
        cards.append(Card("corners", figure_of(result.reprojection_rms_px, "px"), "RMS"))
    return cards


def _poses(result: HandEyeResult) -> list[str]:
    out = []
    poses = (
        (f"T_{result.camera_parent}_camera", result.T_parent_camera, result.std),
        (f"T_{result.target_parent}_target", result.T_parent_target, result.target_std),
    )
    for name, pose, std in poses:
        values = [*(pose.translation / MM), *(pose.rotation.as_rotvec() / DEG)]
        rows = []
        for (key, deviation), value in zip(std.items(), values, strict=True):
            stem, unit, factor = displayed_name(key)
            shown, uncertainty = with_deviation(float(value), deviation / factor)
            rows.append([stem, shown, uncertainty, page_unit(unit)])
        out.append(table([name, "value", "±", "unit"], rows, numbers=(1, 2)))
    return out


def _comparison(comparison: ImageComparison) -> str:
    """Return the errors at images left out of every calibration from these images."""

    def figure(value: float | None, factor: float) -> str:
        return "no prediction" if value is None else figure_of(value / factor)

    rows = [
        [
            f"{basis.phrase}{', kept' * (basis is comparison.kept)}",
            figure(errors.position_m, MM),
            figure(errors.points_m, MM),
            figure(errors.orientation_rad, DEG),
            figure(errors.reprojection_px, 1.0),
        ]
        for basis, errors in comparison.errors.items()
    ]
    names = ["from", "target's position, mm", "board's points, mm", "orientation, °", "corners, px"]
    return table(names, rows, numbers=(1, 2, 3, 4))


def _noise(result: HandEyeResult) -> str:
    noise = result.noise

    def row(name: str, part: Part, factor: float, unit: str) -> list[str]:
        if not part.known:
            return [name, f"0 to {figure_of(part.size / factor)}", "cannot be told apart", unit]
        return [name, figure_of(part.size / factor), figure_of(part.deviation / factor), unit]

    rows = [
        row("position, both together", noise.translation_m, MM, "mm"),
        row("position, robot", noise.robot_m, MM, "mm"),
        row("position, camera", noise.camera_m, MM, "mm"),
        row("orientation, robot", noise.robot_rad, DEG, "°"),
        row("orientation, camera", noise.camera_rad, DEG, "°"),
    ]
    return table(["noise", "value", "±", "unit"], rows, numbers=(1, 2))


def scene_figure(result: HandEyeResult) -> Figure:
    """Return flanges, cameras and targets in the base's axes."""
    flange = result.pairs.T_base_flange
    if result.camera_parent == "flange":
        camera, target = flange * result.T_parent_camera, _stacked(result.T_parent_target)
    else:
        camera, target = _stacked(result.T_parent_camera), flange * result.T_parent_target
    everything = np.concatenate([flange.translation, camera.translation, target.translation])
    size = float(np.linalg.norm(np.ptp(everything, axis=0))) or 1.0
    data: list[Plot] = []
    for name, poses, colour in (("flange", flange, GREY), ("camera", camera, BLUE), ("target", target, ORANGE)):
        data.append(_dots(name, poses, colour))
        data += _axes(poses, AXIS_SHARE * size)
    scene = {"aspectmode": "data", **{f"{k}axis": {"title": {"text": f"{k}, m"}} for k in "xyz"}}
    return Figure(data=data, layout=layout(scene=scene), height_px=560)


def residual_figure(result: HandEyeResult) -> Figure:
    """Return each pose's residual and left-out error, position above, orientation below."""
    names = short_names(result.pairs.names)
    at = np.arange(1.0, len(names) + 1.0)
    data: list[Plot] = []
    for k, (part, factor) in enumerate(((slice(0, 3), MM), (slice(3, 6), DEG)), start=1):
        for values, title, colour, side in (
            (result.residuals, "residual", BLUE, -0.2),
            (result.left_out, "left out", ORANGE, 0.2),
        ):
            size = np.linalg.norm(values[:, part], axis=1) / factor
            for chosen, opacity, what in ((result.used, 1.0, title), (~result.used, 0.35, f"{title}, rejected")):
                style = {"name": what, "opacity": opacity, "showlegend": k == 1, **subplot(k)}
                hover = {"text": [names[i] for i in np.flatnonzero(chosen)], "hovertemplate": "%{text}: %{y:.3g}"}
                if chosen.any():
                    data.append(bars(at[chosen] + side, size[chosen], 0.4, colour, **style, **hover))
    named = named_ticks(names)
    shape = layout(
        grid={"rows": 2, "columns": 1, "pattern": "independent", "ygap": 0.4},
        xaxis=axis("", **named),
        xaxis2=axis("", **named),
        yaxis=axis("position, mm", rangemode="tozero"),
        yaxis2=axis("orientation, °", rangemode="tozero"),
    )
    return Figure(data=data, layout=shape, height_px=560)


def turning_figure(result: HandEyeResult) -> Figure:
    """Return the turns of the hand as points, with the principal axes at two root mean squares."""
    rotation_excitation = result.rotation_excitation
    w = rotation_excitation.rotvecs_rad / DEG
    data: list[Plot] = [
        {
            "type": "scatter3d",
            "mode": "markers",
            "x": w[:, 0],
            "y": w[:, 1],
            "z": w[:, 2],
            "name": "poses",
            "marker": {"size": 4, "color": BLUE},
        }
    ]
    for k, (rms, direction) in enumerate(
        zip(rotation_excitation.rms_rad / DEG, rotation_excitation.axes, strict=True), start=1
    ):
        ends = np.outer([-2.0 * rms, 2.0 * rms], direction)
        data.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "x": ends[:, 0],
                "y": ends[:, 1],
                "z": ends[:, 2],
                "name": f"axis {k}: {rms:.1f}° RMS",
                "line": {"width": 5, "color": (INK, ORANGE, GREY)[k - 1]},
            }
        )
    scene = {"aspectmode": "data", **{f"{k}axis": {"title": {"text": f"about {k}, °"}} for k in "xyz"}}
    return Figure(data=data, layout=layout(scene=scene), height_px=460)


def _stacked(pose: RigidTransform) -> RigidTransform:
    return RigidTransform.from_matrix(pose.as_matrix()[None])


def _dots(name: str, poses: RigidTransform, colour: str) -> Plot:
    x, y, z = poses.translation.T
    marker = {"size": 3, "color": colour}
    return {"type": "scatter3d", "mode": "markers", "x": x, "y": y, "z": z, "name": name, "marker": marker}


def _axes(poses: RigidTransform, length_m: float) -> list[Plot]:
    """Return three traces of short lines, one per axis, broken between poses."""
    origin, R = poses.translation, poses.rotation.as_matrix()
    out = []
    for k, colour in enumerate(AXIS_COLOURS):
        points = np.full((3 * len(origin), 3), np.nan)
        points[0::3], points[1::3] = origin, origin + length_m * R[:, :, k]
        out.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "x": points[:, 0],
                "y": points[:, 1],
                "z": points[:, 2],
                "hoverinfo": "skip",
                "showlegend": False,
                "line": {"width": 3, "color": colour},
            }
        )
    return out
