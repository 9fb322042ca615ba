"""Compiled parts of the rooms: rays cast onto textured rectangles, and the light that falls on them.

A scene is one tuple of arrays, made by rooms.scene.Scene:
geometry (n, 12): corner at texture (0, 0), unit axes x (right) and y (down), z = x cross y, away from who sees it.
size (n, 2) m. texture (n,) number. density (n, 2): texels of the finest level per m. look (n, 4): glow, gloss,
exponent of the gloss, 1 for cut-outs. place (n, 3): first entry, columns and rows of its part of light (k, 3) float32,
which falls on it. texels (m, 4) uint8: square roots of blue, green, red; coverage. levels (textures, LEVELS, 3): first
texel, columns and rows of each level, no rows where there is none. lamps (l, 6): place, and blue, green, red intensity,
for highlights.
"""

from __future__ import annotations

import numpy as np

from armsight._numba import inline_kernel, inner_kernel, kernel
from armsight.geometry.kernels import cross, dot

LEVELS = 10
"""Most levels of a texture, each half as fine as the one before."""

TILE = 16
"""Pixels on a side of the squares for which the rectangles in question are sorted out together."""

SQUARE = (np.arange(256) / 255.0).astype(np.float32) ** 2
"""Reflectance of a stored byte: its square, so that dark tones have fine steps."""
SQUARE.setflags(write=False)

MOSTLY = 128
"""Coverage from which a cut-out stops a ray."""


@inline_kernel
def _covers(texture, density, texels, levels, k, a, b):
    """Tell whether a cut-out covers its own point (a, b) m."""
    first, columns, rows = levels[texture[k], 0, 0], levels[texture[k], 0, 1], levels[texture[k], 0, 2]
    i, j = int(a * density[k, 0]) % columns, int(b * density[k, 1]) % rows
    return texels[first + j * columns + i, 3] >= MOSTLY


@inline_kernel
def _nearest(
    geometry,
    size,
    texture,
    density,
    look,
    texels,
    levels,
    candidates,
    depths,
    count,
    pace,
    ox,
    oy,
    oz,
    dx,
    dy,
    dz,
    both,
):
    """Return which rectangle the ray meets first (-1: none), how far along, and where on it; both: from either side.

    depths: no less deep is the candidate of the same place, and none behind it; the ray goes `pace` deep in its unit.
    """
    best, along, at_a, at_b = -1, 1e30, 0.0, 0.0
    for c in range(count):
        if along * pace < depths[c]:
            break
        k = candidates[c]
        towards = dx * geometry[k, 9] + dy * geometry[k, 10] + dz * geometry[k, 11]
        if towards <= 1e-9 and not (both and towards < -1e-9):
            continue
        px, py, pz = geometry[k, 0] - ox, geometry[k, 1] - oy, geometry[k, 2] - oz
        t = (px * geometry[k, 9] + py * geometry[k, 10] + pz * geometry[k, 11]) / towards
        if t <= 1e-4 or t >= along:
            continue
        hx, hy, hz = t * dx - px, t * dy - py, t * dz - pz
        a = hx * geometry[k, 3] + hy * geometry[k, 4] + hz * geometry[k, 5]
        if a < 0.0 or a >= size[k, 0]:
            continue
        b = hx * geometry[k, 6] + hy * geometry[k, 7] + hz * geometry[k, 8]
        if b < 0.0 or b >= size[k, 1]:
            continue
        if look[k, 3] > 0.0 and not _covers(texture, density, texels, levels, k, a, b):
            continue
        best, along, at_a, at_b = k, t, a, b
    return best, along, at_a, at_b


