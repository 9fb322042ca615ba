"""Half-hidden lights: is a pose from a light that an edge covers in part ever called good beyond its claim?

Composites (composites.py) with something before one light of the target, 10 to 95 % of its light gone in one view or
both: straight and round edges, sharp and soft, dark, grey and textured, some over two lights. The same pictures
without it are the controls. A third of the cases is a track of three pairs of which the last is covered. Truth, light
and cover are drawn by code that shares nothing with the product. `--traced`: the same question to the product's
simulation, which shares nothing with composites: a card, a hand or a cable traced ray by ray between light and cameras.

    python benchmarks/half_hidden.py                       # 500 covered cases and their controls
    python benchmarks/half_hidden.py --traced --cases 90
    python benchmarks/half_hidden.py --write FOLDER --seeds 3 17
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from armsight.errors import ArmsightError
from armsight.measure.poses import solving
from armsight.measure.poses.outcome import Track
from armsight.measure.poses.pipeline import Setup, measure_pair, warm_up
from armsight.optics import Rig
from armsight.records import Frame, PoseStatus, Target
from armsight.store import rig_from_mapping, target_from_mapping
from armsight_sim import LedCellOptions, led_cell
from armsight_sim.camera import SimCamera
from armsight_sim.cell import Cell
from armsight_sim.rooms.occluders import EDGE_BLUR_PX, make_occluder
from backdrops import photographs
from bench import machine, table
from composites import SIDES, Composite, composite
from lights import Array, Disc, Lens, image_of, shine
from scenes import psf_of
from verdicts import pose_error, reason, share, spread
from webcam import Light

STEP_S = 1.0 / 30.0
SEQUENCE = 3
"""Pairs of a track; the last one is covered."""
BEYOND = float(chi2.isf(1e-3, 6))
SIGMAS = 3.0
BISECTIONS = 9
LEAST_HIDDEN, MOST_HIDDEN = 0.1, 0.95


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hidden:
    """What one cover does: light, views, and the share of it that is gone in each view; how the edge looks."""

    light: int
    shares: tuple[float, float]
    edge: str
    soft_px: float
    shade: str
    others: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What became of one pair. error (6,), covariance (6, 6) where the status is ok; reasons: counted words."""

    status: str
    why: str
    error: Array | None = None
    covariance: Array | None = None

    @property
    def ok(self) -> bool:
        """Whether there is a complete pose."""
        return self.error is not None

    @property
    def mm(self) -> float:
        """Error of the position."""
        return np.nan if self.error is None else 1e3 * float(np.linalg.norm(self.error[:3]))

    @property
    def claimed_mm(self) -> float:
        """What is claimed of it: one standard deviation of all three coordinates."""
        return np.nan if self.covariance is None else 1e3 * float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def chi2(self) -> float:
        """Squared error over its claim, six degrees of freedom."""
        if self.error is None or self.covariance is None:
            return np.nan
        return float(self.error @ np.linalg.solve(self.covariance, self.error))

    @property
    def beyond(self) -> bool:
        """Whether the pose is called good and is beyond 99.9 % of its claim."""
        return self.ok and self.chi2 > BEYOND

    @property
    def three_sigma(self) -> bool:
        """Whether one of its six numbers is off by more than three claimed standard deviations."""
        if self.error is None or self.covariance is None:
            return False
        return bool((np.abs(self.error) > SIGMAS * np.sqrt(np.diag(self.covariance))).any())


SETS = {
    "covered": "covered",
    "control": "control",
    "covered -": "covered, no diameter in the target",
    "control -": "control, no diameter in the target",
    "covered, blind": "covered, outlines not looked at",
    "control, blind": "control, outlines not looked at",
}


