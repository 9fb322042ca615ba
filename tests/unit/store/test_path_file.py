"""path.csv: a taught path comes back as it was written; what is none is refused with its place."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadFile, Inconsistent, NotEnoughData
from armsight.records import WELD_ON, TaughtPath
from armsight.store.path_file import parse_path, read_path
from refusals import refuses

HEADER = "index,t_s,x_m,y_m,z_m,qx,qy,qz,qw,speed_m_s,tag\n"


def made() -> TaughtPath:
    rng = np.random.default_rng(2)
    poses = RigidTransform.from_components(rng.normal(size=(5, 3)), Rotation.random(5, random_state=3))
    return TaughtPath(
        T_world_tip=poses.as_matrix(),
        t_s=np.array([0.0, 0.1, 0.25, np.nan, 0.5]),
        speed_m_s=np.array([0.01, np.nan, 0.02, 0.02, 0.02]),
        tags=("", WELD_ON, "", "", "corner"),
    )


def test_a_path_comes_back_as_it_was_written(tmp_path: Path) -> None:
    made().save(tmp_path / "path.csv")
    again = read_path(tmp_path / "path.csv")
    np.testing.assert_allclose(again.T_world_tip, made().T_world_tip, atol=1e-15)
    np.testing.assert_array_equal(again.t_s, made().t_s)
    np.testing.assert_array_equal(again.speed_m_s, made().speed_m_s)
    assert again.tags == made().tags


def test_places_alone_are_a_path() -> None:
    path = parse_path(b"x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,0,0,0,1\n0.03,0.04,0,0,0,0,1\n", "x")
    np.testing.assert_allclose(path.length_m, [0.0, 0.05])
    assert np.isnan(path.t_s).all()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("0,0,0,0,0,0,0,0,1,,\n0,1,0,0,0,0,0,0,1,,\n", ("line 3", "index")),
        ("0,1,0,0,0,0,0,0,1,,\n1,0,0,0,0,0,0,0,1,,\n", "times"),
        ("0,0,0,0,0,0,0,0,1,-0.1,\n", "speed"),
        ("0,0,0,0,0,0,0,0,1,,Weld-On\n", ("line 2", "tag", "Weld-On")),
        ("0,0,nan,0,0,0,0,0,1,,\n", "x_m"),
    ],
)
def test_what_is_no_path_is_refused_with_its_place(rows: str, said: str) -> None:
    with refuses((BadFile, Inconsistent), said):
        parse_path((HEADER + rows).encode(), "path.csv")


def test_an_empty_path_is_refused() -> None:
    with pytest.raises(NotEnoughData):
        parse_path(HEADER.encode(), "path.csv")
