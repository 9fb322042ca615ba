"""report.html of a measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from armsight.arrays import Array
from armsight.measure.results import ConsistencyOutput, OtherCause, note_of
from armsight.measure.series import Errors, Series, errors_of, losses_of, median_columns, series_of
from armsight.optics import Camera, Rig
from armsight.records import PoseStatus, Target
from armsight.report.figures import MAX_PLOTTED
from armsight.report.html import Card, Page, add_recordings, bullets, table
from armsight.report.residuals import distance_rms, residual_figure
from armsight.report.run import MeasureRun
from armsight.report.scene import sample_figure, scene_figure
from armsight.report.track import NEIGHBOURS, deviation_figure, scatter_of, time_figure, track_figure
from armsight.units import MM, figure_of

AXES = ("x", "y", "z", "rx", "ry", "rz")

MAX_LOSSES = 25
MAX_SAMPLES = 6


def measure_report(run: MeasureRun) -> str:
    """Return the page of a measurement as HTML text that needs no other file."""
    series = series_of(run.poses, timed=run.timed, apart=run.stills)
    errors = errors_of(run.poses, run.truth) if run.truth is not None else None
    page = Page(
        title=run.title,
        subtitle=run.subtitle or _subtitle(run, series),
        verdict=run.verdict,
        cards=_cards(run, series, errors),
    )
    _add_scene(page, run)
    _add_truth(page, errors)
    _add_track(page, run, series, errors)
    _add_residuals(page, run)
    _add_cameras(page, run)
    _add_consistency(page, run)
    _add_losses(page, run, series)
    _add_inputs(page, run)
    return page.html()


def _subtitle(run: MeasureRun, series: Series) -> str:
    n = len(run.poses)
    if n < 2:
        return f"{n} frame{'s' * (n != 1)}"
    if series.apart:
        return f"{n:,} single shots"
    over = f" over {figure_of(float(np.ptp(series.t_s)), 's')}" if series.timed else ""
    return f"{n:,} {'pairs of frames' if run.rig.is_pair else 'moments'}{over}"


def _rms_columns(values: Array) -> Array:
    """Return the root mean square of each column, NaN aside; NaN for a column without numbers."""
    known = [column[np.isfinite(column)] for column in values.T]
    return np.array([np.sqrt(np.mean(column**2)) if len(column) else np.nan for column in known])


def _judged(inside: float, low: float, high: float) -> str:
    if low <= inside <= high:
        return "the claims are true"
    return f"the claimed standard deviations are {'too small' if inside < low else 'larger than the errors'}"


def _cards(run: MeasureRun, series: Series, errors: Errors | None) -> list[Card]:
    n = len(run.poses)
    count = {status: int(series.where(status).sum()) for status in PoseStatus}
    middle = median_columns(series.std[series.whole])
    spots = sum(len(rows) for rows in run.residuals.values())
    cards = [
        Card(
            "full poses",
            f"{int(series.whole.sum()):,}",
            f"of {n:,}, {count[PoseStatus.DOUBTFUL]:,} doubtful; "
            f"{count[PoseStatus.POSITION_ONLY]:,} position only, {count[PoseStatus.LOST]:,} lost",
        ),
        Card(
            "position uncertainty",
            figure_of(float(np.sqrt(np.sum(middle[:3] ** 2))), "mm"),
            "claimed, 3-D, one standard deviation, median",
        ),
        Card(
            "rotation uncertainty",
            figure_of(float(np.sqrt(np.sum(middle[3:] ** 2))), "°"),
            "claimed, one standard deviation, median",
        ),
        Card(
            "reprojection",
            figure_of(distance_rms([rows[:, 1:] for rows in run.residuals.values()]), "px"),
            f"RMS distance, {spots:,} spots" if spots else "",
        ),
        Card(
            "time per pair" if run.rig.is_pair else "time per moment",
            figure_of(run.median_ms, "ms"),
            f"median; 99 % below {figure_of(run.p99_ms, 'ms')}" if run.p99_ms is not None else "median",
        ),
    ]
    return cards if errors is None else [cards[0], _error_card(errors), *cards[1:]]


def _error_card(errors: Errors) -> Card:
    rms = float(np.sqrt(np.nansum(_rms_columns(errors.values)[:3] ** 2)))
    return Card("position error", figure_of(rms, "mm"), "against the truth, 3-D RMS")


def _add_truth(page: Page, errors: Errors | None) -> None:
    if errors is None or not np.isfinite(errors.values).any():
        return
    known = np.isfinite(errors.values[:, 0])
    values, std = errors.values[known], errors.std[known]
    claimed = _rms_columns(std)
    rms = _rms_columns(values)
    figures = np.stack([values.mean(axis=0), values.std(axis=0), rms, np.abs(values).max(axis=0), claimed], axis=1)
    rows = [
        [
            f"{axis}, {'mm' if i < 3 else '°'}",
            *(figure_of(float(figure)) for figure in figures[i]),
            figure_of(float(rms[i] / claimed[i])) if claimed[i] > 0.0 else "–",
        ]
        for i, axis in enumerate(AXES)
    ]
    inside, low, high = errors.inside()
    page.add(
        "Errors against the truth",
        f"Measured minus true over {len(values):,} full poses; rotations as a vector in the parent's axes. "
        f"{100 * inside:.1f} % of the errors lie inside their own 95 % ellipsoid; true claims leave "
        f"{100 * low:.1f} to {100 * high:.1f} %: {_judged(inside, low, high)}.",
        table(
            ["", "mean", "standard deviation", "RMS", "largest", "claimed (RMS)", "RMS / claimed"],
            rows,
            numbers=range(1, 7),
        ),
    )


def _add_track(page: Page, run: MeasureRun, series: Series, errors: Errors | None) -> None:
    by, band = ("of each shot", "bar") if series.apart else ("over time", "band")
    if np.isfinite(series.values[:, 0]).any():
        page.add(
            f"{'Places' if series.apart else 'Track'} in the axes of {run.parent}",
            "Drag to turn, scroll to zoom; a click on a name in the legend hides or shows it.",
            page.plot(track_figure(run, series)),
        )
        page.add(
            f"Position and rotation {by}",
            f"The {band} holds the true value in 95 % of the frames (1.96 standard deviations); rx, ry, rz are angles "
            "about x, y, z with R = Rz Ry Rx. Red marks at the bottom are frames without a full pose; "
            "orange dots are the mean of the spots seen where not all were." + _thinning_note(len(series.t_s)),
            page.plot(time_figure(series)),
        )
        _add_deviation(page, series, errors)


def _add_deviation(page: Page, series: Series, errors: Errors | None) -> None:
    """Add the errors over time; where no truth is known, how the poses lie about themselves."""
    if errors is not None:
        figure = deviation_figure(series, errors.values, errors.std)
        title = "Error of each shot" if series.apart else "Error over time"
        page.add(title, "Measured minus true, within the claimed 95 % band.", page.plot(figure))
        return
    std = series.full()[1]
    if series.apart:  # they lie where each was taken: nothing is there that they could scatter about
        text = "Half the width of the 95 % bars: what may be read off the pose in each shot."
        page.add("What each shot claims", text, page.plot(deviation_figure(series, None, std)))
        return
    scatter = scatter_of(series)
    if scatter is None:
        text = "Half the width of the 95 % band: what may be read off the pose at each moment."
        page.add("Width of the band over time", text, page.plot(deviation_figure(series, None, std)))
        return
    values, resting = scatter
    rms, claimed = (float(np.sqrt(np.nansum(_rms_columns(part)[:3] ** 2))) for part in (values, std))
    about = (
        "the mean, since nothing moved"
        if resting
        else f"the smooth track, a parabola through {NEIGHBOURS} frames; a quicker motion shows here too"
    )
    page.add(
        "Deviation over time",
        f"No truth is known: each pose about {about}. Position scatters by {figure_of(rms, 'mm')} RMS (3-D); "
        f"{figure_of(claimed, 'mm')} are claimed, the band being 95 %. Errors that stay the same do not show.",
        page.plot(deviation_figure(series, values, std)),
    )


def _thinning_note(n: int) -> str:
    """Return the sentence on what a plot of n frames leaves out."""
    return (
        ""
        if n <= MAX_PLOTTED
        else f" Of {n:,} frames each column of pixels shows the least and the greatest; poses.csv has all."
    )


def _add_residuals(page: Page, run: MeasureRun) -> None:
    if not any(len(rows) for rows in run.residuals.values()):
        return
    aside = f" {run.n_aside:,} sights known worse than to 1 px are left aside." * (run.n_aside > 0)
    rows = []
    for side, row in run.residuals.items():
        if len(row):
            figures = (*_rms_columns(row[:, 1:]), *row[:, 1:].mean(axis=0), np.abs(row[:, 1:]).max())
            rows.append([side, f"{len(row):,}", *(figure_of(float(x)) for x in figures)])
    page.add(
        "Reprojection",
        "Measured spot minus the model's, per camera. A cloud off the centre or an oblong one says that rig or target "
        f"do not fit the frames.{aside}",
        page.plot(residual_figure({side: r[:, 1:] for side, r in run.residuals.items() if len(r)})),
        table(
            ["camera", "spots", "RMS u, px", "RMS v, px", "mean u, px", "mean v, px", "largest, px"],
            rows,
            numbers=range(1, 7),
        ),
    )


def _add_cameras(page: Page, run: MeasureRun) -> None:
    """Add what each camera had of the run, where it is not a pair's."""
    if not run.by_camera:
        return
    rows = [
        [
            name,
            f"{part.n_used:,} of {part.n_frames:,}",
            figure_of(part.rms_px, "px") if part.rms_px else "",
            note_of(part),
        ]
        for name, part in run.by_camera.items()
    ]
    page.add(
        "What each camera had of it",
        "Moments whose pose took lights that the camera shows; a light that one camera alone shows counts too.",
        table(["camera", "used in", "residuals, RMS", ""], rows, numbers=(1, 2)),
    )


