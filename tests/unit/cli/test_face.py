"""What all commands share: help that is quick, one JSON object, exit codes, messages, a log for the unforeseen."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from armsight import errors
from armsight.cli.command_ui import CommandUI
from armsight.cli.commands import app
from armsight.cli.tables import parameter, pose_rows
from armsight.fields import Doc
from armsight.geometry import pose_from_quat
from armsight.records.output import Output, output
from armsight.records.result_parts import PoseStd
from refusals import names_it

HEAVY = ("numba", "cv2", "plotly", "scipy", "numpy", "markdown_it", "pygments")
"""What takes longer to load than help may take; pydantic, which reads flags' values, is not needed for the overview."""


def run(*words: str) -> Any:
    return CliRunner().invoke(app, list(words))


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("armsight.ops.doctor.looked_at", fail)


def test_help_and_wrong_flags_load_no_compiler_no_plots_and_no_markdown() -> None:
    code = (
        "import sys\nfrom armsight.cli.commands import app\nfrom armsight.cli.examples import every_command\n"
        "wrong = [[*name.split(), '--nosuch'] for name, _ in every_command(app)]\n"
        "for words in (['--help'], *([*one[:-1], '--help'] for one in wrong), *wrong):\n"
        "    try:\n        app(words)\n    except SystemExit as end:\n"
        "        assert end.code == (2 if words[-1] == '--nosuch' else 0), words\n"
        "    assert words != ['--help'] or 'pydantic' not in sys.modules\n"
        f"print('loaded', [name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "loaded []", done.stderr
    for word in ("measure", "calibrate", "demo", "convert", "doctor", "simulate"):
        assert word in done.stdout


def test_wrong_usage_ends_with_2() -> None:
    for words in (("measure",), ("nosuch",), ("doctor", "--depth", "far"), ("calibrate", "camera", "a", "-o", "b")):
        assert run(*words).exit_code == 2, words


def test_json_is_one_object_on_stdout_and_text_is_on_stderr() -> None:
    done = run("doctor", "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["versions"]["armsight"]
    assert "This machine" in done.stderr
    assert run("doctor").stdout == ""


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.UsageError("the call is wrong", cure="Do it right"), 2),
        (errors.BadImage("the image is black", consequence="No pose", cure="Light it"), 3),
        (errors.DeviceLost("the camera is gone", consequence="No frames", cure="Plug it in"), 4),
        (errors.Cancelled("stopped after 3 pairs"), 130),
        (KeyboardInterrupt(), 130),
    ],
)
def test_a_known_error_is_one_message_and_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    failing(monkeypatch, error)
    done = run("doctor", "--json")
    assert done.exit_code == code
    told = json.loads(done.stdout)["error"]
    assert told["exit_code"] == code
    for part in ("cause", "consequence", "cure"):
        assert told[part] in done.stderr
    assert "Traceback" not in done.stderr
    assert run("doctor").stdout == ""


def test_the_unforeseen_is_one_line_and_a_log(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    failing(monkeypatch, ZeroDivisionError("nobody thought of this"))
    monkeypatch.setenv("ARMSIGHT_LOG_FOLDER", str(tmp_path / "logs"))
    done = run("doctor")
    assert done.exit_code == 1
    (log,) = (tmp_path / "logs").iterdir()
    assert "Traceback" in log.read_text()
    assert str(log) in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_log_that_cannot_be_written_does_not_hide_the_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    failing(monkeypatch, ValueError("odd"))
    monkeypatch.setenv("ARMSIGHT_LOG_FOLDER", str(tmp_path / "file" / "logs"))
    done = run("doctor")
    assert done.exit_code == 1
    assert "odd" in done.stderr


def test_no_number_that_is_not_finite_gets_into_json(capsys: pytest.CaptureFixture[str]) -> None:
    @output
    class Sample(Output):
        """A result."""

        a_m: Annotated[float, Doc("No number.")]
        b: Annotated[list[float], Doc("Numbers.")]
        c: Annotated[dict[str, tuple[int, int | None]], Doc("Counts.")]

    with CommandUI(as_json=True) as face:
        face.result(Sample(a_m=float("nan"), b=[1.0, float("inf")], c={"d": (1, None)}))
    assert json.loads(capsys.readouterr().out) == {"a_m": None, "b": [1.0, None], "c": {"d": [1, None]}}


def test_ctrl_c_asks_first_and_the_second_one_stops_at_once() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(typer.Exit) as ended, CommandUI(as_json=False) as face:
        bar = face.progress("working")
        assert not bar.cancelled()
        os.kill(os.getpid(), signal.SIGINT)
        assert bar.cancelled()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert ended.value.exit_code == 130, "work that was stopped is not done, whatever it returns"
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("with_progress", [True, False])
def test_work_that_asks_for_no_end_is_stopped_at_once(with_progress: bool) -> None:
    with pytest.raises(typer.Exit) as ended, CommandUI(as_json=False) as face:
        if with_progress:
            face.progress("working")  # and never asks it
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("it went on")
    assert ended.value.exit_code == 130


def test_what_runs_until_it_is_stopped_has_a_good_end() -> None:
    with CommandUI(as_json=False, until_stopped=True):
        os.kill(os.getpid(), signal.SIGINT)


def test_labels_are_of_the_unit_that_is_shown_and_poses_have_their_rotation() -> None:
    assert parameter("j2.theta_rad", np.pi / 2) == ["j2.theta, deg", "90.00"]
    assert parameter("j2.a_m", 0.001) == ["j2.a, mm", "1.000"]
    pose = pose_from_quat([0.1, 0.0, 0.0], [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    std = PoseStd(x_m=1e-4, y_m=1e-4, z_m=1e-4, rx_rad=1e-3, ry_rad=1e-3, rz_rad=1e-3)
    rows = {name: value for name, value, _ in pose_rows(pose, std)}
    assert float(rows["x, mm"]) == 100.0 and float(rows["rotation vector z, deg"]) == 90.0


@pytest.mark.parametrize("given", ["nan", "-inf"])
def test_a_number_that_is_none_is_refused(given: str) -> None:
    words = ("join", "--measured", "poses.csv", "-o", "points.csv", "--offset")
    done = run(*words[:-1], f"{words[-1]}={given}")
    assert done.exit_code == 2
    assert names_it(done.stderr, words[-1]) and any(said in done.stderr for said in ("finite", "less than or equal"))
