"""What a page sends in place of what was typed or drawn: refused by name, never taken for something else."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from armsight.console import layout as fields
from armsight.console.layout import file_name, number, text, ticked, whole_number
from armsight.console.pages.live import MASKS, masked
from armsight.console.scene import Scene
from armsight.console.state import Console
from armsight.errors import UsageError
from refusals import refuses


def field(value: object, low: float = -math.inf, high: float = math.inf) -> Any:
    return SimpleNamespace(value=value, min=low, max=high, props={"label": "From (deg)"})


@pytest.mark.parametrize(
    "value", [None, "", "ten", "1,5", math.nan, math.inf, 1e9, -1e9, "1e999", 10**400, True, [1.0], {}]
)
def test_what_is_no_figure_is_refused_by_name(value: object) -> None:
    with refuses(UsageError, "Joint 3", "From"):
        number(field(value), of="Joint 3")


def test_an_empty_field_is_zero_only_where_that_is_meant() -> None:
    assert number(field(None), empty=0.0) == 0.0
    assert number(field(-12.5)) == -12.5


def test_limits_of_a_field_hold_before_it_is_left() -> None:
    assert whole_number(field(10, 4, 100)) == 10
    for value in (3, 101, -10):
        with refuses(UsageError, "4 to 100"):
            whole_number(field(value, 4, 100))
    with pytest.raises(UsageError, match="whole"):
        whole_number(field(10.5, 4, 100))


@pytest.mark.parametrize("value", [1, True, ["a"], {"a": 1}, "a\nb", "\x00", "\ud800", "a\u200b", "x" * 1001])
def test_what_is_no_line_of_text_is_refused_by_name(value: object) -> None:
    with pytest.raises(UsageError, match="From"):
        text(field(value))
    with pytest.raises(UsageError, match="From"):
        file_name(field(value))


@pytest.mark.parametrize("value", ["/etc/passwd", "../rig.yaml", "a/../../rig.yaml", ".."])
def test_a_file_outside_the_folder_is_refused_unless_the_cell_has_it(value: str) -> None:
    with refuses(UsageError, "folder"):
        file_name(field(value))
    assert file_name(field(value), kept=value) == value


def test_names_of_the_folder_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("", "rig.yaml", "identify/arm.yaml", "a/../größe.yaml", "..rig.yaml"):
        assert file_name(field(f" {name} ")) == name
    assert text(field(None)) == ""
    monkeypatch.setattr(fields, "text", lambda one: one.value)  # a planted fault: no look at the type
    with pytest.raises((TypeError, AttributeError)):
        file_name(field(["a"]))


def test_only_true_is_a_tick() -> None:
    assert [ticked(field(value)) for value in (True, False, 1, "false", None, [0])] == [True] + [False] * 5


BOX = {"side": "left", "mask": [1, 2.5, 30, 40]}


@pytest.mark.parametrize(
    "said",
    [
        None, [], "left", {}, {"side": "left"}, {**BOX, "more": 1}, {**BOX, "side": "top"}, {**BOX, "side": 0},
        {**BOX, "side": "x" * 99},
        *[{**BOX, "mask": [1, 2, 3, one]} for one in ("4", None, True, math.nan, math.inf, 1e6, 10**400, [4])],
        *[{**BOX, "mask": mask} for mask in ([1, 2, 3], [1] * 5, "1234", {"0": 1}, None)],
    ],
)  # fmt: skip
def test_what_is_no_rectangle_is_refused(tmp_path: Path, said: object) -> None:
    with pytest.raises(UsageError):
        masked(Console(folder=tmp_path), said)


def test_a_rectangle_is_masked_and_there_is_an_end_to_them(tmp_path: Path) -> None:
    console = Console(folder=tmp_path)
    for _ in range(MASKS):
        console.set_look(masked(console, BOX))
    assert console.look.masked == {"left": ((1.0, 2.5, 30.0, 40.0),) * MASKS}
    with pytest.raises(UsageError, match="already"):
        masked(console, BOX)


def test_only_a_place_of_a_path_is_picked() -> None:
    picked: list[int] = []
    scene = cast(Any, SimpleNamespace(_picked=picked.append))
    for name in ("place-²", "place-", "place--1", "place-1e3", "place-" + "9" * 5000, "arm", None, 7, ["place-1"]):
        Scene._clicked(scene, cast(Any, SimpleNamespace(hits=[SimpleNamespace(object_name=name)])))
    assert picked == []
    Scene._clicked(scene, cast(Any, SimpleNamespace(hits=[SimpleNamespace(object_name="place-12")])))
    assert picked == [12]
