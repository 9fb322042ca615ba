"""A rig, a target, a pose, and the light of the scene on both sensors: drawn at random, with its truth."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from backdrops import backdrops
from lights import Array, Disc, Lens, Patch, image_of, shine
from webcam import Light

SIDES = ("left", "right")
SIZES = {1280: 720, 640: 480}
MARGIN_PX = 18.0
"""Least distance of a light's rim from the picture's edge."""

ISOSCELES = {"A": (-0.0298142397, 0.0, 0.0), "B": (0.0149071198, 0.04, 0.0), "C": (0.0149071198, -0.04, 0.0)}
"""The target of the stills in rooms/."""


def draw_scene(rng: np.random.Generator) -> dict[str, object]:
    """Return random settings of the lights and of what is near them."""
    return {
        "light": str(rng.choice(["disc", "point"], p=[0.8, 0.2])),
        "level": float(np.exp(rng.uniform(np.log(0.6), np.log(8.0)))),
        "diameter_px": float(np.exp(rng.uniform(np.log(2.0), np.log(15.0)))),
        "diameter_m": None,
        "light_tint": tuple(rng.uniform(0.85, 1.0, 3).tolist()),
        "psf_sigma_px": float(rng.uniform(0.5, 1.5)),
        "halo": float(rng.choice([0.0, 1.0], p=[0.6, 0.4]) * rng.uniform(0.01, 0.03)),
        "halo_sigma_px": float(rng.uniform(5.0, 15.0)),
        "motion_px": float(rng.choice([0.0, 1.0], p=[0.75, 0.25]) * rng.uniform(0.3, 2.0)),
        "plate": bool(rng.uniform() < 0.5),
        "plate_light": float(rng.uniform(0.005, 0.08)),
        "hidden": bool(rng.uniform() < 0.08),
        "lit": True,
        "decoys": int(rng.choice([0, 1, 2, 3], p=[0.7, 0.1, 0.1, 0.1])),
    }


def draw_lenses(width: int, rng: np.random.Generator) -> list[Lens]:
    """Return two lenses about 0.12 m apart; rig axes are the left one's."""
    height, scale = SIZES[width], width / 1280.0
    turned = Rotation.from_rotvec(rng.uniform(-0.05, 0.05, 3)).as_matrix()
    place = np.array([rng.uniform(0.11, 0.13), *rng.uniform(-0.003, 0.003, 2)])
    lenses = []
    for R, at in ((np.eye(3), np.zeros(3)), (turned, place)):
        f = scale * rng.uniform(930.0, 1080.0)
        k1 = rng.uniform(-0.12, 0.04)
        k = (k1, -0.3 * k1 + rng.uniform(-0.02, 0.02), *rng.uniform(-8e-4, 8e-4, 2), 0.0)
        c = 0.5 * np.array([width - 1, height - 1]) + rng.uniform(-14.0, 14.0, 2) * scale
        aspect = rng.uniform(0.997, 1.003)
        lenses.append(Lens(width=width, height=height, f=(f, f * aspect), c=tuple(c), k=k, R=R.T, t=-R.T @ at))
    return lenses


def draw_triangle(rng: np.random.Generator) -> dict[str, tuple[float, float, float]]:
    """Return three lights 50-90 mm apart, no two sides alike by less than 8 mm, origin at their mean, in z = 0."""
    while True:
        a, b, c = np.sort(rng.uniform(0.05, 0.09, 3))
        if min(b - a, c - b) < 0.008:
            continue
        x = (a**2 + c**2 - b**2) / (2.0 * c)
        xy = np.array([[0.0, 0.0], [c, 0.0], [x, np.sqrt(a**2 - x**2)]])
        if rng.uniform() < 0.5:
            xy[:, 1] *= -1.0
        angle = rng.uniform(0.0, 2.0 * np.pi)
        xy = (xy - xy.mean(axis=0)) @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        return {name: (float(p[0]), float(p[1]), 0.0) for name, p in zip("ABC", xy, strict=True)}


