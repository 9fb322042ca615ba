"""The field that brings a file of the person's machine into the cell's folder."""

from __future__ import annotations

from nicegui import ui

from armsight.console import texts
from armsight.console.layout import text_of
from armsight.console.routes import LARGEST_BYTES


def uploader() -> None:
    """Choose a file of this machine and bring it into the cell's folder; the browser sends it by itself."""
    with ui.element("label"):
        text_of("span", texts.UPLOAD.format(mb=LARGEST_BYTES // 1_000_000))
        chooser = ui.element("input")
        chooser.props.update(
            {
                "type": "file",
                "data-upload": "/console/files/",
                "data-largest": str(LARGEST_BYTES),
                "data-too-big": texts.TOO_BIG.format(mb=LARGEST_BYTES // 1_000_000),
                "data-not-sent": texts.NOT_SENT,
                "data-testid": "upload",
            }
        )
    text_of("p", role="alert", id="uploaded").classes("hint")
