"""The page on JSON output and the JSON schemas say what the models say."""

from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import pytest

from armsight.records.output import keys
from armsight.store.codec import outputs_in
from loading import module_of

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    """tools/json_schemas.py"""
    return module_of(ROOT / "tools" / "json_schemas.py")


def test_page_and_schemas_are_up_to_date(tool: Any) -> None:
    assert not tool.stale(ROOT / "docs"), "run python tools/json_schemas.py"


def test_every_key_is_described_in_one_line(tool: Any) -> None:
    kinds = set(tool.OUTPUTS.values())
    assert len(kinds) > 40
    while more := {kind for one in kinds for key in keys(one) for kind in outputs_in(key.hint)} - kinds:
        kinds |= more
    for kind in kinds:
        for key in keys(kind):
            assert key.doc.text.endswith("."), (kind, key.name)
            assert "\n" not in key.doc.text and len(key.doc.text) < 170, (kind, key.name)
        # what may be None is left out then where that is its default, and always there where it has none
        told = {key.attribute for key in keys(kind) if type(None) in get_args(next(iter(get_args(key.hint)), None))}
        held = fields(kind) if is_dataclass(kind) else ()  # named tuples have no defaults
        assert all(one.default in (None, MISSING) for one in held if one.name in told), kind
