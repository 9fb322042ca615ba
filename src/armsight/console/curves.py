"""Curves in three dimensions, told apart by line and marks as well as by colour, and axes in mm about them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from armsight.console.tracks import Place, Ticks
from armsight.units import MM

DASH_M = 0.003
INK = "#14181c"


class Curve(Object3D, component=Path(str(files("armsight") / "console" / "static" / "curve.js"))):
    """A curve through places; line: solid, dashed or none; marks of mark_px, none for 0; layer: higher is before."""

    def __init__(self, name: str, *, line: str, mark_px: float, layer: int) -> None:
        super().__init__([], [], line, mark_px, DASH_M, layer)
        self.with_name(f"curve-{name}")
        self.places: Sequence[Place] = ()

    def show(self, places: Sequence[Place], colours: Sequence[Sequence[float]]) -> None:
        """Draw it; colours: r, g, b in 0 to 1 of each place. Nothing is sent where it is the same."""
        sent = [[list(place) for place in places], [list(colour) for colour in colours]]
        if sent == self.args[:2]:
            return
        self.places = tuple(places)
        self.args[:2] = sent
        self.scene.run_method("run_method_on_component", self.id, "set_points", *sent)


class Ruler:
    """Axes in mm about the curves; they grow with them."""

    def __init__(self, scene: ui.scene) -> None:
        self._scene = scene
        self._ticks: Ticks | None = None
        self._drawn = scene.group()

    def show(self, ticks: Ticks | None) -> None:
        """Draw these axes, none for None. Nothing is sent where they are the same."""
        if ticks == self._ticks:
            return
        self._ticks = ticks
        self._drawn.delete()
        with self._scene, self._scene.group() as self._drawn:
            if ticks is not None:
                for axis in range(3):
                    self._axis(ticks, axis)

    def _axis(self, ticks: Ticks, axis: int) -> None:
        low, along = np.array(ticks.low_mm, dtype=float), np.eye(3)[axis]
        aside = np.eye(3)[2 if axis != 2 else 0] * -0.25 * ticks.step_mm
        marks = range(ticks.low_mm[axis], ticks.high_mm[axis] + 1, ticks.step_mm)
        self._scene.line((MM * low).tolist(), (MM * (low + (marks[-1] - marks[0]) * along)).tolist()).material(INK)
        for mark in marks:
            at = low + (mark - marks[0]) * along
            self._scene.line((MM * at).tolist(), (MM * (at + aside)).tolist()).material(INK)
            words = f"{'xyz'[axis]} {mark} mm" if mark == marks[-1] else str(mark)
            label = self._scene.text(words, f"font-size: 12px; font-weight: 600; color: {INK}")
            label.move(*(MM * (at + 1.8 * aside)).tolist())
