"""Reports as PDF: printed by a browser where there is one, refused with a cure where not."""

from __future__ import annotations

import re
import shutil
import zlib
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.errors import DeviceFailed, DeviceNotFound
from armsight.ops.print_report import BROWSERS, print_report
from armsight.records.result_parts import Verdict
from armsight.report.figures import Figure, layout, points_in_space
from armsight.report.html import Page
from refusals import refuses


@pytest.fixture
def report(tmp_path: Path) -> Path:
    page = Page(
        title="Title",
        subtitle="",
        verdict=Verdict(level="good", headline="Good", reasons=["It is good."], next=[""]),
        cards=(),
    )
    cube = points_in_space("cube", np.random.default_rng(1).uniform(size=(20, 3)), {"size": 4})
    page.add("Space", "", page.plot(Figure(data=[cube], layout=layout(scene={"aspectmode": "data"}))))
    (tmp_path / "report.html").write_text(page.html(created=datetime(2026, 1, 1)), encoding="utf-8")
    return tmp_path / "report.html"


def browser(folder: Path, script: str) -> str:
    path = folder / "browser"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no browser that prints")
def test_a_browser_prints_it_with_its_plot(report: Path) -> None:
    done = CliRunner().invoke(app, ["report", str(report.parent), "--pdf"])
    assert done.exit_code == 0, done.output
    pdf = report.with_suffix(".pdf").read_bytes()
    assert pdf.startswith(b"%PDF") and b"/MediaBox [0 0 594.95996 841.91998]" in pdf  # A4
    drawn = [zlib.decompress(data) for data in re.findall(rb"/Subtype /Image.*?stream\r?\n(.*?)endstream", pdf, re.S)]
    assert max(len(set(pixels)) for pixels in drawn) > 20, "the view in space, drawn by WebGL, is not blank"
    assert b"/Title (Title)" in pdf


def test_without_a_browser_it_is_refused_with_a_cure(report: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(DeviceNotFound, match="ARMSIGHT_BROWSER") as refused:
        print_report(report)
    assert refused.value.cure
    monkeypatch.setenv("ARMSIGHT_BROWSER", "no-such-browser")
    with refuses(DeviceNotFound, "no-such-browser"):
        print_report(report)


@pytest.mark.parametrize(("script", "named"), [("echo no display >&2; exit 1", "no display"), ("exit 0", "PDF")])
def test_a_browser_that_does_not_print_is_told(
    report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, named: str
) -> None:
    monkeypatch.setenv("ARMSIGHT_BROWSER", browser(tmp_path, script))
    with refuses(DeviceFailed, named):
        print_report(report)
    assert not report.with_suffix(".pdf").exists()
