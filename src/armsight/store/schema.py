"""What every YAML file of ours has in common: format, version and origin."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import Field

from armsight._version import __version__
from armsight.errors import BadFile
from armsight.store.atomic import plain, sha256, write_text
from armsight.store.codec import Strict, named, validated
from armsight.store.yamls import dump_yaml, read_yaml

Record = TypeVar("Record")


class InputFile(Strict):
    """A file that the result was made from."""

    path: str
    sha256: str


class Origin(Strict):
    """Where a file comes from."""

    version: typing.Literal[1] = 1
    created: str | None = None
    software: str | None = None
    inputs: list[InputFile] = Field(default_factory=list)


def write_document(
    path: Path,
    format_: str,
    content: Mapping[str, Any],
    inputs: Sequence[Path],
    *,
    earlier: Sequence[Mapping[str, str]] = (),
) -> None:
    """Write a YAML file of ours; content without None, its version 1 or said. earlier: inputs it had, put first."""
    document = {
        "format": format_,
        "version": 1,
        **{key: plain(value) for key, value in content.items() if value is not None},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": f"armsight {__version__}",
        "inputs": [*earlier, *({"path": item.as_posix(), "sha256": sha256(item)} for item in _files(inputs))],
    }
    write_text(path, dump_yaml(document))


def _files(inputs: Sequence[Path]) -> Iterator[Path]:
    """Yield the files among inputs, and those in folders that are."""
    for item in inputs:
        if item.is_dir():
            yield from sorted(file for file in item.iterdir() if file.is_file())
        else:
            yield item


def read_document(path: Path, format_: str) -> dict[str, Any]:
    """Return the content of a YAML file that says it is of this format; BadFile where it says otherwise."""
    content = read_yaml(path)
    found = content.get("format")
    if found == format_:
        return content
    said = f"format {found!r}" if found is not None else "no format"
    raise BadFile(f"{path}: says {str(said)[:80]}, not {format_!r}", cure=_format_cure(content, format_))


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind(Generic[Record]):
    """A kind of YAML file of ours, `format: armsight/NAME`: the keys it may have, and how record and file differ.

    record: of a model that holds the file's keys. content: the keys that a record is written with, without format and
    origin; those that are None are left out. later: the models of later versions of the file, from 2 on, whose content
    says its `version`.
    """

    name: str
    model: type[Origin]
    record: Callable[[Any], Record]
    content: Callable[[Any], Mapping[str, Any]]
    later: tuple[type[Origin], ...] = ()

    @property
    def format(self) -> str:
        """What the files say they are."""
        return f"armsight/{self.name}"

    def parse(self, content: Mapping[str, Any], where: str = "") -> Record:
        """Return what a file's structure describes; BadFile, with where and the key, where it cannot be."""
        version, models = content.get("version"), (self.model, *self.later)
        at = min(version, len(models)) - 1 if type(version) is int and version > 0 else 0
        model = validated(models[at], content, where or self.name)
        with named(where or self.name):
            return self.record(model)

    def read(self, path: Path) -> Record:
        """Return what a file says; BadFile where it is none of this kind."""
        return self.parse(read_document(path, self.format), str(path))

    def write(self, path: Path, record: object, *, inputs: Sequence[Path] = ()) -> None:
        """Write a file with the hashes of the files it was made from; see write_document."""
        write_document(path, self.format, self.content(record), inputs)


SECOND_CAMERA = ("M2", "K2", "cameraMatrix2", "M1", "K1", "cameraMatrix1")
"""Keys of OpenCV's files of two cameras."""


def _format_cure(content: Mapping[str, Any], format_: str) -> str:
    from armsight.store.foreign.storage import kind_of_mapping  # the foreign readers use this module

    kind = kind_of_mapping(content)
    name = format_.removeprefix("armsight/")
    of_one = kind in ("ros", "opencv") and not {"T", *SECOND_CAMERA} & set(content)
    if kind == "armsight/camera" and name == "rig":
        return "This is one camera, and a rig is two: give the rig.yaml of `armsight calibrate stereo`"
    if kind is not None and name == "rig" and of_one:
        return (
            "This is one camera, and a rig is two: give the rig.yaml of `armsight calibrate stereo`, or where both "
            "were calibrated together that of `armsight convert rig LEFT RIGHT -o rig.yaml`"
        )
    if kind is not None and kind.startswith("armsight/"):
        return f"Give a file that begins with 'format: {format_}', not one of {kind}"
    if kind is not None and name in ("rig", "camera"):
        return f"This is a file of {kind}: convert it first, with `armsight convert {name} FILE -o {name}.yaml`"
    if kind is not None:
        return f"Give a file that begins with 'format: {format_}'; this one holds cameras, as {kind} writes them"
    return f"Give a file that begins with 'format: {format_}'"
