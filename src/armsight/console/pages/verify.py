"""Verify: measured poses against the arm's own joints, and all reports of the cell."""

from __future__ import annotations

from datetime import datetime
from functools import partial
from pathlib import Path

from nicegui import run, ui

from armsight.app.requests.verify import VerifyJob
from armsight.app.schemas.verify import VerifyOutput
from armsight.app.verify.run import run_verify
from armsight.console import texts
from armsight.console.fields import file_name
from armsight.console.layout import button, card, set_attribute, set_text, text_of
from armsight.console.pages.iso import iso_card
from armsight.console.pages.supervision import supervision_card
from armsight.console.state import Console
from armsight.console.uploads import reports
from armsight.errors import ArmsightError
from armsight.store.cell_file import within

FIELDS = ("measured", "joints")


def verify_page(console: Console) -> None:
    """Build the page."""
    with card(texts.VERIFY):
        fields = {name: ui.input(texts.VERIFY_FIELDS[name]).classes("w-full") for name in FIELDS}
        for name, field in fields.items():
            field.props["data-testid"] = f"field-{name}"
        said = text_of("p", role="alert").classes("hint")
        result = ui.element("div").classes("scroll")

        async def verify() -> None:
            set_attribute(said, "data-level", "good")
            set_text(said, texts.RUNNING_VERIFY)
            result.clear()
            try:
                done = await run.io_bound(partial(_verify, console, {n: file_name(f) for n, f in fields.items()}))
                if done is None:  # the server is ending
                    return
                set_text(said, done.verdict)
                with result:
                    _table(done)
                listing.refresh(console)
            except ArmsightError as error:
                set_text(said, str(error))
                set_attribute(said, "data-level", "bad")

        button(texts.VERIFY_RUN, verify, testid="verify-run")
    supervision_card(console)
    iso_card(console, lambda: listing.refresh(console))
    listing(console)


def _verify(console: Console, names: dict[str, str]) -> VerifyOutput:
    """Verify files of the cell's folder into a folder of their own, named after the time."""
    out = console.folder / f"verify-{datetime.now():%Y%m%d-%H%M%S}"
    measured, joints = (within(console.folder, names[name]) for name in FIELDS)
    arm = console.file("arm") if names["joints"] else None
    job = VerifyJob(measured=measured, out=out, arm=None if arm is None else str(arm), joints=joints if arm else None)
    return run_verify(job)


def _table(done: VerifyOutput) -> None:
    with ui.element("table").classes("plain"):
        for name, value in (
            (texts.ROWS, str(done.n)),
            (texts.CAUSE, done.cause),
        ):
            with ui.element("tr"):
                text_of("td", name)
                text_of("td", value)


@ui.refreshable
def listing(console: Console) -> None:
    """List the cell's reports, the newest first."""
    with card(texts.REPORTS):
        found = reports(console.folder)
        if not found:
            text_of("p", texts.NO_REPORTS).classes("hint")
        with ui.element("table").classes("plain"):
            for path in found:
                with ui.element("tr"):
                    with ui.element("td"):
                        text_of("a", str(path), href=f"/console/files/{path}", target="_blank")
                    text_of("td", _when(console.folder / path))


def _when(path: Path) -> str:
    return datetime.fromtimestamp(path.stat().st_mtime).strftime("%Y-%m-%d %H:%M")
