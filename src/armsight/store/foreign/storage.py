"""Calibrations of other programs as a mapping (YAML, JSON, XML, TOML, INI, HALCON's lists), and whose file one is.

A camera_info message, as `ros2 topic echo` prints it, becomes what camera_calibration writes to a file.
"""

from __future__ import annotations

import configparser
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from armsight.errors import BadFile
from armsight.store.atomic import read_bytes
from armsight.store.tables import plain_float
from armsight.store.yamls import MAX_BYTES, parse_yaml, parse_yaml_documents

ROOT = "opencv_storage"
COLMAP_CAMERAS, COLMAP_RIGS = "cameras.txt", "rigs.txt"
COLMAP = {"# Camera list with one line": COLMAP_CAMERAS, "# Rig calib list with one line": COLMAP_RIGS}
"""How COLMAP's text files begin, by what becomes of their lines."""
MATLAB = b"MATLAB "
"""How a .mat file begins, of version 5 and of 7.3."""
MATLAB_FILE, REALSENSE_TEXT = "a MATLAB file", "what rs-enumerate-devices prints"
"""Keys that these become: the one is read by its own reader, the other as text."""
REALSENSE = re.compile(r'^\s*Intrinsic of "[^"]+" / \d+x\d+ / \{', re.MULTILINE)
METASHAPE = "calibration"
"""Root of Agisoft's XML of one camera."""
SECTION = re.compile(r"\A\s*(?:[#;].*\s+)*\[[\w.\"-]+\]\s*$", re.MULTILINE)
"""How TOML with tables and INI files begin, and no YAML or JSON does."""
HALCON = re.compile(r"^\s*ParGroup\s*:\s*([\w\s:]+);", re.MULTILINE)
HALCON_VALUE = re.compile(r"^\s*(?!ParGroup)(\w+)\s*:\s*[A-Za-z]\w*\s*:\s*([^;\n]+);", re.MULTILINE)
"""Name, short name, value: the first of a parameter's three lines (MVTec's reference of read_cam_par)."""
HALCON_BYTES, BINARY = b"HCPR", "HALCON's binary form"
"""How HALCON 13 and later begin such a file, which is no text any more, and the key that it becomes."""

MESSAGE = {"distortion_model", "d", "k", "r", "p", "width", "height"}
"""Fields of sensor_msgs/CameraInfo, in small letters: ROS 1 writes D, K, R, P."""


def read_storage(path: Path) -> dict[str, Any]:
    """Return the mapping in a file of any of these forms; BadFile, naming place and reason, where it is none.

    Of a stream of camera_info messages the first is taken, where all are of one calibration.
    """
    data, where = read_bytes(path, limit=MAX_BYTES), str(path)
    if data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"<":
        return _of_xml(data, where)
    if data.startswith(MATLAB):
        return {MATLAB_FILE: path.name}
    if data.startswith(HALCON_BYTES):
        return {"ParGroup": ["Camera"], BINARY: data}
    text = data.decode("utf-8-sig", errors="replace")
    if REALSENSE.search(text):
        return {REALSENSE_TEXT: text}
    for head, name in COLMAP.items():
        if text.startswith(head):
            return {name: [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]}
    if SECTION.match(text):
        return _of_sections(text, where)
    return _of_halcon(text, where) if HALCON.search(text) else _of_yaml(data, where)


def _of_halcon(text: str, where: str) -> dict[str, Any]:
    values = [(name, _word(value)) for name, value in HALCON_VALUE.findall(text)]
    if len(dict(values)) < len(values):
        raise BadFile(f"{where}: the parameters of more than one camera", cure="Keep those of one camera")
    return {"ParGroup": HALCON.findall(text), **dict(values)}


def _of_yaml(data: bytes, where: str) -> dict[str, Any]:
    """Return YAML or JSON. Raises BadFile, also where a comma stands in a number: YAML takes {a: 1,280} as two keys."""
    try:
        content = parse_yaml(data, where)
    except BadFile:
        messages = [_message(one) for one in parse_yaml_documents(data, where)]
        if not messages or None in messages:
            raise
        content = _one_of(messages, where)
    cut = _key_without_value(content)
    if cut is not None:
        raise BadFile(
            f"{where}: the number {cut} has no name", cure="Write numbers with points and without other signs"
        )
    message = _message(content)
    return content if message is None else _camera_info(message, where)


def _key_without_value(content: Any) -> object:
    """Return a number that is a key without a value somewhere in mappings and lists, None where there is none."""
    if isinstance(content, dict):
        alone = (key for key, value in content.items() if value is None and not isinstance(_word(str(key)), str))
        inner = (_key_without_value(value) for value in content.values() if isinstance(value, dict | list))
        return next(alone, next((one for one in inner if one is not None), None))
    if isinstance(content, list):
        inner = (_key_without_value(value) for value in content if isinstance(value, dict | list))
        return next((one for one in inner if one is not None), None)
    return None


def _one_of(messages: list[dict[str, Any] | None], where: str) -> dict[str, Any]:
    """Return the first of camera_info messages. Raises BadFile where they differ in more than time."""
    calibrations = [{key: one[key] for key in MESSAGE} for one in messages if one is not None]
    if any(one != calibrations[0] for one in calibrations):
        raise BadFile(
            f"{where}: {len(messages)} camera_info messages that are not of one camera and calibration",
            cure="Keep one message of the camera that is meant",
        )
    return messages[0] or {}


