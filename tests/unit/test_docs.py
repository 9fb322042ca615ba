"""Every code block of the README and the docs runs; blocks of one page share a folder and follow each other.

Blocks marked `text` are output, need hardware or take long, and are not run here: tools/follow_guides.py follows them.
`make` lines are checked against the Makefile.
"""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import warm_python
from loading import module_of

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RUN = {"bash", "python"}
MADE = {
    *("json.md", "python-flags.md", "protocol-messages.md"),
    *("benchmark-tables.md", "security-roles.md", "security-tests.md", "strangers.md"),
}
"""Pages that are made with the site."""
SHOWN = {"text", "yaml", "json", "csv", "toml", "mermaid"}


def blocks(page: Path) -> list[tuple[str, str]]:
    return [(match[1], match[2]) for match in FENCE.finditer(page.read_text(encoding="utf-8"))]


def make_targets() -> set[str]:
    return set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def test_every_block_is_of_a_known_kind() -> None:
    unknown = {(page.name, kind) for page in PAGES for kind, _ in blocks(page) if kind not in RUN | SHOWN}
    assert not unknown, "blocks of these kinds are neither run nor shown as output"


@pytest.mark.parametrize(
    "page", [p for p in PAGES if any(kind in RUN for kind, _ in blocks(p))], ids=lambda p: str(p.relative_to(ROOT))
)
def test_the_blocks_run(page: Path, tmp_path: Path) -> None:
    path = os.pathsep.join([str(warm_python.commands()), str(Path(sys.executable).parent), os.environ["PATH"]])
    for number, (kind, text) in enumerate(block for block in blocks(page) if block[0] in RUN):
        if kind == "bash":
            lines = [line for line in text.splitlines() if not line.startswith("git clone")]
            made = [line.split()[1] for line in lines if line.startswith("make ")]
            assert set(made) <= make_targets(), f"{page.name}: no such make target among {made}"
            text = "\n".join(line for line in lines if not line.startswith(("make ", "cd armsight")))
            command = ["bash", "-euo", "pipefail", "-c", text]
        else:
            script = tmp_path / f"block_{number}.py"
            script.write_text(text, encoding="utf-8")
            command = ["python", str(script)]
        done = subprocess.run(
            command, cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{page.name}, block {number}:\n{text}\n{done.stdout}\n{done.stderr}"


def test_links_inside_the_project_lead_somewhere() -> None:
    for page in PAGES:
        text = FENCE.sub("", page.read_text(encoding="utf-8"))
        for link in re.findall(r"\]\(([^)#\s]+)", text):
            if "://" not in link and not link.startswith("mailto:"):
                there = (page.parent / link).exists() or link.split("/")[-1] in MADE
                assert there, f"{page.name} links to {link}, which is not there"


def test_the_files_that_the_architecture_leads_to_are_there() -> None:
    text = FENCE.sub("", (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"))
    named = re.findall(r"`([a-z0-9_/]+\.py)`", text)
    roots = ("", "src/armsight", "sim/src", "sim/src/armsight_sim", "plant/src", "lab/src", "lab/src/armsight_lab")
    missing = [name for name in named if not any((ROOT / root / name).is_file() for root in roots)]
    assert len(named) > 40 and not missing


def test_every_benchmark_with_figures_has_a_headline_a_script_and_tables() -> None:
    tool = module_of(ROOT / "tools" / "benchmark_results.py")
    results = tool.results()
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert set(re.findall(r"benchmark-tables\.md#(\w+)", page)) == set(results)
    assert tool.with_summary(page) == page  # the table of the last run
    assert tool.with_summary(page.replace("Pinocchio", "Another", 1)) == page
    scripts = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    assert set(results) - scripts == {"public_data"}  # read by hand
    made = tool.page()
    for name, content in results.items():
        assert f"\n## {name}\n" in made
        for run in content["runs"]:
            assert {"command", "date", "machine", "commit"} < set(run)
            for one in run["tables"]:
                head, _, *rows = tool.markdown(one["rows"]).splitlines()
                assert {row.count(" | ") for row in rows} == {head.count(" | ")}, (name, one["title"])


def test_a_headline_is_taken_from_its_row_and_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    summary = module_of(ROOT / "benchmarks" / "summary.py")
    header = ["what", "median", "fastest", "wanted", "peer", "ratio"]
    rows = [header, ["FK", "0.1", "0.1", "", "Pinocchio FK", "5x"], ["Pinocchio FK", "0.5", "0.4", "", "", ""]]
    first = summary.FIGURES[0]
    assert summary.row_of(first, [("korayem6r, 2 poses", rows)])[1:4] == [0.1, 0.5, "5"]
    assert summary.row_of(first, [("korayem6r, 2 poses", rows[:2])])[1:] == [0.1, "", "", "Pinocchio: not installed"]
    assert summary.row_of(first, [])[-1].endswith("not run here")


def test_the_tests_of_what_was_tried_are_there() -> None:
    with (ROOT / "tests" / "security" / "tried.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    named = {name for row in rows for name in re.findall(r"`(?:architecture/)?(test_\w+)`", row["test"])}
    assert len(rows) > 30 and named <= {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
