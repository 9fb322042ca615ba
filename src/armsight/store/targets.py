"""target.yaml, and boards said in one word on the command line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, create_model

from armsight.arrays import Array
from armsight.errors import BadFile, UsageError
from armsight.records import Colour, NamedCovariance, Target, TargetKind, board_target, spot_target, unmeasured_target
from armsight.records.target import BLUE, GREEN, RED
from armsight.store import codec
from armsight.store.schema import Kind, Origin, read_document, write_document
from armsight.store.yamls import read_yaml

MAX_BOARD = 200
"""Rows or columns: no printed board that a camera resolves has more."""

NEGATIVE = 1e-9
"""Negative variance over the largest one that is the rounding of a covariance without information in some direction."""

TAG_FAMILY = "DICT_APRILTAG_36h11"
SPACING_DIGITS = 12
"""Of the ratio that Kalibr calls tagSpacing, when it is told from the lengths again."""

COLOURS: Mapping[str, Colour] = {"red": RED, "green": GREEN, "blue": BLUE}

BOARD_FORMS = (
    "checkerboard:COLUMNSxROWS:SQUARE_M (inner corners, e.g. checkerboard:9x6:0.025), circles:CxR:PITCH_M, "
    "acircles:CxR:PITCH_M, charuco:CxR:SQUARE_M:MARKER_M:DICTIONARY (squares, e.g. "
    "charuco:8x5:0.04:0.03:DICT_4X4_50), aprilgrid:CxR:TAG_M:SPACING (tags, and Kalibr's ratio, e.g. "
    "aprilgrid:6x6:0.088:0.3), or a board's target.yaml, or Kalibr's"
)

Positive = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=codec.LARGEST)]
Side = Annotated[int, Field(ge=2, le=MAX_BOARD)]
SpotName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,40}$")]


ColourModel = codec.structure(Colour)


class LitModel(Origin):
    """Lights: measured (spots_m), or three whose positions nobody has measured (labels)."""

    format: Literal["armsight/target"] = "armsight/target"
    kind: Literal["spots"]
    spots_m: Annotated[dict[SpotName, codec.Vector3], Field(min_length=1, max_length=200)] | None = None
    labels: list[str] | None = None
    std_m: Annotated[dict[SpotName, codec.Vector3], Field(max_length=200)] | None = None
    covariance: codec.CovarianceModel | None = None
    diameter_m: Positive | None = None
    colour: Literal["red", "green", "blue"] | ColourModel | None = None  # type: ignore[valid-type]  # of the record


CIRCLES = {"pitch_m": (Positive, ...), "diameter_m": (Positive | None, None)}
BOARD_KEYS: Mapping[str, Mapping[str, Any]] = {
    "checkerboard": {"square_m": (Positive, ...)},
    "charuco": {"square_m": (Positive, ...), "marker_m": (Positive, ...), "dictionary": (str, ...)},
    "aprilgrid": {
        "tag_m": (Positive, ...),
        "spacing": (Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1.0)], ...),
    },
    "circles": CIRCLES,
    "acircles": CIRCLES,
}
"""What a board's file holds beside columns and rows: inner corners of a checkerboard, squares of a ChArUco board, tags
of an AprilGrid, whose spacing is the gap between them over their side, circles of a grid, straight or staggered."""


def _board_model(kind: str) -> type[Origin]:
    size = {"columns": (Side, ...), "rows": (Side, ...)}
    form = {"format": (Literal["armsight/target"], "armsight/target"), "kind": (str, ...)}
    held: dict[str, Any] = {**form, **size, **BOARD_KEYS[kind]}
    return create_model(kind, __base__=Origin, **held)


_MODELS: Mapping[str, type[Origin]] = {
    "spots": LitModel,
    **{kind: _board_model(kind) for kind in BOARD_KEYS},
}


def target_from_mapping(content: Mapping[str, Any], where: str = "target") -> Target:
    """Return the target that target.yaml's structure describes; BadFile, with the key, where it cannot be."""
    if "target_type" in content:
        content = _of_kalibr(content, where)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in _MODELS:
        raise BadFile(f"{where}: the key kind is {str(kind)[:40]!r}", cure=f"Choose one of {', '.join(_MODELS)}")
    return replace(TARGET_YAML, model=_MODELS[kind]).parse(content, where)


