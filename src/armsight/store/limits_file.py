"""limits.yaml: what the guard keeps a robot within."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from armsight.control.guard import Limits
from armsight.errors import Inconsistent
from armsight.store.codec import mapping, named, record_of, structure
from armsight.store.schema import Kind, Origin, read_document

Limit = structure(Limits)


class LimitsModel(Origin, Limit):  # type: ignore[valid-type, misc]  # made of the record's fields
    """limits.yaml; every key but the format may be left out for its default."""

    record = Limits
    format: Literal["armsight/limits"] = "armsight/limits"


def limits_from_mapping(content: Mapping[str, Any], where: str = "limits") -> Limits:
    """Return the limits that limits.yaml's structure describes; BadFile, with the key, where they cannot be."""
    with named(where):
        _check_values(content)
    return LIMITS_YAML.parse(content, where)


def _check_values(content: Any, key: str = "") -> None:
    """Raise Inconsistent for a key without a value: what was to stand there would not be kept."""
    parts = content.items() if isinstance(content, Mapping) else enumerate(content) if isinstance(content, list) else ()
    for part, value in parts:
        at = f"{key}[{part}]" if isinstance(part, int) else f"{key}.{part}" if key else str(part)
        if value is None:
            raise Inconsistent(
                f"{at[:80]} has no value",
                consequence="What should stand there would not be kept, and nothing is moved",
                cure="Give one, or leave the key away for the default",
            )
        _check_values(value, at)


def limits_mapping(limits: Limits) -> dict[str, Any]:
    """Return limits as limits.yaml has them, all of them written out."""
    content = mapping(limits)
    return content if limits.joints else {key: value for key, value in content.items() if key != "joints"}


LIMITS_YAML: Kind[Limits] = Kind(name="limits", model=LimitsModel, record=record_of, content=limits_mapping)
write_limits = LIMITS_YAML.write


def read_limits(path: Path) -> Limits:
    """Return what a limits.yaml says; BadFile where it is none."""
    return limits_from_mapping(read_document(path, LIMITS_YAML.format), str(path))
