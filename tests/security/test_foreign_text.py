"""Names that somebody else wrote, in pages, tables, programs and on the terminal: they are shown, and do nothing."""

from __future__ import annotations

import ast
import base64
import csv
import gzip
import io
import json
import re
from collections.abc import Iterator
from datetime import datetime
from html.parser import HTMLParser
from pathlib import Path
from unicodedata import category
from xml.sax.saxutils import escape

import numpy as np
import pytest
import typer
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from armsight.cli.command_ui import CommandUI, visible
from armsight.cli.commands import app as commands
from armsight.control.guard import Box, Limits
from armsight.control.paths import check_path
from armsight.errors import BadFile
from armsight.kinematics import Arm, pose, preset
from armsight.kinematics.symbolic import python_source
from armsight.ops.tables import convert_table
from armsight.ops.verify import verify
from armsight.records import PoseStatus, Spots, TargetPose, TaughtPath
from armsight.records.result_parts import Verdict
from armsight.report import html as pages
from armsight.report.arm_view import arm_report
from armsight.report.html import Card, Page, bullets, table
from armsight.report.path_report import path_report
from armsight.store.arm_file import read_arm
from armsight.store.tables import bare, parse_table, word
from armsight.store.tracks import SpotsWriter, write_poses
from armsight.store.urdf import arm_from_urdf, urdf_text

MARKUP = [
    "</script><script>alert(1)</script>",
    "\"'><img src=x onerror=alert(1)>",
    "<svg/onload=alert(1)>",
    "<a href='javascript:alert(1)'>x</a>",
    '<a href="https://evil.example">x</a>',
    "<iframe srcdoc='x'>",
    "</style><style>*{display:none}",
    "<!--",
    "&lt;b&gt;",
    "{{7*7}}${7*7}",
]
FORMULAS = [
    "=1+1",
    "=cmd|' /C calc'!A0",
    "+1+cmd|'!A0",
    "-1+cmd|'!A0",
    "@SUM(1)",
    '=HYPERLINK("https://evil.example","x")',
    "\t=1+1",
    "\r=1+1",
    "'=1+1",
    "''=1",
    "a,=1+1",
    'a"\n=1+1',
]
HARMLESS = ["A", "P1", "-1", "+2.5", "-1e-3", "a=b", "it's", "'quoted'", "", "x y"]
TERMINAL = ["\x1b[2J", "\x1b]0;title\x07", "\x9b31m", "a\rb", "a\x08\x08b", "\u202etxt.exe", "\u2066x\u2069", "\x00"]


class Seen(HTMLParser):
    """What a browser would make of a page: its tags, its handlers, where it leads."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def check(self) -> None:
        """Fail where it holds what none of our pages has."""
        assert not {"a", "iframe", "object", "embed", "form", "link", "base"} & set(self.tags)
        assert self.tags.count("script") == 3 and self.tags.count("style") == 1
        assert not [name for name, _ in self.attributes if name.startswith("on") or name == "srcdoc"]
        outside = [value for name, value in self.attributes if name in ("src", "href") and value]
        assert all(value.startswith(("data:image/", "#")) for value in outside)


def texts_of(page: str) -> Iterator[str]:
    """Yield every text that plotly gets: it reads some markup in them, links among it."""
    packed = re.search(r'id="figures">([^<]*)<', page)
    assert packed is not None
    left = [json.loads(gzip.decompress(base64.b64decode(packed[1])))]
    while left:
        value = left.pop()
        if isinstance(value, str):
            yield value
        elif isinstance(value, dict | list):
            left += value.values() if isinstance(value, dict) else value


def check(page: str) -> None:
    Seen(page).check()
    known = re.compile(r"</?(b|br|extra)>")
    assert not [text for text in texts_of(page) if re.search(r"<[a-z/!]", known.sub("", text))]


def hostile_arm(name: str) -> Arm:
    """Return an arm whose every name is this one, as a URDF of somebody else's brings it."""
    said = escape(name, {'"': "&quot;"})
    text = urdf_text(preset("irb120"))
    return arm_from_urdf(re.sub(r'"(irb120|j\d)"', lambda found: f'"{said}{found[1]}"', text))


@pytest.mark.parametrize("name", MARKUP)
def test_every_part_of_a_page_shows_markup_as_text(name: str) -> None:
    page = Page(
        title=name,
        subtitle=name,
        verdict=Verdict(level=name, headline=name, reasons=[name], next=[name]),
        cards=[Card(name, name, name)],
    )
    page.add(name, name, table([name], [[name]], numbers=[0]), bullets([name]))
    shown = page.html(created=datetime(2026, 1, 1))
    Seen(shown).check()
    assert shown.count(pages.text(name)) >= 10


@pytest.mark.parametrize("name", MARKUP)
def test_an_arms_page_shows_its_names_as_text(name: str) -> None:
    arm = hostile_arm(name)
    assert name in arm.joints[0].name
    check(arm_report(arm, np.zeros(6)))


