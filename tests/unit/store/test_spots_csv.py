"""Tables of one camera's spots: what is read, and what is refused by its line and column."""

import numpy as np
import pytest

from armsight.errors import BadFile, NotEnoughData
from armsight.store.spots_csv import STD_PX, parse_spot_track

HEAD = "t_s,u_px,v_px,su_px,sv_px,spot\n"


def test_rows_of_one_time_are_one_frame() -> None:
    track = parse_spot_track(f"{HEAD}0.1,10,20,0.1,0.2,A\n0.1,30,40,0.1,0.2,B\n0.2,11,21,0.1,0.2,A\n".encode(), "l.csv")
    assert track.t_s.tolist() == [0.1, 0.2]
    assert track.frame.tolist() == [0, 0, 1]
    assert track.names == ("A", "B", "A")
    assert track.light("A").tolist() == [0, 2]
    assert not track.alone
    np.testing.assert_allclose(track.covariance_px2[0], np.diag([0.01, 0.04]))


def test_names_and_deviations_may_be_left_away() -> None:
    track = parse_spot_track(b"t_s,u_px,v_px\n0.1,10,20\n0.2,11,21\n", "l.csv")
    assert track.alone and track.names == ("", "")
    np.testing.assert_allclose(track.covariance_px2[1], STD_PX**2 * np.eye(2))


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (f"{HEAD}0.2,1,2,1,1,A\n0.1,1,2,1,1,A\n", "line 3, column t_s"),
        (f"{HEAD}0.1,1,2,1,1,A\n0.1,1,2,1,1,A\n", "line 3, column spot"),
        (f"{HEAD}0.1,1,2,1,1,\n", "line 2, column spot"),
        (f"{HEAD}0.1,1,2,-1,1,A\n", "line 2, column su_px"),
        (f"{HEAD}0.1,nan,2,1,1,A\n", "line 2, column u_px"),
        (f"{HEAD}0.1,1,1e60,1,1,A\n", "line 2, column v_px"),
        ("t_s,u_px,v_px,su_px\n0.1,1,2,1\n", "sv_px"),
    ],
)
def test_bad_tables_are_refused_by_line_and_column(text: str, place: str) -> None:
    with pytest.raises(BadFile) as caught:
        parse_spot_track(text.encode(), "left.csv")
    assert "left.csv" in str(caught.value) and place in str(caught.value)


def test_an_empty_table_is_refused() -> None:
    with pytest.raises(NotEnoughData):
        parse_spot_track(HEAD.encode(), "left.csv")