def draw_pose(lenses: list[Lens], model: Array, rng: np.random.Generator) -> Array:
    """Return T_rig_target (4, 4): 0.4-1.3 m away, up to 40 degrees from facing the rig, all lights in both pictures."""
    rim = np.vstack([model + d for d in 0.006 * np.vstack([np.eye(3)[:2], -np.eye(3)[:2]])])
    left = lenses[0]
    for _ in range(2000):
        depth = np.exp(rng.uniform(np.log(0.4), np.log(1.3)))
        ray = left.rays(rng.uniform([0, 0], [left.width - 1, left.height - 1])[None])[0]
        lean, about = np.deg2rad(rng.uniform(0.0, 40.0)), rng.uniform(0.0, 2.0 * np.pi)
        lean = Rotation.from_rotvec(lean * np.array([np.cos(about), np.sin(about), 0.0]))
        view = ray - 0.5 * lenses[1].eye / depth  # from the middle between the cameras
        face = Rotation.from_rotvec(np.cross([0.0, 0.0, 1.0], view / np.linalg.norm(view)))
        roll = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = (face * lean * roll).as_matrix(), depth * ray
        if all(inside(lens, rim @ T[:3, :3].T + T[:3, 3]) for lens in lenses):
            return T
    raise RuntimeError("no pose lies in both pictures")


def inside(lens: Lens, points: Array) -> bool:
    """Whether all points are well within the picture."""
    uv = lens.project(points)
    return bool((uv > MARGIN_PX).all() and (uv < np.array([lens.width, lens.height]) - 1.0 - MARGIN_PX).all())


def diameter_of(lens: Lens, T: Array, diameter_px: float) -> float:
    """Return the diameter in m that is as many pixels wide there, within what lights are made as."""
    depth = float(lens.depth(T[None, :3, 3])[0])
    return float(np.clip(diameter_px * depth / lens.f[0], 0.0015, 0.016))


def draw_light(
    lenses: list[Lens],
    discs: list[Disc],
    names: list[str],
    T: Array,
    settings: Mapping[str, object],
    rng: np.random.Generator,
) -> tuple[list[Light], list[dict[str, object]]]:
    """Return the light on both sensors, and the rows of the truth without what the pictures will show."""
    views = backdrops(lenses, settings, rng)
    hidden = (int(rng.integers(2)), int(rng.integers(len(discs)))) if settings["hidden"] else None
    way = rng.normal(size=3) * [1.0, 1.0, 0.3]
    way /= np.linalg.norm(way)
    factors = rng.uniform(0.85, 1.15, (2, len(discs)))
    others = draw_decoys(lenses, discs, int(settings["decoys"]), rng)
    shade = rng.uniform(0.01, 0.3, 3)
    truth = []
    for side, (lens, view) in enumerate(zip(lenses, views, strict=True)):
        if settings["plate"]:
            lay_plate(lens, view, T, discs, settings)
        for number, disc in enumerate(discs + others):
            level = float(settings["level"]) * (float(factors[side, number]) if number < len(discs) else 1.0)
            motion = motion_of(lens, disc, way, float(settings["motion_px"]), lenses[0])
            if (side, number) == hidden:
                cover_up(lens, view, disc, discs, shade)
            elif settings["lit"] or number >= len(discs):
                lay(view, shine(lens, disc, psf_of(settings), motion), level, settings)
            if number < len(discs):
                row = row_of(lens, disc, names[number], SIDES[side], level)
                truth.append(row | {"visible": bool(settings["lit"]) and (side, number) != hidden})
    return views, truth


def psf_of(settings: Mapping[str, object]) -> dict[str, float]:
    """Return what `shine` wants to know of the lens."""
    return {
        "sigma_px": float(settings["psf_sigma_px"]),
        "halo": float(settings["halo"]),
        "halo_sigma_px": float(settings["halo_sigma_px"]),
    }


def motion_of(lens: Lens, disc: Disc, way: Array, motion_px: float, left: Lens) -> Array:
    """Return the way (2,) in px of a light that moves along `way`, motion_px at most in the left picture."""
    if motion_px == 0.0:
        return np.zeros(2)
    step = 0.5 * motion_px * float(left.depth(disc.centre[None])[0]) / left.f[0] * way
    return np.asarray(lens.project((disc.centre + step)[None])[0] - lens.project((disc.centre - step)[None])[0])