@inline_kernel
def _reflectance(texture, density, texels, levels, k, a, b, footprint_m, out):
    """Fill out (3,) with the texture of rectangle k at (a, b) m, of the level that a footprint asks for."""
    number, level = texture[k], 0
    wide = footprint_m * min(density[k, 0], density[k, 1])
    while wide > 1.5 and level + 1 < LEVELS and levels[number, level + 1, 2] > 0:
        wide *= 0.5
        level += 1
    first, columns, rows = levels[number, level, 0], levels[number, level, 1], levels[number, level, 2]
    s = a * density[k, 0] * columns / levels[number, 0, 1] - 0.5
    t = b * density[k, 1] * rows / levels[number, 0, 2] - 0.5
    s -= np.floor(s / columns) * columns
    t -= np.floor(t / rows) * rows
    i0, j0 = min(int(s), columns - 1), min(int(t), rows - 1)
    fs, ft = np.float32(s - i0), np.float32(t - j0)
    one = np.float32(1.0)
    i1, j1 = i0 + 1 if i0 + 1 < columns else 0, j0 + 1 if j0 + 1 < rows else 0
    p00, p01 = first + j0 * columns + i0, first + j0 * columns + i1
    p10, p11 = first + j1 * columns + i0, first + j1 * columns + i1
    for c in range(3):
        upper = (one - fs) * SQUARE[texels[p00, c]] + fs * SQUARE[texels[p01, c]]
        lower = (one - fs) * SQUARE[texels[p10, c]] + fs * SQUARE[texels[p11, c]]
        out[c] = (one - ft) * upper + ft * lower


@inline_kernel
def _fallen(size, place, light, k, a, b, out):
    """Fill out (3,) with the light that falls on rectangle k at (a, b) m."""
    first, columns, rows = place[k, 0], place[k, 1], place[k, 2]
    s = min(max(a / size[k, 0] * columns - 0.5, 0.0), columns - 1.0)
    t = min(max(b / size[k, 1] * rows - 0.5, 0.0), rows - 1.0)
    i, j = int(s), int(t)
    fs, ft = np.float32(s - i), np.float32(t - j)
    one = np.float32(1.0)
    i1, j1 = min(i + 1, columns - 1), min(j + 1, rows - 1)
    for c in range(3):
        upper = (one - fs) * light[first + j * columns + i, c] + fs * light[first + j * columns + i1, c]
        lower = (one - fs) * light[first + j1 * columns + i, c] + fs * light[first + j1 * columns + i1, c]
        out[c] = (one - ft) * upper + ft * lower


@inner_kernel
def _add_gloss(geometry, look, lamps, k, a, b, dx, dy, dz, out):
    """Add the lamps' highlights on rectangle k to out (3,): Phong's lobe about the ray that leaves a mirror."""
    g = geometry[k]
    x, y, z = g[0] + a * g[3] + b * g[6], g[1] + a * g[4] + b * g[7], g[2] + a * g[5] + b * g[8]
    towards = 2.0 * (dx * g[9] + dy * g[10] + dz * g[11])
    rx, ry, rz = dx - towards * g[9], dy - towards * g[10], dz - towards * g[11]
    length = np.sqrt(rx * rx + ry * ry + rz * rz)
    for lamp in range(lamps.shape[0]):
        lx, ly, lz = lamps[lamp, 0] - x, lamps[lamp, 1] - y, lamps[lamp, 2] - z
        rr = lx * lx + ly * ly + lz * lz
        cosine = (rx * lx + ry * ly + rz * lz) / (length * np.sqrt(rr))
        if cosine > 0.0:
            lobe = look[k, 1] * cosine ** look[k, 2] / max(rr, 0.04)
            for c in range(3):
                out[c] += np.float32(lobe * lamps[lamp, 3 + c])


@inline_kernel
def _radiance(
    geometry,
    size,
    texture,
    density,
    look,
    place,
    texels,
    levels,
    light,
    lamps,
    k,
    along,
    a,
    b,
    dx,
    dy,
    dz,
    spread,
    colour,
    fallen,
):
    """Fill colour (3,) with the light that leaves rectangle k at (a, b) m against a ray of the given direction."""
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    slant = max((dx * geometry[k, 9] + dy * geometry[k, 10] + dz * geometry[k, 11]) / length, 0.15)
    _reflectance(texture, density, texels, levels, k, a, b, along * length * spread / slant, colour)
    if look[k, 0] > 0.0:
        for c in range(3):
            colour[c] *= np.float32(look[k, 0])
        return
    _fallen(size, place, light, k, a, b, fallen)
    for c in range(3):
        colour[c] *= fallen[c]
    if look[k, 1] > 0.0:
        _add_gloss(geometry, look, lamps, k, a, b, dx, dy, dz, colour)


