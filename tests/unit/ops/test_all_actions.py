"""Every action (armsight.ops) is what its signature says: run, told, written, refused and stopped alike.

A new action needs its case in tests/action_cases.py.
"""

import contextlib
import importlib
import json
import math
import pkgutil
import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import armsight.ops
import warm_python
from action_cases import CASES, COSTLY, ON_DEVICES, lend, make_files, run
from armsight.cli.command import Command
from armsight.cli.commands import app
from armsight.cli.examples import every_command
from armsight.errors import ArmsightError, Cancelled, UsageError
from armsight.fields import Flag, marks
from armsight.file_names import report_path
from armsight.ops.action import OUT, PROGRESS, Action
from armsight.records import Silent
from loading import module_of

ROOT = Path(__file__).resolve().parents[3]
GOOD = [pytest.param(name, id=name) for name in CASES]
EVERY = {**CASES, **COSTLY}
WRITTEN = {
    "convert.export_recording": {"left", "right", "times.csv"},
    "machine.write_simulation": {"left", "right", "rig.yaml", "scenario.yaml", "target.yaml", "times.csv", "truth.csv"},
}
"""What is in a folder that an action makes whose files are not its results by name."""
VARIES = re.compile(r"took|per_pair|per_frame|pairs_per_s|elapsed|compute|seconds_s|size_bytes|^compiled$")
"""Keys of durations, and of the kernels compiled this far, to which a test beside adds."""
NOT_FINITE = (".issues",)
"""What has no value and no limit where a path changes its branch or is not reached."""
TABLE, YAML = "a,b\n1,2\n", "format: armsight/mask\nversion: 1\n"


def actions() -> dict[str, Callable[..., Any]]:
    """Return every action by module and name."""
    found = {}
    for module in pkgutil.walk_packages(armsight.ops.__path__, f"{armsight.ops.__name__}."):
        for name, one in vars(importlib.import_module(module.name)).items():
            if isinstance(getattr(one, "action", None), Action) and one.__module__ == module.name:
                found[f"{module.name.removeprefix('armsight.ops.')}.{name}"] = one
    return found


ACTIONS = actions()


def test_every_action_has_a_case_or_a_reason() -> None:
    assert set(EVERY) | set(ON_DEVICES) == set(ACTIONS) and not set(EVERY) & set(ON_DEVICES)
    named = {file for reason in ON_DEVICES.values() for file in re.findall(r"tests/\S+\.py", reason)}
    assert named and all((ROOT / file).is_file() for file in named)
    commands = {name for name, _ in every_command(app)}
    assert {one.action.command for one in ACTIONS.values()} <= commands  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def made(scene: Any, boards: Any, mirror_boards: Any) -> Path:
    with contextlib.chdir(ROOT):
        drawn = scene.folder, boards.folder, mirror_boards.straight
        return warm_python.once("actions", lambda folder: make_files(folder, *drawn))


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with all files in it."""
    lend(made, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def schemas() -> ModuleType:
    return module_of(ROOT / "tools" / "json_schemas.py")


def asked(words: str) -> dict[str, Any]:
    """Return what the command line hands to the action that it does, by parameter."""
    given: list[Mapping[str, Any]] = []

    def note(self: Action, taken: Mapping[str, Any], progress: object = None) -> None:
        given.append(taken)
        raise UsageError("enough")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Action, "run", note)
        done = run(words)
    assert given, done.output
    return {name: value for name, value in given[0].items() if value is not None}


def results() -> set[str]:
    """Return what lies in the working folder, and in the folder `new`, that was not given."""
    return {path.as_posix() for pattern in ("new*", "new/*") for path in Path().glob(pattern)}


def declared(name: str, out: Path) -> set[str]:
    """Return what an action may write."""
    done: Action = ACTIONS[name].action  # type: ignore[attr-defined]  # an action
    keeps = WRITTEN.get(name, set()) | set(done.keeps) | set(command_of(done).keeps)
    if not out.suffix:
        return {out.name, *(f"{out.name}/{one}" for one in keeps)}
    return {out.name, report_path(out).name, *(out.with_suffix(one).name for one in done.beside)}


def out_of(given: Mapping[str, Any]) -> Path | None:
    """Return what is written, the first of several."""
    out = given.get(OUT)
    return out[0] if isinstance(out, list) else out


def command_of(done: Action) -> Command:
    """Return the command that does an action."""
    found: Any = next(one for name, one in every_command(app) if name == done.command)
    return found.callback.armsight  # type: ignore[no-any-return]  # see cli.command.add


def off_schema(value: Any, schema: Any, whole: Any, where: str = "") -> Iterator[str]:
    """Yield what of a JSON value is not as its schema says."""
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].rpartition("/")[2]]
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None), "integer": int}
    if "anyOf" in schema:
        if all(list(off_schema(value, one, whole, where)) for one in schema["anyOf"]):
            yield f"{where} is none of what it may be: {value!r}"
        return
    kind = kinds.get(schema.get("type"), (int, float) if schema.get("type") == "number" else object)
    if value is None and kind == (int, float) and where.startswith(NOT_FINITE):
        return
    if not isinstance(value, kind) or (isinstance(value, bool) and kind not in (bool, object)):
        yield f"{where} is no {schema['type']}: {value!r}"
        return
    if ("enum" in schema and value not in schema["enum"]) or ("const" in schema and value != schema["const"]):
        yield f"{where} is {value!r}"
    if isinstance(value, dict):
        yield from off_keys(value, schema, whole, where)
    if isinstance(value, list):
        yield from off_entries(value, schema, whole, where)


def off_entries(value: list[Any], schema: Any, whole: Any, where: str) -> Iterator[str]:
    """Yield what of a JSON array's entries is not as its schema says."""
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
        yield f"{where} has {len(value)} entries"
    first = schema.get("prefixItems", ())
    for k, one in enumerate(value):
        yield from off_schema(one, first[k] if k < len(first) else schema.get("items", {}), whole, f"{where}[{k}]")


