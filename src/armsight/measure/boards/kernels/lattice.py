"""Compiled growth of a lattice over points, the best-fitting one next."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel

STEPS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
FURTHEST = 128
"""Steps from the seed: no board has so many."""
CROSSED = 0.35
"""Sine of the angle between a lattice's steps."""


@inner_kernel
def _push(heap, key, n, item):
    """Put an item into a heap of n by key (m,), the smallest first; of equal keys the earlier item."""
    child = n
    while child > 0:
        parent = (child - 1) // 2
        other = heap[parent]
        if key[other] < key[item] or (key[other] == key[item] and other < item):
            break
        heap[child] = other
        child = parent
    heap[child] = item


@inner_kernel
def _pop(heap, key, n):
    """Take the item of the smallest key from a heap of n."""
    best, item = heap[0], heap[n - 1]
    parent = 0
    while 2 * parent + 1 < n - 1:
        child = 2 * parent + 1
        if child + 1 < n - 1:
            a, b = heap[child], heap[child + 1]
            if key[b] < key[a] or (key[b] == key[a] and b < a):
                child += 1
        other = heap[child]
        if key[item] < key[other] or (key[item] == key[other] and item < other):
            break
        heap[parent] = other
        parent = child
    heap[parent] = item
    return best


@kernel
def chain(uv, width_px, columns, rows):
    """Return the first point of each cell (rows, columns) and the next one after each point (n,); -1 for none.

    uv (n, 2) px, within the cells.
    """
    first, after = np.full((rows, columns), -1), np.full(len(uv), -1)
    for i in range(len(uv)):
        row, column = int(uv[i, 1] / width_px), int(uv[i, 0] / width_px)
        after[i] = first[row, column]
        first[row, column] = i
    return first, after


@inner_kernel
def _nearest(uv, first, after, width_px, u, v, reach_px):
    """Return the point nearest to a place and its distance; -1 where none is within reach."""
    rows, columns = first.shape
    best, least = -1, reach_px
    for row in range(max(0, int((v - reach_px) / width_px)), min(rows, int((v + reach_px) / width_px) + 1)):
        for column in range(max(0, int((u - reach_px) / width_px)), min(columns, int((u + reach_px) / width_px) + 1)):
            k = first[row, column]
            while k >= 0:
                away = sqrt((uv[k, 0] - u) ** 2 + (uv[k, 1] - v) ** 2)
                if away < least or (away == least and k < best):
                    best, least = k, away
                k = after[k]
    return best, least


@kernel
def seed_steps(step, error, pairs, order):
    """Return how irregular each point's neighbours are (n,), infinite for no seed, and the steps to them (n, 2, 2).

    step (n, k, 2): to the neighbours. pairs (p, 2): of two of them; error (n, p): how far a pair's middle is from the
    point between them, infinite where they are not opposite; order (n, p): the pairs of each by length. The shortest
    pair counts and the next that runs otherwise.
    """
    n = len(error)
    irregular, steps = np.full(n, np.inf), np.zeros((n, 2, 2))
    for i in range(n):
        first = -1
        for j in order[i]:
            if error[i, j] == np.inf:
                continue
            x, y = step[i, pairs[j, 0]]
            if first < 0:
                first = j
                steps[i, 0, 0], steps[i, 1, 0] = x, y
                continue
            u, v = steps[i, 0, 0], steps[i, 1, 0]
            if abs(u * y - v * x) > CROSSED * sqrt((u * u + v * v) * (x * x + y * y)):
                steps[i, 0, 1], steps[i, 1, 1] = x, y
                irregular[i] = error[i, first] + error[i, j]
                break
    return irregular, steps


@kernel
def grow_lattice(uv, area, first, after, width_px, seed, steps, near, alike):
    """Return the points (m,) and their places (m, 2) in the lattice grown from a seed, which comes first at (0, 0).

    uv (n, 2) px, area (n,) px^2; first, after, width_px: as chained. steps (2, 2): columns are the ways to the seed's
    neighbours. A point joins within the share near of a step of where it is expected, and where it is like its
    neighbour, by the factor alike in area. Those that fit worse come last, and lead nothing astray.
    """
    n = len(uv)
    most = 4 * n + 1  # each point offers four
    heap, key = np.empty(most, np.int64), np.zeros(most)
    dot, node, way = np.empty(most, np.int64), np.zeros((most, 2), np.int64), np.empty((most, 2, 2))
    members, taken = np.empty(n, np.int64), np.zeros(n, np.bool_)
    filled = np.zeros((2 * FURTHEST + 1, 2 * FURTHEST + 1), np.bool_)
    nodes = np.empty((n, 2), np.int64)
    dot[0], way[0], heap[0] = seed, steps, 0
    made, waiting, m = 1, 1, 0
    while waiting > 0:
        item = _pop(heap, key, waiting)
        waiting -= 1
        i, at = dot[item], node[item]
        # a better-fitting point or way was there first
        if taken[i] or max(abs(at[0]), abs(at[1])) > FURTHEST or filled[at[0] + FURTHEST, at[1] + FURTHEST]:
            continue
        taken[i] = filled[at[0] + FURTHEST, at[1] + FURTHEST] = True
        members[m], nodes[m, 0], nodes[m, 1] = i, at[0], at[1]
        m += 1
        for side in range(4):
            axis, sense = side // 2, 1.0 - 2.0 * (side % 2)
            du, dv = sense * way[item, 0, axis], sense * way[item, 1, axis]
            reach = near * sqrt(du * du + dv * dv)
            k, away = _nearest(uv, first, after, width_px, uv[i, 0] + du, uv[i, 1] + dv, reach)
            if k < 0 or not 1.0 / alike < area[k] / area[i] < alike:
                continue
            dot[made], key[made] = k, near * away / reach
            node[made, 0], node[made, 1] = at[0] + STEPS[side, 0], at[1] + STEPS[side, 1]
            way[made] = way[item]
            way[made, 0, axis], way[made, 1, axis] = sense * (uv[k, 0] - uv[i, 0]), sense * (uv[k, 1] - uv[i, 1])
            _push(heap, key, waiting, made)
            waiting += 1
            made += 1
    return members[:m], nodes[:m]


@kernel
def fullest(table, nodes, least):
    """Return how many of places (n, 2) hold a number that is not negative in a table (r, c) where the most do, and from
    which corners (m, 2) on they do; 0 where they are fewer than least.
    """
    rows, columns = table.shape[0] - nodes[:, 0].max(), table.shape[1] - nodes[:, 1].max()
    corners, n = np.empty((rows * columns, 2), np.int64), 0
    most = int(np.ceil(least))
    for row in range(rows):
        for column in range(columns):
            empty = 0
            for k in range(len(nodes)):
                empty += table[row + nodes[k, 0], column + nodes[k, 1]] < 0
                if len(nodes) - empty < most:
                    break
            held = len(nodes) - empty
            if held < most:
                continue
            if held > most:  # what was found before is less
                most, n = held, 0
            corners[n, 0], corners[n, 1] = row, column
            n += 1
    return most if n > 0 else 0, corners[:n]
