"""Finds what is bright: background and noise from a sample, a block-wise scan, run-length components.

All functions see grey through `flip`: 0 as it is, 255 inverted (dark spots on light become light on dark).
A mask is a (h, w) uint8 array, zero where nothing may be found; an array of size 0 stands for no mask.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inner_kernel, lean_kernel, lean_sum_kernel
from armsight.measure.spots.kernels import columns as col
from armsight.measure.spots.kernels.columns import insertion_sort

BLOCK = 64
"""Pixels that are accepted or skipped together."""
SUPER = 512
"""Pixels whose maximum is taken at once; the compiler turns it into vector instructions at the speed of memory."""
LEVEL_RANGE = 2.0
"""Range of the tiles' levels (grey) within which the background is level; the sample's own scatter is half of it."""
SKIP = 16
"""Pixels of a bright block that are skipped together where they are dark."""
LINE = 64
"""Pixels sampled in a tile: one cache line, so that the sample costs 64 memory accesses and no more."""
LEAST_NOISE = 0.1
"""Variance (grey levels^2) below which a sensor's noise was taken away: rounding alone leaves a twelfth."""
WHITE = 0.1
"""How far the median tile's ratio of neighbouring steps may be from that of white noise; its standard deviation is
0.02."""
SHORT = 16
"""Fewest pixels sampled in a tile: narrower tiles share some."""
GROUPS = 4
"""Parts of a line; the second-darkest part gives the tile's level, so that a spot on the line does not count."""


@lean_sum_kernel
def sample_line(image, flip, y, x, n, parts):
    """Return level and noise variance of n pixels from (x, y), and the sums of products of their steps.

    Level: second-darkest part's mean. Variance: mean squared step / 2. Sums: of steps squared, and of each with the
    next one: of white noise the second is minus half of the first.
    """
    m = n // GROUPS
    row = np.uint64(y)
    for k in range(GROUPS):
        first = np.uint64(x + k * m)
        total = 0.0
        for i in range(m):
            total += float(np.uint8(image[row, first + np.uint64(i)] ^ flip))
        parts[k] = total / m
    first = np.uint64(x)
    # steps from pixel to pixel: a slope of the background hardly counts in them, as it would in deviations
    steps = 0.0
    products = 0.0
    for i in range(m * GROUPS - 2):
        here = float(image[row, first + np.uint64(i + 1)])
        step = here - float(image[row, first + np.uint64(i)])
        steps += step * step
        products += step * (float(image[row, first + np.uint64(i + 2)]) - here)
    insertion_sort(parts, parts.shape[0])
    return parts[1], 0.5 * steps / max(m * GROUPS - 2, 1), steps, products


@lean_kernel
def count_masked(mask, y, x, n):
    """Return how many of the line's pixels are masked out."""
    count = 0
    for i in range(x, x + n):
        count += mask[y, i] == 0
    return count