class Edge:
    """A cover that is put before one light, drawn by its own seed; `made` says what it did."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 777])
        self.made: Hidden | None = None

    def __call__(self, lit: list[Light], lenses: list[Lens], discs: list[Disc], settings: Mapping[str, object]) -> None:
        """Cover the light in both sensors' light, in place."""
        rng = self.rng
        light = int(rng.integers(len(discs)))
        views = [0, 1] if rng.uniform() < 0.65 else [int(rng.integers(2))]
        wanted = float(rng.uniform(LEAST_HIDDEN, MOST_HIDDEN))
        edge = str(rng.choice(["straight", "round", "hollow"], p=[0.5, 0.35, 0.15]))
        soft = float(rng.uniform(0.4, 0.8) if rng.uniform() < 0.6 else np.exp(rng.uniform(np.log(0.8), np.log(4.0))))
        shade = str(rng.choice(["dark", "grey", "textured"], p=[0.45, 0.25, 0.3]))
        curve, wide, deep = rng.uniform(0.8, 5.0), rng.uniform(1.2, 6.0), rng.uniform(1.5, 6.0)
        angle, paint = rng.uniform(0.0, 2.0 * np.pi), self._paint(shade)
        shares, others = [0.0, 0.0], 0
        for side in views:
            lens, view = lenses[side], lit[side]
            share_here = float(np.clip(wanted + rng.normal(0.0, 0.12), LEAST_HIDDEN, MOST_HIDDEN))
            turned = angle + rng.normal(0.0, 0.1)
            weights = [light_of(lens, disc, settings) for disc in discs]
            reach = image_of(lens, discs[light])[2] + 2.0 * float(settings["psf_sigma_px"])  # type: ignore[arg-type]
            form = Form(edge, turned, reach, curve, wide, deep, soft)
            at = place(form, weights[light], share_here)
            mask = form.mask(view.shape[:2], weights[light].middle, at)
            lost = [w.lost(mask) for w in weights]
            shares[side] = lost[light]
            others = max(others, sum(x > 0.02 for k, x in enumerate(lost) if k != light))
            soft_mask = mask[..., None].astype(np.float32)
            view *= 1.0 - soft_mask
            view += soft_mask * paint(view.shape)
        self.made = Hidden(
            light=light, shares=(shares[0], shares[1]), edge=edge, soft_px=soft, shade=shade, others=others
        )

    def hidden(self) -> Hidden:
        """Return what it did."""
        if self.made is None:
            raise RuntimeError("nothing was covered yet")
        return self.made

    def _paint(self, shade: str):  # type: ignore[no-untyped-def]
        rng = self.rng
        if shade == "dark":
            level = rng.uniform(0.002, 0.02)
            return lambda shape: np.float32(level)
        if shade == "grey":
            level = rng.uniform(0.03, 0.35)
            return lambda shape: np.float32(level)
        photo = photographs()[2][int(rng.integers(15))]
        exposure, mirrored = np.float32(rng.uniform(0.15, 0.9)), rng.uniform() < 0.5

        def textured(shape: tuple[int, ...]) -> Light:
            part = cv2.resize(photo[:, ::-1] if mirrored else photo, (shape[1], shape[0]))
            return np.asarray(exposure * part)

        return textured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weights:
    """What one light adds to each pixel (n, n) of a crop from (x0, y0); its middle in the picture."""

    x0: int
    y0: int
    shine: Array
    middle: Array

    def lost(self, mask: Array) -> float:
        """Return the share of it that a mask (h, w) takes away."""
        n = len(self.shine)
        y, x = np.mgrid[self.y0 : self.y0 + n, self.x0 : self.x0 + n]
        inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
        return float((self.shine[inside] * mask[y[inside], x[inside]]).sum() / self.shine.sum())


def light_of(lens: Lens, disc: Disc, settings: Mapping[str, object]) -> Weights:
    """Return where a light's own light falls, without halo and motion."""
    patch = shine(lens, disc, {**psf_of(settings), "halo": 0.0}, np.zeros(2))
    return Weights(x0=patch.x0, y0=patch.y0, shine=patch.shine, middle=image_of(lens, disc)[1])


@dataclass(frozen=True, slots=True)
class Form:
    """An edge in px: angle into the cover, the light's reach, curve, width and depth in reaches, softness."""

    edge: str
    angle: float
    reach: float
    curve: float
    wide: float
    deep: float
    soft_px: float

    def mask(self, shape: tuple[int, int], middle: Array, at: float) -> Array:
        """Return (h, w) in 0..1 of a cover whose edge stands `at` px behind the middle along its angle."""
        out = np.zeros(shape)
        far = (1.0 + 2.0 * max(self.curve, self.wide, self.deep)) * self.reach + 12.0 * self.soft_px + abs(at)
        x0, y0 = np.maximum(middle - far, 0.0).astype(int)
        x1, y1 = np.minimum(middle + far, (shape[1], shape[0])).astype(int)
        y, x = np.mgrid[y0:y1, x0:x1]
        out[y0:y1, x0:x1] = self.inside(x - middle[0], y - middle[1], at)
        return out

    def inside(self, x: Array, y: Array, at: float) -> Array:
        """Return the cover at places beside the light's middle."""
        along = x * np.cos(self.angle) + y * np.sin(self.angle) - at
        across = -x * np.sin(self.angle) + y * np.cos(self.angle)
        if self.edge == "round":
            r = self.curve * self.reach
            d = r - np.hypot(along - r, across)
        else:
            d = along
            if self.edge == "hollow":  # the edge bends about the light
                r = (0.8 + self.curve) * self.reach
                d = np.hypot(along + r, across) - r
            deep, wide = self.deep * self.reach + 4.0 * self.soft_px, self.wide * self.reach + 4.0 * self.soft_px
            d = np.minimum(d, np.minimum(deep - along, wide - np.abs(across)))
        return np.asarray(soft_step(d / self.soft_px))