@pytest.mark.parametrize("name", MARKUP)
def test_a_paths_page_shows_its_names_as_text(name: str) -> None:
    arm, home = hostile_arm(name), np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])
    T = np.repeat(pose(arm, home).as_matrix()[None], 4, axis=0)
    T[:, 1, 3] += np.linspace(0, 0.02, 4)
    tip = T[0, :3, 3]
    path = TaughtPath.of_poses(RigidTransform.from_matrix(T))
    limits = Limits(forbidden=(Box(lower_m=tip - 0.1, upper_m=tip + 0.1, name=name),))
    check(path_report(path, arm, limits, check_path(path, arm, limits, start=home), name=name))


def repeats(folder: Path, name: str) -> Path:
    """Return a file of measured repeats whose poses have this name."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(["pose", "visit", "x_m", "y_m", "z_m"])
    for i in range(12):
        writer.writerow([name if i % 2 else "P1", i // 2 + 1, 0.1 * (i % 2), 1e-5 * i, 0.0])
    path = folder / "points.csv"
    path.write_bytes(out.getvalue().encode())
    return path


@pytest.mark.parametrize("name", ["<a href='https://evil.example'>x</a>", "=1+1", "a,=1+1", 'a"b'])
def test_a_verification_shows_names_as_text_and_writes_no_formula(name: str, tmp_path: Path) -> None:
    verify(measured=repeats(tmp_path, name), out=tmp_path / "out")
    check((tmp_path / "out" / "report.html").read_text())
    rows = rows_of(tmp_path / "out" / "errors.csv")
    assert {len(row) for row in rows} == {len(rows[0])}
    assert {bare(row[1]) for row in rows[1:]} == {"P1", name} and not any(_runs(cell) for row in rows for cell in row)


def rows_of(path: Path) -> list[list[str]]:
    return list(csv.reader(io.StringIO(path.read_text(), newline="")))


def _runs(cell: str) -> bool:
    """Whether a spreadsheet takes a cell for a formula."""
    try:
        float(cell)
    except ValueError:
        return cell[:1] in ("=", "+", "-", "@", "\t", "\r")
    return False


@pytest.mark.parametrize("text", [*FORMULAS, *HARMLESS, *MARKUP])
def test_a_text_comes_back_out_of_its_cell_and_is_no_formula(text: str) -> None:
    line = f"name,x\n{word(text)},1\n"
    ((cell, _),) = list(csv.reader(io.StringIO(line, newline="")))[1:]
    assert not _runs(cell)
    back = parse_table(line.encode(), "x.csv", ("name", "x"), text=("name",)).text["name"]
    assert back == (text if word(text) != text else text.strip(),)
    assert word(text) == text or text not in HARMLESS


def test_spots_and_poses_of_a_foreign_recording_write_no_formula(tmp_path: Path) -> None:
    spots = Spots(uv_px=[[1.0, 2.0]], covariance_px2=[np.eye(2)], peak=[9.0], size_px=[2.0], model=("gauss",))
    with SpotsWriter(tmp_path / "spots.csv") as writer:
        writer.write(0.0, "=cam", ["=1+1"], spots)
    write_poses(tmp_path / "poses.csv", [TargetPose(t_s=0.0, status=PoseStatus.LOST, parent="rig", spots=("=1,2",))])
    for name in ("spots.csv", "poses.csv"):
        rows = rows_of(tmp_path / name)
        assert len(rows[0]) == len(rows[1]) and not any(_runs(cell) for cell in rows[1])


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_a_table_that_is_converted_writes_no_formula(unit: str, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f'q1,x_{unit},y_{unit},z_{unit},point\n0,1,2,3,=1+1\n0.1,4,5,6,"@a,b"\n')
    convert_table(tmp_path / "in.csv", kind="points").write(tmp_path / "out.csv")
    rows = rows_of(tmp_path / "out.csv")
    place = rows[0].index("point")
    assert [row[place] for row in rows[1:]] == ["'=1+1", "'@a,b"]


@pytest.mark.parametrize("name", ['"""\nimport os\nos.abort()\n"""', "\\", "x\nimport os", "{}", '"""'])
def test_an_arms_name_does_not_become_code(name: str) -> None:
    tree = ast.parse(python_source(hostile_arm(name)))
    imported = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert imported == ["math"] and not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]


@pytest.mark.parametrize("text", TERMINAL)
def test_nothing_that_a_terminal_obeys_is_printed(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with CommandUI(as_json=False) as face:
        face.say(f"read {text}")
        face.table("names", ["name"], [[f"[/bold]{text}[red]"]])
        face.progress(f"reading {text}").update(1.0, 2.0, text)
        with pytest.raises(typer.Exit), CommandUI(as_json=False):
            raise BadFile(f"{text} is none")
    shown = capsys.readouterr().err
    assert all(one in "\n\t" or category(one) not in ("Cc", "Cf", "Cs") for one in shown)
    assert "[/bold]" in shown, "and no markup of ours is read in it"


def test_what_people_read_stays_as_it_is() -> None:
    assert visible("Größe 12 µm, 30° — 中文\n\tσ") == "Größe 12 µm, 30° — 中文\n\tσ"


@pytest.mark.parametrize("text", TERMINAL[:3])
def test_a_refusal_out_of_a_file_does_not_reach_the_terminal_raw(text: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(json.dumps({"format": "armsight/arm", f"key{text}": 1}))
    with pytest.raises(BadFile):
        read_arm(path)
    done = CliRunner().invoke(commands, ["kinematics", "show", "--arm", str(path)])
    assert done.exit_code != 0 and text not in done.output
