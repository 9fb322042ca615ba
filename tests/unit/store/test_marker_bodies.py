"""Markers as a body against the truth: lost ones, labels exchanged by the tracker, and shapes that look like themselves
from another side. The world is numpy's alone; nothing that is wrong is read."""

from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import Ambiguous, Inconsistent
from armsight.store.interpret import TableFormat
from armsight.store.verify_files import read_measured
from refusals import refuses
from tracker_writers import Take, turned_about, written

N, NOISE_M = 120, 5e-5
UNLIKE = {"A": (0, 0, 0), "B": (0.09, 0.01, 0), "C": (-0.01, 0.07, 0.02), "D": (0.03, 0.02, 0.06), "E": (0.05, 0.1, 0)}
SQUARE = {"A": (0, 0, 0), "B": (0.08, 0, 0), "C": (0.08, 0.08, 0), "D": (0, 0.08, 0)}
BOX = {f"M{k}": ((k & 1) * 0.12, (k >> 1 & 1) * 0.08, (k >> 2) * 0.05) for k in range(8)}
ISOSCELES = {"A": (0, 0, 0), "B": (0.06, 0, 0), "C": (0.03, 0.1, 0)}
MIRRORED = {"A": (-0.05, 0, 0), "B": (0.05, 0, 0), "C": (0, 0.08, 0), "D": (0, 0.02, 0)}
"""Of a plane: half a revolution about its line of symmetry lays it on itself."""
HANDED = {"A": (-0.05, 0, 0), "B": (0.05, 0, 0), "C": (0, 0.08, 0), "D": (0.01, 0.02, 0.06)}
LONGER = {"A": (0, 0, 0), "B": (0.06, 0, 0), "C": (0.032, 0.1, 0)}
"""Isosceles but for 2 mm: an exchange of A and B is 1.2 mm off."""


def world(shape, noise_m=NOISE_M):
    """Return T_tracker_shape (R, t) and the take of its markers."""
    s = np.linspace(0.0, 3.0, N)
    R = Rotation.from_rotvec(np.stack([0.9 * np.sin(s), 0.7 * s, 0.6 * np.cos(2 * s)], axis=1))
    t = np.stack([1.0 + 0.3 * np.sin(s), 0.4 * np.cos(s), 0.7 + 0.1 * s], axis=1)
    rng = np.random.default_rng(7)
    markers = {name: xyz + rng.normal(0.0, noise_m, (N, 3)) for name, xyz in turned_about(R, t, shape).items()}
    return R, t, Take(rate=50.0, markers=markers)


def read(tmp_path, take, kind="trc", **stated):
    return read_measured(written(tmp_path, "take", kind, take), TableFormat(**stated))


def off(found, R, t, shape):
    """Return which frames are read, and how far each is from the truth: m, rad."""
    frames = np.round(found.measured.t_s * 50.0).astype(int)
    middle = np.mean(list(shape.values()), axis=0)
    xyz = np.linalg.norm(found.measured.xyz_m - R[frames].apply(middle) - t[frames], axis=1)
    own = R[frames].inv() * Rotation.from_matrix(found.measured.rotation)  # one and the same but for noise
    return frames, xyz.max(), (own * own.mean().inv()).magnitude().max()


def exchange(take, frames, a, b):
    first, second = take.markers[a], take.markers[b]
    first[frames], second[frames] = second[frames].copy(), first[frames].copy()


def lose(take, frames, *names):
    for name in names:
        take.markers[name][frames] = np.nan


@pytest.mark.parametrize("kind", ["trc", "c3d", "qtm-3d", "vicon-trajectories"])
def test_markers_that_are_lost_in_turn_leave_a_true_body(tmp_path, kind):
    R, t, take = world(UNLIKE)
    for k, name in enumerate(take.markers):
        lose(take, slice(20 * k, 20 * k + 15), name)
    lose(take, [110, 111], "A", "B", "C")
    frames, xyz, turned = off(read(tmp_path, take, kind), R, t, UNLIKE)
    assert sorted(set(range(N)) - set(frames)) == [110, 111]
    assert xyz < 6 * NOISE_M and turned < 6e-3


