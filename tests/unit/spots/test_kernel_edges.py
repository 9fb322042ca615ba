"""The seams of the compiled search: last blocks, touching corners, tiles at the border, window ends; against scipy."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from armsight.measure.poses.kernels.correspondence import Best, _keep
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.columns import Picture
from armsight.measure.spots.kernels.peaks import MOST_PEAKS, PEAK_PX, nearest_peaks
from armsight.measure.spots.kernels.round_gaussian import MOST, REACH, set_box
from armsight.measure.spots.kernels.scan import (
    BLOCK,
    SUPER,
    bright_blocks,
    connected_components,
    connected_components_in_window,
    threshold_map,
)

Image = NDArray[np.uint8]
NO_MASK = np.empty((0, 0), np.uint8)
LEVEL = 100


def expected(image: Image) -> list[tuple[int, ...]]:
    """Area, first and last column, first and last row, and peak of every 8-connected area above LEVEL, by scipy."""
    labels, _ = ndimage.label(image > LEVEL, structure=np.ones((3, 3)))
    rows = []
    for number, (y, x) in enumerate(ndimage.find_objects(labels), start=1):
        own = labels[y, x] == number
        rows.append((int(own.sum()), x.start, x.stop - 1, y.start, y.stop - 1, int(image[y, x][own].max())))
    return sorted(rows)


def found(table: NDArray[np.float64], n: int) -> list[tuple[int, ...]]:
    """The same columns of a table of areas."""
    return sorted(
        tuple(int(v) for v in row)
        for row in table[:n][:, [col.AREA, col.X_MIN, col.X_MAX, col.Y_MIN, col.Y_MAX, col.PEAK]]
    )


def pictures() -> list[Image]:
    """Speckle, diagonals, staircases and combs, of widths beside the kernels' strides."""
    rng = np.random.default_rng(4)
    sizes = [(7, 9), (33, 61), (40, 64), (41, 65), (50, 127), (64, 129), (3, 1000), (1000, 3)]
    images = [(rng.random(size) < share) * np.uint8(200) for size in sizes for share in (0.05, 0.3, 0.6)]
    for size in ((60, 70), (65, 64)):
        step = np.zeros(size, np.uint8)
        np.fill_diagonal(step, 180)
        np.fill_diagonal(np.fliplr(step), 190)
        comb = np.zeros(size, np.uint8)
        comb[:, ::2] = 150
        comb[-1] = 220
        images += [step, comb]
    return [np.ascontiguousarray(image, np.uint8) for image in images]


