"""Detection before ordinary backgrounds: ray-traced stills, composites before photographs, bad pictures.

Truth comes from other code than the product's and its simulation's; OpenCV's blob detector runs beside ours.
`--quick` takes a hundred composites; `--only NAME` runs one part. `--pin dark=True --pin jpeg=0` pins settings of the
composites; `composites.py --write FOLDER --seeds 7 38` writes pictures to look at.
"""

from __future__ import annotations

import argparse
import ast
import csv
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

from armsight.measure.poses.pipeline import Setup, warm_up
from bad_pictures import bad_pictures
from bench import machine, table
from composites import Composite, composite
from room_stills import stills
from shuffled import shuffled
from verdicts import SIDES, Array, Verdict, blob_detector, judge, near, reason, share, spread, within

REACH_PX = 1.5
"""A spot within this of a light's centre is that light."""

LEVELS = ((0.0, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 99.0))

WORST = 20
"""Cells of all settings together that are listed: there are hundreds, and few composites in each."""

CROSSES = (("curve", "sharpen"), ("curve", "level"), ("bayer", "jpeg"), ("sharpen", "level"))
FULL = ("curve", "bayer", "sharpen", "jpeg", "level")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """One composite's outcome: its settings and kind, our verdict, what the blob detector found."""

    seed: int
    kind: str
    settings: Mapping[str, object]
    visible: int
    clear: int
    found: int
    found_clear: int
    blobs_clear: int
    verdict: Verdict


def lights_of(made: Composite) -> dict[tuple[str, str], Array]:
    """Return the true centre of area of every visible light."""
    return {(light.side, light.name): light.uv_disc for light in made.lights if light.visible}


def run_case(seed: int, blobs: Callable[..., Array], **overrides: object) -> Case:
    """Measure one composite."""
    made = composite(seed, **overrides)
    lights = lights_of(made)
    verdict = judge(Setup(made.rig, made.target), made.frames(), made.T_rig_target, lights, reach_px=REACH_PX)
    clear = {(light.side, light.name) for light in made.lights if light.clear}
    at = dict(zip(SIDES, map(blobs, (made.left, made.right)), strict=True))
    return Case(
        seed=seed,
        kind=made.kind,
        settings=made.settings,
        visible=len(lights),
        clear=len(clear),
        found=len(verdict.found),
        found_clear=len(verdict.found & clear),
        blobs_clear=sum(near(at[side], lights[side, name], REACH_PX) for side, name in clear),
        verdict=verdict,
    )


def composites(n: int, first: int, pinned: Mapping[str, object], file: Path | None) -> None:
    """Print what becomes of n composites; file: where each is written in a row of its own."""
    blobs = blob_detector()
    cases = [run_case(seed, blobs, **pinned) for seed in range(first, first + n)]
    if file is not None:
        write(cases, file)
    outcome(cases)
    reasons(cases)
    wrong_ones(cases)
    quantiles(cases)
    cells(cases)


def write(cases: Sequence[Case], file: Path) -> None:
    """Write one row a composite: what was asked and what came."""
    keys = list(cases[0].settings)
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        told = ["seed", "kind", "status", "why", "found", "visible", "mm", "deg", "chi2", "chi2_position"]
        writer.writerow([*told, "worst_spot_chi2", "worst_spot_px", "models", "ms", *keys])
        for c in cases:
            v = c.verdict
            row = [c.seed, c.kind, v.status, v.why, c.found, c.visible, v.position_mm, v.orientation_deg, v.chi2]
            row += [v.chi2_position, max((s.chi2 for s in v.named), default=np.nan)]
            row += [max((float(np.linalg.norm(s.error_px)) for s in v.named), default=np.nan)]
            row += [" ".join(sorted({s.model for s in v.named})), v.ms]
            writer.writerow([*row, *(c.settings[key] for key in keys)])


