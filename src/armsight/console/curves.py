"""Curves in three dimensions, told apart by line and marks as well as by colour, and axes in mm about them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from armsight.console.tracks import Array, Place, Ticks
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
    """Axes in mm about the curves, their corner and ends named; they grow with them."""

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
                low = np.array(ticks.low_mm, dtype=float)
                for axis, high in enumerate(ticks.high_mm):
                    self._axis(low, axis, range(ticks.low_mm[axis], high + 1, ticks.step_mm))
                self._name("({}, {}, {}) mm".format(*ticks.low_mm), low - 0.8 * ticks.step_mm * np.eye(3)[2])

    def _axis(self, low: Array, axis: int, marks: range) -> None:
        """Draw one from the corner low (3,) in mm, with its ticks; named at its end."""
        along, tick = np.eye(3)[axis], np.eye(3)[1 if axis == 0 else 0] * -0.3 * marks.step
        end = low + (marks[-1] - marks[0]) * along
        self._line(low, end)
        for mark in marks:
            at = low + (mark - marks[0]) * along
            self._line(at, at + tick)
        self._name(f"{'xyz'[axis]} {marks[-1]} mm", end + 0.6 * marks.step * along)

    def _line(self, one_mm: Array, next_mm: Array) -> None:
        self._scene.line((MM * one_mm).tolist(), (MM * next_mm).tolist()).material(INK)

    def _name(self, words: str, at_mm: Array) -> None:
        self._scene.text(words, f"font-size: 12px; font-weight: 600; color: {INK}").move(*(MM * at_mm).tolist())
