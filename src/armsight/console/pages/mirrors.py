"""What the step Mirrors has beside every step: how they were built, and their alignment live."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement
from pydantic import ValidationError

from armsight.app.guided.mirror_alignment import MirrorAlignment, MirrorState
from armsight.calibrate.mirrors.diagnosis import MirrorTurn
from armsight.calibrate.mirrors.result import MirrorCheckOutput
from armsight.console import texts
from armsight.console.layout import (
    button,
    card,
    notice,
    number,
    say,
    set_attribute,
    set_text,
    show_level,
    text_of,
    ticked,
)
from armsight.console.plots import Plot
from armsight.console.state import Console
from armsight.errors import ArmsightError
from armsight.store.cell_file import CellMirrors
from armsight.units import MM

LOOK_S = 1.0
"""Time between two looks at the mirrors: the board is searched in the whole picture each time."""
MRAD = 1e-3
FULL_MRAD = 5.0
"""Angle at which a bar is full."""


def built_card(console: Console, changed: Callable[[], None]) -> None:
    """How the mirrors were built, to be kept in cell.yaml; changed: is called then."""
    built = console.cell.mirrors
    with card(texts.MIRRORS_BUILT):
        text_of("p", texts.MIRRORS_BUILT_HELP).classes("hint")
        shown = ui.radio(texts.MIRRORS_SHOWN, value=built.shown).props("inline")
        with ui.element("div").classes("row"):
            fields = {
                name: ui.number(label, value=_mm(built, name), step=step)
                for name, (label, step) in texts.MIRRORS_FIELDS.items()
            }
            for name, field in fields.items():
                field.props["data-testid"] = f"mirrors-{name}"
        said = text_of("p", role="alert").classes("hint")

        def keep() -> None:
            try:
                values = {name: number(field) for name, field in fields.items() if field.value not in (None, "")}
                console.set_mirrors(_built(str(shown.value), values))
            except (ArmsightError, ValidationError) as error:
                say(said, texts.MIRRORS_WRONG if isinstance(error, ValidationError) else str(error), "bad")
                return
            changed()

        button(texts.MIRRORS_KEEP, keep, kind="act quiet", testid="mirrors-keep")


def _mm(built: CellMirrors, name: str) -> float | None:
    value: float | None = getattr(built, name)
    return value if value is None or name == "index" else round(value / MM, 3)


def _built(shown: str, values: dict[str, float]) -> CellMirrors:
    """Return what was typed, mm in m; a field left out is the design's usual value. Raises ValidationError."""
    scaled = {name: value * (1.0 if name == "index" else MM) for name, value in values.items()}
    return CellMirrors.model_validate({"shown": shown, **scaled})


def alignment_card(console: Console) -> None:
    """The mirrors' alignment, live: how far they are off, which to turn how, and the last looks as a plot."""
    try:
        alignment = console.mirror_alignment()
        rig = console.mirror_rig()
    except ArmsightError as error:
        notice(str(error))
        return
    with card(texts.ALIGNMENT):
        _Alignment(console, alignment)
        if rig is not None:
            with ui.element("div").classes("row"):
                for parallel, (words, testid) in enumerate(texts.AGAINST):
                    act = partial(alignment.hold_against, parallel=bool(parallel))
                    button(words, act, kind="act quiet", testid=testid)