def lay(view: Light, patch: Patch, level: float, settings: Mapping[str, object]) -> None:
    """Put a light into a view: it hides what is behind it and adds its own light."""
    n = len(patch.shine)
    top, left = max(patch.y0, 0), max(patch.x0, 0)
    bottom, right = min(patch.y0 + n, view.shape[0]), min(patch.x0 + n, view.shape[1])
    if top >= bottom or left >= right:
        return
    part = (slice(top - patch.y0, bottom - patch.y0), slice(left - patch.x0, right - patch.x0))
    tint = np.array(settings["light_tint"]) / max(settings["light_tint"])  # type: ignore[call-overload]
    room = view[top:bottom, left:right]
    room *= (1.0 - patch.covered[part])[..., None].astype(np.float32)
    room += (level * patch.shine[part][..., None] * tint).astype(np.float32)


def lay_plate(lens: Lens, view: Light, T: Array, discs: list[Disc], settings: Mapping[str, object]) -> None:
    """Put the dark plate that carries the lights into a view."""
    model = np.array([d.centre for d in discs]) @ T[:3, :3] - T[:3, 3] @ T[:3, :3]
    low, high = model.min(axis=0)[:2] - 0.018, model.max(axis=0)[:2] + 0.018
    corners = np.array([[low[0], low[1], 0], [high[0], low[1], 0], [high[0], high[1], 0], [low[0], high[1], 0]])
    uv = lens.project(corners @ T[:3, :3].T + T[:3, 3])
    mask = np.zeros(view.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, np.rint(uv * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    soft = cv2.GaussianBlur(mask, (0, 0), float(settings["psf_sigma_px"])).astype(np.float32)[..., None] / 255.0
    view *= 1.0 - soft
    view += soft * np.float32(float(settings["plate_light"]))


def cover_up(lens: Lens, view: Light, disc: Disc, discs: list[Disc], shade: Array) -> None:
    """Put something dark before a light's place, as large as the other lights leave room for."""
    at, _, radius = image_of(lens, disc)
    others = [np.linalg.norm(image_of(lens, other)[0] - at) for other in discs if other is not disc]
    reach = min(3.0 * radius + 20.0, 0.5 * min(others))
    axes = (round(16 * reach), round(16 * 0.7 * reach))
    mask = np.zeros(view.shape[:2], np.uint8)
    cv2.ellipse(mask, tuple(np.rint(16 * at).astype(int).tolist()), axes, 30.0, 0, 360, 255, -1, cv2.LINE_AA, 4)
    soft = cv2.GaussianBlur(mask, (0, 0), 1.0).astype(np.float32)[..., None] / 255.0
    view *= 1.0 - soft
    view += soft * shade.astype(np.float32)


def draw_decoys(lenses: list[Lens], discs: list[Disc], n: int, rng: np.random.Generator) -> list[Disc]:
    """Return n lights that are none of the target's: other lamps of the room, 0.1 m or more from the target."""
    out: list[Disc] = []
    middle = np.mean([d.centre for d in discs], axis=0)
    while len(out) < n:
        uv = rng.uniform([0, 0], [lenses[0].width, lenses[0].height])
        centre = lenses[0].rays(uv[None])[0] * rng.uniform(0.5, 2.5)
        if np.linalg.norm(centre - middle) > 0.1 and all(
            np.linalg.norm(lens.project(centre[None])[0] - lens.project(d.centre[None])[0]) > 40.0
            for lens in lenses
            for d in discs
        ):
            normal = -centre / np.linalg.norm(centre)
            out.append(Disc(centre=centre, normal=normal, radius_m=max(discs[0].radius_m, 0.001)))
    return out


def row_of(lens: Lens, disc: Disc, name: str, side: str, level: float) -> dict[str, object]:
    """Return what is known of a light before the picture is taken."""
    (u, v), (u_disc, v_disc), radius = image_of(lens, disc)
    at = {"u_px": float(u), "v_px": float(v), "u_disc_px": float(u_disc), "v_disc_px": float(v_disc)}
    return {"name": name, "side": side, "radius_px": radius, "level": level, **at}
