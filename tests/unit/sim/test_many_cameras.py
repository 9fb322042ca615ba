"""Cells of one to eight cameras: what is drawn, what the truth tells of every light, and what cannot be."""

from __future__ import annotations

import copy
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from armsight.ops.simulation.scenarios import build_world, scenario_model
from armsight_sim.world import World

NAMES = ("left", "right", "far-left", "far-right")
BEHIND = {"home": [0.0, -60.0, 90.0, -30.0, -90.0, 0.0], "amplitude": 6 * [0.0]}
"""The flange looks to the back: for cameras in front of the arm its links are before the lights."""


def content() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((files("armsight_sim") / "scenarios" / "arm-cell.yaml").read_text())
    found["cameras"]["pipeline"], found["room"] = "ideal", "dark"
    return found


def world(change: Callable[[dict[str, Any]], object] = lambda _: None, frames: int = 40) -> World:
    keys = copy.deepcopy(content())
    change(keys)
    made: World = build_world("arm-cell", scenario_model(keys, "arm-cell"), seed=None, frames=frames)
    return made


def shine_all_round(keys: dict[str, Any]) -> None:
    """Turn the flange to the back, with lights that shine every way: links alone hide them."""
    keys["motion"] |= BEHIND
    del keys["target"]["facing"]
    keys["target"]["everywhere"] = True


def marched(made: World, index: int, camera: str, place_m: np.ndarray) -> str:
    """Return the link that holds any of 4,000 places on the way from a light to a camera, and not the light itself."""
    frames = made.true.frames(made.servo.at(np.array([index / made.fps]))[0])[:, :3, 3]
    eye = (made.T_base_rig * made.cameras[camera].T_world_camera).translation
    way = place_m + np.linspace(0.0, 1.0, 4000)[:, None] * (eye - place_m)
    for joint, a, b, radius in zip(made.true.joints, frames[:-1], frames[1:], made.radii_m, strict=True):
        share = np.clip((way - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
        off = np.linalg.norm(way - a - share[:, None] * (b - a), axis=1)
        if off[0] > radius and off.min() < radius:
            return joint.name
    return ""


def test_the_truth_tells_which_link_hides_a_light_from_which_camera() -> None:
    made, told = world(shine_all_round), []
    for index in (0, 20):
        for one in made.sights(index):
            light = next(light for light in made.lights if light.name == one.light)
            place = made.T_base_rig * made.path(np.array([index / made.fps]))[0]
            assert one.hidden_by in ("outside", marched(made, index, one.camera, place.apply(light.xyz_m)))
            told.append(one.hidden_by)
    assert told.count("") > 4 and len(set(told)) > 1  # some seen, some hidden


def test_a_light_is_drawn_where_it_is_told_to_be_seen_and_only_there() -> None:
    made, hidden = world(shine_all_round), 0
    pictures = dict(zip(made.views, (frame.image for frame in next(made.frames())), strict=True))
    for one in made.sights(0):
        u, v = np.rint(one.uv_px).astype(int)
        others = [
            o.uv_px for o in made.sights(0) if o.camera == one.camera and o.light != one.light and not o.hidden_by
        ]
        alone = min((float(np.linalg.norm(at - one.uv_px)) for at in others), default=np.inf) > 12.0
        level = int(pictures[one.camera][v - 1 : v + 2, u - 1 : u + 2].max())
        if one.hidden_by == "":
            assert level > 120
        elif alone:
            hidden += 1
            assert level < 60
    assert hidden


def test_what_was_told_to_happen_happens_to_the_camera_named() -> None:
    def covered(keys: dict[str, Any]) -> None:
        shine_all_round(keys)
        keys["motion"]["home"] = [0.0, -60.0, 90.0, -30.0, 90.0, 0.0]
        event = {"kind": "occluded", "at_s": 0.0, "for_s": 0.1, "lights": ["A"]}
        keys["events"] = [event | {"side": "far-left"}, event | {"side": "all", "lights": ["B"], "at_s": 0.2}]

    made = world(covered)
    assert {(one.camera, one.light) for one in made.sights(0) if one.hidden_by == "event"} == {("far-left", "A")}
    assert {(one.camera, one.light) for one in made.sights(6) if one.hidden_by == "event"} == {(n, "B") for n in NAMES}
