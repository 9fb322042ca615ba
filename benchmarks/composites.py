"""Stereo pictures of lit targets before photographs of ordinary rooms, with truth; the same seed gives the same ones.

Lights are drawn ray by ray with the optics of `lights.py`, before the backdrops of `backdrops.py`, and go through the
camera of `webcam.py`: no code is shared with the product or its simulation, but for the records that it is asked with.

    composite(7)                                        # everything at random
    composite(7, curve="linear", background="dark")     # one stage or more pinned; DEFAULTS names them all

`--check` compares the generator with itself; `--write FOLDER` writes pictures to look at.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.optics import Camera, Rig, RigKind
from armsight.records import Frame, Target, spot_target
from backdrops import draw_backdrop
from lights import Array, Disc, Lens, image_of, shine
from scenes import (
    ISOSCELES,
    SIDES,
    SIZES,
    diameter_of,
    draw_lenses,
    draw_light,
    draw_pose,
    draw_scene,
    draw_triangle,
    motion_of,
    psf_of,
)
from webcam import Light, Picture, develop, draw_webcam

Cover = Callable[[list[Light], list[Lens], list[Disc], Mapping[str, object]], None]
"""Changes the light on both sensors, given the lenses, the target's lights and the settings."""

CLEAR = 25.0
"""Grey levels above nine tenths of its surroundings that a light must reach to count as standing clear."""

STAGES = ("rig", "target", "pose", "scene", "camera")
"""Streams of random numbers: `rig_seed=` and so on pin one of them while the others follow the seed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """One light in one picture: pixel of its centre in space and of its image's centre of area, and what it looks like.

    radius_px: of the sharp image, 0 for a point. level: peak before clipping, full scale 1. visible: not covered.
    contrast: grey levels of its middle above nine tenths of the ring about it, in the finished picture: little where
    the light is faint, or stands before or beside something as bright.
    """

    name: str
    side: str
    u_px: float
    v_px: float
    u_disc_px: float
    v_disc_px: float
    radius_px: float
    level: float
    contrast: float
    visible: bool

    @property
    def clear(self) -> bool:
        """Whether it is visible and stands out from all that is around it."""
        return self.visible and self.contrast >= CLEAR

    @property
    def uv_disc(self) -> Array:
        """The centre of area (2,)."""
        return np.array([self.u_disc_px, self.v_disc_px])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Composite:
    """Two pictures, what the product is asked with, and the truth. T_rig_target: (4, 4)."""

    seed: int
    left: Picture
    right: Picture
    rig: Rig
    target: Target
    T_rig_target: Array
    lights: tuple[Truth, ...]
    settings: Mapping[str, object]

    def frames(self, t_s: float = 0.0, sequence: int = 0) -> tuple[Frame, Frame]:
        """Return the pictures as frames of one moment."""
        return tuple(  # type: ignore[return-value]
            Frame(image=image, t_s=t_s, sequence=sequence, source=f"composite {self.seed} {side}")
            for side, image in zip(SIDES, (self.left, self.right), strict=True)
        )

    def truth(self, side: str) -> dict[str, Truth]:
        """Return the lights of one side by name."""
        return {light.name: light for light in self.lights if light.side == side}

    @property
    def kind(self) -> str:
        """'clear' where every light stands clear in both pictures, 'hidden' where one is behind something, 'hard'."""
        if not all(light.visible for light in self.lights):
            return "hidden"
        return "clear" if all(light.clear for light in self.lights) else "hard"


def draw_shape(rng: np.random.Generator) -> dict[str, object]:
    """Return random settings of the rig's picture size and the target's kind."""
    return {
        "width": int(rng.choice(list(SIZES), p=[0.7, 0.3])),
        "target": str(rng.choice(["scalene", "isosceles"], p=[0.7, 0.3])),
    }


def draw_settings(seed: int, overrides: Mapping[str, object]) -> dict[str, object]:
    """Return the settings of a seed with what is pinned. Raises KeyError for a name that is no setting."""
    out: dict[str, object] = {f"{stage}_seed": seed for stage in STAGES}
    out["T_rig_target"] = None
    for number, draw in enumerate((draw_shape, draw_scene, draw_backdrop, draw_webcam)):
        out |= draw(np.random.default_rng([seed, 100 + number]))
    unknown = set(overrides) - set(out)
    if unknown:
        raise KeyError(f"there is no setting {', '.join(sorted(unknown))}; there are {', '.join(sorted(out))}")
    return out | dict(overrides)


DEFAULTS = tuple(draw_settings(0, {}))
"""Names of all settings that may be pinned."""


def composite(seed: int, cover: Cover | None = None, **overrides: object) -> Composite:
    """Return the composite of a seed; overrides pin settings by name. cover: puts something before the lights."""
    if overrides.pop("dark", False):
        overrides = {"background": "dark", "plate": False, "decoys": 0, "hidden": False} | overrides
    settings = draw_settings(seed, overrides)
    streams = {stage: np.random.default_rng([int(settings[f"{stage}_seed"]), i]) for i, stage in enumerate(STAGES)}
    lenses = draw_lenses(int(settings["width"]), streams["rig"])
    spots = ISOSCELES if settings["target"] == "isosceles" else draw_triangle(streams["target"])
    model = np.array(list(spots.values()))
    T = settings["T_rig_target"]
    T = draw_pose(lenses, model, streams["pose"]) if T is None else np.asarray(T, float)
    if settings["diameter_m"] is None:
        settings["diameter_m"] = diameter_of(lenses[0], T, float(settings["diameter_px"]))
    disc = settings["light"] == "disc"
    radius_m = 0.5 * float(settings["diameter_m"]) if disc else 0.0
    discs = [Disc(centre=T[:3, :3] @ p + T[:3, 3], normal=T[:3, 2], radius_m=radius_m) for p in model]
    lit, truth = draw_light(lenses, discs, list(spots), T, settings, streams["scene"])
    if cover is not None:
        cover(lit, lenses, discs, settings)
    pictures = [develop(light, settings, streams["camera"]) for light in lit]
    return Composite(
        seed=seed,
        left=pictures[0],
        right=pictures[1],
        rig=rig_of(lenses),
        target=spot_target(spots, diameter_m=2.0 * radius_m or None),
        T_rig_target=T,
        lights=tuple(with_contrast(light, pictures[SIDES.index(light["side"])]) for light in truth),
        settings=settings,
    )


def rig_of(lenses: list[Lens]) -> Rig:
    """Return the product's record of the lenses."""
    cameras = [
        Camera.pinhole(lens.width, lens.height, *lens.f, *map(float, lens.c), distortion=lens.k) for lens in lenses
    ]
    poses = [RigidTransform.from_components(lens.eye, Rotation.from_matrix(lens.R.T)) for lens in lenses]
    return Rig(kind=RigKind.STEREO, left=cameras[0], right=cameras[1], T_rig_left=poses[0], T_rig_right=poses[1])


