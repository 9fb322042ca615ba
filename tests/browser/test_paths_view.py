"""From the console's first answer to a played path: what is waited for, and the view of taught, measured and driven."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.console.texts import OPENING, PATHS_LEGEND
from armsight.ops.arm_files import load_arm
from armsight.store.path_file import read_path
from armsight.store.recording import Recording

NEAR_M = 0.004
"""The arm that was built is up to 2.6 mm off its model here; a track's places are 0.5 mm apart or more."""

pytestmark = [pytest.mark.alone, pytest.mark.timeout(600)]

Array = NDArray[np.float64]

KEEP_TOLD = """document.addEventListener("DOMContentLoaded", () => {
  const told = document.querySelector("[data-testid=waiting]")?.textContent;
  if (told) sessionStorage.told = JSON.stringify([...JSON.parse(sessionStorage.told || "[]"), told]);
});"""
"""Of every page that the browser loads by itself."""
CURVE = """name => {
  const scene = window[Object.keys(window).find((key) => key.startsWith("scene_"))];
  const curve = scene?.getObjectByName(`curve-${name}`);
  return curve ? [...curve.children[0].geometry.attributes.position.array] : [];
}"""
HOLDS_ALL = """name => {
  const scene = window[Object.keys(window).find((key) => key.startsWith("scene_"))];
  const { geometry } = scene.getObjectByName(`curve-${name}`).children[0];
  const { position } = geometry.attributes;
  if (!geometry.boundingSphere) geometry.computeBoundingSphere();
  const { center, radius } = geometry.boundingSphere;
  return [...Array(position.count).keys()].every(
    (i) => Math.hypot(...["x", "y", "z"].map((n, k) => position.getComponent(i, k) - center[n])) <= radius + 1e-5
  );
}"""
"""What is drawn is chosen by this sphere: a place out of it goes with the others."""


