"""What a LinuxCNC twin is started from, and what it refuses; nothing is started here."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from armsight.drivers.linuxcnc.__main__ import set_up
from armsight.drivers.linuxcnc_bridge.ini import describe
from armsight.errors import UsageError
from armsight_sim.twins.base import small_arm_mapping
from armsight_sim.twins.linuxcnc import LinuxcncTwin
from armsight_sim.twins.linuxcnc_files import ini, machine_hal, rows_of, without_tcp
from refusals import refuses


def of_joint(number: int, **values: object) -> Callable[[dict[str, Any]], None]:
    return lambda arm: arm["joints"][number - 1].update(values)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (lambda arm: arm.update(convention="standard"), "Craig"),
        (lambda arm: arm["joints"].pop(), "5 joints"),
        (lambda arm: arm["joints"].extend([dict(arm["joints"][0])] * 4), "10 joints"),
        (of_joint(3, type="prismatic"), "j3"),
        (of_joint(2, theta_rad=-1.5), "theta_rad"),
        (of_joint(4, beta_rad=0.1), "beta_rad"),
        (of_joint(5, sign=-1), "sign"),
        (of_joint(6, coupled={"j5": 1.0}), "coupled"),
    ],
)
def test_an_arm_that_genserkins_cannot_hold_is_refused(wrong: Callable[[dict[str, Any]], None], named: str) -> None:
    arm = small_arm_mapping()
    wrong(arm)
    with refuses(UsageError, named, "LinuxCNC"):
        LinuxcncTwin(arm=arm)


def test_the_files_hold_the_arm_in_linuxcncs_units(tmp_path: Path) -> None:
    arm = small_arm_mapping()
    of_joint(2, lower=-0.5, upper=0.25, max_speed=math.radians(60.0))(arm)
    rows = rows_of(arm)
    file = tmp_path / "twin.ini"
    file.write_text(ini(rows, servo_ns=1_000_000, display="/hold", hal_files=("machine.hal", "armsight.hal")))
    (tmp_path / "linuxcnc.nml").write_text("")
    told = describe(file)
    second = told["joints"][1]
    assert second["lower"] == pytest.approx(math.degrees(-0.5))
    assert second["speed"] == pytest.approx(60.0)
    assert second["acceleration"] == pytest.approx(400.0)
    assert told["jog_acceleration"] >= 400.0  # else it would cap the joints' jogs
    assert rows[1].home_deg == pytest.approx(math.degrees(-0.4))
    hal = machine_hal(rows)
    assert "setp genserkins.A-2 270\n" in hal
    assert "setp genserkins.ALPHA-1 -1.57079632679\n" in hal
    assert "setp genserkins.D-3 302\n" in hal
    lines = set_up(file, bind="127.0.0.1", port=49165).read_text()
    assert f"{tmp_path}/linuxcnc_bridge run {file} --bind 127.0.0.1 --port 49165" in lines
    assert (tmp_path / "linuxcnc_bridge" / "__main__.py").is_file()


def test_its_nml_file_opens_no_port() -> None:
    nml = "B emcCommand  SHMEM localhost 8192 0 0 1 16 1001 TCP=5005 xdr queue\nP emc  emcCommand LOCAL\n"
    assert without_tcp(nml) == "B emcCommand  SHMEM localhost 8192 0 0 1 16 1001 xdr queue\nP emc  emcCommand LOCAL\n"
