"""The tool that plants faults: its table fits the source, and it tells a fault that is found from a missed one."""

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from loading import module_of

ROOT = Path(__file__).resolve().parents[2]


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


def test_a_branch_that_is_gone_is_not_planted(tool: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text("- {name: a, file: src/planted.py, breaks: '', gone: nothing needs it}\n")
    assert not tool.read_faults(tmp_path / "table.yaml")
