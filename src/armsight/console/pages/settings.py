"""Settings: cameras and files of the cell, all kept in cell.yaml and in the files the command line uses."""

from __future__ import annotations

from nicegui import run, ui

from armsight.console import texts
from armsight.console.layout import button, card, file_name, refusals_in, say, text, text_of, ticked, uploader
from armsight.console.state import Console
from armsight.ops.flags import cameras_of

SOURCES = ("left", "right", "cameras", "board")
BETWEEN = "; "
"""Parts the cameras by name."""


def settings_page(console: Console) -> None:
    """Build the page."""
    fields: dict[str, ui.input] = {}
    with card(texts.CAMERAS):
        for name in SOURCES:
            fields[name] = _field(console, name)
        again = ui.checkbox(texts.PLAY_AGAIN, value=console.cell.play_again)
    with card(texts.FILES.format(folder=console.folder)):
        for name in texts.FIELDS:
            if name not in SOURCES:
                fields[name] = _field(console, name)
        uploader()
    said = text_of("p", role="alert").classes("hint")

    async def apply() -> None:
        with refusals_in(said):
            changed = {name: _typed(console, name, field) for name, field in fields.items()}
            cell = console.cell.changed({**changed, "play_again": ticked(again)})
            await run.io_bound(console.apply, cell)
            say(said, texts.APPLIED)

    button(texts.APPLY, apply, testid="apply")


def _field(console: Console, name: str) -> ui.input:
    named = BETWEEN.join(f"{camera}={source}" for camera, source in console.cell.named.items())
    value = named if name == "cameras" else getattr(console.cell, name)
    field = ui.input(texts.FIELDS[name], value=value).classes("w-full")
    field.props["data-testid"] = f"field-{name}"
    return field


def _typed(console: Console, name: str, field: ui.input) -> str | dict[str, str]:
    """Return what a field holds: cameras by name, a source or board as it is, else a file of the folder.

    Raises UsageError.
    """
    if name == "cameras":
        return cameras_of([one for part in text(field).split(BETWEEN.strip()) if (one := part.strip())])
    return text(field) if name in SOURCES else file_name(field, kept=getattr(console.cell, name))
