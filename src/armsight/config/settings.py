"""Settings that a person or a machine gives once: flag beats environment variable beats file beats default."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field

from armsight.errors import BadFile, UsageError
from armsight.store.codec import Strict, validated
from armsight.store.yamls import parse_yaml, read_yaml

PREFIX = "ARMSIGHT_"
FILE_VARIABLE = "ARMSIGHT_CONFIG"
LOCAL_FILE = "armsight.yaml"

Value = TypeVar("Value")


class Settings(Strict):
    """What may stand in armsight.yaml, or in ARMSIGHT_<NAME> in the environment.

    fps: frames a second of folders of images. max_skew_s: largest time between the frames of a live pair.
    workers: threads that decode images and find boards; None takes every core.
    """

    fps: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None
    max_skew_s: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None
    workers: Annotated[int, Field(ge=1, le=256)] | None = None


def load_settings(environment: Mapping[str, str] | None = None, folder: Path | None = None) -> Settings:
    """Return the settings of file and environment.

    The file is $ARMSIGHT_CONFIG, else armsight.yaml in the current folder, else armsight/config.yaml where the system
    keeps configurations. Raises BadFile, or UsageError for a variable, that names the key.
    """
    environ = os.environ if environment is None else environment
    path = _file(environ, folder or Path.cwd())
    content: dict[str, Any] = {}
    if path is not None:
        content = validated(Settings, read_yaml(path), str(path)).model_dump()
    for name in Settings.model_fields:
        text = environ.get(PREFIX + name.upper())
        if text:
            content[name] = _variable(name, text)
    return Settings(**content)


def chosen(flag: Value | None, setting: Value | None, default: Value) -> Value:
    """Return the flag where it was given, else the setting, else the default."""
    return flag if flag is not None else setting if setting is not None else default


def _variable(name: str, text: str) -> Any:
    where = f"the environment variable {PREFIX}{name.upper()}"
    try:
        model = validated(Settings, parse_yaml(f"{name}: {text}".encode(), where), where)
    except BadFile as error:
        raise UsageError(error.cause, cure="Correct it, or unset it") from error
    return getattr(model, name)


def _file(environ: Mapping[str, str], folder: Path) -> Path | None:
    given = environ.get(FILE_VARIABLE)
    if given:
        return Path(given)  # a file that was named and is missing is an error, told by the reader
    home = environ.get("XDG_CONFIG_HOME")
    base = Path(home) if home else Path(environ.get("HOME", "~")).expanduser() / ".config"
    for path in (folder / LOCAL_FILE, base / "armsight" / "config.yaml"):
        if path.is_file():
            return path
    return None
