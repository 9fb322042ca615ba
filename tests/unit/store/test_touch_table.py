"""touch.csv: what it may say, and what is refused by line and column."""

import pytest

from armsight.calibrate.arm.touch.touches import Kind
from armsight.errors import BadFile, UsageError
from armsight.ops.flags import lengths_of
from armsight.store.touch_table import read_touches
from refusals import refuses


def written(folder, text):
    path = folder / "touch.csv"
    path.write_text(text)
    return path


def test_features_kinds_readings_and_deviations_are_read(tmp_path):
    text = "q1,q2,feature,kind,reading_m,sigma_m\n0.1,0.2,left,point,,\n0.3,0.4,dial,gauge,0.0012,1e-5\n"
    found = read_touches(written(tmp_path, text))
    assert found.feature == ("left", "dial")
    assert found.kind == (Kind.POINT, Kind.GAUGE)
    assert found.reading_m.tolist() == [0.0, 0.0012]
    assert found.sigma_m.tolist() == [0.0, 1e-5]
    assert found.q.tolist() == [[0.1, 0.2], [0.3, 0.4]]


def test_tips_are_read_and_an_empty_column_is_one_tip(tmp_path):
    found = read_touches(written(tmp_path, "q1,feature,tip\n0.1,a,long\n0.2,a,bent\n"))
    assert (found.tip, found.tips, found.of_tip.tolist()) == (("long", "bent"), ("bent", "long"), [1, 0])
    assert read_touches(written(tmp_path, "q1,feature,tip\n0.1,a,\n0.2,a,\n")).tips == ("",)


def test_places_tell_points_apart_and_their_distances_are_known(tmp_path):
    rows = [f"{i / 10},0.5,{0.27 * (i % 2)},0,0" for i in range(8)]
    found = read_touches(written(tmp_path, "\n".join(["q1,q2,x_m,y_m,z_m", *rows]) + "\n"))
    assert found.feature == ("1", "2") * 4
    (known,) = found.lengths
    assert (known.a, known.b, known.length_m) == ("1", "2", pytest.approx(0.27))


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("q1,feature\n0.1,\n", ("line 2", "feature")),
        ("q1,feature,kind\n0.1,a,spike\n", ("line 2", "spike", "plane")),
        ("q1,feature,kind,reading_m\n0.1,a,gauge,\n", ("line 2", "gauge needs its reading")),
        ("q1,feature,kind,reading_m\n0.1,a,point,0.2\n", ("line 2", "no reading")),
        ("q1,feature,tip\n0.1,a,long\n0.2,a,\n", ("line 3", "column tip: empty")),
        ("feature\na\n", ("no column q1",)),
        ("q1\n0.1\n", ("no column feature", "name of the spike")),
        ("q1,x_m,y_m,z_m\n0.1,1,2,3\n0.2,2,3,4\n", ("2 places", "--points")),
    ],
)
def test_what_is_no_touch_is_refused_by_its_line(text, names, tmp_path):
    with refuses(BadFile, *names):
        read_touches(written(tmp_path, text))


def test_lengths_are_written_with_names_and_units():
    assert lengths_of(["left,right,270mm", "ball,19mm,0.01mm"]) == [
        ("left", "right", pytest.approx(0.27), None),
        ("ball", "", pytest.approx(0.019), pytest.approx(1e-5)),
    ]
    for wrong in ("left,right", "270mm", "a,b,c,270mm", "a,b,-1mm"):
        with refuses(UsageError, "--length left,right,270mm"):
            lengths_of([wrong])