def with_contrast(row: dict[str, object], picture: Picture) -> Truth:
    """Return the light with its contrast in the finished picture."""
    grey = picture if picture.ndim == 2 else picture.max(axis=2)
    u, v, r = round(float(row["u_disc_px"])), round(float(row["v_disc_px"])), float(row["radius_px"])
    n = int(np.ceil(r + 8.0))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    away, x, y = np.hypot(x, y), x + u, y + v
    within = (x >= 0) & (y >= 0) & (x < grey.shape[1]) & (y < grey.shape[0])
    near, far = within & (away <= 1.5), within & (away > r + 4.0) & (away < r + 8.0)
    contrast = float(np.median(grey[y[near], x[near]])) - float(np.quantile(grey[y[far], x[far]], 0.9))
    return Truth(**row, contrast=contrast)  # type: ignore[arg-type]


PLAIN: Mapping[str, object] = {
    "dark": True,
    "curve": "linear",
    "bayer": "none",
    "noise": False,
    "vignetting": 0.0,
    "denoise": False,
    "sharpen": 0.0,
    "jpeg": 0,
}
"""Nothing but the lights, as they fall on the sensor."""


def check(n: int = 40) -> None:
    """Compare lights as drawn with their truth; raises where a centroid differs by 0.005 px."""
    worst = 0.0
    for seed in range(n):
        settings, rng = draw_settings(seed, {}) | {"halo": 0.0}, np.random.default_rng(seed)
        lenses = draw_lenses(int(settings["width"]), rng)
        T = draw_pose(lenses, np.array(list(ISOSCELES.values())), rng)
        radius = 0.5 * diameter_of(lenses[0], T, float(settings["diameter_px"])) * (settings["light"] == "disc")
        disc = Disc(centre=T[:3, 3], normal=T[:3, 2], radius_m=radius)
        for lens in lenses:
            motion = motion_of(lens, disc, np.array([0.6, 0.7, 0.2]), float(settings["motion_px"]), lenses[0])
            patch = shine(lens, disc, psf_of(settings), motion)
            y, x = np.mgrid[0 : len(patch.shine), 0 : len(patch.shine)]
            at = np.array([(x * patch.shine).sum(), (y * patch.shine).sum()]) / patch.shine.sum()
            off = at + np.array([patch.x0, patch.y0]) - image_of(lens, disc)[1]
            worst = max(worst, float(np.abs(off).max()))
    print(f"{2 * n} lights: the centroid of what is drawn is within {worst:.5f} px of the centre of area")
    if worst > 0.005:
        raise RuntimeError("the lights are not drawn where the truth says")


def check_pictures(n: int = 20) -> None:
    """Compare finished plain pictures with their truth: grey levels are rounded to 8 bits, which the lights average."""
    off = []
    for seed in range(n):
        pinned = {"width": 1280, "level": 0.9, "halo": 0.0, "diameter_px": 10.0, "light_tint": (1.0, 1.0, 1.0)}
        made = composite(seed, **PLAIN, **pinned)
        for light in made.lights:
            picture = (made.left, made.right)[SIDES.index(light.side)].astype(float)
            y0, x0 = round(light.v_disc_px) - 13, round(light.u_disc_px) - 13
            part = picture[y0 : y0 + 27, x0 : x0 + 27]
            y, x = np.mgrid[y0 : y0 + 27, x0 : x0 + 27]
            off.append(np.array([(x * part).sum(), (y * part).sum()]) / part.sum() - light.uv_disc)
    print(f"{len(off)} lights in plain 8-bit pictures: {np.sqrt(np.mean(np.square(off))):.4f} px RMS per axis")


def main() -> None:
    """Check the generator, or write pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--write", type=Path, metavar="FOLDER")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(8)))
    options = parser.parse_args()
    if options.check:
        check()
        check_pictures()
    if options.write:
        options.write.mkdir(parents=True, exist_ok=True)
        for seed in options.seeds:
            made = composite(seed)
            for side, picture in zip(SIDES, (made.left, made.right), strict=True):
                cv2.imwrite(str(options.write / f"{seed:05d}-{side}.png"), picture)
            print(seed, {k: v if not isinstance(v, float) else round(v, 3) for k, v in made.settings.items()})


if __name__ == "__main__":
    main()