def soft_step(z: Array) -> Array:
    """Return the normal distribution function, nearly (Bowling et al. 2009): 0 to 1."""
    z = np.clip(z, -8.0, 8.0)
    return 1.0 / (1.0 + np.exp(-(0.07056 * z**3 + 1.5976 * z)))


def place(form: Form, weights: Weights, wanted: float) -> float:
    """Return the place of the edge that takes the wanted share of the light, as nearly as this form can."""
    n = len(weights.shine)
    y, x = np.mgrid[weights.y0 : weights.y0 + n, weights.x0 : weights.x0 + n]
    x, y, total = x - weights.middle[0], y - weights.middle[1], weights.shine.sum()
    near, far = -form.reach - 4.0 * form.soft_px, form.reach + 4.0 * form.soft_px
    for _ in range(BISECTIONS):  # the further off the edge, the less it takes
        at = 0.5 * (near + far)
        takes = (weights.shine * form.inside(x, y, at)).sum() > wanted * total
        near, far = (at, far) if takes else (near, at)
    return 0.5 * (near + far)


def settings_of(seed: int) -> dict[str, object]:
    """Return what is pinned for a seed: dark for half of them, never a light hidden for another reason."""
    pinned: dict[str, object] = {"hidden": False, "decoys": 0, "width": 1280 if seed % 5 == 0 else 640}
    return pinned | ({"dark": True} if seed % 2 else {})


def tracked(seed: int) -> bool:
    """Whether the seed's case is a track."""
    return seed % 3 == 2


def case(seed: int) -> tuple[list[Composite], list[Composite], Hidden]:
    """Return the pairs of a case with the last one covered, the same uncovered, and what the cover did."""
    edge = Edge(seed)
    if not tracked(seed):
        made = composite(seed, edge, **settings_of(seed))
        return [made], [composite(seed, **settings_of(seed))], edge.hidden()
    rng = np.random.default_rng([seed, 778])
    first = composite(seed, **settings_of(seed))
    moving = rng.uniform() < 0.6
    way = rng.normal(size=3) * [1.0, 1.0, 0.5] * (0.004 if moving else 0.0)
    turn = rng.normal(size=3) * (0.02 if moving else 0.0)
    pairs = []
    for k in range(SEQUENCE):
        T = np.array(first.T_rig_target)
        T[:3, 3] += (k - SEQUENCE + 1) * way
        T[:3, :3] = Rotation.from_rotvec((k - SEQUENCE + 1) * turn).as_matrix() @ T[:3, :3]
        pinned = {"T_rig_target": T, "diameter_m": first.settings["diameter_m"], "camera_seed": 10_000 * (k + 1) + seed}
        pairs.append(composite(seed, **settings_of(seed), **pinned))
    covered = composite(seed, edge, **settings_of(seed), **pinned)
    return [*pairs[:-1], covered], pairs, edge.hidden()


@contextmanager
def blind() -> Iterator[None]:
    """Nothing looks at outlines within."""
    look = solving.compare
    solving.compare = lambda *_: (solving.outlines.NO_DOUBT, np.zeros((0, 0, 0)))
    try:
        yield
    finally:
        solving.compare = look


class Shown(Protocol):
    """What a case is made of: pictures of one moment, what the product is asked with, and the truth (4, 4)."""

    @property
    def rig(self) -> Rig: ...

    @property
    def target(self) -> Target: ...

    @property
    def T_rig_target(self) -> Array: ...

    def frames(self, t_s: float = 0.0, sequence: int = 0) -> tuple[Frame, Frame]: ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traced:
    """A moment of a simulated cell, number `index` of its frames."""

    cell: Cell
    index: int

    @property
    def rig(self) -> Rig:
        """The cell's rig."""
        return rig_from_mapping(self.cell.rig, "rig")

    @property
    def target(self) -> Target:
        """The cell's target."""
        return target_from_mapping(self.cell.target, "target")

    @property
    def T_rig_target(self) -> Array:
        """The true pose."""
        return np.asarray(self.cell.path(np.array([self.index / self.cell.fps]))[0].as_matrix())

    def frames(self, t_s: float = 0.0, sequence: int = 0) -> tuple[Frame, Frame]:
        """Return the pictures as frames of one moment."""
        return tuple(replace(frame, t_s=t_s, sequence=sequence) for frame in self.cell.pair(self.index))  # type: ignore[return-value]


