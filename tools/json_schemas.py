"""Writes docs/schemas/*.json from the results that commands and the robot server tell programs; makes the page on them.

python tools/json_schemas.py [--check]
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from armsight.drivers.remote.protocol import protocol_schema
from armsight.measure.results import REASONS
from armsight.ops import actions
from armsight.ops.action import action_of
from armsight.ops.demo import DemoOutput
from armsight.records.output import Output
from armsight.records.result_parts import RefusalOutput
from armsight.store.codec import output_model
from armsight.store.recording import Repaired
from armsight_lab.batch.results import BatchOutput
from armsight_lab.cell_plan.run import CellPlanOutput
from armsight_lab.design.records import DesignOutput
from armsight_lab.history.adding import AddedOutput
from armsight_lab.history.looking import (
    HistoryCompareOutput,
    HistoryExportOutput,
    HistoryListOutput,
    HistoryShowOutput,
)
from armsight_lab.history.trend import TrendOutput

OTHERS: Sequence[type[Output]] = (
    *(DemoOutput, Repaired, DesignOutput, BatchOutput, CellPlanOutput),
    *(AddedOutput, HistoryListOutput, HistoryShowOutput, HistoryCompareOutput, TrendOutput, HistoryExportOutput),
)
"""Of commands that are no actions."""
NAMES = {
    "ProposedPlanOutput": "identify-propose",
    "MasteringPlanOutput": "verify-mastering-poses",
    "ConvertOutput": "convert",
    "PathChangeOutput": "path-change",
}
"""Of models whose first line has no words for a name alone."""


def given() -> Iterator[type[Output]]:
    """Yield what the actions say to return, from where their modules import it for type checkers."""
    for call in actions():
        module = sys.modules[call.__module__]
        tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        where = {
            alias.name: node.module
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for name in action_of(call).function.__annotations__["return"].split(" | "):
            yield getattr(import_module(str(where[name])), name)


def name_of(model: type[Output]) -> str:
    """Return the name of a model's schema: the command's words, with which the first line of its docstring begins."""
    words = re.match(r"(?:armsight )?([a-z -]+)", str(model.__doc__))
    return NAMES.get(model.__name__) or "-".join(words[1].replace("--", "").split() if words else ())


OUTPUTS: Mapping[str, type[Output]] = {
    **{name_of(model): model for model in (*given(), *OTHERS)},
    "error": RefusalOutput,
}
"""Name of the JSON schema -> model."""


DOCS = Path(__file__).resolve().parent.parent / "docs"
UNITS = {
    "m": "m",
    "rad": "rad",
    "px": "px",
    "s": "s",
    "bytes": "bytes",
    "levels": "grey levels",
    "levels2": "grey levels squared",
}
"""What the last part of a key says of its unit."""

TYPES = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false", "null": "null"}

HEAD = """\
# JSON output

With `--json` a command prints one JSON object on standard output and nothing else. Keys carry their unit; `null` stands
for a figure that there is no data for, and so does every number that is not finite. A key marked *optional* is left out
where it does not apply. Keys stay; more keys may come. Frames are as in [conventions](conventions.md): `T_a_b` is the
pose of b in a.

`NAME` stands for names of the data, `[]` for each item of a list. The JSON schema of each object is linked beside its
command. The schemas are made by `tools/json_schemas.py` from the results themselves, this page with the site.

`reasons` of `measure` and `demo` counts by kind what took poses away or made them doubtful: {kinds}.
""".format(kinds="; ".join(f"`{kind}` ({words})" for kind, words in sorted(REASONS.items())))


def main() -> int:
    """Write the files; with --check tell which are not up to date instead."""
    parser = argparse.ArgumentParser(description="Write docs/schemas/*.json.")
    parser.add_argument("--check", action="store_true", help="write nothing, tell which files are not up to date")
    check = parser.parse_args().check
    wrong = stale(DOCS)
    for name in wrong:
        print(f"{name} is not up to date" if check else name)
    if not check:
        write(DOCS)
    return int(check and bool(wrong))


def pages() -> dict[str, str]:
    """Return the content of every generated file by its name below docs/."""
    made = {f"schemas/{name}.json": json.dumps(schema(name), indent=2, ensure_ascii=False) + "\n" for name in OUTPUTS}
    protocol = json.dumps(protocol_schema(), indent=2, ensure_ascii=False) + "\n"
    return {**made, "schemas/robot-server.json": protocol}


def stale(docs: Path) -> list[str]:
    """Return the names of the files below docs that are missing, differ from what the models say, or are left over."""
    made = pages()
    there = {f"schemas/{path.name}" for path in (docs / "schemas").glob("*.json")}
    differ = [name for name, text in made.items() if not _is(docs / name, text)]
    return [*differ, *sorted(there - made.keys())]


def write(docs: Path) -> None:
    """Write every generated file below docs, and remove those left over."""
    made = pages()
    (docs / "schemas").mkdir(parents=True, exist_ok=True)
    for path in (docs / "schemas").glob("*.json"):
        if f"schemas/{path.name}" not in made:
            path.unlink()
    for name, text in made.items():
        (docs / name).write_text(text, encoding="utf-8")


def schema(name: str) -> dict[str, Any]:
    """Return the JSON schema of a command's object; further keys are allowed, as they may come."""
    made: dict[str, Any] = _plain(output_model(OUTPUTS[name]).model_json_schema(mode="serialization"))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **made}


