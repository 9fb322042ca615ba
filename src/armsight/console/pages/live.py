"""Live: all pictures, the pose with its uncertainty, the cell in 3-D, curves, and how lights are looked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.elements.mixins.text_element import TextElement
from numpy.typing import NDArray

from armsight.app.live.measurement import DetectionSettings
from armsight.app.live.station import Snapshot, picture_view
from armsight.app.live.views import SideView
from armsight.console import texts
from armsight.console.layout import (
    TICK_S,
    button,
    canvas_of,
    card,
    notice,
    number,
    number_field,
    picture_title,
    refusals_in,
    say,
    set_text,
    text_of,
    ticked,
)
from armsight.console.plots import Plot
from armsight.console.robot_link import drawn
from armsight.console.scene import Scene
from armsight.console.state import Console, values_of
from armsight.console.work import jog_card
from armsight.errors import ArmsightError, UsageError
from armsight.ops.measure import measure
from armsight.store.cell_file import COMPLEX
from armsight.units import DEG

Refresh = Callable[[Snapshot], None]

SLOW_S = 0.5
"""Time between two updates of scene and curves."""
CURVE_POINTS = 300
PAIR = 2
"""Pictures up to which each is as large as the page has room for; more stand in a grid."""
MASKS = 50
"""Of a picture; each costs measuring its time."""


def live_page(console: Console, *, watching: bool = False) -> None:
    """Build the page; watching: without anything that changes the cell."""
    if console.station is None:
        notice(texts.NO_CAMERAS)
    else:
        _measuring(console, watching=watching)
    if console.robot is not None and not watching:
        jog_card(console.robot)


def _measuring(console: Console, *, watching: bool) -> None:
    if not watching:
        _lost_camera(console)
    with ui.element("div").classes("columns" if len(console.pictures) <= PAIR else "pictures"):
        pictures = [_picture(name) for name in console.pictures]
        beside = _figures(console, watching=watching) if len(pictures) == 1 else None
    with ui.element("div").classes("columns"):
        figures, record = beside or _figures(console, watching=watching)
        with card(texts.SCENE):
            scene = _scene(console)
            legend = text_of("p", texts.SCENE_HELP, testid="scene-legend").classes("hint")
    with card(texts.CURVES), ui.element("div").classes("plots"):
        curves = [_curve(i) for i in range(len(texts.AXES))]
    if not watching:
        with card(texts.SEARCH):
            _search(console)

    def tick() -> None:
        shown = console.remember()
        record()
        if shown is not None:
            for refresh in (*pictures, *figures):
                refresh(shown)
        if scene is not None:
            scene.show(shown.view if shown is not None and console.current else None)

    def slow() -> None:
        if scene is not None:
            set_text(legend, _legend(scene.scale, scene.show_track(), arm=scene.has_arm))
        _draw(curves, list(console.history))

    ui.timer(TICK_S, tick)
    ui.timer(SLOW_S, slow)


def _figures(console: Console, *, watching: bool) -> tuple[tuple[Refresh, ...], Callable[[], None]]:
    """The pose, how measuring goes, and recording; return what keeps them as they are now."""
    with card(texts.POSE):
        return (_pose(console), _status(many=len(console.pictures) > PAIR)), (lambda: None) if watching else _record(
            console
        )


def _lost_camera(console: Console) -> None:
    """A line that is there while a camera or all give no pictures or count no more, with what to do, and a button."""
    with ui.element("div").classes("row notice") as line:
        words = text_of("p", role="alert", testid="camera-lost")
        button(texts.RESTART, lambda: run.io_bound(console.require_station().start), testid="restart")

    def tick() -> None:
        station = console.station
        failure = "" if station is None else station.failure
        told = texts.CAMERA_LOST.format(why=failure) if failure else ""
        if station is not None and station.shown is not None and not failure:
            away = {name: _away(view) for name, view in station.shown.view.cameras.items()}
            told = " ".join(f"{picture_title(name)}: {why}" for name, why in away.items() if why)
        line.set_visibility(bool(told))
        set_text(words, told)

    tick()
    ui.timer(TICK_S, tick)


def _legend(scale: float, range_m: tuple[float, float] | None, *, arm: bool) -> str:
    """Return what the scene's ellipsoid and tracks say, in words; arm: one is drawn."""
    parts = [texts.SCENE_HELP]
    if scale > 0.0:
        parts.append(texts.ELLIPSOID.format(scale=scale))
    if range_m is not None:
        parts.append(texts.TRACK.format(least=1e3 * range_m[0], most=1e3 * range_m[1]))
    return " ".join([*parts, *([texts.ROBOT_TRACK] if arm else [])])


