"""Compiled code follows one rule: only `_numba` says how, so that no kernel raises on exact data."""

import ast
import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError

import armsight
import armsight_lab
import armsight_sim
from armsight import _kernel_cache
from armsight._kernel_cache import KernelCache
from armsight._numba import (
    InnerKernel,
    borrowing_kernel,
    fast_kernel,
    inner_kernel,
    kernel,
    lean_kernel,
    sum_kernel,
)

ROOT = Path(__file__).resolve().parents[2]
BARE = re.compile(r"\b(njit|numba\.jit|guvectorize)\b")


@inner_kernel
def doubled(x: Any) -> Any:
    return 2.0 * x


@kernel
def quadrupled(x: Any) -> Any:
    return doubled(doubled(x))


class Pair(NamedTuple):
    a: Any
    b: Any


@borrowing_kernel
def first_of(pair: Any) -> Any:
    a, row = pair.a, pair.b[0]
    return a[0] + row[0]


@kernel
def sum_of_firsts(a: Any, b: Any, n: Any) -> Any:
    pair, total = Pair(a, b), 0.0
    for _ in range(n):
        total += first_of(pair)
    return total


def named_outside(folder: Path) -> list[str]:
    files = [path for path in folder.rglob("*.py") if path.name != "_numba.py"]
    return [path.name for path in files if BARE.search(path.read_text(encoding="utf-8"))]


def inner_kernels_of(module: ModuleType | SimpleNamespace, source: str) -> list[str]:
    """Return the inner kernels that a module which is no kernel names."""
    seen = [module, *(value for value in vars(module).values() if isinstance(value, ModuleType | SimpleNamespace))]
    if not any(isinstance(value, InnerKernel) for one in seen for value in vars(one).values()):
        return []  # most modules: they need not be parsed
    named = {node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name)}
    found = [name for name in named if isinstance(getattr(module, name, None), InnerKernel)]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            value = getattr(getattr(module, node.value.id, None), node.attr, None)
            if isinstance(value, InnerKernel):
                found.append(node.attr)
    return found


def test_only_one_file_says_how_kernels_are_compiled(tmp_path: Path) -> None:
    assert not named_outside(ROOT / "src")
    assert not named_outside(ROOT / "sim" / "src")
    assert not named_outside(ROOT / "plant" / "src")
    assert not named_outside(ROOT / "lab" / "src")
    (tmp_path / "planted.py").write_text("from numba import njit\n")
    assert named_outside(tmp_path) == ["planted.py"]


def test_the_program_calls_no_inner_kernel_from_python() -> None:
    walked = [
        *pkgutil.walk_packages(armsight.__path__, "armsight."),
        *pkgutil.walk_packages(armsight_sim.__path__, "armsight_sim."),
        *pkgutil.walk_packages(armsight_lab.__path__, "armsight_lab."),
    ]
    for info in walked:
        if "kernels" in info.name.split(".") or info.name == "armsight.__main__":
            continue
        module = importlib.import_module(info.name)
        assert not inner_kernels_of(module, Path(str(module.__file__)).read_text(encoding="utf-8")), info.name
    planted = SimpleNamespace(kernels=SimpleNamespace(doubled=doubled))
    assert inner_kernels_of(planted, "kernels.doubled(1.0)") == ["doubled"]


def test_an_inner_kernel_gives_the_same_from_kernels_and_from_python() -> None:
    assert quadrupled(1.5) == 6.0
    assert doubled(1.5) == 3.0
    assert np.array_equal(doubled(np.ones(2)), [2.0, 2.0])


def test_a_borrowing_kernel_leaves_the_arrays_of_its_tuples_to_their_owners() -> None:
    a, b = np.array([1.5, 2.0]), np.ones((2, 3))
    held = sys.getrefcount(a), sys.getrefcount(b)
    assert sum_of_firsts(a, b, 1000) == 2500.0
    assert (sys.getrefcount(a), sys.getrefcount(b)) == held
    assert a.tolist() == [1.5, 2.0] and b.sum() == 6.0


@inner_kernel
def sum_of_a_new_array(n: Any) -> Any:
    return np.ones(n).sum()


@lean_kernel
def lean_caller(n: Any) -> Any:
    return sum_of_a_new_array(n)


@lean_kernel
def lean_rows(a: Any) -> Any:
    return a[0], a[1]


@lean_kernel
def caller_of_a_row(a: Any) -> Any:
    return doubled(a)[0, 0]


def test_a_kernel_that_counts_no_references_returns_no_array_nor_calls_what_does() -> None:
    assert lean_caller(4) == 4.0  # what it calls may make arrays: it does not take over its caller's rule
    for planted, name in ((lean_rows, "lean_rows"), (caller_of_a_row, "caller_of_a_row")):
        with pytest.raises(TypingError, match=f"{name} counts no references"):
            planted(np.ones((2, 2)))