def _estimate(cause: ConsistencyOutput | OtherCause) -> str:
    if cause.estimate is None:
        return ""
    unit = (cause.unit or "").replace("1", "")
    return f"{figure_of(cause.estimate)} ± {figure_of(cause.std, digits=2)} {unit}"


def _add_consistency(page: Page, run: MeasureRun) -> None:
    found = run.consistency
    if found is None or found.verdict == "unchecked":
        return
    causes: list[ConsistencyOutput | OtherCause] = [found, *found.others] if found.cause else []
    rows = [
        [
            cause.cause,
            _estimate(cause),
            figure_of(None if cause.effect_m is None else cause.effect_m / MM, "mm", digits=2),
            figure_of(float(np.exp(min(-cause.log_odds, 20.0))), digits=2) if isinstance(cause, OtherCause) else "",
        ]
        for cause in causes
    ]
    # 0: nothing was looked for, such as clocks that the run itself estimates
    told = {cause: figure_of(off_m / MM, "mm", digits=2) for cause, off_m in found.undetected_m.items() if off_m}
    kinds = _by_kind(told, () if run.rig.is_pair else run.rig.names)
    unseen = [
        [cause, value] for cause, value in told.items() if not any(cause in row.values() for row in kinds.values())
    ]
    page.add(
        "Do the residuals agree with rig, target and noise?",
        f"{found.sentence or 'They do.'} {found.advice} The noise is "
        f"{figure_of(found.noise_scale, digits=2)} times what the spots claim; {found.n_frames:,} frames judged.",
        table(["cause", "estimate", "error of positions", "times less likely"], rows, numbers=(1, 2, 3))
        if rows
        else "",
        "<p>What could be wrong, at most, without this run showing it (error of positions, RMS):</p>",
        table(["cause", "error of positions"], unseen, numbers=(1,)),
        _of_cameras(told, kinds, run.rig.names) if kinds else "",
    )