def off_keys(value: dict[str, Any], schema: Any, whole: Any, where: str) -> Iterator[str]:
    """Yield what of a JSON object's keys is not as its schema says."""
    own, other = schema.get("properties", {}), schema.get("additionalProperties")
    yield from (f"{where} has no {key}" for key in schema.get("required", ()) if key not in value)
    for key, one in value.items():
        if key in own or isinstance(other, dict):
            yield from off_schema(one, own.get(key, other), whole, f"{where}.{key}")
        elif own and not other:
            yield f"{where}.{key} is not described"


def alike(a: Any, b: Any) -> bool:
    """Tell whether two JSON objects are the same to rounding, but for durations."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(VARIES.search(key) or alike(one, b[key]) for key, one in a.items())
    if isinstance(a, list):
        return len(a) == len(b) and all(map(alike, a, b))
    return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12) if isinstance(a, float) else bool(a == b)


@pytest.mark.parametrize("name", GOOD)
def test_a_good_run_is_told_and_written_as_declared_and_python_does_the_same(
    name: str, here: Path, schemas: Any
) -> None:
    given, done = asked(CASES[name]), run(CASES[name])
    assert done.exit_code == 0, done.output
    told, written = json.loads(done.stdout), results()
    out = out_of(given)
    assert written <= (set() if out is None else declared(name, out)), written
    assert out is None or out.name in written
    for path in map(Path, sorted(written)):
        if path.parent == Path():
            shutil.move(path, f"command-{path.name}")
    result = ACTIONS[name](**given)
    assert results() == written
    if ACTIONS[name].action.gives:  # type: ignore[attr-defined]  # Python gets the object alone
        assert out is not None and out.read_bytes() == Path(f"command-{out.name}").read_bytes()
        return
    assert alike(json.loads(result.to_json()), told)
    of = next(key for key, kind in schemas.OUTPUTS.items() if type(result) is kind)
    schema = json.loads((ROOT / "docs" / "schemas" / f"{of}.json").read_text(encoding="utf-8"))
    assert not list(off_schema(told, schema, schema))


def inputs_of(name: str, given: Mapping[str, Any]) -> dict[str, str]:
    """Return what is given as files, by parameter."""
    each = {one: given[one] for one in ACTIONS[name].action.inputs if one in given}  # type: ignore[attr-defined]
    return {one: str(value[0] if isinstance(value, list) else value) for one, value in each.items()}


@pytest.mark.parametrize("name", EVERY)
def test_what_is_read_is_not_written_over(name: str, here: Path) -> None:
    given, done = asked(EVERY[name]), ACTIONS[name].action  # type: ignore[attr-defined]  # an action
    out, folder = out_of(given), done.keeps or command_of(done).keeps
    for parameter, text in inputs_of(name, given).items() if out is not None else ():
        if not Path(text).is_file() or parameter == done.in_place:
            continue
        before, words = Path(text).read_bytes(), shlex.split(EVERY[name])
        if folder:
            Path("new").mkdir(exist_ok=True)
            copy = f"new/{folder[0]}"
            shutil.copy(text, copy)
            words, text = [copy if word == text else word for word in words], copy
            words += ["--overwrite"] if command_of(done).keeps else []
        else:
            words[words.index("-o") + 1] = text
        ran = run(shlex.join(words))
        assert ran.exit_code == 2, (parameter, ran.output)
        assert Path(text).read_bytes() == before
        with pytest.raises(UsageError):
            ACTIONS[name](**{**given, parameter: Path(text), OUT: out if folder else Path(text)})
        assert Path(text).read_bytes() == before


@pytest.mark.parametrize("name", [name for name in EVERY if command_of(ACTIONS[name].action).keeps])  # type: ignore[attr-defined]
def test_results_of_another_run_stay(name: str, here: Path) -> None:
    file = Path("new", sorted(command_of(ACTIONS[name].action).keeps)[0])  # type: ignore[attr-defined]
    file.parent.mkdir()
    file.write_text("mine")
    done = run(EVERY[name])
    assert done.exit_code == 2 and "--overwrite" in done.output
    assert file.read_text() == "mine" and results() == {"new", file.as_posix()}


class Stopped(Silent):
    """Cancels at once."""

    def cancelled(self) -> bool:
        return True


STOPPED = {
    "calibrate_hand_eye.calibrate_hand_eye": "a table is read at once; images ask, as those of a camera do",
    "calibrate_rig.calibrate_timing": "tables are read at once",
    "calibrate_robot.calibrate_pivot": "judges the poses that were taken until then",
    "identify.identify_arm": "a table is read at once",
    "machine.doctor": "asks while it compiles alone",
    "measure.record": "ends the recording",
    "teach.teach": "ends the teaching, and a table is read at once",
}
"""Actions that a stop ends in another way."""
KEEPS_WHAT_WAS_DONE = ("convert.export_recording", "machine.reproduce", "machine.write_simulation", "measure.measure")


@pytest.mark.parametrize(
    "name",
    [name for name in EVERY if PROGRESS in ACTIONS[name].action.parameters and name not in STOPPED],  # type: ignore[attr-defined]
)
def test_who_stops_it_finds_no_half_file(name: str, here: Path) -> None:
    given = asked(EVERY[name])
    with pytest.raises(Cancelled):
        ACTIONS[name](**given, progress=Stopped())
    assert not results() or name in KEEPS_WHAT_WAS_DONE
    assert not [path for path in Path("new").rglob("*") if path.is_file() and not path.stat().st_size]


def wrong_files(text: str, folder: Path) -> dict[str, str]:
    """Return what is wrong with each of the files that stand for a given one."""
    suffix = Path(text).suffix
    found = {"missing": f"wrong/nowhere{suffix}", "empty": f"wrong/empty{suffix}", "other": f"wrong/other{suffix}"}
    (folder / "wrong").mkdir(exist_ok=True)
    (folder / found["empty"]).write_bytes(b"")
    (folder / found["other"]).write_text(YAML if suffix in (".yaml", ".yml") else TABLE)
    return found


@pytest.mark.parametrize("name", EVERY)
def test_a_file_that_is_missing_empty_or_another_is_refused_by_name(name: str, here: Path, schemas: Any) -> None:
    given, failed = asked(EVERY[name]), []
    schema = json.loads((ROOT / "docs" / "schemas" / "error.json").read_text(encoding="utf-8"))
    for parameter, text in inputs_of(name, given).items():
        hint = ACTIONS[name].action.hints[parameter]  # type: ignore[attr-defined]
        flag = next(iter(marks(hint, Flag)), Flag()).written(parameter)
        for what, wrong in wrong_files(text, here).items():
            words = [re.sub(rf"(^|=){re.escape(text)}$", rf"\1{wrong}", word) for word in shlex.split(EVERY[name])]
            done, value = run(shlex.join(words)), Path(wrong) if isinstance(given[parameter], Path) else wrong
            told = json.loads(done.stdout) if done.stdout else {}
            if done.exit_code not in (2, 3, 4) or "error" not in told or list(off_schema(told, schema, schema)):
                failed.append((parameter, what, done.exit_code, done.stderr[-200:]))
                continue
            if wrong not in done.stderr and flag not in done.stderr:
                failed.append((parameter, what, "names nothing", done.stderr[-200:]))
            try:
                ACTIONS[name](**{**given, parameter: [value] if isinstance(given[parameter], list) else value})
                failed.append((parameter, what, "taken by Python"))
            except ArmsightError as error:
                if type(error).__name__ != told["error"]["kind"] or error.exit_code != done.exit_code:
                    failed.append((parameter, what, repr(error), told))
                if (wrong not in str(error) and parameter not in str(error)) or " --" in str(error):
                    failed.append((parameter, what, "Python", str(error)))
    assert not failed
    assert not results()