def traced_case(seed: int) -> tuple[list[Traced], list[Traced], Hidden]:
    """Return as `case` the pairs of a simulated cell with something traced before one light, and without it."""
    rng = np.random.default_rng([seed, 779])
    options = LedCellOptions(
        width=1280 if seed % 5 == 0 else 640,
        height=720 if seed % 5 == 0 else 360,
        level=float(np.exp(rng.uniform(np.log(120.0), np.log(900.0)))),
        sigma_px=float(rng.uniform(0.7, 1.8)),
        diameter_m=float(rng.uniform(0.003, 0.012)) if rng.uniform() < 0.75 else None,
        hot_pixels=0,
        faults=False,
    )
    room = "dark" if seed % 2 else str(rng.choice(["workshop", "office", "plain"]))
    cell = led_cell(seed, 30, options, room=room, pipeline=str(rng.choice(["ideal", "machine", "webcam"])))
    index, light = int(rng.integers(SEQUENCE, 30)), int(rng.integers(len(cell.lights)))
    while True:
        kind, cameras = put_before(cell, index, light, rng)
        covered = replace(cell, cameras=cameras)
        shares = [[lost(cell, covered, side, index, k) for k in range(len(cell.lights))] for side in SIDES]
        mine = (shares[0][light], shares[1][light])
        most = max(x for side in shares for k, x in enumerate(side) if k != light)
        if LEAST_HIDDEN <= max(mine) <= MOST_HIDDEN and most < MOST_HIDDEN:
            break
    others = max(sum(x > 0.02 for k, x in enumerate(side) if k != light) for side in shares)
    first = index - SEQUENCE + 1 if tracked(seed) else index
    pairs = [Traced(cell=cell, index=k) for k in range(first, index + 1)]
    what = Hidden(light=light, shares=mine, edge=kind, soft_px=EDGE_BLUR_PX, shade="grey", others=others)
    return [*pairs[:-1], Traced(cell=covered, index=index)], pairs, what


def put_before(cell: Cell, index: int, light: int, rng: np.random.Generator) -> tuple[str, dict[str, SimCamera]]:
    """Return what stands before a light, its edge or middle near it, and cameras of which one or both look past it."""
    t_s = index / cell.fps
    place = cell.path(np.array([t_s]))[0].apply(np.array(cell.lights[light].xyz_m))
    kind = str(rng.choice(["card", "hand", "cable"], p=[0.6, 0.25, 0.15]))
    camera = cell.cameras[SIDES[int(rng.integers(2))]]
    eye, nearer, size = np.asarray(camera.T_world_camera.translation), rng.uniform(0.85, 0.99), rng.uniform(0.015, 0.05)
    at = eye + nearer * (place - eye)
    px_m = at[2] / camera.lens.focal_px[0]
    off_m = rng.uniform(-6.0, 6.0, 2) * px_m
    if kind == "card":  # one of its four edges near the light
        axis = int(rng.integers(2))
        off_m[axis] += rng.choice([-0.5, 0.5]) * size
        off_m[1 - axis] = rng.uniform(-0.3, 0.3) * size
    elif kind == "hand":
        off_m += rng.uniform(-0.5, 0.5, 2) * size
    at[:2] += off_m
    thing = make_occluder(
        kind, size_m=size, from_m=at, to_m=at, first_s=t_s - 1e-6, last_s=t_s + 1e-3,
        level=float(np.exp(rng.uniform(np.log(10.0), np.log(400.0)))), seed=int(rng.integers(1 << 30)),
    )  # fmt: skip
    both = rng.uniform() < 0.65
    return kind, {
        side: replace(one, occluders=(thing,)) if both or one is camera else one for side, one in cell.cameras.items()
    }