@pytest.fixture(scope="module")
def cell(browser: Any, console: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    """A simulated cell as a page saw it that was there first: world, folder, page, and the steps that it was told."""
    home = tmp_path_factory.mktemp("view")
    world, folder = console.small_cell(home / "small.yaml"), home / "cell"
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.set_default_timeout(120_000)
    page.add_init_script(KEEP_TOLD)

    def watch(address: str) -> None:
        page.goto(f"{address}/teach", wait_until="domcontentloaded")
        page.wait_for_selector("[data-testid=state]")

    address, process = console.begin(folder, "--robot", f"sim:{home / 'small.yaml'}", meanwhile=watch)
    try:
        told = page.evaluate("JSON.parse(sessionStorage.told || '[]')")
        yield SimpleNamespace(world=world, folder=folder, page=page, told=list(dict.fromkeys(told)), address=address)
        page.close()
    finally:
        console.end(process)


def test_a_page_that_is_there_first_is_told_the_steps_in_order_and_becomes_the_console(cell: SimpleNamespace) -> None:
    """Nobody loads it anew. A step shorter than the second between two looks may pass unseen."""
    steps = [words.format(robot=f"sim:{cell.folder.parent / 'small.yaml'}") for words in OPENING.values()]
    assert cell.told and cell.told == [step for step in steps if step in cell.told]
    assert cell.page.url == f"{cell.address}/teach"
    assert cell.page.locator("[data-testid=scene]").count() == 1


def test_taught_measured_and_driven_are_drawn_where_they_were(console: Any, cell: SimpleNamespace) -> None:
    """Against the path's file, and against what the simulator's arm did by the recordings of every try of the play."""
    page = cell.page
    teach(page, console)
    q = np.concatenate([q for played in play(page, console, cell.folder) if len(q := joints_of(played))])
    arm = load_arm(str(cell.folder / "arm.yaml"))
    driven = np.array([arm.fk(arm.values(one))[:3, 3] for one in q])
    world = cell.world
    flange = RigidTransform.from_matrix(world.true.flanges(q))
    lit = (world.true.T_world_base * flange * world.T_flange_tool).translation
    taught = drawn(page, "taught")
    assert np.allclose(taught, read_path(cell.folder / "path.csv").xyz_m, atol=1e-5)
    for name, truth in (("measured", lit), ("tool", driven)):
        page.wait_for_function(f"name => ({CURVE})(name).length > 3 * 20", arg=name)
        curve = drawn(page, name)
        assert np.allclose([curve.min(axis=0), curve.max(axis=0)], extent(truth, taught), atol=NEAR_M), name
        assert apart(truth, curve).max() < NEAR_M, name
        led_or_driven = np.minimum(apart(curve, taught), apart(curve, truth))
        assert led_or_driven.max() < NEAR_M, (name, curve[led_or_driven > NEAR_M])
        assert page.evaluate(HOLDS_ALL, name), name
    looked_at_from_near(page)
    named = page.locator("[data-testid=scene-legend] li").evaluate_all("all => all.map((one) => one.dataset.curve)")
    assert named == list(PATHS_LEGEND)


IN_SIGHT = """name => {
  const names = [...document.querySelectorAll("[data-testid=scene] div div")].map((one) => one.textContent);
  return ["x", "y", "z"].every((axis) => names.some((words) => new RegExp(`^${axis} -?[0-9]+ mm$`).test(words)));
}"""
"""Of an axis the name is in the page only while it is before the eye and not too near."""


def looked_at_from_near(page: Any) -> None:
    """All axes come into sight; a phone shows all of it without scrolling sideways."""
    page.click("[data-testid=look-paths]")
    page.wait_for_function(IN_SIGHT)
    page.set_viewport_size({"width": 390, "height": 900})
    page.wait_for_function("document.querySelector('[data-testid=scene] canvas').clientWidth < 390")
    edges = "all => all.map((one) => one.getBoundingClientRect().right)"
    assert max(page.locator("section.card").evaluate_all(edges)) <= 390


def teach(page: Any, console: Any) -> None:
    """Take three places, with the jog keys between them."""
    console.measuring(page)
    console.rests(page)
    page.locator("[data-testid=override]").fill("100")
    page.click("[data-testid=jog-base]")
    for taken, key in enumerate((None, "base:2:1", "base:1:1"), start=1):
        if key is not None:
            console.jog(page, key, 600)
        page.click("[data-testid=point]")
        page.wait_for_function(
            "n => document.querySelector('[data-testid=taught]').textContent.startsWith(`${n} poses`)", arg=taken
        )
    page.click("[data-testid=save]")
    page.wait_for_selector("text=/3 places over/")


def joints_of(played: Path) -> Array:
    """Return every tenth reading (n, axes) of the joints in a recording."""
    with Recording(played) as recording:
        return np.array([reading.q for reading in recording.joints()])[::10]


def play(page: Any, console: Any, folder: Path) -> list[Path]:
    """Play the path to its end; return the recordings of all tries: what was measured in each stays in view."""
    page.get_by_label("Speed along the path").fill("40")
    page.click("[data-testid=check]")
    page.wait_for_selector("text=The arm can run this path")
    for _ in range(6):  # a machine that is late holds the arm; where that is often the path is given up
        page.click("[data-testid=play]")
        page.click("[data-testid=yes]:visible")
        if console.held(page, "Played: ") and "Played: 100%" in page.inner_text("[data-testid=verdict]"):
            return sorted(folder.glob("played-*/play.mcap"))
    raise AssertionError(page.inner_text("[data-testid=verdict]") + page.inner_text("[data-testid=work]"))


def drawn(page: Any, name: str) -> Array:
    """Return the places (n, 3) in m of a curve as the browser draws it."""
    return np.array(page.evaluate(CURVE, name), dtype=float).reshape(-1, 3)


def extent(*curves: Array) -> Array:
    """Return the least and the greatest x, y, z (2, 3) of curves."""
    all_of = np.concatenate(curves)
    return np.array([all_of.min(axis=0), all_of.max(axis=0)])


def apart(places: Array, line: Array) -> Array:
    """Return how far in m (n,) places (n, 3) are from a line through others (m, 3)."""
    begin, way = line[:-1], np.diff(line, axis=0)
    share = np.einsum("nmk,mk->nm", places[:, None] - begin, way) / np.maximum(np.einsum("mk,mk->m", way, way), 1e-18)
    on = begin + np.clip(share, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(places[:, None] - on, axis=-1).min(axis=1))
