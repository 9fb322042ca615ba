"""Rooms are geometry: points project where a pinhole says, the same seed furnishes the same room, occluders hide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight_sim import Cell, LedCellOptions, Lens, led_cell
from armsight_sim.rooms import textures as tx
from armsight_sim.rooms.scene import Panel, Scene, Texture, View


def small(seed: int, frames: int, *, room: Any = "dark", pipeline: Any = "ideal", **options: Any) -> Cell:
    chosen = LedCellOptions(**{"width": 160, "height": 90, "sigma_px": 1.0, "faults": False} | options)
    return led_cell(seed, frames, chosen, room=room, pipeline=pipeline)


def white(size: int = 8) -> Texture:
    return tx.stored(np.ones((size, size, 3)))


ASLANT = Rotation.from_rotvec([0.0, 0.0, 0.4])
"""Edges aslant to the pixels: rays on a lattice then place them well."""


def panel(xyz_m: list[float], size_m: tuple[float, float], turn: Rotation | None = None) -> Panel:
    pose = RigidTransform.from_components(xyz_m, turn or Rotation.identity())
    return Panel(T_room_panel=pose, size_m=size_m, texture=white())


def centre(share: np.ndarray) -> np.ndarray:
    v, u = np.mgrid[0 : share.shape[0], 0 : share.shape[1]]
    return np.array([(share * u).sum(), (share * v).sum()]) / share.sum()


@pytest.mark.parametrize("camera_at", [[0.0, 0.0, 0.0], [0.12, 0.01, -0.02]])
def test_a_point_of_the_room_is_where_the_pinhole_says(camera_at: list[float]) -> None:
    """Both cameras of a pair; own arithmetic: R^T (X - t), then f x / z + c. A small square is centred on the point."""
    lens = Lens(width=320, height=240, focal_px=(300.0, 310.0), centre_px=(158.0, 121.0))
    R = Rotation.from_rotvec([0.02, -0.08, 0.03])
    point = np.array([0.21, -0.14, 1.7])
    scene = Scene.evenly([panel(point.tolist(), (0.08, 0.08), R * ASLANT)])
    seen = View(lens=lens).cast(scene, RigidTransform.from_components(camera_at, R))
    x, y, z = R.as_matrix().T @ (point - camera_at)
    want = [300.0 * x / z + 158.0, 310.0 * y / z + 121.0]
    np.testing.assert_allclose(centre(seen[:, :, 3]), want, atol=0.06)
    area = 300.0 * 310.0 * 0.08**2 / z**2
    assert seen[:, :, 3].sum() == pytest.approx(area, rel=0.05)


def test_the_nearer_thing_hides_the_farther_one_and_is_seen_from_the_front_only() -> None:
    lens = Lens(width=60, height=40, focal_px=(50.0, 50.0), centre_px=(29.5, 19.5))
    near, far = panel([0.0, 0.0, 1.0], (0.2, 0.2)), panel([0.0, 0.0, 2.0], (1.0, 1.0))
    for order in ([near, far], [far, near]):
        numbers = [1.0 if one is near else 3.0 for one in order]
        lit = Scene.evenly(order)
        light = np.concatenate(
            [np.full((place[1] * place[2], 3), n, np.float32) for place, n in zip(lit.arrays[5], numbers, strict=True)]
        )
        shaded = Scene(panels=lit.panels, arrays=(*lit.arrays[:8], light, lit.arrays[9]))
        seen = View(lens=lens).cast(shaded, RigidTransform.identity())
        assert seen[20, 30, :3].tolist() == [1.0, 1.0, 1.0]
        assert seen[20, 36, :3].tolist() == [3.0, 3.0, 3.0]
    behind = RigidTransform.from_components([0.0, 0.0, 4.0], Rotation.from_rotvec([0.0, np.pi, 0.0]))
    assert View(lens=lens).cast(Scene.evenly([near, far]), behind).max() == 0.0


def hand(**keys: Any) -> dict[str, Any]:
    crossing = {"kind": "card", "at_s": 0.0, "for_s": 1.0, "from_m": [-0.2, 0.0, 0.4], "to_m": [0.4, 0.0, 0.4]}
    return {"preset": "dark", "occluders": [{**crossing, "size_m": 0.5, **keys}]}


def test_an_occluder_hides_the_lights_behind_it_and_is_gone_afterwards() -> None:
    cell = small(5, 90, room=hand())
    free = small(5, 90)
    lights = np.array([len(cell.centres_px(k, "left")) for k in range(90)])
    assert lights[25] == 0
    assert (lights[60:] == 3).all()
    assert cell.cameras["left"].light(cell.lights, cell.path, 25 / 60).max() < 60.0
    for k in (70, 80):
        np.testing.assert_array_equal(cell.pair(k)[0].image, free.pair(k)[0].image)
    beyond = small(5, 90, room=hand(from_m=[-0.2, 0.0, 3.0], to_m=[0.4, 0.0, 3.0], size_m=4.0))
    assert len(beyond.centres_px(25, "left")) == 3
    assert beyond.cameras["left"].light(cell.lights, cell.path, 25 / 60).max() > 120.0
