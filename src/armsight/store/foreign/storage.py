"""OpenCV's FileStorage as a mapping: YAML and JSON, which is YAML, and XML."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from armsight.errors import BadFile
from armsight.store.atomic import read_bytes
from armsight.store.yamls import MAX_BYTES, parse_yaml

ROOT = "opencv_storage"


def read_storage(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file or in FileStorage's XML; BadFile, naming place and reason, where it is none."""
    data = read_bytes(path, limit=MAX_BYTES)
    return (
        _of_xml(data, str(path))
        if data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"<"
        else parse_yaml(data, str(path))
    )


def _of_xml(data: bytes, where: str) -> dict[str, Any]:
    """Return matrices as rows, cols (or sizes) and data, and single values; what else is there is left out."""
    if b"<!" in data:  # entities, which FileStorage does not write, could grow without end
        raise BadFile(
            f"{where}: a document type or a comment stands in it", consequence="It is not read", cure="Take it out"
        )
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise BadFile(f"{where}: {error}", consequence="The file cannot be read", cure="Correct it there") from error
    if root.tag != ROOT:
        raise BadFile(
            f"{where}: XML whose root is {root.tag[:40]!r}",
            consequence="It is not read",
            cure=f"Give OpenCV's FileStorage, whose root is {ROOT}, or YAML",
        )
    return {one.tag: _value(one, where) for one in root}


def _value(element: ElementTree.Element, where: str) -> Any:
    if len(element):
        return {part.tag: _words(part.text) if part.tag in ("data", "sizes") else _word(part.text) for part in element}
    words = _words(element.text)
    return words[0] if len(words) == 1 else words


def _words(text: str | None) -> list[Any]:
    return [_word(word) for word in (text or "").split()]


def _word(text: str | None) -> Any:
    word = (text or "").strip()
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word