def _message(content: Any) -> dict[str, Any] | None:
    """Return a camera_info message with its fields in small letters, None for anything else."""
    if not isinstance(content, dict):
        return None
    lower = {str(key).lower(): value for key, value in content.items()}
    return lower if lower.keys() >= MESSAGE else None


def _camera_info(message: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a message as the file of camera_calibration. Raises BadFile where its images are a part, or binned."""
    region = message.get("roi") or {}
    whole = {"x_offset": 0, "y_offset": 0, "width": message["width"], "height": message["height"]}  # 0: all of it
    cut = isinstance(region, dict) and any(region.get(key) not in (None, 0, size) for key, size in whole.items())
    if cut or any(message.get(key) not in (None, 0, 1) for key in ("binning_x", "binning_y")):
        raise BadFile(
            f"{where}: its images are binned, or a part of the sensor, and the calibration is of the whole one",
            consequence="It is not read: every pixel would be another",
            cure="Calibrate with images as they are measured",
        )
    head = message.get("header")
    name = head.get("frame_id", "") if isinstance(head, dict) else ""
    told = {"image_width": message["width"], "image_height": message["height"], "camera_name": str(name)}
    return told | {
        "camera_matrix": message["k"],
        "distortion_model": message["distortion_model"],
        "distortion_coefficients": message["d"],
        "rectification_matrix": message["r"],
        "projection_matrix": message["p"],
    }


def _of_sections(text: str, where: str) -> dict[str, Any]:
    """Return TOML, or an INI file's sections with their words as numbers where they are such."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as not_toml:
        parser = configparser.ConfigParser(interpolation=None, strict=True)
        parser.optionxform = str  # type: ignore[assignment,method-assign]  # the documented switch: letters as they are
        try:
            parser.read_string(text)
        except configparser.Error as error:
            raise BadFile(
                f"{where}: neither TOML ({not_toml}) nor sections of name=value ({str(error).splitlines()[0]})",
                cure="Copy the file anew from the program or device that wrote it",
            ) from error
        return {name: {key: _word(value) for key, value in parser[name].items()} for name in parser.sections()}


def _of_xml(data: bytes, where: str) -> dict[str, Any]:
    """Return matrices as rows, cols (or sizes) and data, and single values; what else is there is left out."""
    if b"<!" in data:  # entities, which FileStorage does not write, could grow without end
        raise BadFile(f"{where}: a document type or a comment stands in it", cure="Take it out")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise BadFile(f"{where}: {error}", cure="Correct it there") from error
    if root.tag not in (ROOT, METASHAPE):
        raise BadFile(
            f"{where}: XML whose root is {root.tag[:40]!r}",
            cure=f"Give OpenCV's FileStorage, root {ROOT}, Metashape's camera calibration, root {METASHAPE}, or YAML",
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
    try:
        number = plain_float(word)
    except ValueError:
        return word
    return int(word) if word.lstrip("+-").isdecimal() else number


def _camera_tables(tables: Mapping[str, Any], keys: set[str]) -> bool:
    """Tell whether each of some tables is a camera that has keys."""
    cameras = [one for name, one in tables.items() if name != "metadata"]
    return bool(cameras) and all(isinstance(one, Mapping) and keys <= one.keys() for one in cameras)


def _holds(content: Any, keys: set[str]) -> bool:
    """Tell whether a mapping of keys is somewhere among nested mappings."""
    if not isinstance(content, Mapping):
        return False
    return keys <= content.keys() or any(_holds(value, keys) for value in content.values())


BY_KEYS: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "zed": lambda found: "STEREO" in found and any(str(key).startswith("LEFT_CAM_") for key in found),
    "depthai": lambda found: isinstance(found.get("cameraData"), list),
    "caliscope": lambda found: (
        isinstance(found.get("cameras"), Mapping)
        and _camera_tables(found["cameras"], {"matrix", "distortions", "size"})
    ),
    "multical": lambda found: (
        isinstance(found.get("cameras"), Mapping) and _camera_tables(found["cameras"], {"K", "dist", "image_size"})
    ),
    "aniposelib": lambda found: _camera_tables(found, {"matrix", "distortions", "size", "name"}),
    "metashape": lambda found: "projection" in found and {"f", "width", "height"} <= found.keys(),
    "halcon": lambda found: "ParGroup" in found,
    "colmap": lambda found: COLMAP_CAMERAS in found or COLMAP_RIGS in found,
    "matlab": lambda found: MATLAB_FILE in found,
    "realsense": lambda found: REALSENSE_TEXT in found or _holds(found, {"ppx", "ppy", "coeffs"}),
}
"""Formats by the keys that no other has."""


def kind_of_mapping(content: Mapping[str, Any]) -> str | None:
    """Return the name of a format of other programs, an armsight format such as 'armsight/rig', or None."""
    format_ = content.get("format")
    if isinstance(format_, str) and format_.startswith("armsight/"):
        return None if len(format_) > 40 else format_
    if isinstance(content.get("cam0"), Mapping):
        return "kalibr"
    device = next((name for name, knows in BY_KEYS.items() if knows(content)), None)
    if device is not None:
        return device
    if "camera_matrix" in content and ("projection_matrix" in content or "camera_name" in content):
        return "ros"
    if {"camera_matrix", "cameraMatrix", "mtx", "cameraMatrix1", "M1", "K1"} & set(content) or {"R", "T"} <= set(
        content
    ):
        return "opencv"
    return None


def kind_of(path: Path) -> str | None:
    """Return whose file this is; see kind_of_mapping. BadFile where it is neither YAML nor OpenCV's XML."""
    return kind_of_mapping(read_storage(path))
