"""What every YAML file of ours has in common: format, version, origin, and errors that name the key."""

from __future__ import annotations

import contextlib
import difflib
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import RigidTransform

from armsight._version import __version__
from armsight.errors import BadFile, DataRefused
from armsight.geometry import pose_from_quat, xyz_quat
from armsight.records import NamedCovariance
from armsight.store.atomic import plain, sha256, write_text
from armsight.store.yamls import dump_yaml, read_yaml

MAX_SHOWN = 5
"""Errors told at once; more of them have the same cause."""

SYMMETRY_TOLERANCE = 1e-6
"""Largest relative asymmetry of a covariance: above the rounding of a file written by another program."""

LARGEST = 1e50
"""Numbers beyond it are no lengths, angles or pixels, and their squares soon no numbers."""

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Vector4 = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Vector5 = Annotated[list[Finite], Field(min_length=5, max_length=5)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class Strict(BaseModel):
    """Unknown keys and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class InputFile(Strict):
    """A file that the result was made from."""

    path: str
    sha256: str


class Origin(Strict):
    """Where a file comes from."""

    version: typing.Literal[1] = 1
    created: str | None = None
    software: str | None = None
    inputs: list[InputFile] = []


class PoseModel(Strict):
    """A pose as position in m and scalar-last quaternion."""

    xyz_m: Vector3
    quat_xyzw: Vector4

    def pose(self) -> RigidTransform:
        """Return it as a RigidTransform; Inconsistent where the quaternion is none."""
        return pose_from_quat(self.xyz_m, self.quat_xyzw)


class CovarianceModel(Strict):
    """A covariance with named rows."""

    names: list[str]
    matrix: list[list[Finite]]

    def covariance(self) -> NamedCovariance:
        """Return the record; BadFile where the matrix is no covariance of these names."""
        n = len(self.names)
        if len(set(self.names)) != n or len(self.matrix) != n or any(len(row) != n for row in self.matrix):
            raise BadFile(f"covariance: {n} names need a matrix of {n} rows and columns, and every name once")
        matrix = np.array(self.matrix, float).reshape(n, n)
        scale = np.sqrt(np.abs(np.diag(matrix)))
        if (np.diag(matrix) < 0.0).any() or (
            np.abs(matrix - matrix.T) > SYMMETRY_TOLERANCE * np.outer(scale, scale) + np.finfo(float).tiny
        ).any():
            raise BadFile("covariance: the matrix is not symmetric with a diagonal of variances")
        return NamedCovariance(names=tuple(self.names), matrix=matrix)


def pose_mapping(pose: RigidTransform) -> dict[str, list[float]]:
    """Return a pose as files hold it."""
    xyz, quat = xyz_quat(pose)
    return {"xyz_m": xyz.tolist(), "quat_xyzw": quat.tolist()}


def covariance_mapping(covariance: NamedCovariance) -> dict[str, Any]:
    """Return a covariance as files hold it."""
    return {"names": list(covariance.names), "matrix": covariance.matrix.tolist()}


def write_document(
    path: Path,
    format_: str,
    content: Mapping[str, Any],
    inputs: Sequence[Path],
    *,
    earlier: Sequence[Mapping[str, str]] = (),
) -> None:
    """Write a YAML file of ours: format, version, content without None, and where it comes from.

    earlier: inputs as the file held them before, kept in front of the new ones.
    """
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
    raise BadFile(
        f"{path}: says {str(said)[:80]}, not {format_!r}",
        consequence="It is not read",
        cure=_format_cure(content, format_),
    )


SECOND_CAMERA = ("M2", "K2", "cameraMatrix2", "M1", "K1", "cameraMatrix1")
"""Keys of OpenCV's files of two cameras."""


def _format_cure(content: Mapping[str, Any], format_: str) -> str:
    from armsight.store.foreign.format_detection import kind_of_mapping  # the foreign readers use this module

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


Model = TypeVar("Model", bound=BaseModel)


def validated(model: type[Model], content: Mapping[str, Any], where: str) -> Model:
    """Return content as the pydantic model; BadFile that names each wrong key, and the valid keys."""
    try:
        return model.model_validate(plain(content))
    except ValidationError as error:
        details = error.errors(include_url=False)
        told = [_told(model, detail) for detail in details[:MAX_SHOWN]]
        more = f" (and {len(details) - MAX_SHOWN} more)" if len(details) > MAX_SHOWN else ""
        raise BadFile(
            f"{where}: " + "; ".join(told) + more, consequence="The file is not used", cure="Correct it there"
        ) from error
    except RecursionError as error:
        raise BadFile(f"{where}: nested too deeply", consequence="The file is not used") from error


def _told(model: type[BaseModel], detail: Any) -> str:
    key = _path(detail["loc"])
    kind, value = detail["type"], detail["input"]
    if kind == "extra_forbidden":
        valid = _keys_at(model, detail["loc"][:-1])
        close = difflib.get_close_matches(str(detail["loc"][-1]), valid, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        return f"unknown key {key} ({hint}valid here: {', '.join(valid)})"
    if kind == "missing":
        return f"the key {key} is missing"
    if kind == "finite_number":
        return f"{key} is {value}, which is not a finite number"
    if detail["loc"] == ("version",):
        return f"version {_short(value)} is not known here, this armsight reads version 1"
    message = str(detail["msg"])
    shown = "" if isinstance(value, dict | list) else f", not {_short(value)}"
    return f"{key}: {message[:1].lower() + message[1:]}{shown}"


def _short(value: object) -> str:
    text = value if isinstance(value, str) else str(type(value)) if isinstance(value, int) and value > 1e30 else value
    text = repr(text)
    return text if len(text) <= 40 else text[:37] + "..."


def _path(location: Sequence[str | int]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text[:120] or "the file"


def _keys_at(model: type[BaseModel], location: Sequence[str | int]) -> list[str]:
    """Return the keys that are valid at a place in a model; empty where the place holds no mapping of keys."""
    at: Any = model
    for part in location:
        found = _models_in(at)
        if found is None:
            return []
        at = found.model_fields[part].annotation if part in found.model_fields else at
    found = _models_in(at)
    return list(found.model_fields) if found else []


def _models_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model that an annotation such as Model | None, list[Model] or dict[str, Model] speaks of."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    for inner in typing.get_args(annotation):
        found = _models_in(inner)
        if found is not None:
            return found
    return None


@contextlib.contextmanager
def named(where: str) -> Iterator[None]:
    """Put the file's name before the cause of whatever the records refuse."""
    try:
        yield
    except DataRefused as error:
        raise BadFile(
            f"{where}: {error.cause}",
            consequence=error.consequence or "The file is not used",
            cure=error.cure or "Correct it there",
        ) from error