def _picture(side: str) -> Refresh:
    with card(picture_title(side)):
        canvas_of(side, testid=f"camera-{side}")
        if side == COMPLEX:
            text_of("p", texts.COMPLEX_HELP).classes("hint")
        hint = text_of("p", testid=f"sees-{side}").classes("hint")
        figures = text_of("p").classes("hint")

    def refresh(shown: Snapshot) -> None:
        view = picture_view(shown, side)
        say(hint, *camera_state(view, shown.view.n_lights))
        set_text(figures, "" if view.lost else _aiming(view))

    return refresh


def _away(view: SideView) -> str:
    """Return why a camera does not count, empty where it does."""
    if view.lost:
        return texts.GONE_CAMERA.format(why=view.lost)
    return texts.LEFT_OUT.format(why=view.left_out) if view.left_out else ""


def camera_state(view: SideView, n_lights: int | None) -> tuple[str, str]:
    """Return what is told of a camera, and its level: lost, left out, or the lights it sees and how it is aimed."""
    if away := _away(view):
        return away, "bad"
    n = len(view.names)
    seen = texts.FINDS.format(n=len(view.spots)) if n_lights is None else texts.SEES.format(n=n, of=n_lights)
    good = view.advice == "good" and (n_lights is None or n > 0)
    return f"{seen} {texts.ADVICE[view.advice]}", "good" if good else "warn"


def _aiming(view: SideView) -> str:
    brightest = texts.NO_VALUE if view.brightest is None else f"{view.brightest:.0f}"
    width = texts.NO_VALUE if view.sigma_px is None else f"{view.sigma_px:.1f}"
    figures = texts.ADVICE_FIGURES.format(background=view.background, brightest=brightest, width=width)
    if view.n_clipped is not None:
        figures += texts.ADVICE_CLIPPED.format(n=view.n_clipped)
    return figures if view.exposure_s is None else figures + texts.ADVICE_EXPOSURE.format(ms=1e3 * view.exposure_s)


def _number(name: str, testid: str) -> tuple[TextElement, TextElement]:
    with ui.element("div").classes("number"):
        text_of("div", name).classes("what")
        return text_of("div", texts.NO_VALUE, testid=testid).classes("value"), text_of("div").classes("std")


def _pose(console: Console) -> Refresh:
    """The pose with its spread; nothing while no pictures come, since the target may have gone anywhere."""
    with ui.element("div").classes("numbers"):
        numbers = [_number(name, f"pose-{name}") for name in texts.AXES]

    def refresh(shown: Snapshot) -> None:
        view = shown.view
        values = values_of(view)
        std = (
            np.full(6, np.nan) if view.std is None else np.pad(view.std, (0, 6 - len(view.std)), constant_values=np.nan)
        )
        for i, (value, spread) in enumerate(numbers):
            unit, scale, digits = ("mm", 1e3, 2) if i < 3 else ("deg", 1.0 / DEG, 3)
            known = console.current and np.isfinite(values[i])
            set_text(value, f"{scale * values[i]:.{digits}f} {unit}" if known else texts.NO_VALUE)
            claim = known and np.isfinite(std[i])
            set_text(spread, texts.SPREAD.format(value=f"{scale * std[i]:.{digits + 1}f}", unit=unit) if claim else "")

    return refresh


def _status(*, many: bool) -> Refresh:
    """How measuring goes; many: with how many of the cameras see the target."""
    with ui.element("div").classes("numbers"):
        fps, _ = _number(texts.FPS, "fps")
        latency, _ = _number(texts.LATENCY, "latency")
        lost = _number(texts.COUNTS, "lost")
        partly = _number(texts.POSITION_COUNT, "position-only")
        residual, _ = _number(texts.RESIDUAL, "residual")
        seeing = _number(texts.SEEING, "cameras-seeing") if many else None
    why = text_of("p").classes("hint")

    def refresh(shown: Snapshot) -> None:
        view = shown.view
        set_text(fps, f"{view.fps:.0f}")
        set_text(latency, f"{1e3 * view.latency_s:.0f} ms")
        for (label, below), n in ((lost, view.counts.lost), (partly, view.counts.position_only)):
            set_text(label, texts.COUNT.format(n=n, share=n / max(view.sequence, 1)))
            set_text(below, texts.OF_ALL.format(total=view.sequence))
        px = view.residual_px
        set_text(residual, texts.NO_VALUE if px is None else texts.RESIDUAL_VALUE.format(value=px))
        if seeing is not None:
            counts = [len(one.names) for one in view.cameras.values() if not one.left_out]
            set_text(seeing[0], texts.SEEING_VALUE.format(n=sum(map(bool, counts)), of=len(view.cameras)))
            of = len(view.cameras) * (view.n_lights or 0)
            set_text(seeing[1], texts.SIGHTS.format(n=sum(counts), of=of) if of else "")
        set_text(why, view.why)

    return refresh


