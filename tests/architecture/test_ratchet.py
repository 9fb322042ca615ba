"""What makes the house larger, or says a thing once more, is counted; make check holds the source against it."""

from pathlib import Path
from types import ModuleType

import pytest

from loading import module_of

ROOT = Path(__file__).resolve().parents[2]
CLEAN = {
    "__init__.py": "if TYPE_CHECKING:\n    from armsight.a import one as one\n",
    "part/a.py": "class A:\n    speed_m_s: float = 0.25\n\n\ndef one(a: A) -> A:\n    return A(speed_m_s=2.0)\n",
    "part/b.py": "def two(on: int = 1, *, name: str = 'x') -> None: ...\n",
}
PLANTED = {
    "lines of armsight/part": ("part/c.py", "X = 1\n"),
    "declared fields of armsight/part": ("part/c.py", "class B:\n    x: int\n"),
    "files": ("c.py", ""),
    "classes": ("c.py", "class B: ...\n"),
    "public names": (
        "__init__.py",
        "if TYPE_CHECKING:\n    from armsight.a import A as A\n    from armsight.b import two as two\n",
    ),
    "numeric defaults of one name in several modules": ("c.py", "def three(*, speed_m_s: float = 0.5) -> None: ...\n"),
    "literal columns of tables": ("c.py", "COLUMNS = ('x_m', 'y_m', 'z_m')\n"),
    "keywords that hand on a field of the same name": ("c.py", "def three(a):\n    return one(a=b.a)\n"),
}


@pytest.fixture(scope="module")
def ratchet() -> ModuleType:
    return module_of(ROOT / "tools" / "ratchet.py")


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / "armsight" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "armsight" / name).write_text(text)
    return folder / "armsight"


@pytest.mark.parametrize("figure", PLANTED)
def test_what_grows_is_over_its_limit(ratchet: ModuleType, tmp_path: Path, figure: str) -> None:
    limits = {"most": {name: count.n for name, count in ratchet.figures(written(tmp_path, CLEAN)).items()}}
    assert ratchet.above(ratchet.figures(tmp_path / "armsight"), limits) == []
    place, text = PLANTED[figure]
    over = ratchet.above(ratchet.figures(written(tmp_path, {place: text})), limits)
    assert any(one.startswith(f"{figure} is ") for one in over)


def test_a_limit_of_nothing_and_a_rise_without_its_decision_are_told(ratchet: ModuleType) -> None:
    assert len(ratchet.above({}, {"most": {"files": 1}})) == 1
    assert len(ratchet.unexplained({"raised": {"files": "0000-no-such.md"}})) == 1
    assert ratchet.unexplained({"raised": {"files": "README.md"}}) == []


def test_a_default_of_a_simulation_is_no_second_one(ratchet: ModuleType, tmp_path: Path) -> None:
    root = written(tmp_path, CLEAN)
    (tmp_path / "armsight_sim").mkdir()
    (tmp_path / "armsight_sim" / "x.py").write_text("def three(*, speed_m_s: float = 0.5) -> None: ...\n")
    name = "numeric defaults of one name in several modules"
    assert ratchet.figures(root, tmp_path / "armsight_sim")[name].n == 0
