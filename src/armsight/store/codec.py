"""Between records and what files hold: the structure of a record follows from its own fields, bounds and shapes."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, create_model
from scipy.spatial.transform import RigidTransform

from armsight.errors import BadFile, DataRefused
from armsight.fields import Bounds
from armsight.geometry import pose_from_quat, xyz_quat
from armsight.records import NamedCovariance
from armsight.records.checks import Shape
from armsight.records.output import Output, field_keys, is_output, keys
from armsight.store.atomic import plain

Kind = TypeVar("Kind", bound=Output)

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

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)  # made for the first file

    record: ClassVar[type | None] = None
    """What `structure` made the model from."""

    def made(self) -> Any:
        """Return the record that it holds."""
        return record_of(self)


class PoseModel(Strict):
    """A pose as position in m and scalar-last quaternion."""

    xyz_m: Vector3
    quat_xyzw: Vector4

    def pose(self) -> RigidTransform:
        """Return it as a RigidTransform; Inconsistent where the quaternion is none."""
        return pose_from_quat(self.xyz_m, self.quat_xyzw)


class PoseOutput(BaseModel):
    """The pose of one frame in another; the key says which: T_a_b is the pose of b in a."""

    xyz_m: tuple[float, float, float] = Field(description="Position, m, in the first frame's axes.")
    quat_xyzw: tuple[float, float, float, float] = Field(description="Orientation as a unit quaternion, scalar last.")


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


@cache
def structure(kind: type) -> type[Strict]:
    """Return the model of a record's fields as files hold them: poses as position and quaternion, arrays as lists.

    A field with a default may be left out; one that is endless by default may be null. Bounds and Shape count.
    """
    hints = typing.get_type_hints(kind, include_extras=True)
    held: dict[str, Any] = {}
    for one in dataclasses.fields(kind):
        if one.init:
            default = one.default
            endless = isinstance(default, float) and math.isinf(default)
            wanted = _endless(default) if endless else _held(hints[one.name])
            required = default is dataclasses.MISSING and one.default_factory is dataclasses.MISSING
            held[one.name] = (wanted, ... if required else None)
    model = create_model(kind.__name__, __base__=Strict, __doc__=kind.__doc__, **held)
    model.record = kind
    return model


def output_model(kind: type) -> type[BaseModel]:
    """Return the model of a result's keys as its JSON object holds them; its JSON schema is the result's."""
    of: Any = kind  # a class can be hashed
    return _output_model(of)


@cache
def _output_model(kind: Any) -> type[BaseModel]:
    held: dict[str, Any] = {}
    for key in keys(kind):
        extra: Any = {"unit": key.doc.unit} if key.doc.unit else None
        field = Field(None if key.optional else ..., description=key.doc.text, json_schema_extra=extra)
        held[key.name] = (_shown(key.hint) | None if key.doc.nullable else _shown(key.hint), field)
    about = (kind.__doc__ or "").splitlines()[0]
    return create_model(kind.__name__, __doc__=about, __config__=ConfigDict(extra="forbid"), **held)


def _shown(hint: Any) -> Any:
    """Return the type that the JSON object of a result holds for a field."""
    parts = typing.get_args(hint)
    if typing.get_origin(hint) is Annotated:
        shape = next((one for one in parts if isinstance(one, Shape)), None)
        return _shown(parts[0]) if shape is None else _rows(shape)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return typing.Union[tuple(map(_shown, parts))]  # noqa: UP007  # of a tuple that is known at run time only
    if typing.get_origin(hint) in (list, tuple, dict):
        return typing.get_origin(hint)[tuple(one if one is Ellipsis else _shown(one) for one in parts)]
    if is_output(hint):
        return output_model(hint)
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return str
    return PoseOutput if hint is RigidTransform else hint


def _rows(shape: Shape) -> Any:
    """Return the type of an array's numbers as rows in rows."""
    out: Any = float
    for n in reversed(shape.lengths):
        out = list[out] if n is None else tuple[(out,) * n]  # type: ignore[misc]  # known at run time only
    return out


def read_output(kind: type[Kind], content: Mapping[str, Any], where: str) -> Kind:
    """Return the result that a JSON object holds; BadFile that names each wrong key. Figures are worked out anew."""
    found: Kind = _result(kind, validated(output_model(kind), content, where))
    return found


def _result(hint: Any, value: Any) -> Any:
    """Return a value of a result's field from the model's: the arm of a union that the model was made from."""
    if isinstance(value, PoseOutput):
        return pose_from_quat(value.xyz_m, value.quat_xyzw)
    if isinstance(value, BaseModel):
        kind = next(one for one in outputs_in(hint) if output_model(one) is type(value))
        return kind(**{key.attribute: _result(key.hint, getattr(value, key.name)) for key in field_keys(kind)})
    if isinstance(value, list | tuple):
        return type(value)(_result(hint, one) for one in value)
    return {name: _result(hint, one) for name, one in value.items()} if isinstance(value, dict) else value


