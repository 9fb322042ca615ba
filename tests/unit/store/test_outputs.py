"""Where results may be written: files and folders, one writer at a time, also from Python."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

import armsight as library
from armsight.cli.command import WRITTEN, Command
from armsight.cli.commands import app
from armsight.cli.examples import every_command
from armsight.errors import DeviceFailed
from armsight.store.atomic import held_outputs

JOINTS = "q1,q2,q3,q4,q5,q6\n0.1,-1.0,1.2,-0.3,1.2,0.4\n"


def test_a_second_writer_is_told_and_the_first_ones_end_lets_go(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with held_outputs([out]):
        with pytest.raises(DeviceFailed), held_outputs([tmp_path / "x" / ".." / "out"]):
            raise AssertionError("held twice")
        with pytest.raises(DeviceFailed):
            library.write_simulation("arm-points", out)
        with pytest.raises(DeviceFailed):
            library.convert(library.presets.ur10(), [out])
    assert not out.exists()
    assert library.write_formulas("ur10", tmp_path / "a.tex").arm


def test_every_command_that_writes_refuses_a_device_and_a_place_in_use(tmp_path: Path) -> None:
    held_by = {name: getattr(info.callback, "armsight") for name, info in every_command(app)}  # noqa: B009
    commands = {name: one if isinstance(one, Command) else one() for name, one in held_by.items()}
    taken = {name: [one.name for one in command.parameters()] for name, command in commands.items()}
    writing = [name for name, flags in taken.items() if WRITTEN & set(flags)]
    assert len(writing) > 40
    assert {name for name, command in commands.items() if command.streamed} < set(writing)
    busy = tmp_path / "busy"
    for name in writing:
        flag = next(one for one in ("out", "record", "log") if one in taken[name])
        for place, held in (("/dev/null", []), (busy, [busy])):
            value = [Path(place)] if name == "convert rig" else Path(place)
            with pytest.raises(BaseException) as ended, held_outputs(held):
                commands[name].run(**{flag: value})
            assert getattr(ended.value, "exit_code", None) == (4 if held else 2), name
    assert not busy.exists()


def test_one_table_goes_to_the_standard_output(tmp_path: Path) -> None:
    (tmp_path / "q.csv").write_text(JOINTS, encoding="utf-8")
    words = ["kinematics", "fk", "--arm", "ur10", "--joints", str(tmp_path / "q.csv"), "-o"]
    assert CliRunner().invoke(app, [*words, str(tmp_path / "poses.csv")]).exit_code == 0
    done = CliRunner().invoke(app, [*words, "-"])
    assert (done.exit_code, done.stdout) == (0, (tmp_path / "poses.csv").read_text(encoding="utf-8"))
    assert done.stderr.endswith(" of ur10: -\n"), "no name of a file that is gone"
    assert CliRunner().invoke(app, [*words, "-", "--json"]).exit_code == 2
    assert CliRunner().invoke(app, ["convert", "arm", "ur10", "-o", "-"]).exit_code == 2
