"""YAML text in and out: the safe core of YAML 1.2, no surprises.

Only null, bool, int, float, str, lists and mappings are read (and OpenCV's matrix tag, for its files). Words like
`yes` or `2026-11-20` stay text, `1e-5` is a number, keys are text and appear once, aliases may not blow up.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from armsight.errors import BadFile
from armsight.store.atomic import read_bytes

MAX_BYTES = 500_000
"""The largest file of ours, a rig with its full covariance, has 20 kB."""

MAX_NODES = 30_000
"""Values in a file, with aliases written out: a rig with its full covariance has 800."""

MAX_DEPTH = 40
"""Lists and mappings within each other: the deepest file of ours has 5."""

_INT = re.compile(r"^[-+]?[0-9]+$|^0o[0-7]+$|^0x[0-9a-fA-F]+$")
_FLOAT = re.compile(
    r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|Nan|NaN|NAN)$"
)
_NULL = re.compile(r"^(?:~|null|Null|NULL|)$")
_BOOL = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
_TAG = "tag:yaml.org,2002:"
_CORE = ((f"{_TAG}null", _NULL), (f"{_TAG}bool", _BOOL), (f"{_TAG}int", _INT), (f"{_TAG}float", _FLOAT))


class _Loader(yaml.SafeLoader):
    """SafeLoader cut down to the core schema."""

    yaml_implicit_resolvers = {None: list(_CORE)}  # noqa: RUF012 - the base class's own attribute, read only
    yaml_constructors = {}  # noqa: RUF012 - filled below, once

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node, and give up early on a file that is none of ours."""
        self._depth += 1
        self._nodes += 1
        if self._depth > MAX_DEPTH:
            raise yaml.composer.ComposerError(None, None, "nested too deeply")
        if self._nodes > MAX_NODES:
            raise yaml.composer.ComposerError(None, None, "more values than any file here has")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _null(loader: _Loader, node: yaml.Node) -> None:
    return None


def _scalar(loader: _Loader, node: yaml.Node) -> str:
    if not isinstance(node, yaml.ScalarNode):
        raise yaml.constructor.ConstructorError(None, None, "a single value is wanted here", node.start_mark)
    text = str(node.value)
    if any("\ud800" <= letter <= "\udfff" for letter in text):
        raise yaml.constructor.ConstructorError(None, None, "half a character (a surrogate)", node.start_mark)
    return text


def _bool(loader: _Loader, node: yaml.Node) -> bool:
    return _checked(node, _scalar(loader, node), _BOOL).lower() == "true"


def _int(loader: _Loader, node: yaml.Node) -> int:
    text = _checked(node, _scalar(loader, node), _INT)
    return int(text, 0) if text[:2] in ("0o", "0x") else int(text)


def _float(loader: _Loader, node: yaml.Node) -> float:
    text = _scalar(loader, node)
    if _INT.match(text):
        return float(_int(loader, node))
    text = _checked(node, text, _FLOAT).lower()
    return float(text.replace(".inf", "inf").replace(".nan", "nan"))


def _checked(node: yaml.Node, text: str, pattern: re.Pattern[str]) -> str:
    if not pattern.match(text):
        raise yaml.constructor.ConstructorError(None, None, f"{text[:40]!r} does not fit its tag", node.start_mark)
    return text


def _list(loader: _Loader, node: yaml.Node) -> list[Any]:
    if not isinstance(node, yaml.SequenceNode):
        raise yaml.constructor.ConstructorError(None, None, "a list is wanted here", node.start_mark)
    return [loader.construct_object(item, deep=True) for item in node.value]


def _mapping(loader: _Loader, node: yaml.Node) -> dict[str, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, "a mapping is wanted here", node.start_mark)
    out: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = _scalar(loader, key_node)
        if key in out:
            raise yaml.constructor.ConstructorError(
                None, None, f"the key {key[:60]!r} stands twice", key_node.start_mark
            )
        out[key] = loader.construct_object(value_node, deep=True)
    return out


def _undefined(loader: _Loader, node: yaml.Node) -> None:
    raise yaml.constructor.ConstructorError(None, None, f"the tag {node.tag[:60]!r} is not known", node.start_mark)


_Loader.add_constructor(None, _undefined)
for _name, _constructor in (
    ("null", _null),
    ("bool", _bool),
    ("int", _int),
    ("float", _float),
    ("str", _scalar),
    ("seq", _list),
    ("map", _mapping),
    ("opencv-matrix", _mapping),
    ("opencv-nd-matrix", _mapping),
):
    _Loader.add_constructor(_TAG + _name, _constructor)