@pytest.mark.parametrize(("a", "b"), [("A", "B"), ("B", "D"), ("C", "E")])
def test_frames_with_exchanged_labels_are_lost_and_the_others_true(tmp_path, a, b):
    R, t, take = world(UNLIKE)
    exchange(take, slice(30, 48), a, b)
    found = read(tmp_path, take)
    frames, xyz, turned = off(found, R, t, UNLIKE)
    assert set(range(N)) - set(frames) == set(range(30, 48))
    assert xyz < 6 * NOISE_M and turned < 6e-3
    assert "18" in " ".join(found.notes)


def test_labels_exchanged_for_good_are_refused(tmp_path):
    _, _, take = world(UNLIKE)
    exchange(take, slice(70, None), "A", "B")
    with refuses(Inconsistent, "keep their distances", "--body"):
        read(tmp_path, take)


@pytest.mark.parametrize("shape", [SQUARE, BOX, ISOSCELES, MIRRORED], ids=["square", "box", "isosceles", "mirrored"])
def test_a_shape_that_looks_like_itself_from_another_side_is_refused(tmp_path, shape):
    _, _, take = world(shape)
    with refuses(Ambiguous, "exchanges", "--body"):
        read(tmp_path, take)
    found = read(tmp_path, take, body=next(iter(shape)))  # the cure
    assert found.measured.rotation is None and len(found.measured.xyz_m) == N


def test_a_shape_without_a_rotation_onto_itself_is_read_whatever_its_mirror_image(tmp_path):
    R, t, take = world(HANDED)
    frames, xyz, turned = off(read(tmp_path, take), R, t, HANDED)
    assert len(frames) == N and xyz < 6 * NOISE_M and turned < 6e-3


def test_a_small_difference_tells_an_exchange_as_far_as_the_noise_lets_it(tmp_path):
    R, t, take = world(LONGER)
    exchange(take, slice(10, 20), "A", "B")
    frames, xyz, turned = off(read(tmp_path, take), R, t, LONGER)
    assert set(range(N)) - set(frames) == set(range(10, 20))
    assert xyz < 6 * NOISE_M and turned < 6e-3
    with refuses(Ambiguous, "exchanges"):
        read(tmp_path, world(LONGER, noise_m=5e-4)[2])


def test_what_is_left_of_a_body_may_be_exchangeable_though_the_body_is_not(tmp_path):
    shape = ISOSCELES | {"D": (0.01, 0.03, 0.05)}
    R, t, take = world(shape)
    lose(take, slice(50, 60), "D")
    exchange(take, slice(52, 55), "A", "B")
    found = read(tmp_path, take)
    frames, xyz, turned = off(found, R, t, shape)
    assert set(range(N)) - set(frames) == set(range(50, 60))
    assert xyz < 6 * NOISE_M and turned < 6e-3


def test_every_exchange_of_labels_is_noticed_or_refused(tmp_path):
    """Of 40 drawn shapes, with other permutations of four labels in some frames: no frame is read that is not true."""
    rng, seen = np.random.default_rng(11), {"read": 0, "refused": 0}
    orders = list(permutations("ABCD"))[1:]
    for _ in range(40):
        places = rng.uniform(-0.06, 0.06, (4, 3)) * rng.choice([1.0, 1.0, 0.02], 3)  # flat and narrow ones too
        shape = dict(zip("ABCD", places, strict=True))
        R, t, take = world(shape)
        wrong = {}
        for k, order in zip(range(5, N, 20), rng.permutation(len(orders)), strict=False):
            was = {name: take.markers[name][k].copy() for name in "ABCD"}
            for name, other in zip("ABCD", orders[order], strict=True):
                take.markers[name][k] = was[other]
            wrong[k] = orders[order]
        try:
            frames, _, _ = off(found := read(tmp_path, take), R, t, shape)
        except Exception as error:
            assert type(error).__name__ in ("Ambiguous", "Degenerate", "Inconsistent")
            seen["refused"] += 1
            continue
        assert not set(wrong) & set(frames)
        seen["read"] += 1
        assert len(found.measured.xyz_m) == N - len(wrong)
    assert min(seen.values()) > 3