def _by_kind(told: Mapping[str, str], names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the causes that are of one camera, such as 'turned top', by their kind and the camera's name."""
    kinds: dict[str, dict[str, str]] = {}
    for cause in told:
        kind, _, name = cause.rpartition(" ")
        if kind != "light" and name in names:
            kinds.setdefault(kind, {})[name] = cause
    return kinds


def _of_cameras(told: Mapping[str, str], kinds: Mapping[str, Mapping[str, str]], names: Sequence[str]) -> str:
    rows = [[kind, *(told[of[name]] if name in of else "" for name in names)] for kind, of in kinds.items()]
    return table(["camera", *names], rows, numbers=range(1, len(names) + 1))


def _add_scene(page: Page, run: MeasureRun) -> None:
    """Open with what was there: cameras, target and rays in space, then what the cameras saw."""
    figure = scene_figure(run)
    if figure is not None:
        page.add(
            "The scene",
            f"The cameras, the target where it is known best, and the rays that found its lights, in the axes of "
            f"{run.parent}. Drag to turn, scroll to zoom; a click on a name in the legend hides or shows it.",
            page.plot(figure),
        )
    if not run.samples:
        return
    moments = {sample.frame: [one for one in run.samples if one.frame == sample.frame] for sample in run.samples}
    each = list(moments.values())
    if not run.rig.is_pair:  # there is room for few moments: one with a pose comes first
        each.sort(key=lambda seen: not any(one.names for one in seen))
    shown = each[: max(MAX_SAMPLES // len(run.rig.cameras), 1)]
    with ThreadPoolExecutor() as pool:  # most of it is packing images
        figures = "".join(pool.map(sample_figure, (one for seen in shown for one in seen), range(len(run.samples))))
    page.add(
        "What the cameras saw",
        "Green: spots used, with their names and, enlarged, their measured centres. Orange: seen and not matched. "
        "Red crosses: rejected; the reason shows when the pointer rests on one.",
        f'<div class="pair">{figures}</div>',
    )


def _add_losses(page: Page, run: MeasureRun, series: Series) -> None:
    losses = losses_of(run.poses)
    if not losses:
        page.add("What was lost", "Nothing: every frame gave a full pose.")
        return
    names = {PoseStatus.DOUBTFUL: "doubtful", PoseStatus.POSITION_ONLY: "position only", PoseStatus.LOST: "lost"}
    when = "first – last, s" if series.timed else ""
    rows = [
        [
            names[loss.status],
            loss.why,
            f"{len(loss.frames):,}",
            f"{100 * len(loss.frames) / len(run.poses):.1f} %",
            ranges(loss.frames),
            f"{series.t_s[loss.frames[0]]:.3f} – {series.t_s[loss.frames[-1]]:.3f}" if series.timed else "",
        ]
        for loss in losses[:MAX_LOSSES]
    ]
    if len(losses) > MAX_LOSSES:
        rest = losses[MAX_LOSSES:]
        count = sum(len(loss.frames) for loss in rest)
        rows.append(["", f"{len(rest)} more reasons", f"{count:,}", f"{100 * count / len(run.poses):.1f} %", "", ""])
    page.add(
        "What was lost, and why",
        "Frames without a full pose, or with one that is doubtful, counted from 0; frames with the same reason stand "
        "together, in the first one's wording.",
        table(["", "why", "frames", "share", "which", when], rows, numbers=(2, 3, 5)),
    )


def _add_inputs(page: Page, run: MeasureRun) -> None:
    rig, target = run.rig, run.target
    rows = [
        ["rig", _rig_text(rig)],
        *([f"{one.name} camera", _camera_text(one.camera)] for one in rig.cameras),
        ["calibration's RMS", figure_of(rig.rms_px, "px") if rig.rms_px is not None else "not given"],
        ["target", _target_text(target)],
        ["frame of the poses", run.parent],
        *([name, value] for name, value in run.facts),
    ]
    if target.diameter_m is not None:
        rows.insert(len(rig.cameras) + 3, ["diameter of a light", figure_of(target.diameter_m / MM, "mm")])
    assumed = [f"<p>Assumed:</p>{bullets(list(run.assumptions))}"] if run.assumptions else []
    add_recordings(page, run.recordings)
    page.add("What went in", "", table(["", ""], rows), *assumed)


def ranges(frames: Sequence[int], limit: int = 8) -> str:
    """Return frames as '3, 7–12, 40' with at most limit pieces."""
    pieces: list[list[int]] = []
    for frame in frames:
        if pieces and frame == pieces[-1][1] + 1:
            pieces[-1][1] = frame
        else:
            pieces.append([frame, frame])
    shown = [f"{a}" if a == b else f"{a}–{b}" for a, b in pieces[:limit]]
    return ", ".join(shown) + (f" and {len(pieces) - limit} more stretches" if len(pieces) > limit else "")


def _rig_text(rig: Rig) -> str:
    if rig.is_pair:
        return f"{rig.kind}, baseline {figure_of(rig.baseline_m / MM, 'mm', digits=5)}"
    return f"{len(rig.cameras)} camera{'s' * (len(rig.cameras) > 1)}: {', '.join(rig.names)}"


def _camera_text(camera: Camera) -> str:
    fx, fy = camera.intrinsics[:2]
    return f"{camera.width} × {camera.height} px, fx {fx:.1f} px, fy {fy:.1f} px"


def _target_text(target: Target) -> str:
    if target.is_board:
        return f"{target.kind}, {target.columns} × {target.rows}, {figure_of(target.pitch_m / MM, 'mm')} apart"
    n, known = len(target.names), "" if target.model_known else ", positions not measured"
    return f"{n} light{'s' * (n > 1)}: {', '.join(target.names)}{known}"
