"""What a command stands in: streams that are closed or full, other locales, interrupts at any moment, odd places."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import armsight
from armsight.drivers.live import open_camera
from armsight.drivers.sources import open_video
from armsight.errors import BadFile, DeviceFailed, DeviceNotFound, Inconsistent
from armsight.ops.simulation.cells import write_png
from armsight.records import Frame
from armsight_sim.backdrops import picture_backdrop
from refusals import refuses

JOINTS = "q1,q2,q3,q4,q5,q6\n0,0,0,0,0,0\n"
FK = "kinematics fk --arm ur10 --joints joints.csv -o poses.csv --json"
POSIX = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
INTERRUPTED = """
import sys

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            sys.meta_path.remove(self)
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupts())
from armsight.cli import main
main()
"""
CRASHES = """
import armsight.ops.kinematics_results as kinematics

def fail(*_):
    raise ZeroDivisionError("odd \\udcff")

kinematics.read_values = fail
from armsight.cli import main
main()
"""


def shell(folder: Path, command: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run `armsight ...` or `python ...` as a shell does, in a folder with joints.csv."""
    (folder / "joints.csv").write_text(JOINTS)
    script = (
        f"armsight() {{ '{sys.executable}' -m armsight \"$@\"; }}\npython() {{ '{sys.executable}' \"$@\"; }}\n{command}"
    )
    source = str(
        Path(armsight.__file__).parents[1]
    )  # where PYTHONPATH is relative, another folder has another armsight
    env = {**os.environ, "PYTHONPATH": source, "ARMSIGHT_LOG_FOLDER": str(folder / "logs"), **environment}
    done = subprocess.run(["bash", "-c", script], cwd=folder, env=env, capture_output=True, check=False)
    assert b"Traceback" not in done.stderr, done.stderr.decode(errors="replace")
    assert b"Exception ignored" not in done.stderr
    return done


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (f"armsight {FK} > /dev/full", 4),
        (f"armsight {FK} 2> /dev/full", 0),
        (f"python -O -m armsight {FK} <&- >&- 2>&-", 0),
        ("armsight kinematics fk --arm ur10 --joints joints.csv -o - > /dev/full", 4),
        ("mkdir gone && cd gone && rmdir ../gone && armsight kinematics fk --arm ur10 --joints q.csv -o poses.csv", 4),
    ],
)
def test_each_ends_with_its_code_and_no_traceback(tmp_path: Path, command: str, code: int) -> None:
    done = shell(tmp_path, command)
    assert done.returncode == code, done.stderr.decode(errors="replace")
    if code == 0:
        assert (tmp_path / "poses.csv").read_text().startswith("t_s,"), "nothing that was printed is in the file"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (f"{FK} -o /dev/full", 2),
        (f"{FK} -o {'x' * 300}.csv", 2),
        (f"{FK} --joints pipe", 3),
        (f"{FK} -o pipe", 2),
        ("simulate webcam-cell --frames 1000000000 -o cell", 2),
        (f"{FK} -o ring", 0),
    ],
)
def test_each_odd_place_has_its_code(
    armsight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, code: int
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("joints.csv").write_text(JOINTS)
    os.mkfifo("pipe")
    Path("ring").symlink_to("ring")
    assert armsight(*words.removesuffix("--json").replace("--json ", "").split()).code == code
    assert code or Path("ring").read_text().startswith("t_s,"), "the link, which led nowhere, is replaced"


@pytest.mark.parametrize(("environment", "name"), [(POSIX, "n\u00fc"), ({"LC_ALL": "C.UTF-8"}, "n\udcff")])
def test_any_name_in_any_locale(tmp_path: Path, environment: dict[str, str], name: str) -> None:
    (tmp_path / name).mkdir()
    word = os.fsencode(name).decode("latin-1")
    quoted = "$'" + "".join(one if one.isascii() else f"\\x{ord(one):02x}" for one in word) + "'"
    if environment is POSIX:
        assert shell(tmp_path, f"armsight {FK} -o {quoted}/poses.csv", **environment).returncode == 0
    done = shell(tmp_path, f"armsight {FK} --joints {quoted}/no.csv", **environment)
    assert done.returncode == 3
    assert "no.csv" in json.loads(done.stdout)["error"]["cause"]
    (tmp_path / "crash.py").write_text(CRASHES)
    done = shell(tmp_path, f"python crash.py {FK} -o {quoted}/poses.csv", **environment)
    assert done.returncode == 1
    (log,) = (tmp_path / "logs").iterdir()
    assert "ZeroDivisionError" in log.read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "told"), [("armsight.cli.commands", False), ("numpy", True)])
def test_an_interrupt_during_an_import_is_a_stop(tmp_path: Path, name: str, told: bool) -> None:
    (tmp_path / "run.py").write_text(INTERRUPTED.format(name=name))
    done: Any = shell(tmp_path, f"python run.py {FK}")
    assert done.returncode == 130
    assert b"stopped" in done.stderr
    assert not told or json.loads(done.stdout)["error"]["exit_code"] == 130


def test_opencv_is_given_no_name_that_it_crashes_at(tmp_path: Path) -> None:
    name = str(tmp_path / "n\udcff")
    frame = Frame(image=np.full((4, 6), 7, np.uint8), t_s=0.0, sequence=0, source="test")
    write_png(Path(f"{name}.png"), frame)
    assert Path(f"{name}.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(BadFile, match="UTF-8"):
        open_video(f"{name}.avi")
    with pytest.raises(DeviceNotFound, match="UTF-8"):
        open_camera(name)
    camera: Any = SimpleNamespace(backdrop=np.zeros((4, 6, 1)))
    with refuses(Inconsistent, "picture"):
        picture_backdrop(f"{name}.png", camera)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a full disk is Linux's")
def test_a_full_disk_leaves_no_half_of_a_frame(tmp_path: Path) -> None:
    path = tmp_path / "000000.png"
    path.symlink_to("/dev/full")
    frame = Frame(image=np.full((4, 6), 7, np.uint8), t_s=0.0, sequence=0, source="test")
    with refuses(DeviceFailed, "No space"):
        write_png(path, frame)
    assert not os.path.lexists(path)
