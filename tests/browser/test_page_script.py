"""The page's own script in a browser without a console: what is lost is not shown as how it is now."""

from __future__ import annotations

from importlib.resources import files
from typing import Any


def test_without_a_connection_state_and_figures_are_hidden(browser: Any) -> None:
    static = files("armsight") / "console" / "static"
    style, script = (static.joinpath(name).read_text(encoding="utf-8") for name in ("console.css", "page.js"))
    body = '<span data-testid="state">Measuring</span><div class="number"><div class="value">1.00 mm</div></div>'
    page = browser.new_page()
    page.set_content(f"<style>{style}</style>{body}<script>window.socket = {{connected: true}};{script}</script>")
    for connected, state in ((True, "visible"), (False, "hidden"), (True, "visible")):
        page.evaluate("now => (window.socket.connected = now)", connected)
        for what in ("[data-testid=state]", ".value"):
            page.wait_for_selector(what, state=state)
    page.close()