def lost(cell: Cell, covered: Cell, side: str, index: int, light: int) -> float:
    """Return the share of a light's light on a sensor that a cover takes away."""
    t_s, hidden_too = index / cell.fps, frozenset(one.name for one in cell.lights)
    alone = hidden_too - {cell.lights[light].name}
    falls = [
        float(
            (
                c.light(cell.lights, cell.path, t_s, hidden=alone)
                - c.light(cell.lights, cell.path, t_s, hidden=hidden_too)
            ).sum()
        )
        for c in (cell.cameras[side], covered.cameras[side])
    ]
    return 1.0 - falls[1] / falls[0]


def measure(pairs: Sequence[Shown], *, diameter: bool) -> Outcome:
    """Return what the product makes of the last pair, the others before it as its track."""
    target = pairs[0].target if diameter else without_diameter(pairs[0])
    setup, track = Setup(pairs[0].rig, target), None
    for k, made in enumerate(pairs):
        try:
            measured = measure_pair(setup, *made.frames(k * STEP_S, k), track)
        except ArmsightError as error:
            return Outcome(status="raised", why=str(error.cause))
        track = measured.track if isinstance(measured.track, Track) else None
    pose = measured.pose
    if pose.status is not PoseStatus.OK or pose.T_parent_target is None:
        return Outcome(status=str(pose.status), why=pose.why)
    error = pose_error(pose.T_parent_target, pairs[-1].T_rig_target)
    return Outcome(status=str(pose.status), why="", error=error, covariance=pose.covariance)


def without_diameter(made: Shown) -> Target:
    """Return the target without the size of its lights."""
    return replace(made.target, diameter_m=None)


def summary(title: str, rows: Sequence[tuple[str, Sequence[Outcome]]]) -> None:
    """Print a row for each set of outcomes."""
    out = []
    for name, mine in rows:
        ok = [o for o in mine if o.ok]
        states = Counter(o.status for o in mine)
        worst = max(ok, key=lambda o: o.mm, default=None)
        out.append(
            [
                name,
                len(mine),
                len(ok),
                states["position_only"],
                states["lost"] + states["raised"],
                sum(o.beyond for o in ok),
                share(sum(o.beyond for o in ok), len(ok)),
                sum(o.three_sigma for o in ok),
                share(sum(o.three_sigma for o in ok), len(ok)),
                share(sum(o.chi2 <= chi2.ppf(0.95, 6) for o in ok), len(ok)),
                spread([o.chi2 for o in ok], 6),
                f"{worst.mm:.2f} ({worst.claimed_mm:.2f})" if worst else "-",
                float(np.median([o.mm for o in ok])) if ok else np.nan,
                float(np.median([o.claimed_mm for o in ok])) if ok else np.nan,
            ]
        )
    head = ["", "n", "ok", "position only", "lost", "beyond 99.9 %", "% of ok", "over 3 sigma", "% of ok"]
    head += ["in 95 %", "middle error / claim", "worst mm (claimed)", "median mm", "median claimed mm"]
    table(title, head, out)


def groups(seeds: Sequence[int], hidden: Mapping[int, Hidden], outcomes: Mapping[int, Outcome]) -> None:
    """Print the covered cases by what covers them."""

    def rows(names: Mapping[str, Sequence[int]]) -> list[tuple[str, Sequence[Outcome]]]:
        return [(name, [outcomes[s] for s in mine]) for name, mine in names.items()]

    def by(test) -> Sequence[int]:  # type: ignore[no-untyped-def]
        return [s for s in seeds if test(hidden[s])]

    bins = ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 1.01))
    names = {
        f"{100 * a:.0f}-{min(100 * b, 100):.0f} % gone": by(lambda h, a=a, b=b: a <= max(h.shares) < b) for a, b in bins
    }
    names |= {f"edge {k}": by(lambda h, k=k: h.edge == k) for k in sorted({h.edge for h in hidden.values()})}
    names |= {f"{k} cover": by(lambda h, k=k: h.shade == k) for k in sorted({h.shade for h in hidden.values()})}
    names |= {"sharp": by(lambda h: h.soft_px < 0.8), "soft": by(lambda h: h.soft_px >= 0.8)}
    names |= {"one view": by(lambda h: min(h.shares) == 0.0), "both views": by(lambda h: min(h.shares) > 0.0)}
    names |= {"one light": by(lambda h: h.others == 0), "more lights": by(lambda h: h.others > 0)}
    names |= {"single": [s for s in seeds if not tracked(s)], "tracked": [s for s in seeds if tracked(s)]}
    names |= {"dark room": [s for s in seeds if s % 2], "before photographs": [s for s in seeds if not s % 2]}
    summary("Covered, by kind", rows(names))


