"""What the source must not call: what runs foreign text, unpickles foreign bytes, or sets foreign text as markup."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "armsight"
OTHERS = (ROOT / "sim" / "src", ROOT / "plant" / "src", ROOT / "lab" / "src")

UNSAFE = re.compile(
    r"(?:pickle|_pickle|dill|marshal|shelve)\.(?:load|loads|Unpickler|open)|(?:builtins\.)?(?:eval|exec)|os\.(?:system|popen)"
    r"|yaml\.(?:load|load_all|unsafe_load|full_load)|ssl\._create_unverified_context|tempfile\.mktemp"
    r"|ui\.(?:html|markdown|add_body_html)|(?:np|numpy)\.load|joblib\.load"
)
"""Calls by their names as written."""

NAMED = re.compile(
    r"pickle|dill|marshal|shelve|eval|exec|system|popen|yaml|_create_unverified_context|mktemp|joblib|shell|verify"
    r"|check_hostname|sanitize|\bui\b|\b(?:np|numpy)\s*\.\s*load"
)
"""What a text without any such call does not hold: it need not be parsed."""

ALLOWED = {
    "ops/robot/hosting.py": {"pickle.loads"},  # memory shared with the loop, its own child process, alone
    "control/session/loop_side.py": {"pickle.loads"},  # ... and the child's side of it
    "armsight_plant/process.py": {"pickle.loads"},  # memory shared with the publishers, its own child process
    "armsight_sim/twins/urscript.py": {
        "exec"
    },  # an emulated controller's program, of listed kinds of nodes, without builtins
}

SCRIPTS = re.compile(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|javascript:")


def calls(source: str) -> Iterator[str]:
    """Yield what a module calls in one of these ways, and keywords that switch a check off."""
    for node in ast.walk(ast.parse(source)) if NAMED.search(source) else ():
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        if UNSAFE.fullmatch(name):
            yield name
        for one in node.keywords:
            if isinstance(one.value, ast.Constant) and (one.arg, one.value.value) in OFF:
                yield f"{one.arg}={one.value.value}"


OFF = (("shell", True), ("verify", False), ("check_hostname", False), ("allow_pickle", True), ("sanitize", False))


def found() -> dict[str, set[str]]:
    said = {
        path.relative_to(root).as_posix(): set(calls(path.read_text()))
        for root in (SOURCE, *OTHERS)
        for path in root.rglob("*.py")
    }
    return {name: called for name, called in said.items() if called}


def test_nothing_runs_foreign_text_but_what_is_allowed() -> None:
    assert found() == ALLOWED


def test_no_script_of_ours_sets_text_as_markup() -> None:
    scripts = list((SOURCE / "console" / "static").glob("*.js"))
    assert scripts and not [path.name for path in scripts if SCRIPTS.search(path.read_text())]


@pytest.mark.parametrize(
    "planted",
    [
        "pickle.loads(data)",
        "yaml.load(text)",
        "eval(text)",
        "subprocess.run(text, shell=True)",
        "np.load(path)",
        "f(path, allow_pickle=True)",
        "ui.html(text)",
        "os.system(text)",
    ],
)
def test_what_is_planted_is_seen(planted: str) -> None:
    assert list(calls(f"def planted():\n    return {planted}\n"))