def outcome(cases: Sequence[Case]) -> None:
    """Print lights found and poses given, for each kind of composite."""
    rows = []
    for kind in ("clear", "hard", "hidden", "all"):
        mine = [c for c in cases if kind in (c.kind, "all")]
        if not mine:
            continue
        states = Counter(c.verdict.status for c in mine)
        clear = sum(c.clear for c in mine)
        given = [share(states[status], len(mine)) for status in ("ok", "position_only", "lost", "raised")]
        rows.append(
            [
                kind,
                len(mine),
                share(sum(c.found for c in mine), sum(c.visible for c in mine)),
                share(sum(c.found_clear for c in mine), clear),
                share(sum(c.blobs_clear for c in mine), clear),
                *given,
                sum(c.verdict.misplaced for c in mine),
                sum(c.verdict.mistaken for c in mine),
                f"{sum(c.verdict.far for c in mine)} ({sum(c.verdict.far and c.verdict.claimed for c in mine)})",
                sum(c.verdict.beyond for c in mine),
                float(np.median([c.verdict.ms for c in mine])),
                float(np.max([c.verdict.ms for c in mine])),
            ]
        )
    head = ["composites", "n", "lights found %", "clear ones %", "blobs: clear ones %", "ok %", "position only %"]
    head += ["lost %", "raised %", "position only, misplaced", "not the lights", "far off (as claimed)", "beyond claim"]
    title = "Composites before photographs ('clear': every light stands out; far off: by 5 mm or 5 deg)"
    table(title, [*head, "ms both, median", "ms, max"], rows)


def reasons(cases: Sequence[Case]) -> None:
    """Print why poses were not given."""
    counted = Counter((c.verdict.status, reason(c.verdict.why)) for c in cases if not c.verdict.ok)
    clear = Counter((c.verdict.status, reason(c.verdict.why)) for c in cases if not c.verdict.ok and c.kind == "clear")
    rows = [[status, why, n, clear[status, why]] for (status, why), n in counted.most_common(20)]
    table("Why there was no whole pose", ["status", "why", "composites", "of them clear"], rows)


def wrong_ones(cases: Sequence[Case]) -> None:
    """List the wrong poses and positions, so that each can be looked at."""
    wrong = [c for c in cases if c.verdict.wrong or c.verdict.misplaced]
    if not wrong:
        print("\nno wrong pose")
        return
    head = ["seed", "kind", "status", "mm", "deg", "sigmas", "worst spot px", "settings"]
    title = "Wrong: far off, or beyond six sigma and 1 mm; positions without orientation where no light is"
    table(title, head, [wrong_row(c) for c in wrong])


def wrong_row(c: Case) -> list[object]:
    """Return what is wrong with a pose, and what it was made from."""
    v, s = c.verdict, c.settings
    told = f"{s['width']}, {s['target']}, {s['light']}, level {s['level']:.2f}, decoys {s['decoys']}"
    if v.claimed:
        told += "; as claimed"
    if not v.ok:
        return [c.seed, c.kind, v.status, v.place_mm, "", "", "", told]
    named = max((float(np.linalg.norm(e.error_px)) for e in v.named), default=np.nan)
    sigmas = float(np.sqrt(max(v.chi2, v.chi2_position)))
    return [c.seed, c.kind, v.status, v.position_mm, v.orientation_deg, sigmas, named, told]


def quantiles(cases: Sequence[Case]) -> None:
    """Print how squared errors over their claims are spread, beside what they should be."""
    right = right_lights(cases)
    at = (0.1, 0.5, 0.9, 0.95, 0.99, 0.999)
    rows = []
    for name, values, freedom in (
        ("pose", [v.chi2 for v in right], 6),
        ("position", [v.chi2_position for v in right], 3),
        ("spot", [s.chi2 for v in right for s in v.named], 2),
    ):
        if not values:
            continue
        should = chi2.ppf(at, freedom)
        cells = [f"{a:.2f} ({b:.2f})" for a, b in zip(np.quantile(values, at), should, strict=True)]
        rows.append([name, len(values), within(values, freedom), spread(values, freedom), *cells])
    head = ["", "n", "in 95 % ellipsoid", "middle error / claim", *[f"{100 * q:g} %" for q in at]]
    table("Squared errors over claims, poses of the right lights: quantiles (and what they should be)", head, rows)


def right_lights(cases: Sequence[Case]) -> list[Verdict]:
    """Return the verdicts on whole poses made of the target's lights: those whose covariances mean something."""
    return [c.verdict for c in cases if c.verdict.ok and not c.verdict.mistaken]


def level_bin(settings: Mapping[str, object]) -> str:
    """Return the bin of the lights' level."""
    level = float(settings["level"])  # type: ignore[arg-type]
    low, high = next((a, b) for a, b in LEVELS if a <= level < b)
    return f"level {low:g}-{high:g}" if high < 99.0 else f"level > {low:g}"