class _Dumper(yaml.SafeDumper):
    """SafeDumper that also quotes what only our reader would take for a number."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - the base class's own attribute, read only
        **yaml.SafeDumper.yaml_implicit_resolvers,
        None: [*yaml.SafeDumper.yaml_implicit_resolvers.get(None, []), *_CORE],
    }

    def ignore_aliases(self, data: Any) -> bool:
        """Write every value out in full."""
        return True


def _text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    """Escape the line ends of Unicode, which plain and single-quoted text would lose."""
    style = '"' if any(letter in text for letter in "\x85\u2028\u2029") else None
    return dumper.represent_scalar(f"{_TAG}str", text, style=style)


_Dumper.add_representer(str, _text)


def dump_yaml(value: dict[str, Any]) -> str:
    """Return the mapping as YAML in its own order; short lists on one line, floats in full precision."""
    return str(
        yaml.dump(value, Dumper=_Dumper, default_flow_style=None, sort_keys=False, width=120, allow_unicode=True)
    )


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file; BadFile, naming place and reason, where it is none."""
    return parse_yaml(read_bytes(path, limit=MAX_BYTES), str(path))


def parse_yaml(data: bytes, where: str) -> dict[str, Any]:
    """Return the mapping in YAML bytes (UTF-8); where names them in errors. Raises BadFile and nothing else."""
    value = _guarded(_without_opencv_header(_decoded(data, where)), where)
    if not isinstance(value, dict):
        found = "empty" if value is None else f"a {type(value).__name__}, not a mapping of keys to values"
        raise BadFile(f"{where}: the file is {found}", cure="Check the file")
    return value


def _decoded(data: bytes, where: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadFile(
            f"{where}: byte {error.start} is not UTF-8 text", cure="Save it as UTF-8; it may be a binary file"
        ) from error


def _without_opencv_header(text: str) -> str:
    """Drop `%YAML:1.0`, which OpenCV writes and which no YAML reader takes; the line stays, empty."""
    return text[text.index("\n") :] if text.startswith("%YAML:") and "\n" in text else text


def _load(text: str) -> Any:
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _refuse_explosion(node)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _refuse_explosion(root: yaml.Node) -> None:
    """Raise where aliases, written out, make a cycle or more than MAX_NODES nodes."""
    sizes: dict[int, int] = {}

    def size(node: yaml.Node) -> int:
        known = sizes.get(id(node))
        if known == 0:
            raise yaml.constructor.ConstructorError(None, None, "an alias that contains itself", node.start_mark)
        if known is not None:
            return known
        sizes[id(node)] = 0
        children: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            children = node.value
        elif isinstance(node, yaml.MappingNode):
            children = [part for pair in node.value for part in pair]
        total = 1 + sum(size(child) for child in children)
        if total > MAX_NODES:
            raise yaml.constructor.ConstructorError(None, None, "more values than any file here has", node.start_mark)
        sizes[id(node)] = total
        return total

    size(root)


def _not_yaml(position: str, reason: str) -> BadFile:
    return BadFile(f"{position}: {reason}", cure="Correct it there")


def parse_yaml_documents(data: bytes, where: str) -> list[Any]:
    """Return the documents in YAML (or JSON) bytes, apart by '---', each within parse_yaml's limits. Raises BadFile."""
    text = _without_opencv_header(_decoded(data, where))
    out = []
    for part in re.split(r"(?m)^---[ \t]*$", text):
        if not part.strip() or all(line.lstrip().startswith("#") or not line.strip() for line in part.splitlines()):
            continue
        out.append(_guarded(part, where))
    return out


def _guarded(text: str, where: str) -> Any:
    """Return the value in one document; BadFile that names place and reason for whatever goes wrong."""
    try:
        return _load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        position = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise _not_yaml(where + position, error.problem or "not valid YAML") from error
    except RecursionError as error:
        raise _not_yaml(where, "nested too deeply") from error
    except (yaml.YAMLError, ValueError, OverflowError, LookupError, TypeError, AttributeError) as error:
        # the scanner lets a few of Python's own errors through, e.g. for "\UFFFFFFFF"
        raise _not_yaml(where, " ".join(str(error).split())[:120]) from error
