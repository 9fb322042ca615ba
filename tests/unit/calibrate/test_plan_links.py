"""Links as lines with a thickness: distances by brute force, walls, boxes, and an arm that folds onto itself."""

import numpy as np

from armsight.kinematics import Arm, Joint
from armsight_lab.links import Links, Wall, _from_box
from armsight_lab.links import apart as distance_apart

HALF_PI = np.pi / 2.0
PLANAR = Arm(
    name="planar",
    joints=(
        Joint(name="base", d_m=0.4, alpha_rad=HALF_PI),
        Joint(name="shoulder", a_m=0.5),
        Joint(name="elbow", a_m=0.4),
        Joint(name="wrist", a_m=0.1),
    ),
)
STRAIGHT = np.zeros(4)


def links(arm: Arm = PLANAR, *walls: Wall, radius_m: float = 0.05) -> Links:
    return Links(arm=arm, radius_m=radius_m, keep_m=0.01, walls=walls)


def box(middle: tuple[float, float, float], half: float, *, room: bool = False) -> Wall:
    return Wall(name="post", lower=np.array(middle) - half, upper=np.array(middle) + half, room=room)


def named(made: Links, q: np.ndarray, which: int | None = None) -> set[str]:
    """Return which joints and boxes the links are named by that are struck at a reading."""
    told = made.struck(q) if which is None else made.struck(q).split(";")[which]
    return {word for word in ("base", "shoulder", "elbow", "wrist", "flange", "post") if word in told}


def test_distances_are_those_of_points_along_the_parts() -> None:
    rng = np.random.default_rng(3)
    a, b, c, d = rng.uniform(-1.0, 1.0, (4, 200, 3))
    b[:20] = a[:20] + 1e-3 * b[:20]  # hardly a line
    d[20:40] = c[20:40] + (b - a)[20:40]  # in step
    s = np.linspace(0.0, 1.0, 401)[:, None, None]
    p, r = a + s * (b - a), c + s * (d - c)
    lower, upper = np.array([-0.2, -0.3, 0.1]), np.array([0.3, 0.1, 0.4])
    to_box = np.linalg.norm(p - np.clip(p, lower, upper), axis=2).min(axis=0)
    assert np.allclose(_from_box(a, b, lower, upper), to_box, atol=4e-3)
    apart = np.array([np.linalg.norm(p[:, None, k] - r[None, :, k], axis=2).min() for k in range(200)])
    found = distance_apart(a, b, c, d)
    assert np.allclose(found, apart, atol=4e-3) and (found < apart + 1e-9).all()


def test_a_box_at_the_elbow_alone_is_kept_clear_of_and_the_link_is_named() -> None:
    up = np.array([0.0, HALF_PI, -HALF_PI, 0.0])  # upper arm upright, the elbow 0.9 m high, forearm level
    post = box((0.0, 0.0, 0.99), 0.04)
    tool = PLANAR.fk(up)[:3, 3]
    assert np.linalg.norm(tool - [0.0, 0.0, 1.0]) > 0.4, "the tool is far from it"
    made = links(PLANAR, post)
    assert made(np.array([up, STRAIGHT])).tolist() == [False, True]
    assert named(made, up) == {"shoulder", "elbow", "wrist", "post"}
    assert made.struck(STRAIGHT) == ""
    # it is 60 mm that count, thickness and distance together
    for gap_m, clear in ((0.059, False), (0.061, True)):
        above = links(PLANAR, box((0.25, 0.0, 0.4 + gap_m + 0.04), 0.04))
        assert above(STRAIGHT[None])[0] == clear


def test_the_foot_stands_where_it_stands_and_a_face_it_is_beyond_is_no_wall() -> None:
    table = Wall(name="table", lower=np.array([-2.0, -2.0, -0.5]), upper=np.array([2.0, 2.0, 0.0]))
    down = np.array([0.0, -0.6, 0.0, 0.0])
    assert links(PLANAR, table)(STRAIGHT[None])[0] and not links(PLANAR, table)(down[None])[0]
    room = Wall(name="cell", lower=np.array([0.3, -2.0, 0.0]), upper=np.array([2.0, 0.2, 2.0]), room=True)
    aside = np.array([HALF_PI, 0.0, 0.0, 0.0])
    assert links(PLANAR, room)(STRAIGHT[None])[0], "the tool's workspace begins in front of the base"
    assert not links(PLANAR, room)(aside[None])[0] and not links(PLANAR, room)(down[None])[0]


def test_an_arm_that_folds_onto_itself_is_told_and_what_is_next_to_each_other_is_not() -> None:
    folded = np.array([0.0, HALF_PI, 0.98 * np.pi, 0.0])  # the forearm back along the upper arm, to the column
    made = links()
    assert named(made, folded) == {"base", "shoulder", "elbow", "wrist", "flange"}
    assert named(made, folded, 0) == {"base", "shoulder", "wrist", "flange"}
    assert made(np.array([STRAIGHT, folded])).tolist() == [True, False]
    assert links(radius_m=1e-3)(folded[None])[0]