def _target(model: Any) -> Target:
    if isinstance(model, LitModel):
        return _lit(model)
    kind = TargetKind(model.kind)
    if kind is TargetKind.APRILGRID:
        return aprilgrid(model.columns, model.rows, model.tag_m, model.spacing)
    if kind is TargetKind.CHARUCO:
        _check_marker(model.square_m, model.marker_m)
        printed = {"marker_m": model.marker_m, "dictionary": model.dictionary}
        return board_target(kind, model.columns, model.rows, model.square_m, **printed)
    if kind is TargetKind.CHECKERBOARD:
        return board_target(kind, model.columns, model.rows, model.square_m)
    return replace(board_target(kind, model.columns, model.rows, model.pitch_m), diameter_m=model.diameter_m)


def aprilgrid(columns: int, rows: int, tag_m: float, spacing: float) -> Target:
    """Return Kalibr's AprilGrid of columns x rows tags; spacing: the gap between them over their side."""
    pitch_m = tag_m * (1.0 + spacing)
    return board_target(TargetKind.APRILGRID, columns, rows, pitch_m, marker_m=tag_m, dictionary=TAG_FAMILY)


def _spacing(board: Target) -> float:
    return round(board.pitch_m / board.marker_m - 1.0, SPACING_DIGITS)


def _of_kalibr(content: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return Kalibr's description of an AprilGrid as target.yaml's structure; BadFile for its other targets."""
    if content["target_type"] != "aprilgrid":
        raise BadFile(
            f"{where}: a target of Kalibr's of type {str(content['target_type'])[:40]!r}",
            cure="Kalibr's aprilgrid is; say others as checkerboard:9x6:0.025 or circles:7x11:0.02",
        )
    known = {"tagCols": "columns", "tagRows": "rows", "tagSize": "tag_m", "tagSpacing": "spacing"}
    other = {key: value for key, value in content.items() if key not in (*known, "target_type", "codeOffset")}
    named_ = {ours: content[theirs] for theirs, ours in known.items() if theirs in content}
    if content.get("codeOffset", 0) != 0:
        raise BadFile(f"{where}: codeOffset {content['codeOffset']!r}", cure="Only tags that begin at 0 are known")
    return {"kind": "aprilgrid", **named_, **other}


def _lit(model: LitModel) -> Target:
    colour = (
        COLOURS[model.colour]
        if isinstance(model.colour, str)
        else codec.record_of(model.colour)
        if model.colour
        else None
    )
    if (model.spots_m is None) == (model.labels is None):
        raise BadFile(
            "a target of kind spots needs exactly one of spots_m and labels",
            cure="Give spots_m: {A: [x, y, z], ...} in metres, or labels: [A, B, C] for three lights whose positions "
            "nobody has measured",
        )
    if model.std_m is not None and (model.spots_m is None or set(model.std_m) != set(model.spots_m)):
        raise BadFile(
            f"std_m names {', '.join(model.std_m)}, not the spots of spots_m",
            cure="Give std_m: {A: [sx, sy, sz], ...} in metres for every spot of spots_m, or leave it out",
        )
    if model.spots_m is not None:
        spots = {name: (xyz[0], xyz[1], xyz[2]) for name, xyz in model.spots_m.items()}
        if len(set(spots.values())) != len(spots):
            raise BadFile("two spots of spots_m stand at the same place")
        target = spot_target(spots, diameter_m=model.diameter_m, colour=colour)
        return replace(target, covariance=_covariance(model, target))
    if model.covariance is not None:
        raise BadFile(
            "a covariance without spots_m says how well nothing is known", cure="Leave it out, or give spots_m"
        )
    if model.labels != ["A", "B", "C"]:
        raise BadFile(
            f"labels are {model.labels}, not [A, B, C]",
            consequence="Without measured positions the target's frame cannot be made",
            cure="An unmeasured target has three lights: A left, B lower right, C upper right as the camera sees them",
        )
    return unmeasured_target(diameter_m=model.diameter_m, colour=colour)


def _covariance(model: LitModel, target: Target) -> Array | None:
    """Return (3 n, 3 n) in the target's order: of the key covariance, else of std_m; None where neither is there.

    A target measured by `armsight calibrate target` carries both: the positions depend on each other, so that the
    covariance counts. Raises BadFile where its names are not those of the spots, or where it has a negative variance.
    """
    names = target.covariance_names
    if model.covariance is None:
        if model.std_m is None:
            return None
        std = np.array([model.std_m[name] for name in target.names]).ravel()
        if (std < 0.0).any():
            raise BadFile("a standard deviation of std_m is negative")
        return np.diag(std**2)
    covariance = model.covariance.covariance()
    if set(covariance.names) != set(names):
        raise BadFile(
            f"covariance names {', '.join(covariance.names)[:120]}, not the spots' coordinates",
            cure=f"Name its rows {', '.join(names[:4])}, ... , one for each coordinate, or leave it out",
        )
    matrix = covariance.block(names)
    least, most = np.linalg.eigvalsh(matrix)[[0, -1]]
    if least < -NEGATIVE * most:
        raise BadFile("the covariance has a negative variance")
    return matrix


def _check_marker(square_m: float, marker_m: float) -> None:
    if not marker_m < square_m:
        raise BadFile(
            f"markers of {marker_m} m do not fit into squares of {square_m} m",
            consequence="The board cannot be",
            cure="Write a square's side as square_m and a marker's, which is smaller, as marker_m, both in metres",
        )


def target_mapping(target: Target) -> dict[str, Any]:
    """Return the target as target.yaml's structure, without format, version and origin."""
    out: dict[str, Any] = {"kind": target.kind.value}
    if target.is_board:
        if target.kind is TargetKind.APRILGRID:
            size = {"columns": target.columns, "rows": target.rows, "tag_m": target.marker_m}
            return out | size | {"spacing": _spacing(target)}
        squares = target.kind in (TargetKind.CHECKERBOARD, TargetKind.CHARUCO)
        out |= {"columns": target.columns, "rows": target.rows, "square_m" if squares else "pitch_m": target.pitch_m}
        if target.kind is TargetKind.CHARUCO:
            out |= {"marker_m": target.marker_m, "dictionary": target.dictionary}
        return out | {"diameter_m": target.diameter_m}
    if target.model_known:
        out["spots_m"] = dict(zip(target.names, target.xyz_m.tolist(), strict=True))
        if target.covariance is not None:
            named_rows = NamedCovariance(names=target.covariance_names, matrix=target.covariance)
            out["covariance"] = codec.covariance_mapping(named_rows)
    else:
        out["labels"] = list(target.names)
    out["diameter_m"] = target.diameter_m
    out["colour"] = _colour_value(target.colour) if target.colour else None
    return out


def _colour_value(colour: Colour) -> str | dict[str, Any]:
    content = codec.mapping(colour)
    return next((name for name, known in COLOURS.items() if codec.mapping(known) == content), content)


TARGET_YAML: Kind[Target] = Kind(name="target", model=LitModel, record=_target, content=target_mapping)
"""Of lights; target_from_mapping takes the model of the board that a file describes."""


def read_target(path: Path) -> Target:
    """Return the target in a target.yaml, or in Kalibr's aprilgrid.yaml; BadFile where it is none."""
    content = read_yaml(path)
    if "target_type" not in content:  # Kalibr's has no format
        content = read_document(path, TARGET_YAML.format)
    return target_from_mapping(content, str(path))


def write_target(
    path: Path, target: Target, *, inputs: Sequence[Path] = (), std_m: Mapping[str, Sequence[float]] | None = None
) -> None:
    """Write target.yaml with the hashes of the files it was made from; std_m: standard deviations (3,) of each spot's
    place.

    The standard deviations are for people, where the target brings a covariance: that one counts when the file is read.
    """
    write_document(path, TARGET_YAML.format, {**target_mapping(target), "std_m": std_m}, inputs)


PARTS: Mapping[str, int] = {"checkerboard": 2, "circles": 2, "acircles": 2, "charuco": 4, "aprilgrid": 3}
"""Kinds of boards -> how many parts follow the name."""


def parse_board(text: str) -> Target:
    """Return the board that one of BOARD_FORMS describes; UsageError, with the forms, where none does, BadFile."""
    if text.endswith((".yaml", ".yml")):
        board = read_target(Path(text))
        if not board.is_board:
            raise _wrong_board(text, "it describes lights")
        return board
    kind, _, rest = text.partition(":")
    if kind not in PARTS:
        raise _wrong_board(text, f"no kind of board is called {kind!r}")
    parts = rest.split(":")
    if len(parts) != PARTS[kind]:
        raise _wrong_board(text, f"{kind} takes {PARTS[kind]} parts after its name, not {len(parts) if rest else 0}")
    size = re.fullmatch(r"([0-9]{1,4})[xX]([0-9]{1,4})", parts[0])
    if size is None or not all(2 <= int(n) <= MAX_BOARD for n in size.groups()):
        raise _wrong_board(text, f"the size {parts[0]!r} is not COLUMNSxROWS with 2 to {MAX_BOARD} each")
    columns, rows = (int(n) for n in size.groups())
    pitch_m = _length_m(text, parts[1])
    if kind == "aprilgrid":
        return _aprilgrid_of(text, columns, rows, pitch_m)
    return (
        _charuco_of(text, columns, rows, pitch_m)
        if kind == "charuco"
        else board_target(TargetKind(kind), columns, rows, pitch_m)
    )


def _aprilgrid_of(text: str, columns: int, rows: int, tag_m: float) -> Target:
    part = text.split(":")[3]
    if not (spacing := _length_m(text, part)) <= 1.0:
        raise _wrong_board(text, f"a gap of {part} times a tag's side is none of Kalibr's, 1 at most")
    return aprilgrid(columns, rows, tag_m, spacing)


def _charuco_of(text: str, columns: int, rows: int, square_m: float) -> Target:
    marker, dictionary = text.split(":")[3:]
    marker_m = _length_m(text, marker)
    if not marker_m < square_m:
        raise _wrong_board(text, f"markers of {marker_m} m do not fit into squares of {square_m} m")
    if not re.fullmatch(r"[A-Za-z0-9_]{1,40}", dictionary):
        raise _wrong_board(text, f"{dictionary!r} is not the name of a dictionary such as DICT_4X4_50")
    return board_target(TargetKind.CHARUCO, columns, rows, square_m, marker_m=marker_m, dictionary=dictionary)


def board_text(board: Target) -> str:
    """Return a board in the form parse_board reads."""
    if board.kind is TargetKind.APRILGRID:
        return f"aprilgrid:{board.columns}x{board.rows}:{board.marker_m!r}:{_spacing(board)!r}"
    text = f"{board.kind.value}:{board.columns}x{board.rows}:{board.pitch_m!r}"
    return f"{text}:{board.marker_m!r}:{board.dictionary}" if board.kind is TargetKind.CHARUCO else text


def _length_m(text: str, part: str) -> float:
    if not re.fullmatch(r"[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]{1,2})?", part) or not 0.0 < float(part) < 10.0:
        raise _wrong_board(text, f"{part!r} is not a length in metres between 0 and 10")
    return float(part)


def _wrong_board(text: str, reason: str) -> UsageError:
    return UsageError(f"the board {text[:80]!r} is not understood: {reason}", cure=f"Write {BOARD_FORMS}")