class _Alignment:
    """The card's figures; a look is taken each LOOK_S while the box is ticked."""

    def __init__(self, console: Console, alignment: MirrorAlignment) -> None:
        self._console, self._alignment, self._busy = console, alignment, False
        self._held = text_of("p").classes("hint")
        self._watch = ui.checkbox(texts.ALIGNMENT_WATCH, value=True)
        self._watch.props["data-testid"] = "alignment-watch"
        self._lamp = text_of("p", testid="alignment", role="status").classes("lamp")
        self._todo = [text_of("p", testid=f"turn-{i}").classes("todo") for i in range(2)]
        self._note = text_of("p").classes("hint")
        with ui.element("div").classes("numbers"):
            self._numbers = {name: _bar(label) for name, label in texts.ALIGNMENT_ANGLES.items()}
        self._plot = Plot(texts.ALIGNMENT_PLOT, texts.ALIGNMENT_LEGEND, testid="alignment-plot")
        ui.timer(LOOK_S, self._tick)
        self._show()

    async def _tick(self) -> None:
        watched, station = ticked(self._watch) and self._alignment.possible, self._console.station
        if self._busy or not watched or station is None or station.shown is None:
            return
        self._busy = True
        try:
            await run.io_bound(self._alignment.look, station)
            self._show()
        except ArmsightError as error:
            self._level("bad", str(error))
        finally:
            self._busy = False

    def _show(self) -> None:
        set_text(self._held, texts.HELD_PARALLEL if self._alignment.to_parallel else texts.HELD_RIG)
        looks = tuple(self._alignment.looks)
        if not looks:
            self._level("idle", texts.ALIGNMENT_STARTING if self._alignment.possible else texts.ALIGNMENT_NEEDS)
            return
        last = looks[-1]
        if last.check is None:
            self._level("idle", texts.ALIGNMENT_UNSEEN.format(why=last.why))
            return
        if last.unsure:
            self._level("idle", texts.ALIGNMENT_UNSURE.format(std=last.std_rad / MRAD))
        elif last.done:
            self._level("good", texts.ALIGNED_PARALLEL if self._alignment.to_parallel else texts.ALIGNED_RIG)
        else:
            self._level("warn", texts.TURN_NEXT)
        for label, turn in zip(self._todo, [*last.turns, None, None], strict=False):
            set_text(label, "" if turn is None else turn_words(turn))
        set_text(self._note, _note(last))
        for name, (value, below, marker) in self._numbers.items():
            angle, std = _angle(last.check, name)
            set_text(value, texts.ANGLE.format(value=angle))
            set_text(below, "" if std is None else texts.ANGLE_STD.format(std=std))
            set_attribute(marker, "data-level", "good" if abs(angle) < 1.0 else "warn")
            marker.style(f"left: {50.0 + 50.0 * max(-1.0, min(1.0, angle / FULL_MRAD)):.1f}%")
        self._draw(looks)

    def _draw(self, looks: tuple[MirrorState, ...]) -> None:
        seen = [(one.number - looks[-1].number, one.check) for one in looks]
        curves = [
            [(number, None if check is None else _angle(check, name)[0]) for number, check in seen]
            for name in texts.ALIGNMENT_ANGLES
        ]
        self._plot.show(curves)

    def _level(self, level: str, words: str) -> None:
        show_level(self._lamp, level, words)
        if level in ("bad", "idle", "good"):
            for label in self._todo:
                set_text(label, "")
            set_text(self._note, "")


def _bar(label: str) -> tuple[TextElement, TextElement, TextElement]:
    with ui.element("div").classes("number"):
        text_of("div", label).classes("what")
        value = text_of("div", texts.NO_VALUE).classes("value")
        with ui.element("div").classes("needle"):
            marker = text_of("span", aria_hidden="true")
        below = text_of("div").classes("std")
    return value, below, marker


def _angle(check: MirrorCheckOutput, name: str) -> tuple[float, float | None]:
    """Return one of the alignment's angles and its standard deviation, in mrad."""
    std = check.alignment.std
    return getattr(check.alignment, name) / MRAD, None if std is None else std[name] / MRAD


def turn_words(turn: MirrorTurn) -> str:
    """Return in words which way a mirror is to be turned, by how much."""
    parts = [
        (texts.TURN_CLOCKWISE if angle > 0.0 else texts.TURN_ANTICLOCKWISE)
        if which == "turn"
        else (texts.TILT_BACK if angle > 0.0 else texts.TILT_FORWARD)
        for which, angle in (("turn", turn.turn_rad), ("tilt", turn.tilt_rad))
    ]
    angles = [abs(angle) / MRAD for angle in (turn.turn_rad, turn.tilt_rad)]
    words = [part.format(angle=angle) for part, angle in zip(parts, angles, strict=True) if angle >= 0.005]
    return texts.MIRROR_TURN.format(mirror=turn.mirror, turns=", ".join(words))


def _note(stand: MirrorState) -> str:
    if stand.others:
        return texts.OTHER_MIRRORS.format(mirrors=", ".join(str(one) for one in stand.others))
    return texts.SEVERAL_MIRRORS if stand.several else ""
