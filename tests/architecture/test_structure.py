"""What is planted beyond the limits of size is seen; `make check` holds the source itself against them."""

from pathlib import Path
from types import ModuleType

import pytest

from loading import module_of

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
    return module_of(ROOT / "tools" / "structure.py")


def over(structure: ModuleType, root: Path, exceptions: dict[str, dict[str, str]]) -> list[str]:
    return [text for figure in structure.figures(root, exceptions=exceptions) for text in figure.unlisted()]


@pytest.mark.parametrize("name", PLANTED)
def test_what_is_planted_beyond_a_limit_is_seen(structure: ModuleType, tmp_path: Path, name: str) -> None:
    path, text, told = PLANTED[name]
    (tmp_path / "clean.py").write_text('"""Nothing."""\n')
    assert over(structure, tmp_path, {}) == []
    (tmp_path / path).write_text(text)
    assert any(one.startswith(told) for one in over(structure, tmp_path, {}))


WHY = "# why\n" * 3
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
        place.write_text(allowed + WHY)
        assert over(structure, tmp_path, {}) == []
    place.write_text(text + WHY)
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


def test_results_among_the_arithmetic_declare_and_need_no_reasons(structure: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "calibrate").mkdir()
    (tmp_path / "calibrate" / "result.py").write_text("X = 1\n" * 50)
    assert over(structure, tmp_path, {}) == []
    (tmp_path / "calibrate" / "planted.py").write_text("X = 1  # why\n" + "X = 1\n" * 49)
    assert over(structure, tmp_path, {}) == ["calibrate: 2.0"]


FIELDS = "".join(f"    {name}: float\n" for name in ("a_m", "b_m", "c_m", "d_m"))
SAME = {
    "report/planted.py": ("def planted(page: dict[str, Any]) -> None:\n    return\n", "report/planted.py: 1"),
    "store/planted.py": ('x = import_module("armsight.app")\n', "store/planted.py: 1"),
    "app/planted.py": (
        f"@output\nclass Told(Output):\n{FIELDS}\n\nclass Found:\n{FIELDS}    e_m: float\n",
        "app/planted.py:Told: app/planted.py:Found, 80 %",
    ),
}


@pytest.mark.parametrize("place", SAME)
def test_open_dictionaries_imports_by_name_and_a_result_of_two_classes_are_seen(
    structure: ModuleType, tmp_path: Path, place: str
) -> None:
    text, told = SAME[place]
    (tmp_path / place).parent.mkdir()
    (tmp_path / place).write_text(text)
    assert over(structure, tmp_path, {}) == [told]


def test_an_exception_that_nothing_needs_is_seen(structure: ModuleType, tmp_path: Path) -> None:
    exceptions = {"long": {"planted.py:planted": "a reason"}}
    (tmp_path / "planted.py").write_text(LONG)
    assert over(structure, tmp_path, exceptions) == []
    (tmp_path / "planted.py").write_text("X = 1\n")
    assert over(structure, tmp_path, exceptions) == ["planted.py:planted: no exception is needed any more"]


def test_the_simulation_is_held_to_the_same_limits_under_its_own_name(structure: ModuleType, tmp_path: Path) -> None:
    roots = tmp_path / "armsight", tmp_path / "armsight_sim"
    for root in roots:
        root.mkdir()
        (root / "planted.py").write_text(LONG)
    long = next(figure for figure in structure.figures(*roots, exceptions={}) if figure.key == "long")
    assert [place for place, _ in long.items] == ["planted.py:planted", "armsight_sim/planted.py:planted"]
    assert structure.ROOTS[1].name == "armsight_sim" and structure.ROOTS[1].is_dir()