@pytest.mark.parametrize("image", pictures(), ids=lambda image: "{}x{}".format(*image.shape))
def test_areas_are_those_of_scipys_labels(image: Image) -> None:
    h, w = image.shape
    most = h * w
    table, runs, parent = np.empty((most, col.COLUMNS)), np.empty((most, 3), np.int32), np.empty(most, np.int32)
    picture = Picture(image, np.uint8(0), 255, NO_MASK)
    hits = np.empty((most + BLOCK - 1) // BLOCK, np.int64)
    blocks = bright_blocks(image.reshape(-1), np.uint8(0), LEVEL, hits)
    level = np.full((col.GRID, col.GRID), float(LEVEL))
    n = connected_components(picture, level, False, hits, blocks, runs, parent, table)
    assert found(table, n) == expected(image)
    whole = np.array([0, w, 0, h])
    n = connected_components_in_window(picture, LEVEL, whole, False, runs, parent, table, np.empty(w, np.uint8))
    assert found(table, n) == expected(image)


@pytest.mark.parametrize("levels", [4, 256])
def test_peaks_of_a_window_are_those_of_looking_at_every_pixel(levels: int) -> None:
    rng = np.random.default_rng(levels)
    for _ in range(40):
        h, w = rng.integers(3, 24, 2)
        image = rng.integers(0, levels, (h, w)).astype(np.uint8) * np.uint8(255 // (levels - 1))
        x0, y0 = rng.integers(0, w), rng.integers(0, h)
        box = np.array([x0, rng.integers(x0, w) + 1, y0, rng.integers(y0, h) + 1])
        u, v = rng.uniform(0.0, w), rng.uniform(0.0, h)
        least = int(image[box[2] : box[3] : 2, box[0] : box[1] : 2].min()) + 24.0
        peaks = []
        for y in range(box[2], box[3]):
            for x in range(box[0], box[1]):
                near = image[max(y - PEAK_PX, 0) : y + PEAK_PX + 1, max(x - PEAK_PX, 0) : x + PEAK_PX + 1]
                first = np.argwhere(near == near.max())[0] + [max(y - PEAK_PX, 0), max(x - PEAK_PX, 0)]
                if image[y, x] >= least and first.tolist() == [y, x]:
                    peaks.append(((x - u) ** 2 + (y - v) ** 2, x, y))
        at = np.empty((MOST_PEAKS, 2), np.int64)
        n = nearest_peaks(Picture(image, np.uint8(0), 255, NO_MASK), u, v, box, 24.0, at)
        assert at[:n].tolist() == [[x, y] for _, x, y in sorted(peaks)[:MOST_PEAKS]]


@pytest.mark.parametrize("size", [1, BLOCK - 1, BLOCK, BLOCK + 1, SUPER - 1, SUPER, SUPER + 1, 3 * SUPER + BLOCK + 5])
def test_the_last_block_is_never_left_out(size: int) -> None:
    for at in {0, size // 2, size - 1}:
        flat = np.zeros(size, np.uint8)
        flat[at] = LEVEL + 1
        hits = np.empty(size // BLOCK + 1, np.int64)
        n = bright_blocks(flat, np.uint8(0), LEVEL, hits)
        assert at // BLOCK in hits[:n].tolist()


def test_a_tiles_threshold_is_the_upper_third_of_the_known_tiles_about_it() -> None:
    rng = np.random.default_rng(2)
    levels = rng.uniform(10.0, 200.0, (col.GRID, col.GRID))
    thresholds = np.empty((col.GRID, col.GRID))
    low, high = threshold_map(levels, 7.0, thresholds)
    for i in range(1, col.GRID - 1):
        for j in range(1, col.GRID - 1):
            assert thresholds[i, j] == np.sort(levels[i - 1 : i + 2, j - 1 : j + 2].ravel())[6] + 7.0
    assert low == thresholds.min() and high == thresholds.max()


@pytest.mark.parametrize("slope", [(11.0, 0.0), (0.0, -5.0), (6.0, 6.0), (-6.0, 6.0)])
def test_a_linear_ground_stays_below_its_thresholds_also_at_the_border(slope: tuple[float, float]) -> None:
    i, j = np.mgrid[: col.GRID, : col.GRID]
    levels = 120.0 + slope[0] * i + slope[1] * j
    thresholds = np.empty((col.GRID, col.GRID))
    threshold_map(levels, 0.0, thresholds)
    corner = 0.5 * (abs(slope[0]) + abs(slope[1]))  # how far a tile's highest corner is above its middle
    assert (thresholds >= levels + corner - 1e-9).all()


@pytest.mark.parametrize("uv", [(20.0, 15.0), (20.49, 14.51), (0.0, 0.0), (39.4, 29.4)])
def test_the_window_is_symmetric_about_its_pixel_and_ends_within_the_image(uv: tuple[float, float]) -> None:
    box = np.empty(4, np.int64)
    q = 2.0
    assert set_box(*uv, q, 30, 40, box)
    r = int(REACH * np.sqrt(q) + 1.5)
    x, y = round(uv[0]), round(uv[1])
    assert box.tolist() == [max(x - r, 0), min(x + r + 1, 40), max(y - r, 0), min(y + r + 1, 30)]
    largest = ((MOST - 1) // 2 - 1.0) / REACH
    assert set_box(100.0, 100.0, largest**2, 400, 400, box) and not set_box(
        100.0, 100.0, (2.0 * largest) ** 2, 400, 400, box
    )


def test_hypotheses_are_kept_in_order_and_the_worst_goes_where_there_is_no_room() -> None:
    """As sorting and cutting does, in whatever order they come; what lies beyond the margin of the best goes."""
    rng = np.random.default_rng(1)
    room, margin = 5, 10.0
    for _ in range(200):
        values = rng.permutation(np.round(rng.uniform(0.0, 30.0, 12), 3))
        names, chi2s, poses = np.zeros((room, 3), np.intp), np.zeros(room), np.zeros((room, 3, 4))
        kept = 0
        for k, chi2 in enumerate(values):
            kept = _keep(kept, margin, np.full(3, k), chi2, np.eye(3), np.zeros(3), Best(names, chi2s, poses))
        wanted = [v for v in sorted(values)[:room] if v <= min(values) + margin]
        assert chi2s[:kept].tolist() == wanted
        assert [values[row[0]] for row in names[:kept]] == wanted