def page() -> str:
    """Return the page with a table of keys for each command."""
    parts = [HEAD]
    for name in OUTPUTS:
        made = schema(name)
        parts.append(f"\n## {name}\n\n{made['description']} [JSON schema](schemas/{name}.json)\n")
        parts.append("| key | type | unit | meaning |\n|---|---|---|---|")
        parts += [f"| {' | '.join(row)} |" for row in rows(made, made.get("$defs", {}))]
    return "\n".join(parts) + "\n"


def rows(
    model: Mapping[str, Any], known: Mapping[str, Any], prefix: str = "", unit: str = ""
) -> Iterator[tuple[str, str, str, str]]:
    """Yield key, type, unit and meaning of every key of an object, those of objects inside it after it."""
    for key, field in model["properties"].items():
        own = _unit(key, field) or unit
        optional = "" if key in model["required"] else " *optional*"
        yield f"`{prefix}{key}`", _type(field, known) + optional, own, _meaning(field, known)
        for path, inner in _inside(field, known):
            yield from rows(inner, known, f"{prefix}{key}{path}.", own)


def _inside(field: Mapping[str, Any], known: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the objects that a key holds, with what stands between its name and theirs; of several the fullest."""
    if "$ref" in field:
        yield "", known[_name(field)]
    elif "anyOf" in field:
        found = [item for option in field["anyOf"] for item in _inside(option, known)]
        yield from sorted(found, key=lambda item: -len(item[1]["properties"]))[:1]
    elif field.get("type") == "array" and "items" in field:
        yield from ((f"[]{path}", inner) for path, inner in _inside(field["items"], known))
    elif isinstance(field.get("additionalProperties"), dict):
        yield from ((f".NAME{path}", inner) for path, inner in _inside(field["additionalProperties"], known))


def _meaning(field: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    """Return a key's description; pydantic leaves it out where it is that of the object itself."""
    return str(field["description"] if "description" in field else known[_name(field)]["description"])


def _type(field: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    if "$ref" in field:
        return "object"
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(_type(option, known) for option in field["anyOf"]))
    if field["type"] == "array":
        items = field.get("prefixItems")
        of = _type(items[0] if items else field["items"], known)
        return f"list of {len(items)} ({of})" if items else f"list ({of})"
    if field["type"] == "object":
        return f"by name ({_type(field['additionalProperties'], known)})"
    return TYPES[field["type"]]


def _unit(key: str, field: Mapping[str, Any]) -> str:
    given = field.get("unit")
    last = key.rpartition("_")[2] if "_" in key else ""
    return str(given) if given is not None else UNITS.get(last, "")


def _name(field: Mapping[str, Any]) -> str:
    return str(field["$ref"]).rpartition("/")[2]


def _plain(value: Any, *, names: bool = False) -> Any:
    """Return a schema without pydantic's titles and the ban on further keys; names: the keys are names of fields."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if not isinstance(value, dict):
        return value
    if not names:
        value = _without_default(value)
    closed = not names and value.get("additionalProperties") is False
    dropped = set() if names else {"title", "additionalProperties"} if closed else {"title"}
    return {
        key: _plain(item, names=key in ("properties", "$defs") and not names)
        for key, item in value.items()
        if key not in dropped
    }


def _without_default(field: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a key that may be left out without its default null, which is never written."""
    if "default" not in field or "anyOf" not in field:
        return field
    options = [option for option in field["anyOf"] if option != {"type": "null"}]
    rest = {key: item for key, item in field.items() if key not in ("default", "anyOf")}
    return {**rest, **options[0]} if len(options) == 1 else {**rest, "anyOf": options}


def _is(path: Path, text: str) -> bool:
    return path.is_file() and path.read_text(encoding="utf-8") == text


if __name__ == "__main__":
    sys.exit(main())