def claims(outcomes: Mapping[str, Mapping[int, Outcome]]) -> None:
    """Print how much more is claimed of poses, and how many are given up, than without a look at outlines."""
    rows = []
    for name in ("covered", "control"):
        before, now = outcomes[f"{name}, blind"], outcomes[name]
        given = [s for s, o in before.items() if o.ok]
        kept = [s for s in given if now[s].ok]
        ratios = np.array([now[s].claimed_mm / before[s].claimed_mm for s in kept])
        medians = [float(np.median([set_[s].claimed_mm for s in kept])) if kept else np.nan for set_ in (before, now)]
        rows.append(
            [
                name,
                len(given),
                share(len(given) - len(kept), len(given)),
                *medians,
                100.0 * (medians[1] / medians[0] - 1.0),
                share(int((ratios > 1.01).sum()), len(kept)),
            ]
        )
    head = ["", "ok, blind", "% given up", "median claimed mm, blind", "now", "% more", "% that claim more"]
    table("Against the same without a look at outlines", head, rows)


def main() -> None:
    """Print outcomes of covered cases beside their controls."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--traced", action="store_true", help="simulated cells in place of composites")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, nargs="+")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="only write the pictures of --seeds")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="a CSV file for one row a case")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    seeds = options.seeds or list(range(options.first, options.first + options.cases))
    if options.write:
        write_pictures(options.write, seeds)
        return
    print(machine())
    warm_up()
    made: dict[int, Hidden] = {}
    outcomes: dict[str, dict[int, Outcome]] = {name: {} for name in SETS}
    for seed in seeds:
        covered, control, made[seed] = traced_case(seed) if options.traced else case(seed)
        for name, pairs in (("covered", covered), ("control", control)):
            outcomes[name][seed] = measure(pairs, diameter=True)
            outcomes[f"{name} -"][seed] = measure(pairs, diameter=False)
            with blind():
                outcomes[f"{name}, blind"][seed] = measure(pairs, diameter=True)
    rows = [(title, list(outcomes[name].values())) for name, title in SETS.items()]
    summary("Half-hidden lights", rows)
    claims(outcomes)
    groups(seeds, made, outcomes["covered"])
    counted = Counter(reason(o.why) for o in outcomes["covered"].values() if not o.ok)
    before = Counter(reason(o.why) for o in outcomes["control"].values() if not o.ok)
    table(
        "Why there was no whole pose",
        ["why", "covered", "controls"],
        [[w, n, before[w]] for w, n in (counted | before).most_common(12)],
    )
    table("The worst beyond their claim", WORST_HEAD, worst_rows(made, outcomes))
    if options.rows:
        write_rows(options.rows, seeds, made, outcomes)


WORST_HEAD = ["seed", "set", "mm", "claimed mm", "chi2", "gone left, right", "edge", "soft px", "cover", "others"]


def worst_rows(hidden: Mapping[int, Hidden], outcomes: Mapping[str, Mapping[int, Outcome]]) -> list[list[object]]:
    """Return rows of the poses that mislead most."""
    beyond = [(name, s, o) for name in tuple(SETS)[:4] for s, o in outcomes[name].items() if o.beyond]
    rows = []
    for name, seed, o in sorted(beyond, key=lambda x: -x[2].chi2)[:40]:
        h = hidden[seed]
        gone = f"{100 * h.shares[0]:.0f}, {100 * h.shares[1]:.0f} %"
        rows.append([seed, name, o.mm, o.claimed_mm, o.chi2, gone, h.edge, h.soft_px, h.shade, h.others])
    return rows


def write_rows(
    file: Path, seeds: Sequence[int], hidden: Mapping[int, Hidden], outcomes: Mapping[str, Mapping[int, Outcome]]
) -> None:
    """Write one row for each case and set."""
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(
            ["seed", "set", "status", "mm", "claimed_mm", "chi2", "beyond", "over_3_sigma", "left", "right"]
        )
        for name, mine in outcomes.items():
            for s in seeds:
                o = mine[s]
                row = [s, name, o.status, o.mm, o.claimed_mm, o.chi2, o.beyond, o.three_sigma, *hidden[s].shares]
                writer.writerow(row)


def write_pictures(folder: Path, seeds: Sequence[int]) -> None:
    """Write the covered pairs of some seeds, with what covers them."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        pairs, _, what = case(seed)
        for side, picture in zip(SIDES, (pairs[-1].left, pairs[-1].right), strict=True):
            cv2.imwrite(str(folder / f"{seed:05d}-{side}.png"), picture)
        print(seed, what)


if __name__ == "__main__":
    main()