def _record(console: Console) -> Callable[[], None]:
    with ui.element("div").classes("row"):
        toggle = button(texts.RECORD, console.record, testid="record")
        said = text_of("span", role="status").classes("hint")

    def refresh() -> None:
        state = console.station.recording if console.station else None
        if state is None:
            return
        set_text(toggle, texts.RECORD if state.file is None else texts.END_RECORDING)
        if state.failure:
            set_text(said, state.failure)
        elif state.file is not None:
            text = texts.RECORDING.format(file=state.file.name, n=state.n_pairs)
            set_text(said, f"{text}; {texts.DROPPED.format(n=state.n_dropped)}" if state.n_dropped else text)
        elif console.last_recording is not None:
            set_text(said, texts.RECORDED.format(file=console.last_recording))

    return refresh


def _scene(console: Console) -> Scene | None:
    try:
        return Scene(console)
    except ArmsightError as error:
        notice(str(error))
        return None


def _curve(axis: int) -> Plot:
    """One of x y z rx ry rz over time, on an axis of its own: what moves is seen beside what is far away."""
    name, unit = texts.AXES[axis], "mm" if axis < 3 else "deg"
    return Plot(f"{name} ({unit})", (name,), testid=f"plot-{name}", along="{value} s", first=axis % 3)


def _draw(curves: list[Plot], moments: list[NDArray[np.float64]]) -> None:
    if not moments:
        return
    kept = np.array(moments[:: max(1, len(moments) // CURVE_POINTS)])
    values = kept[:, 1:] * np.repeat([1e3, 1.0 / DEG], 3)
    t_s = kept[:, 0] - kept[-1, 0]
    for curve, column in zip(curves, values.T, strict=True):
        points = [
            (round(float(t), 2), round(float(v), 3) if np.isfinite(v) else None)
            for t, v in zip(t_s, column, strict=True)
        ]
        curve.show([points])


def _search(console: Console) -> None:
    with ui.element("div").classes("row"):
        threshold = number_field(texts.THRESHOLD, measure, "threshold", step=1).style("min-width: 20rem")
        threshold.value = console.look.threshold
        inverted = ui.checkbox(texts.INVERTED, value=console.look.inverted)
        masking = ui.checkbox(texts.MASK)
        button(texts.UNMASK, lambda: console.set_look(replace(console.look, masked={})), kind="act quiet")
    text_of("p", texts.MASK_HELP).classes("hint")
    said = text_of("p", role="alert").classes("hint")

    def look(change: Callable[[], DetectionSettings]) -> None:
        """Look in another way, or tell why not."""
        with refusals_in(said):
            console.set_look(change())
            say(said, "")

    threshold.on_value_change(lambda: look(lambda: replace(console.look, threshold=_level(threshold))))
    ui.on("armsight_mask", lambda event: look(lambda: masked(console, event.args)))
    inverted.on_value_change(lambda: console.set_look(replace(console.look, inverted=ticked(inverted))))
    masking.on_value_change(
        lambda: ui.run_javascript(
            "document.querySelectorAll('canvas[data-side]')"
            f".forEach((c) => c.dataset.masking = '{'true' if ticked(masking) else 'false'}')"
        )
    )


def _level(field: ui.number) -> float | None:
    """Return the threshold typed, None where it is found by itself. Raises UsageError."""
    return None if field.value in (None, "") else number(field)


def masked(console: Console, said: Any) -> DetectionSettings:
    """Return how lights are looked for with a rectangle more, as the page tells it. Raises UsageError."""
    box = drawn(said)
    if box.side not in console.pictures:
        raise UsageError("no picture of this cell was drawn on", consequence="Nothing is masked")
    there = console.look.masked.get(box.side, ())
    if len(there) >= MASKS:
        raise UsageError(texts.MASKS_FULL.format(n=MASKS), consequence="Nothing is masked", cure=texts.UNMASK)
    return replace(console.look, masked={**console.look.masked, box.side: (*there, box.mask)})