@inner_kernel
def product_and_sum(a, b, c):
    """Return a b + c."""
    return a * b + c


@fast_kernel
def every_product_and_sum(a, b, c, out):
    """Fill out (n,) with a b + c."""
    for i in range(len(out)):
        out[i] = product_and_sum(a[i], b[i], c[i])


def test_a_plain_kernel_reckons_alike_whichever_kernel_is_compiled_first() -> None:
    """Fused, three in four of these sums would have another last digit."""
    a, b, c = np.random.default_rng(1).normal(size=(3, 1000))
    out = np.empty(1000)
    every_product_and_sum(a, b, c, out)
    np.testing.assert_array_equal(out, a * b + c)


@sum_kernel
def reordered_sum(a: Any) -> Any:
    return a.sum()


@kernel
def plain_sum(a: Any) -> Any:
    return a.sum()


def test_a_function_of_numba_keeps_to_the_rules_of_the_kernel_that_calls_it() -> None:
    a = np.random.default_rng(2).normal(size=4097)
    reordered = reordered_sum(a)
    assert plain_sum(a) == sum(a.tolist()) != reordered
    assert np.isclose(reordered, plain_sum(a), rtol=1e-9, atol=1e-9)


def printed(folder: Path, code: str = "from planted.outer import outer; print(outer(1.0))") -> str:
    """Return what a process prints that calls the planted kernel."""
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


def test_a_change_in_any_file_that_is_compiled_in_counts_in_the_next_process(tmp_path: Path) -> None:
    """A kernel is kept by the text of all that it calls and by the constants of others that it uses."""
    package = tmp_path / "planted"
    package.mkdir()
    texts = {
        "__init__": "",
        "constants": "SCALE = 3.0\n",
        "inner": "from armsight._numba import inner_kernel\n\n\n@inner_kernel\ndef inner(x):\n    return x + 1.0\n",
        "between": "from armsight._numba import inner_kernel\nfrom planted import constants\n"
        "from planted.inner import inner\n\n\n@inner_kernel\ndef between(x):\n    return constants.SCALE * inner(x)\n",
        "outer": "from armsight._numba import kernel\nfrom planted.between import between\n\n\n"
        "@kernel\ndef outer(x):\n    return between(x)\n",
    }
    for name, text in texts.items():
        (package / f"{name}.py").write_text(text)
    assert printed(tmp_path) == "6.0"
    kept = {path: path.read_bytes() for path in package.rglob("*.nbc")}
    assert len(kept) == 1
    assert printed(tmp_path) == "6.0"
    assert {path: path.read_bytes() for path in package.rglob("*.nbc")} == kept  # it was not compiled again
    (package / "inner.py").write_text(texts["inner"].replace("1.0", "2.0"))
    assert printed(tmp_path) == "9.0"
    (package / "constants.py").write_text("SCALE = 4.0\n")
    assert printed(tmp_path) == "12.0"


def test_a_kept_kernel_is_called_without_the_compiler_and_goes_into_other_kernels(tmp_path: Path) -> None:
    package = tmp_path / "planted"
    package.mkdir()
    head = "import numpy as np\nfrom armsight._numba import kernel\n"
    (package / "__init__.py").write_text("")
    (package / "outer.py").write_text(
        f"{head}\n\n@kernel\ndef outer(x):\n    a = np.empty(3)\n    a[:] = x\n    return a\n"
    )
    (package / "other.py").write_text(
        f"{head}from planted.outer import outer\n\n\n@kernel\ndef other(x):\n    return 2.0 * outer(x).sum()\n"
    )
    show = (
        "import sys\nfrom numba import njit\nfrom numba.core import entrypoints\nfrom planted.outer import outer\n"
        "print(outer(1.5), 'numba.np.linalg' in sys.modules, entrypoints._already_initialized)\n"
        "njit(lambda x: x)(1.5)\nprint(entrypoints._already_initialized)"
    )
    assert printed(tmp_path, show) == "[1.5 1.5 1.5] True True\nTrue"
    assert printed(tmp_path, show) == "[1.5 1.5 1.5] False False\nTrue"  # a person's own kernel has the extensions
    both = "from planted.outer import outer\nouter(1.5)\nfrom planted.other import other\nprint(other(1.5))"
    assert printed(tmp_path, both) == "9.0"


def test_where_nothing_can_be_written_kernels_are_compiled_without_keeping(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(KernelCache._impl_class, "_locator_classes", [])  # as where numba finds no folder to write to
    _kernel_cache._warn_once.cache_clear()
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR") as told:
        unkept = [kernel(function) for function in (lambda x: x + 1.0, lambda x: x + 2.0)]
        assert [function(1.0) for function in unkept] == [2.0, 3.0]
    assert len(told) == 1
