"""The protocol's page and schema tell every message and every key."""

import json
import re
from pathlib import Path
from typing import get_args

import pytest

from armsight.drivers.remote import protocol as say
from loading import module_of

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = (DOCS / "protocol.md").read_text(encoding="utf-8")
MADE = module_of(DOCS.parent / "tools" / "protocol_messages.py").page()
MESSAGES = [*get_args(say.Command), *get_args(say.ServerMessage)]
EXAMPLES = re.findall(r"^```json\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_every_message_and_key_is_told(kind):
    name = kind.model_fields["type"].default
    assert f"`{name}`" in PAGE or f'"type": "{name}"' in PAGE
    section = next(part for part in MADE.split("\n### ") if part.startswith(f"{name}\n"))
    for key in kind.model_fields.keys() - {"type", "session", "seq"}:
        assert f"| `{key}` |" in section, key


def test_the_examples_are_messages():
    welcome, goal = EXAMPLES
    assert say.parse_answer(welcome).session == say.parse_command(goal).session


def test_the_limits_are_told():
    assert f"{say.MAX_BYTES} bytes" in PAGE
    assert f"Version {say.VERSION}." in PAGE


def test_the_schema_is_published():
    assert json.loads((DOCS / "schemas" / "robot-server.json").read_text()) == say.protocol_schema()
