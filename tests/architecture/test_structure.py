"""What is planted beyond the limits of size is seen; `make check` holds the source itself against them."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]

LONG = "def planted() -> int:\n" + "    x = 1\n" * 45 + "    return x\n"
WIDE = "def planted(" + ", ".join(f"a{i}: int" for i in range(9)) + ") -> int:\n    return a0\n"
PLANTED = {
    "a long function": ("planted.py", LONG, "planted.py:planted: 47 lines"),
    "many arguments": ("planted.py", WIDE, "planted.py:planted: 9 arguments"),
    "no types": ("planted.py", "def planted(a):\n    return a\n", "planted.py:planted"),
    "a long file": ("planted.py", "X = 1\n" * 401, "planted.py: 401"),
    "lines kept from the formatter": ("planted.py", "X = (1,\n     2)  # fmt: skip\n", "planted.py: 1"),
}


@pytest.fixture(scope="module")
def structure() -> ModuleType:
    spec = importlib.util.spec_from_file_location("structure", ROOT / "tools" / "structure.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def over(structure: ModuleType, root: Path, exceptions: dict[str, dict[str, str]]) -> list[str]:
    return [text for figure in structure.figures(root, exceptions) for text in figure.unlisted()]


@pytest.mark.parametrize("name", PLANTED)
def test_what_is_planted_beyond_a_limit_is_seen(structure: ModuleType, tmp_path: Path, name: str) -> None:
    path, text, told = PLANTED[name]
    (tmp_path / "clean.py").write_text('"""Nothing."""\n')
    assert over(structure, tmp_path, {}) == []
    (tmp_path / path).write_text(text)
    assert any(one.startswith(told) for one in over(structure, tmp_path, {}))


KERNELS = {
    "a long kernel": ("def planted() -> int:\n" + "    x = 1  # why\n" * 60 + "    return x\n", ":planted: 62 lines"),
    "many arguments": (WIDE.replace("a8: int", "a8: int, a9: int, a10: int"), ":planted: 11 arguments"),
}


@pytest.mark.parametrize("name", KERNELS)
def test_kernels_have_limits_of_their_own(structure: ModuleType, tmp_path: Path, name: str) -> None:
    text, told = KERNELS[name]
    (tmp_path / "kernels").mkdir()
    place = tmp_path / "kernels" / "planted.py"
    for allowed in (LONG, WIDE):
        place.write_text(allowed)
        assert over(structure, tmp_path, {}) == []
    place.write_text(text)
    assert over(structure, tmp_path, {}) == [f"kernels/planted.py{told}"]


@pytest.mark.parametrize("place", ["measure/kernels/planted.py", "control/guard/kernels.py"])
def test_arithmetic_without_reasons_is_seen(structure: ModuleType, tmp_path: Path, place: str) -> None:
    code = '"""# Told, and no comment."""\n' + "X = 1\n" * 40
    path = tmp_path / place
    path.parent.mkdir(parents=True)
    path.write_text(code + "# why\n")
    name = place if path.stem == "kernels" else str(Path(place).parent)
    assert over(structure, tmp_path, {}) == [f"{name}: 2.5"]
    path.write_text(code + "# why\n# and its source\n")
    assert over(structure, tmp_path, {}) == []


def test_comments_of_the_other_arithmetic_are_told(structure: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "calibrate").mkdir()
    (tmp_path / "calibrate" / "planted.py").write_text("X = 1  # why\n" + "X = 1\n" * 49)
    figures = {figure.what: figure for figure in structure.figures(tmp_path, {})}
    told = figures["packages of arithmetic, with their comments per 100 lines of code"]
    assert told.items == [("calibrate", "2.0")]
    assert told.unlisted() == []


def test_an_exception_that_nothing_needs_is_seen(structure: ModuleType, tmp_path: Path) -> None:
    exceptions = {"long": {"planted.py:planted": "a reason"}}
    (tmp_path / "planted.py").write_text(LONG)
    assert over(structure, tmp_path, exceptions) == []
    (tmp_path / "planted.py").write_text("X = 1\n")
    assert over(structure, tmp_path, exceptions) == ["planted.py:planted: no exception is needed any more"]
