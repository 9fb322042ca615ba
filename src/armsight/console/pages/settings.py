"""Settings: cameras and files of the cell, all kept in cell.yaml and in the files the command line uses."""

from __future__ import annotations

import re

from nicegui import events, run, ui

from armsight.console import texts
from armsight.console.layout import button, card, set_attribute, set_text, text_of
from armsight.console.state import Console
from armsight.errors import ArmsightError
from armsight.store.atomic import write_bytes

SOURCES = ("left", "right", "board")
LARGEST_BYTES = 2_000_000
"""Of an uploaded file: a rig with its covariance has 20 kB, a long table of readings some 100 kB."""
NAME = re.compile(r"[\w][\w.-]{0,80}\.(ya?ml|csv|urdf)")


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
        _upload(console)
    said = text_of("p", role="alert").classes("hint")

    async def apply() -> None:
        changed = {name: (field.value or "").strip() for name, field in fields.items()}
        try:
            cell = console.cell.model_copy(update={**changed, "play_again": bool(again.value)})
            await run.io_bound(console.apply, cell)
            set_text(said, texts.APPLIED)
            set_attribute(said, "data-level", "good")
        except ArmsightError as error:
            set_text(said, str(error))
            set_attribute(said, "data-level", "bad")

    button(texts.APPLY, apply, testid="apply")


def _field(console: Console, name: str) -> ui.input:
    field = ui.input(texts.FIELDS[name], value=getattr(console.cell, name)).classes("w-full")
    field.props["data-testid"] = f"field-{name}"
    return field


def _upload(console: Console) -> None:
    said = text_of("p", role="alert").classes("hint")
    mb = LARGEST_BYTES // 1_000_000

    async def take(event: events.UploadEventArguments) -> None:
        name = event.file.name
        path = console.folder / name
        if not NAME.fullmatch(name):
            set_text(said, texts.NOT_A_NAME.format(name=name))
        elif path.exists():
            set_text(said, texts.EXISTS.format(name=name))
        else:
            try:
                console.folder.mkdir(parents=True, exist_ok=True)
                write_bytes(path, await event.file.read())
                set_text(said, texts.UPLOADED.format(name=name))
            except ArmsightError as error:
                set_text(said, str(error))

    chooser = ui.upload(
        label=texts.UPLOAD.format(mb=mb),
        auto_upload=True,
        max_file_size=LARGEST_BYTES,
        on_upload=take,
        on_rejected=lambda: set_text(said, texts.TOO_BIG.format(mb=mb)),
    )
    chooser.props["data-testid"] = "upload"