def dimensions(settings: Mapping[str, object]) -> dict[str, str]:
    """Return the cell of a composite in every dimension."""
    jpeg = settings["jpeg"]
    return {
        "curve": f"curve {settings['curve']}",
        "bayer": f"bayer {settings['bayer']}",
        "sharpen": f"sharpening {settings['sharpen']}",
        "jpeg": f"jpeg {jpeg}" if jpeg else "no jpeg",
        "level": level_bin(settings),
        "light": f"light {settings['light']}",
        "width": f"width {settings['width']}",
        "motion": "moving" if settings["motion_px"] else "still",
        "plate": "on a plate" if settings["plate"] else "no plate",
        "halo": "halo" if settings["halo"] else "no halo",
        "denoise": "denoised" if settings["denoise"] else "not denoised",
        "background": f"background {settings['background']}",
        "target": f"target {settings['target']}",
    }


def cells(cases: Sequence[Case]) -> None:
    """Print coverage in the cells of one dimension, of two, and the worst of all five."""
    head = ["", "clear", "poses %", "wrong", "pose in 95 %", "position in 95 %", "spots in 95 %", "spot error / claim"]
    for title, groups in (
        ("Coverage by one setting (± one binomial deviation)", [(name,) for name in dimensions(cases[0].settings)]),
        ("Coverage by two settings", CROSSES),
    ):
        rows = [row for group in groups for row in rows_by(cases, group)]
        table(title, head, rows)
    full = grouped(cases, FULL)
    worst = sorted((name for name in full if spots_of(full[name])), key=lambda name: -deficit(full[name]))[:WORST]
    title = f"The {len(worst)} worst of {len(full)} cells of {' x '.join(FULL)}, by their spots"
    table(title, head, [cell_row(name, full[name]) for name in worst])


def grouped(cases: Sequence[Case], names: Sequence[str]) -> dict[str, list[Case]]:
    """Return the cases by their cell in the dimensions named."""
    out: dict[str, list[Case]] = {}
    for case in cases:
        at = dimensions(case.settings)
        out.setdefault(", ".join(at[name] for name in names), []).append(case)
    return out


def rows_by(cases: Sequence[Case], names: Sequence[str]) -> list[list[object]]:
    """Return the rows of all cells in the dimensions named."""
    return [cell_row(name, mine) for name, mine in sorted(grouped(cases, names).items())]


def spots_of(cases: Sequence[Case]) -> list[float]:
    """Return the squared errors over claims of all named spots of poses of the right lights."""
    return [s.chi2 for v in right_lights(cases) for s in v.named]


def deficit(cases: Sequence[Case]) -> float:
    """Return how surely too few spots are inside their ellipses: shortfall in binomial standard deviations."""
    q = np.array(spots_of(cases))
    return float((0.95 * len(q) - (q <= chi2.ppf(0.95, 2)).sum()) / np.sqrt(len(q) * 0.95 * 0.05))


def cell_row(name: str, cases: Sequence[Case]) -> list[object]:
    """Return a cell's row: poses given where all lights stand clear, wrong ones, coverage."""
    clear = [c for c in cases if c.kind == "clear"]
    right = right_lights(cases)
    q = spots_of(cases)
    return [
        name,
        len(clear),
        share(sum(c.verdict.ok for c in clear), len(clear)),
        sum(c.verdict.wrong for c in cases),
        within([v.chi2 for v in right], 6),
        within([v.chi2_position for v in right], 3),
        within(q, 2),
        spread(q, 2),
    ]


def setting(text: str) -> tuple[str, object]:
    """Return name and value of 'name=value'."""
    name, _, value = text.partition("=")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value


def main() -> None:
    """Print all parts, or one."""
    parts = ("stills", "composites", "shuffled", "bad")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", choices=parts)
    parser.add_argument("--composites", type=int, metavar="N")
    parser.add_argument("--first", type=int, default=0, help="seed of the first composite")
    parser.add_argument("--pin", action="append", default=[], metavar="NAME=VALUE", help="a setting of all composites")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="a CSV file for one row a composite")
    options = parser.parse_args()
    quick = options.quick
    print(machine(), f"OpenCV {cv2.__version__}", sep=", ")
    cv2.setNumThreads(1)
    warm_up()
    chosen = parts if options.only is None else (options.only,)
    if "stills" in chosen:
        stills(1 if quick else 3)
    if "composites" in chosen:
        n = options.composites or (100 if quick else 2000)
        composites(n, options.first, dict(map(setting, options.pin)), options.rows)
    if "shuffled" in chosen:
        shuffled(20 if quick else 100)
    if "bad" in chosen:
        bad_pictures(3 if quick else 20)


if __name__ == "__main__":
    main()
