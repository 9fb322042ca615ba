"""Dots in one image, lattices over them, and where a board may lie on one."""

from __future__ import annotations

import cv2
import numpy as np

from armsight.measure.boards.lattice import MOST_PLACES, Dots, Grid, lattices, placements, round_dots


def rows_of(columns: int, rows: int) -> np.ndarray:
    """Return places (n, 2), row by row."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)


def dots_at(places: np.ndarray) -> Dots:
    """Dots of 5 px on a grid of 20 px, somewhat slanted."""
    uv = 50.0 + 20.0 * places @ np.array([[1.0, 0.1], [-0.15, 0.9]])
    return Dots(uv=uv, axes=np.full((len(uv), 2), 5.0), angle=np.zeros(len(uv)))


def grid(columns: int, rows: int) -> Grid:
    places = rows_of(columns, rows)
    point = np.arange(columns * rows).reshape(rows, columns)
    i, j = np.arange(rows), np.arange(columns)
    sides = (
        (j, np.full(columns, -1)),
        (j, np.full(columns, rows)),
        (np.full(rows, -1), i),
        (np.full(rows, columns), i),
    )
    return Grid(
        nodes=places,
        rims=(point[0], point[-1], point[:, 0], point[:, -1]),
        beyond=tuple(np.stack(side, axis=1) for side in sides),
    )


def test_a_lattice_takes_in_all_dots_and_a_board_lies_on_it_in_its_own_turns_only() -> None:
    places = rows_of(7, 5)
    missing = np.delete(places, 17, axis=0)
    dots = dots_at(missing)
    lattice = next(lattices(dots))
    assert len(lattice) == 34
    ways = placements(lattice, dots, grid(7, 5))
    assert len(ways) == 4  # two turns, and both mirrored
    for way in ways:
        assert way.count == 34
        assert not way.beyond
        at = places[np.delete(np.arange(35), 17)][way.numbering[way.numbering >= 0]]
        turned = rows_of(7, 5)[way.numbering >= 0]
        assert set(np.abs(np.diff(at - at[0], axis=0)).ravel()) == set(np.abs(np.diff(turned, axis=0)).ravel())


def test_a_board_that_fits_anywhere_on_a_larger_lattice_is_tried_so_often_only_and_goes_on() -> None:
    dots = dots_at(rows_of(24, 20))
    lattice = next(lattices(dots))
    assert len(lattice) == 480
    ways = placements(lattice, dots, grid(5, 4))
    assert 0 < len(ways) <= 8 * MOST_PLACES
    assert all(way.beyond for way in ways)


def test_the_smallest_dots_are_seen_among_speckles() -> None:
    rng = np.random.default_rng(4)
    light = np.full((400, 400), 200.0)
    light[rng.uniform(size=light.shape) < 0.02] = 60.0
    truth = 20.0 + 18.0 * rows_of(20, 20) + rng.uniform(-2.0, 2.0, (400, 2))
    image = np.asarray(light, np.uint8)
    for u, v in truth:
        cv2.circle(image, (round(16 * u), round(16 * v)), 16 * 2, 20, -1, cv2.LINE_AA, shift=4)
    found = round_dots(image, 33, dark=True)
    off = np.linalg.norm(found.uv[:, None] - truth[None], axis=2).min(axis=0)
    assert (off < 1.0).mean() > 0.83  # of those that are followed with the speckles on them 0.81
    assert len(found.uv) < 500
