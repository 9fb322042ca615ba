"""Flag beats environment variable beats file beats default."""

from __future__ import annotations

from pathlib import Path

import pytest

from armsight.config import Settings, chosen, load_settings
from armsight.errors import BadFile, UsageError
from refusals import refuses


def test_nothing_said_is_nothing_set(tmp_path: Path) -> None:
    assert load_settings({"HOME": str(tmp_path)}, tmp_path) == Settings()


def test_the_order(tmp_path: Path) -> None:
    (tmp_path / "armsight.yaml").write_text("fps: 25\nworkers: 3\n")
    environment = {"ARMSIGHT_FPS": "50", "HOME": str(tmp_path)}
    settings = load_settings(environment, tmp_path)
    assert (settings.fps, settings.workers, settings.max_skew_s) == (50.0, 3, None)
    assert chosen(60.0, settings.fps, 30.0) == 60.0
    assert chosen(None, settings.fps, 30.0) == 50.0
    assert chosen(None, settings.max_skew_s, 0.01) == 0.01


def test_a_named_file_comes_before_the_local_one_and_must_be_there(tmp_path: Path) -> None:
    (tmp_path / "armsight.yaml").write_text("fps: 25\n")
    (tmp_path / "other.yaml").write_text("fps: 10.5\n")
    assert load_settings({"ARMSIGHT_CONFIG": str(tmp_path / "other.yaml")}, tmp_path).fps == 10.5
    with refuses(BadFile, "missing.yaml"):
        load_settings({"ARMSIGHT_CONFIG": str(tmp_path / "missing.yaml")}, tmp_path)


@pytest.mark.parametrize("text", ["fsp: 25", "fps: fast", "fps: -1", "fps: .nan", "workers: 0", "workers: 1.5"])
def test_a_wrong_file_is_refused_by_key(tmp_path: Path, text: str) -> None:
    (tmp_path / "armsight.yaml").write_text(text + "\n")
    with refuses(BadFile, text.split(":")[0]):
        load_settings({"HOME": str(tmp_path)}, tmp_path)


def test_a_wrong_variable_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="ARMSIGHT_WORKERS"):
        load_settings({"ARMSIGHT_WORKERS": "many", "HOME": str(tmp_path)}, tmp_path)