@inner_kernel
def _sort_out(geometry, size, R, t, rays, origins, j0, j1, i0, i1, candidates, depths, forward):
    """Fill candidates with the rectangles that a tile's rays may meet, nearest first; return how many there are.

    depths: the least depth of each along forward (3,), which is filled with the middle of the tile's rays.
    """
    corner = np.empty((4, 3))
    jj, ii = (j0, j0, j1, j1), (i0, i1, i1, i0)
    several = origins.shape[0] > 1
    o = np.zeros(3)
    for q in range(4):
        for r in range(3):
            corner[q, r] = 0.0
            for c in range(3):
                corner[q, r] += R[r, c] * rays[jj[q], ii[q], c]
                o[r] += 0.25 * R[r, c] * (origins[jj[q], ii[q], c] if several else origins[0, 0, c])
    middle = np.empty(3)
    for r in range(3):
        middle[r] = corner[0, r] + corner[1, r] + corner[2, r] + corner[3, r]
        o[r] += t[r]
    planes = np.empty((5, 3))
    for q in range(4):
        cross(corner[q], corner[(q + 1) % 4], planes[q])
        length = np.sqrt(dot(planes[q], planes[q]))
        sign = -1.0 if dot(planes[q], middle) < 0.0 else 1.0
        for r in range(3):
            planes[q, r] = sign * (planes[q, r] / length)
    length = np.sqrt(dot(middle, middle))
    for r in range(3):
        planes[4, r] = middle[r] / length
        forward[r] = planes[4, r]
    count = 0
    for k in range(geometry.shape[0]):
        g = geometry[k]
        if (g[0] - o[0]) * g[9] + (g[1] - o[1]) * g[10] + (g[2] - o[2]) * g[11] < -0.01:  # seen from behind
            continue
        outside, depth = False, 1e30
        for q in range(5):
            all_out = True
            for v in range(4):
                sa, sb = size[k, 0] * (v & 1), size[k, 1] * (v >> 1)
                off = 0.0
                for r in range(3):
                    off += planes[q, r] * (g[r] + sa * g[3 + r] + sb * g[6 + r] - o[r])
                if off > -0.01:  # the origins behind glass differ by less than this
                    all_out = False
                    if q < 4:
                        break
                depth = min(depth, off) if q == 4 else depth
            if all_out:
                outside = True
                break
        if not outside:
            at = count
            while at > 0 and depths[at - 1] > depth:
                depths[at], candidates[at] = depths[at - 1], candidates[at - 1]
                at -= 1
            depths[at], candidates[at] = depth - 0.02, k
            count += 1
    return count


