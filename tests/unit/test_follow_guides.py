"""The tool that follows the guides sees every command, and its lists name only what the guides still say."""

import re
from pathlib import Path

import pytest

from loading import module_of

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def tool():
    return module_of(ROOT / "tools" / "follow_guides.py")


def commands(tool):
    return [step for page in tool.pages() for step in tool.steps(page)]


def test_every_guide_is_followed(tool):
    assert {page.name for page in (ROOT / "docs" / "guide").glob("*.md")} <= {page.name for page in tool.pages()}
    assert tool.pages()[0] == ROOT / "README.md"


def test_commands_are_told_from_what_they_print(tool):
    block = "armsight a \\\n    --b\nCause: none\n$ armsight c\n# armsight d\ncat > x <<END\narmsight: e\nEND\n"
    told = [step.text for step in tool.shell_steps("x", 1, block, everything=False)]
    assert told == ["armsight a \\\n    --b", "armsight c", "cat > x <<END\narmsight: e\nEND"]
    assert [step.line for step in tool.shell_steps("x", 1, block, everything=False)] == [1, 4, 6]


def test_no_line_with_a_command_is_missed(tool):
    for page in tool.pages():
        blocks = "".join(match[2] for match in tool.FENCE.finditer(page.read_text()) if match[1] in {"bash", "text"})
        lines = re.findall(r"^(?:\$ )?armsight \w", blocks, re.MULTILINE)
        seen = [step for step in tool.steps(page) if re.match("armsight ", step.text)]
        assert len(seen) == len(lines), page


def test_what_stands_in_and_what_cannot_run_is_in_the_guides(tool):
    texts = [step.text for step in commands(tool)]
    for part in (*tool.NOT_HERE, *tool.KEYS):
        assert any(part in text for text in texts), part
    for page, parts in tool.STAND_INS.items():
        own = [step.text for step in commands(tool) if step.page == page]
        assert any(part in text for part in parts for text in own), page
