"""The tool that plants faults: its table fits the source, and it tells a fault that is found from a missed one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from loading import module_of

ROOT = Path(__file__).resolve().parents[2]
TEST = "import planted\n\n\ndef test_one():\n    assert planted.one() == 1\n"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    return module_of(ROOT / "tools" / "mutants.py")


@pytest.mark.parametrize("table", ["mutants.yaml", "ablation.yaml"])
def test_every_fault_can_be_planted(tool: ModuleType, table: str) -> None:
    assert not tool.misfits(tool.read_faults(ROOT / "tools" / table))


def test_a_fault_that_no_longer_fits_is_refused(tool: ModuleType) -> None:
    sound = tool.read_faults()[0]
    stale = [replace(sound, name="a", old="this is nowhere"), replace(sound, name="b", tests=("tests/nowhere.py",))]
    assert [text.split(":")[0] for text in tool.misfits([*stale, sound, sound])] == ["a", "b", sound.name, sound.name]


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A checkout of one function, its test, and a cache that holds it compiled."""
    for name in ("src/__pycache__", "sim/src", "tests"):
        (tmp_path / "small" / name).mkdir(parents=True)
    (tmp_path / "small" / "src" / "planted.py").write_text("def one():\n    return 1\n")
    (tmp_path / "small" / "src" / "__pycache__" / "planted.one-1.py311.nbi").write_text("")
    (tmp_path / "small" / "tests" / "test_planted.py").write_text(TEST)
    return tmp_path / "small"


def test_what_became_of_a_fault_is_told(tool: ModuleType, small: Path, tmp_path: Path) -> None:
    planted = {"return 2": "tests/test_planted.py::test_one", "return 1.0": ""}
    faults = [
        tool.Fault(
            name=new, file="src/planted.py", old="return 1", new=new, breaks="", tests=("tests/test_planted.py",)
        )
        for new in planted
    ]
    assert not tool.misfits(faults, small)
    before = {path: path.read_bytes() for path in small.rglob("*") if path.is_file()}
    found = {fault.name: outcome.found_by for fault, outcome in tool.try_faults(faults, tmp_path / "copies", small)}
    assert found == planted
    assert before == {path: path.read_bytes() for path in small.rglob("*") if path.is_file()}


def test_a_branch_that_is_gone_is_not_planted(tool: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text("- {name: a, file: src/planted.py, breaks: '', gone: nothing needs it}\n")
    assert not tool.read_faults(tmp_path / "table.yaml")