def outputs_in(hint: Any) -> Iterator[type[Output]]:
    """Yield the results that a type speaks of, such as Output | None or list[Output]."""
    if is_output(hint):
        yield hint
    for inner in typing.get_args(hint):
        yield from outputs_in(inner)


def _endless(default: object) -> Any:
    """Return the type of a limit that is none by default: a number, null, or that default."""
    return Annotated[Finite | None, BeforeValidator(lambda value: None if value == default else value)]


def _held(hint: Any) -> Any:
    """Return the type of what a file holds for a field of a record."""
    parts = typing.get_args(hint)
    if typing.get_origin(hint) is Annotated:
        limit = next((one for one in parts if isinstance(one, Shape | Bounds)), None)
        return _held(parts[0]) if limit is None else _limited(parts[0], limit)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return typing.Union[tuple(map(_held, parts))]  # noqa: UP007  # of a tuple that is known at run time only
    if typing.get_origin(hint) is tuple:
        n = None if parts[-1] is Ellipsis else len(parts)
        return Annotated[list[_held(parts[0])], Field(min_length=n, max_length=n)]  # type: ignore[misc]
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return str  # the record tells its members
    if dataclasses.is_dataclass(hint) and hint is not NamedCovariance:
        return structure(hint)  # type: ignore[arg-type]  # no instance of one
    return {float: Finite, RigidTransform: PoseModel, NamedCovariance: CovarianceModel}.get(hint, hint)


def _limited(hint: Any, limit: Shape | Bounds) -> Any:
    if isinstance(limit, Shape):
        out: Any = Finite | None if limit.endless else Finite
        for n in reversed(limit.lengths):
            out = Annotated[list[out], Field(min_length=n, max_length=n)]
        return out
    if typing.get_origin(hint) is tuple:
        return Annotated[_held(hint), Field(min_length=limit.least)]  # type: ignore[arg-type]  # a whole number
    most = LARGEST if limit.most is None else limit.most
    held = Finite if hint is float else hint
    return Annotated[held, Field(gt=limit.above, ge=limit.least, le=most)]


def record_of(model: Strict) -> Any:
    """Return the record that a model of `structure` holds; raises as the record does, with the key before the cause."""
    if model.record is None:
        raise TypeError(f"{type(model).__name__} was not made from a record")
    given = [one.name for one in dataclasses.fields(model.record) if one.name in model.model_fields_set]
    return model.record(**{name: value for name, value in values(model, *given).items() if value is not None})


def values(model: BaseModel, *names: str) -> dict[str, Any]:
    """Return some keys of a model as records hold them, poses and covariances too; None where one says nothing."""
    return {name: _value(name, getattr(model, name)) for name in names}


def _value(key: str, held: Any) -> Any:
    if isinstance(held, PoseModel):
        return held.pose()
    if isinstance(held, CovarianceModel):
        return held.covariance()
    if isinstance(held, Strict):
        with named(key):
            return held.made()
    if isinstance(held, list):  # "joint 3" of joints, but "forbidden[2]": people count from one
        items = [f"{key[:-1]} {k + 1}" if key.endswith("s") else f"{key}[{k}]" for k in range(len(held))]
        return tuple(math.inf if one is None else _value(name, one) for name, one in zip(items, held, strict=True))
    return held


def mapping(record: Any) -> dict[str, Any]:
    """Return a record as files hold it, without what is None or endless."""
    held = {one.name: _written(getattr(record, one.name)) for one in dataclasses.fields(record) if one.init}
    return {name: value for name, value in held.items() if value is not None}


def _written(value: Any) -> Any:
    if isinstance(value, RigidTransform):
        return pose_mapping(value)
    if isinstance(value, NamedCovariance):
        return covariance_mapping(value)
    if dataclasses.is_dataclass(value):
        return mapping(value)
    if isinstance(value, np.ndarray):
        return _written(value.tolist())
    if isinstance(value, list | tuple):
        return [_written(one) for one in value]
    if isinstance(value, StrEnum):
        return value.value
    return None if isinstance(value, float) and math.isinf(value) else value


Model = TypeVar("Model", bound=BaseModel)


def validated(model: type[Model], content: Mapping[str, Any], where: str) -> Model:
    """Return content as the pydantic model; BadFile that names each wrong key, and the valid keys."""
    try:
        return model.model_validate(plain(content))
    except ValidationError as error:
        details = error.errors(include_url=False)
        messages = [_message(model, detail) for detail in details[:MAX_SHOWN]]
        more = f" (and {len(details) - MAX_SHOWN} more)" if len(details) > MAX_SHOWN else ""
        newer = any(detail["loc"] == ("version",) for detail in details)
        cure = "Update armsight where the file is of a newer one, or correct it there" if newer else "Correct it there"
        raise BadFile(f"{where}: " + "; ".join(messages) + more, cure=cure) from error
    except RecursionError as error:
        raise BadFile(f"{where}: nested too deeply") from error


def _message(model: type[BaseModel], detail: Any) -> str:
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
        last = max(typing.get_args(model.model_fields["version"].annotation))
        return f"version {_short(value)} is not known here, this armsight reads version {'1 to ' * (last > 1)}{last}"
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
