"""armsight calibrate timing of a rig of three cameras: tables of spots to a rig.yaml, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.truth.test_clocks import Wave, recorded

from armsight.store import read_rig
from armsight.store.rigs import write_rig

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def waved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("waved")
    for name, wave in (("", Wave(lights=1)), ("hidden-", Wave(hidden=(2,)))):
        rig, tracks = recorded(wave, 6)
        write_rig(folder / "rig.yaml", rig)
        for camera, track in tracks.items():
            rows = (
                f"{track.t_s[f]!r},{u!r},{v!r}" for f, (u, v) in zip(track.frame, track.uv_px.tolist(), strict=True)
            )
            text = "\n".join(row.replace("np.float64(", "").replace(")", "") for row in rows)
            (folder / f"{name}{camera}.csv").write_text(f"t_s,u_px,v_px\n{text}\n")
    return folder


def test_tables_of_three_cameras_give_a_rig_with_their_timing(armsight: Run, waved: Path, tmp_path: Path) -> None:
    out = tmp_path / "timed.yaml"
    spots = [part for k in range(3) for part in ("--spots", f"c{k}={waved / f'c{k}.csv'}")]
    done = armsight("calibrate", "timing", "--rig", waved / "rig.yaml", *spots, "-o", out)
    assert done.code == 0, done.text
    late = done.json["cameras"]["c1"]
    assert abs(late["delay_s"] + 1e-6 * late["drift_ppm"] * late["middle_s"] + 0.12 - 6e-5 * late["middle_s"]) < 3e-4
    first, second, third = read_rig(out, any_cameras=True).timing
    assert first.delay_s == 0.0 and first.names == ("readout_s", "jitter_s")
    assert (second.delay_s, second.drift_ppm) == (late["delay_s"], late["drift_ppm"])
    assert third.std["drift_ppm"] == pytest.approx(done.json["std"]["c2.drift_ppm"])
