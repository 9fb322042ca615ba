"""`armsight design`: a plan in; the deviations over its volume, what they come from and what to change, out."""

from __future__ import annotations

from collections import Counter

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras.pairing import baseline_std
from armsight.columns import POSE6_STD, POSITION
from armsight.records import Progress, Silent
from armsight.store import write_text
from armsight.store.atomic import write_json
from armsight.store.tables import cells, number
from armsight.units import MM
from armsight_lab.design.changes import VOLUME_SHARE, changes_of, reaches
from armsight_lab.design.plan import Plan, plan_of
from armsight_lab.design.records import (
    DesignCalibration,
    DesignChange,
    DesignOutput,
    DesignPart,
    DesignSimulation,
    NotMeasured,
    PointDeviation,
    Spread,
)
from armsight_lab.design.report import design_report
from armsight_lab.design.request import DesignJob
from armsight_lab.design.volume import NOISE, RIG, Forecast, forecast, size_of

SUMMARY, REPORT, MAP = "design.json", "report.html", "map.csv"
COLUMNS = (*POSITION, "status", "position_m", *POSE6_STD[:3], "orientation_rad", "noise_m", "rig_m", "why")


def run_design(job: DesignJob, progress: Progress | None = None) -> DesignOutput:
    """Work out a plan; write design.json, map.csv and report.html; return the figures as --json gives them.

    Raises UsageError, DataRefused for a plan that cannot be, DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    plan = plan_of(job)
    found = forecast(plan)
    changes = changes_of(found, job.wanted_m, progress, one_more=job.one_more)
    simulation = None
    if job.simulate:
        from armsight_lab.design.simulate import simulate_design

        simulation = simulate_design(job, found, progress)
    done = _output(job, plan, found, changes, simulation)
    job.out.mkdir(parents=True, exist_ok=True)
    write_text(job.out / MAP, _table(found))
    write_text(job.out / REPORT, design_report(done, found))
    write_json(job.out / SUMMARY, done.to_dict())
    return done


def _output(
    job: DesignJob,
    plan: Plan,
    found: Forecast,
    changes: tuple[DesignChange, ...],
    simulation: DesignSimulation | None,
) -> DesignOutput:
    wanted, reached = job.wanted_m, None if job.wanted_m is None else reaches(found, job.wanted_m)
    tried = [one.position_m for one in changes if one.position_m is not None]
    position, seen = _spread(found, found.position_m), _seen(found)
    best = min([position.p95, *tried])
    return DesignOutput(
        baseline_m=plan.rig.baseline_m if plan.rig.is_pair else None,
        focal_px=float(plan.rig.cameras[0].camera.intrinsics[0]),
        frame=plan.frame,
        deviation_in="base" if plan.arm is not None else "volume" if plan.relative else "rig",
        n_cells=len(found.measured),
        measured=float(found.measured.mean()),
        whole=float(found.whole.mean()),
        position=position,
        orientation=_spread(found, found.orientation_rad) if found.whole.any() else None,
        aligned=_aligned(plan, found),
        points=_points(found),
        parts=_parts(found),
        not_measured=_not_measured(found),
        calibration=_calibration(found),
        wanted_m=wanted,
        reached=reached,
        changes=changes,
        best_m=best,
        simulation=simulation,
        verdict=_verdict(position, found, wanted, changes, best),
        advice=_advice(plan, found, simulation),
        assumptions=plan.assumptions,
        report=str(job.out / REPORT),
        seen=seen if not plan.rig.is_pair or plan.link_radius_m or job.one_more else None,
    )


def _spread(found: Forecast, values: Array) -> Spread:
    known = values[np.isfinite(values)]
    worst = int(np.nanargmax(values))
    x, y, z = found.cells.xyz_m[worst].tolist()
    return Spread(
        median=float(np.median(known)),
        p95=float(np.percentile(known, 95.0)),
        worst=float(values[worst]),
        worst_at_m=(x, y, z),
    )


def _aligned(plan: Plan, found: Forecast) -> Spread | None:
    """Return the deviation of the position once what the whole volume shares is taken away."""
    if plan.arm is not None or not found.can_align:
        return None
    if plan.relative:
        return _spread(found, found.position_m)
    other = found.within_volume()
    return _spread(found, other.position_m)


def _points(found: Forecast) -> tuple[PointDeviation, ...]:
    values, target = found.point_m(), found.plan.target
    each = [("corners", values.ravel())] if target.is_board else zip(target.names, values.T, strict=True)
    out = []
    for name, column in each:
        known = column[np.isfinite(column)]
        if len(known):
            median, p95, worst = np.percentile(known, [50.0, 95.0, 100.0]).tolist()
            out.append(PointDeviation(name=name, median_m=median, p95_m=p95, worst_m=worst))
    return tuple(out)


def _parts(found: Forecast) -> tuple[DesignPart, ...]:
    total = float(np.trace(found.covariance[found.measured, :3, :3], axis1=1, axis2=2).sum())
    out = []
    for name, C in found.parts.items():
        of_position = np.trace(C[found.measured, :3, :3], axis1=1, axis2=2)
        turned = np.trace(C[found.whole, 3:, 3:], axis1=1, axis2=2)
        out.append(
            DesignPart(
                name=name,
                position_m=float(np.sqrt(of_position.mean())),
                orientation_rad=float(np.sqrt(turned.mean())) if len(turned) else None,
                share=float(of_position.sum() / total),
            )
        )
    return tuple(sorted(out, key=lambda part: -part.share))


def _not_measured(found: Forecast) -> tuple[NotMeasured, ...]:
    counts: Counter[tuple[str, bool]] = Counter()
    for why, measured, whole in zip(found.why, found.measured.tolist(), found.whole.tolist(), strict=True):
        if not whole:
            counts[why, measured] += 1
    n = len(found.measured)
    return tuple(NotMeasured(why=why, share=k / n, position=there) for (why, there), k in counts.most_common())


def _seen(found: Forecast) -> dict[str, float]:
    """Return the share of the lights that each camera sees over the volume."""
    return dict(zip(found.rig.names, found.expected.seen.mean(axis=(0, 1)).tolist(), strict=True))


def _calibration(found: Forecast) -> DesignCalibration:
    covariance = found.rig.covariance
    std = {} if covariance is None else covariance.std()
    first, *others = found.rig.names
    turns = [std.get(f"{other}.{name}", 0.0) for other in others for name in ("rx", "ry", "rz")]
    return DesignCalibration(
        views=None if found.views is None else len(found.views),
        baseline_std_m=baseline_std(found.rig) if found.rig.is_pair else None,
        focal_std_px=std.get(f"{first}.fx", 0.0),
        turn_std_rad=max(turns, default=0.0),
    )


def _verdict(
    position: Spread, found: Forecast, wanted: float | None, changes: tuple[DesignChange, ...], best: float
) -> str:
    share = f"in {100.0 * found.measured.mean():.0f} % of the volume"
    said = (
        f"The position will be off by {_mm(position.median)} (median), {_mm(position.p95)} in 95 % of what is measured"
    )
    text = f"{said}; it is measured {share}."
    if wanted is None:
        return text
    if reaches(found, wanted):
        return f"{text} The wanted {_mm(wanted)} are reached."
    first = next((one for one in changes if one.sufficient), None)
    if first is not None:
        return f"{text} The wanted {_mm(wanted)} are not reached as planned; they are by {first.change}."
    text = f"{text} The wanted {_mm(wanted)} cannot be reached by what was tried"
    if best > wanted:
        return f"{text}; the best is {_mm(best)}."
    most = max([found.measured.mean(), *(one.measured for one in changes)])
    return (
        f"{text}: what is measured would come to {_mm(best)}, but at most {100.0 * most:.0f} % of the volume is "
        f"measured, and {100.0 * VOLUME_SHARE:.0f} % are wanted."
    )


def _mm(value_m: float) -> str:
    return f"{value_m / MM:.3g} mm"


def _advice(plan: Plan, found: Forecast, simulation: DesignSimulation | None) -> tuple[str, ...]:
    parts, out = _parts(found), []
    if not found.rig.is_pair or plan.link_radius_m:
        each = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in _seen(found).items())
        out.append(f"of the lights over the volume the cameras see: {each}")
    if not found.whole.any():
        if len(plan.target.names) < 3:
            lights = "one light" if len(plan.target.names) == 1 else "two lights"
            out.append(f"a target of {lights} tells its position alone: take three lights or more for an orientation")
        else:
            out.append("the lights tell no orientation anywhere in the volume: place them further apart")
    least = {
        NOISE: "the mean of several frames, larger or more lights, a longer baseline",
        RIG: "more pictures of the board, a larger board, or an alignment of the volume (--relative)",
    }.get(parts[0].name)
    if least is not None and parts[0].share > 0.5:
        out.append(f"the {parts[0].name} makes {100.0 * parts[0].share:.0f} % of the variance: {least} would help most")
    if plan.relative:
        out.append("deviations are those within the volume: what moves or turns all of it alike is not in them")
    if found.measured.mean() < 1.0:
        most = next(one for one in _not_measured(found) if not one.position)
        out.append(f"{100.0 * (1.0 - found.measured.mean()):.0f} % of the volume is not measured, mostly: {most.why}")
    if simulation is not None and not simulation.agrees:
        out.append(
            f"the simulation does not agree ({simulation.ratio_position:.2f} times the position's deviation): do not "
            "rely on these figures"
        )
    return tuple(out)


def _table(found: Forecast) -> str:
    """Return map.csv."""
    C, rows = found.covariance, [",".join(COLUMNS)]
    std = np.sqrt(np.diagonal(C, axis1=1, axis2=2)[:, :3])
    noise, of_rig = (size_of(found.parts[name][:, :3, :3]) for name in (NOISE, RIG))
    for i, xyz in enumerate(found.cells.xyz_m):
        status = "ok" if found.whole[i] else "position_only" if found.measured[i] else "not_measured"
        turn = number(float(found.orientation_rad[i])) if found.whole[i] else ""
        of = [number(float(value)) for value in (noise[i], of_rig[i])]
        values = ",".join([number(float(found.position_m[i])), cells(std[i]), turn, *of])
        values = values if found.measured[i] else "," * (len(COLUMNS) - 6)
        rows.append(f"{cells(xyz)},{status},{values},{found.why[i]}")
    return "\n".join(rows) + "\n"