@kernel
def cast_scene(scene, R, t, rays, origins, lattice, spread, out):
    """Fill out (h, w, 4) float32 with blue, green, red and the share covered, as a camera sees a scene.

    R (3, 3), t (3,): pose of the camera in the scene. rays (h + 1, w + 1, 3), origins of the same shape or (1, 1, 3):
    in camera axes, through the corners of the pixels. lattice (n, 2): samples in the unit square. spread: angle of a
    pixel in rad.
    """
    geometry, size, texture, density, look, place, texels, levels, light, lamps = scene
    height, width = out.shape[0], out.shape[1]
    candidates, depths = np.empty(geometry.shape[0], np.int64), np.empty(geometry.shape[0])
    colour, fallen, forward = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(3)
    last, samples = (1 if origins.shape[0] > 1 else 0), lattice.shape[0]
    for tile in range(-(-height // TILE) * -(-width // TILE)):
        j0, i0 = tile // -(-width // TILE) * TILE, tile % -(-width // TILE) * TILE
        j1, i1 = min(j0 + TILE, height), min(i0 + TILE, width)
        count = _sort_out(geometry, size, R, t, rays, origins, j0, j1, i0, i1, candidates, depths, forward)
        for j in range(j0, j1):
            for i in range(i0, i1):
                e0, e1, e2 = (
                    origins[j * last, i * last, 0],
                    origins[j * last, i * last, 1],
                    origins[j * last, i * last, 2],
                )
                ox = R[0, 0] * e0 + R[0, 1] * e1 + R[0, 2] * e2 + t[0]
                oy = R[1, 0] * e0 + R[1, 1] * e1 + R[1, 2] * e2 + t[1]
                oz = R[2, 0] * e0 + R[2, 1] * e1 + R[2, 2] * e2 + t[2]
                blue, green, red, covered = 0.0, 0.0, 0.0, 0.0
                for n in range(samples):
                    fx, fy = lattice[n, 0], lattice[n, 1]
                    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
                    x = (
                        w00 * rays[j, i, 0]
                        + w01 * rays[j, i + 1, 0]
                        + w10 * rays[j + 1, i, 0]
                        + w11 * rays[j + 1, i + 1, 0]
                    )
                    y = (
                        w00 * rays[j, i, 1]
                        + w01 * rays[j, i + 1, 1]
                        + w10 * rays[j + 1, i, 1]
                        + w11 * rays[j + 1, i + 1, 1]
                    )
                    z = (
                        w00 * rays[j, i, 2]
                        + w01 * rays[j, i + 1, 2]
                        + w10 * rays[j + 1, i, 2]
                        + w11 * rays[j + 1, i + 1, 2]
                    )
                    dx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
                    dy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
                    dz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
                    pace = dx * forward[0] + dy * forward[1] + dz * forward[2]
                    k, along, a, b = _nearest(
                        geometry,
                        size,
                        texture,
                        density,
                        look,
                        texels,
                        levels,
                        candidates,
                        depths,
                        count,
                        pace,
                        ox,
                        oy,
                        oz,
                        dx,
                        dy,
                        dz,
                        False,
                    )
                    if k >= 0:
                        _radiance(
                            geometry,
                            size,
                            texture,
                            density,
                            look,
                            place,
                            texels,
                            levels,
                            light,
                            lamps,
                            k,
                            along,
                            a,
                            b,
                            dx,
                            dy,
                            dz,
                            spread,
                            colour,
                            fallen,
                        )
                        blue, green, red, covered = blue + colour[0], green + colour[1], red + colour[2], covered + 1.0
                out[j, i, 0], out[j, i, 1] = np.float32(blue / samples), np.float32(green / samples)
                out[j, i, 2], out[j, i, 3] = np.float32(red / samples), np.float32(covered / samples)


@kernel
def meet_scene(scene, origin, ends, out):
    """Fill out (n,) with the number of the rectangle that stands between origin (3,) and each of ends (n, 3), or -1."""
    geometry, size, texture, density, look, _, texels, levels, _, _ = scene
    everything, nothing = np.arange(geometry.shape[0]), np.zeros(geometry.shape[0])
    for i in range(ends.shape[0]):
        dx, dy, dz = ends[i, 0] - origin[0], ends[i, 1] - origin[1], ends[i, 2] - origin[2]
        k, along, _, _ = _nearest(
            geometry,
            size,
            texture,
            density,
            look,
            texels,
            levels,
            everything,
            nothing,
            everything.size,
            0.0,
            origin[0],
            origin[1],
            origin[2],
            dx,
            dy,
            dz,
            True,
        )
        out[i] = k if along < 1.0 - 1e-6 else -1


@inner_kernel
def _indirect(
    geometry,
    size,
    texture,
    density,
    look,
    texels,
    levels,
    mean,
    everything,
    nothing,
    x,
    y,
    z,
    normal,
    helper,
    directions,
    ambient,
    total,
):
    """Add what comes from all sides to a point: the colour of what is there, less from what is near."""
    for q in range(directions.shape[0]):
        p, r, s = directions[q, 0], directions[q, 1], directions[q, 2]
        dx = p * helper[0, 0] + r * helper[1, 0] - s * normal[0]
        dy = p * helper[0, 1] + r * helper[1, 1] - s * normal[1]
        dz = p * helper[0, 2] + r * helper[1, 2] - s * normal[2]
        k, along, _, _ = _nearest(
            geometry,
            size,
            texture,
            density,
            look,
            texels,
            levels,
            everything,
            nothing,
            everything.size,
            0.0,
            x,
            y,
            z,
            dx,
            dy,
            dz,
            True,
        )
        near = min(1.0, 0.25 + along / 0.8)
        for c in range(3):
            seen = mean[k, c] if k >= 0 else 0.7
            total[c] += ambient * near * (0.3 + 0.7 * seen) / directions.shape[0]


@inner_kernel
def _direct(
    geometry, size, texture, density, look, texels, levels, everything, nothing, x, y, z, normal, emitters, total
):
    """Add what falls on a point from samples of lamps (m, 10): place, normal, bgr times area over pi, whose."""
    for s in range(emitters.shape[0]):
        dx, dy, dz = emitters[s, 0] - x, emitters[s, 1] - y, emitters[s, 2] - z
        rr = dx * dx + dy * dy + dz * dz
        here = -(dx * normal[0] + dy * normal[1] + dz * normal[2])
        there = dx * emitters[s, 3] + dy * emitters[s, 4] + dz * emitters[s, 5]
        if here <= 0.0 or there <= 0.0 or rr < 1e-6:
            continue
        k, along, _, _ = _nearest(
            geometry,
            size,
            texture,
            density,
            look,
            texels,
            levels,
            everything,
            nothing,
            everything.size,
            0.0,
            x,
            y,
            z,
            dx,
            dy,
            dz,
            True,
        )
        if along < 0.999 and k != int(emitters[s, 9]):
            continue
        for c in range(3):
            total[c] += emitters[s, 6 + c] * here * there / max(rr * rr, 0.01)


@kernel
def light_scene(scene, mean, emitters, directions, ambient, large, out):
    """Fill out (k, 3) float32 with the light on every entry of the maps: from the lamps, and from all around.

    mean (n, 3): mean reflectance of each rectangle. emitters (m, 10): see _direct. directions (turns, q, 3): spread
    about z, weighted by its cosine; entries take one turn after the other. large: numbers of what throws shadows.
    """
    geometry, size, texture, density, look, place, texels, levels, _, _ = scene
    nothing = np.zeros(geometry.shape[0])
    total, turn = np.empty(3), 0
    for k in range(geometry.shape[0]):
        g = geometry[k]
        normal, helper = g[9:12], g[3:9].reshape(2, 3)
        first, columns, rows = place[k, 0], place[k, 1], place[k, 2]
        for j in range(rows):
            for i in range(columns):
                a, b = (i + 0.5) / columns * size[k, 0], (j + 0.5) / rows * size[k, 1]
                x = g[0] + a * g[3] + b * g[6] - 1e-3 * g[9]
                y = g[1] + a * g[4] + b * g[7] - 1e-3 * g[10]
                z = g[2] + a * g[5] + b * g[8] - 1e-3 * g[11]
                total[:] = 0.0
                turn = (turn + 1) % directions.shape[0]
                _indirect(
                    geometry,
                    size,
                    texture,
                    density,
                    look,
                    texels,
                    levels,
                    mean,
                    large,
                    nothing,
                    x,
                    y,
                    z,
                    normal,
                    helper,
                    directions[turn],
                    ambient,
                    total,
                )
                _direct(
                    geometry,
                    size,
                    texture,
                    density,
                    look,
                    texels,
                    levels,
                    large,
                    nothing,
                    x,
                    y,
                    z,
                    normal,
                    emitters,
                    total,
                )
                for c in range(3):
                    out[first + j * columns + i, c] = np.float32(total[c])
