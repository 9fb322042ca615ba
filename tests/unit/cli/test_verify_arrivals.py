"""armsight verify: arrivals at a pose and exchanged robots, from columns of the measured file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

AGAIN = "--overwrite"

HEADER = "t_s,pose,visit,arrival,robot,x_m,y_m,z_m"
REST_M = np.array([0.5, 0.1, 0.4])


def lines_of(shift_m: float = 0.0, robot: str = "") -> list[str]:
    """Six visits of P1 that scatter by 10 um along x, and three arrivals that pass the goal by 2 mm and come back.

    Each arrival: from 10 mm before the goal at 0.1 m/s to 2 mm behind it, back at 0.1 m/s, then at rest.
    """
    lines = []
    for visit in range(6):
        x, y, z = REST_M + np.array([shift_m + 1e-5 * (-1) ** visit, 0.0, 0.0])
        lines.append(f"{100 + visit},P1,{visit},,{robot},{x},{y},{z}")
    t = np.arange(0.0, 1.0, 0.002)
    x = np.interp(t, [0.0, 0.12, 0.14], [-0.010, 0.002, 0.0])
    for arrival in range(3):
        rows = zip((t + 200 + 10 * arrival).tolist(), (x + REST_M[0] + shift_m).tolist(), strict=True)
        lines += [f"{at!r},P1,,{arrival},{robot},{place!r},{REST_M[1]},{REST_M[2]}" for at, place in rows]
    return lines


def written(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join([HEADER, *lines]) + "\n")
    return path


def test_arrivals_give_stabilisation_time_and_overshoot(armsight: Any, tmp_path: Path) -> None:
    measured = written(tmp_path / "m.csv", lines_of())
    done = armsight("verify", "--measured", measured, "--band", "0.0005", "-o", tmp_path / "out", AGAIN)
    assert done.code == 0
    iso = done.json["iso9283"]
    # in at -0.5 mm (0.095 s), through, 2 mm beyond (0.12 s), in for good at +0.5 mm (0.135 s)
    assert iso["t_s"]["value"] == pytest.approx(0.040, abs=1e-6)
    assert iso["OV_m"]["value"] == pytest.approx(0.002, abs=1e-6)
    assert (iso["t_s"]["n"], iso["t_s"]["wanted"]) == (3, 3)
    # rows on their way are no visits: RP is that of the six visits, 10 um + 3 * 0
    assert iso["RP_m"]["n"] == 6 and iso["RP_m"]["value"] == pytest.approx(1e-5, rel=1e-6)


def test_robots_of_one_pose_give_exchangeability_and_stay_apart(armsight: Any, tmp_path: Path) -> None:
    measured = written(tmp_path / "m.csv", [*lines_of(0.0, "A"), *lines_of(3e-4, "B")])
    iso = armsight("verify", "--measured", measured, "--band", "0.0005", "-o", tmp_path / "out", AGAIN).json["iso9283"]
    assert iso["E_m"]["value"] == pytest.approx(3e-4, abs=1e-9) and iso["E_m"]["wanted"] == 5
    assert iso["RP_m A P1"]["n"] == iso["RP_m B P1"]["n"] == 6  # one of 12 would be 0.3 mm
    assert iso["t_s B P1"]["value"] == pytest.approx(0.040, abs=1e-6)
    assert (
        "1 of the 2 robots"
        in armsight(
            "verify",
            "--measured",
            written(tmp_path / "one.csv", lines_of(0.0, "A")),
            "-o",
            tmp_path / "out",
            "--overwrite",
        ).json["iso9283"]["E_m"]["withheld"]
    )