@inner_kernel
def estimate_background(image, flip, mask, levels):
    """Fill levels (GRID, GRID) with the background of the tiles (-1 unknown); return the median noise variance.

    Also returned: whether the noise is that of a picture that was processed (demosaiced, sharpened, compressed).
    """
    h, w = image.shape
    n = min(min(LINE, max(w // col.GRID, SHORT)), w)
    n -= n % GROUPS
    noise = np.empty(col.GRID * col.GRID)
    parts = np.empty(GROUPS)
    ratio = np.empty(col.GRID * col.GRID)
    known = np.int64(0)
    for i in range(col.GRID):
        for j in range(col.GRID):
            levels[i, j] = -1.0
            if n == 0:
                continue
            x = min(max((2 * j + 1) * w // (2 * col.GRID) - n // 2, 0), w - n)
            y = (2 * i + 1) * h // (2 * col.GRID)
            if mask.size > 0 and count_masked(mask, y, x, n) > 0:
                continue
            levels[i, j], noise[known], steps, products = sample_line(image, flip, y, x, n, parts)
            ratio[known] = products / steps if steps > 0.0 else 0.0
            known += 1
    if known == 0:
        median = histogram_median(image, flip, mask)
        for i in range(col.GRID):
            for j in range(col.GRID):
                levels[i, j] = median
        return 0.0, False
    # medians over the tiles: edges and lights in less than half of them do not count
    insertion_sort(noise, known)
    insertion_sort(ratio, known)
    # steps of white noise share a pixel with the next one: correlation -1/2, which processing changes
    middle = ratio[known // 2]
    return noise[known // 2], noise[known // 2] < LEAST_NOISE or abs(middle + 0.5) > WHITE


@inner_kernel
def histogram_median(image, flip, mask):
    """Return the median grey of the unmasked pixels (slow; for masks and images too small to be sampled)."""
    counts = np.zeros(256, np.int64)
    total = 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if mask.size == 0 or mask[y, x] != 0:
                counts[np.uint8(image[y, x] ^ flip)] += 1
                total += 1
    seen = 0
    for v in range(256):
        seen += counts[v]
        if 2 * seen >= total:
            return float(v)
    return 0.0


@lean_kernel
def level_at(levels, i, j):
    """Return the level of a tile, of one row or column beyond the image by linear continuation; -1 where unknown."""
    if i < 0 or i >= col.GRID:
        edge = 0 if i < 0 else col.GRID - 1
        a = level_at_column(levels, edge, j)
        b = level_at_column(levels, 1 if i < 0 else col.GRID - 2, j)
        return 2.0 * a - b if a >= 0.0 and b >= 0.0 else -1.0
    return level_at_column(levels, i, j)


@lean_kernel
def level_at_column(levels, i, j):
    """As level_at, for a row within the image."""
    if j < 0 or j >= col.GRID:
        a = levels[i, 0 if j < 0 else col.GRID - 1]
        b = levels[i, 1 if j < 0 else col.GRID - 2]
        return 2.0 * a - b if a >= 0.0 and b >= 0.0 else -1.0
    return levels[i, j]


@inner_kernel
def threshold_map(levels, margin, thresholds):
    """Fill thresholds (GRID, GRID): the upper third of the 3 x 3 tiles around, plus margin; return lowest, highest.

    The upper third lies above the level of a linear gradient in all of the tile where the gradient runs along an axis
    or a diagonal, in most of it else, and ignores up to a third of tiles that a large light has lifted.
    """
    lowest = 1e9
    highest = -1e9
    for i in range(col.GRID):
        for j in range(col.GRID):
            lowest = min(lowest, levels[i, j])
            highest = max(highest, levels[i, j])
    # level all over: one threshold, and with it the faster scan
    if lowest >= 0.0 and highest - lowest < LEVEL_RANGE:
        for i in range(col.GRID):
            for j in range(col.GRID):
                thresholds[i, j] = highest + margin
        return highest + margin, highest + margin
    around = np.empty(9)
    lowest = 1e9
    highest = -1e9
    for i in range(col.GRID):
        for j in range(col.GRID):
            n = np.int64(0)
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    level = level_at(levels, a, b)
                    if level >= 0.0:
                        around[n] = level
                        n += 1
            value = -1.0
            if n > 0:
                insertion_sort(around, n)
                value = around[2 * n // 3] + margin
                lowest = min(lowest, value)
                highest = max(highest, value)
            thresholds[i, j] = value
    for i in range(col.GRID):
        for j in range(col.GRID):
            # masked all around, nothing known: the highest, which lets nothing false through
            if thresholds[i, j] < 0.0:
                thresholds[i, j] = highest
    return lowest, highest


@lean_kernel
def brightest(flat, flip, start, n):
    """Return the highest grey of n pixels from start (unsigned: the test for negative indices forbids vector code)."""
    at = np.uint64(start)
    top = np.uint8(0)
    for i in range(n):
        v = np.uint8(flat[at + np.uint64(i)] ^ flip)
        top = max(top, v)
    return top


@lean_kernel
def bright_blocks(flat, flip, threshold, hits):
    """Fill hits with the numbers of the 64-pixel blocks of flat that hold a pixel above threshold; return how many."""
    t = np.uint8(threshold)
    n = 0
    per = SUPER // BLOCK
    whole = flat.size // SUPER
    for s in range(whole):
        if brightest(flat, flip, s * SUPER, SUPER) > t:
            for b in range(s * per, s * per + per):
                if brightest(flat, flip, b * BLOCK, BLOCK) > t:
                    hits[n] = b
                    n += 1
    # what is left behind the last whole stretch is looked at without a test
    for b in range(whole * per, (flat.size + BLOCK - 1) // BLOCK):
        hits[n] = b
        n += 1
    return n


@lean_kernel
def block_threshold(thresholds, i, h, w):
    """Return the higher one of the thresholds at the first and the last pixel of the block from flat index i."""
    j = min(i + BLOCK - 1, h * w - 1)
    # a block may go over the edge of a tile, or of a row: what exceeds the higher threshold exceeds both
    a = thresholds[(i // w) * col.GRID // h, (i % w) * col.GRID // w]
    return max(a, thresholds[(j // w) * col.GRID // h, (j % w) * col.GRID // w])


@lean_kernel
def lowest_threshold(thresholds, i, j):
    """Return the lowest threshold of the rows of tiles i to j."""
    least = 255.0
    for a in range(i, j + 1):
        for b in range(col.GRID):
            least = min(least, thresholds[a, b])
    return np.uint8(least)


@lean_kernel
def bright_blocks_mapped(flat, flip, h, w, thresholds, hits):
    """As bright_blocks, the threshold being block_threshold's.

    What lies below the lowest threshold of its rows of tiles is skipped together.
    """
    n = 0
    per = SUPER // BLOCK
    whole = flat.size // SUPER
    least = np.uint8(0)
    until = 0
    for s in range(whole):
        if s * SUPER + SUPER > until:  # the stretch reaches a new row of tiles
            i = (s * SUPER // w) * col.GRID // h
            j = ((s * SUPER + SUPER - 1) // w) * col.GRID // h
            least = lowest_threshold(thresholds, i, j)
            until = ((i + 1) * h + col.GRID - 1) // col.GRID * w
        if brightest(flat, flip, s * SUPER, SUPER) > least:
            for b in range(s * per, s * per + per):
                top = brightest(flat, flip, b * BLOCK, BLOCK)
                if top > least and top > np.uint8(block_threshold(thresholds, b * BLOCK, h, w)):
                    hits[n] = b
                    n += 1
    for b in range(whole * per, (flat.size + BLOCK - 1) // BLOCK):
        hits[n] = b
        n += 1
    return n


@lean_kernel
def find_root(parent, i):
    """Return the root of run i, shortening the path."""
    while parent[i] != i:
        # path halving (Tarjan and van Leeuwen 1984)
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@lean_kernel
def add_run(picture, y, start, stop, level, k, table):
    """Write the sums of the run of row y, columns start..stop-1, into row k of table; weights are above level."""
    image, flip, saturation, _ = picture
    # whole numbers, whose sums are exact in any order, and unsigned places: vector code
    weight = sum_x = peak = clipped = np.int64(0)
    row = np.uint64(y)
    for x in range(start, stop):
        grey = np.int64(np.uint8(image[row, np.uint64(x)] ^ flip))
        weight += grey - level
        sum_x += (grey - level) * x
        peak = max(peak, grey)
        clipped += grey >= saturation
    table[k, col.AREA] = stop - start
    table[k, col.WEIGHT] = weight
    table[k, col.SUM_X] = sum_x
    table[k, col.SUM_Y] = weight * y
    table[k, col.PEAK] = peak
    table[k, col.CLIPPED] = clipped
    table[k, col.X_MIN] = start
    table[k, col.X_MAX] = stop - 1
    table[k, col.Y_MIN] = y
    table[k, col.Y_MAX] = y
    table[k, col.LEVEL] = level
    table[k, col.BACKGROUND] = 0.0
    table[k, col.SLOPE] = -1.0


@lean_kernel
def join_touching_runs(runs, parent, first, last, k):
    """Join run k with the runs first..last-1 of the row above that touch it (diagonals count)."""
    q = first
    # what ends before this run touches no later one of its row either: first moves on with it
    while q < last and runs[q, 2] < runs[k, 1] - 1:
        q += 1
    first = q
    while q < last and runs[q, 1] <= runs[k, 2] + 1:
        a = find_root(parent, q)
        b = find_root(parent, k)
        if a < b:
            parent[b] = a
        elif b < a:
            parent[a] = b
        q += 1
    return first


@lean_kernel
def merge_runs(parent, n, table):
    """Add the runs' sums into their roots and move the roots to the front of table; return how many components."""
    count = 0
    for i in range(n):
        r = find_root(parent, i)
        if r != i:
            for c in range(col.AREA, col.PEAK):
                table[r, c] += table[i, c]
            table[r, col.CLIPPED] += table[i, col.CLIPPED]
            table[r, col.PEAK] = max(table[r, col.PEAK], table[i, col.PEAK])
            table[r, col.X_MIN] = min(table[r, col.X_MIN], table[i, col.X_MIN])
            table[r, col.X_MAX] = max(table[r, col.X_MAX], table[i, col.X_MAX])
            table[r, col.Y_MIN] = min(table[r, col.Y_MIN], table[i, col.Y_MIN])
            table[r, col.Y_MAX] = max(table[r, col.Y_MAX], table[i, col.Y_MAX])
    for i in range(n):
        # roots are the lowest numbers of their areas: moving them to the front overwrites nothing that is needed
        if parent[i] == i:
            for c in range(col.COLUMNS):
                table[count, c] = table[i, c]
            count += 1
    return count


@lean_kernel
def connected_components(picture, thresholds, mapped, blocks, n_blocks, runs, parent, table):
    """Fill table (.., COLUMNS) with the connected bright areas of the given blocks; -1 where the runs do not fit.

    thresholds (GRID, GRID): each block's own where mapped, else the first one's. runs (.., 3), parent (..): room to
    work in. A run starts in one of the blocks and may end beyond it.
    """
    image, flip, _, mask = picture
    h, w = image.shape
    flat = image.reshape(-1)
    level = np.uint8(thresholds[0, 0])
    n = np.int64(0)
    first = np.int64(0)
    last = np.int64(0)
    current = np.int64(0)
    row = -2
    end = 0
    done = 0
    for k in range(n_blocks):
        i = max(blocks[k] * BLOCK, done)
        stop = min(blocks[k] * BLOCK + BLOCK, flat.size)
        if mapped and i < stop:
            level = np.uint8(block_threshold(thresholds, blocks[k] * BLOCK, h, w))
        while i < stop:
            if i + SKIP <= stop and brightest(flat, flip, i, SKIP) <= level:
                i += SKIP
                continue
            if np.uint8(flat[i] ^ flip) <= level or (mask.size > 0 and mask[i // w, i % w] == 0):
                i += 1
                continue
            if i >= end:
                y = i // w
                first, last = (current, n) if y == row + 1 else (n, n)
                current = n
                row = y
                end = (y + 1) * w
            base = end - w
            start = i
            while i < end and np.uint8(flat[i] ^ flip) > level and (mask.size == 0 or mask[row, i - base] != 0):
                i += 1
            if n >= parent.size:
                return -1
            runs[n, 0] = row
            runs[n, 1] = start - base
            runs[n, 2] = i - base - 1
            parent[n] = n
            add_run(picture, row, start - base, i - base, level, n, table)
            first = join_touching_runs(runs, parent, first, last, n)
            n += 1
        done = max(done, i)
    return merge_runs(parent, n, table)


@lean_kernel
def mark_bright(picture, level, y, first, marks):
    """Fill marks (n,) with 1 where a pixel of row y, from column first on, is above level and not masked out, else 0.

    Returns how many are. Vector code, as the loop over marks that tells where a run ends is not.
    """
    image, flip, _, mask = picture
    row, at = np.uint64(y), np.uint64(first)
    count = np.int64(0)
    for i in range(marks.shape[0]):
        marks[i] = np.uint8(image[row, at + np.uint64(i)] ^ flip) > level
    if mask.size > 0:
        for i in range(marks.shape[0]):
            marks[i] &= mask[row, at + np.uint64(i)] != 0
    for i in range(marks.shape[0]):
        count += marks[i]
    return count


@lean_kernel
def connected_components_in_window(picture, level, box, give_up, runs, parent, table, marks):
    """As components, within the window box (x0, x1, y0, y1; ends excluded) of an image.

    -1 where the runs do not fit, and with give_up where one goes from edge to edge: then it is no light's window.
    marks: room for a row of the window.
    """
    n = np.int64(0)
    first = np.int64(0)
    last = np.int64(0)
    current = np.int64(0)
    wide = box[1] - box[0]
    marks = marks[:wide]
    for y in range(box[2], box[3]):
        first, last = current, n
        current = n
        bright = mark_bright(picture, level, y, box[0], marks)
        if give_up and bright == wide:
            return -1
        i = 0
        while bright > 0:
            while marks[i] == 0:
                i += 1
            start = i
            while i < wide and marks[i] != 0:
                i += 1
            bright -= i - start
            if n >= parent.size:
                return -1
            runs[n, 0] = y
            runs[n, 1] = box[0] + start
            runs[n, 2] = box[0] + i - 1
            parent[n] = n
            add_run(picture, y, box[0] + start, box[0] + i, level, n, table)
            first = join_touching_runs(runs, parent, first, last, n)
            n += 1
    return merge_runs(parent, n, table)
