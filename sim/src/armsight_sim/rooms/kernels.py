"""Compiled parts of the rooms: rays cast onto textured rectangles, and the light that falls on them.

A scene comes from Python as a plain tuple of arrays, made by rooms.scene.Scene, in the order of Panels. Rays are
cast as by Appel (1968), some a pixel, and followed no further; the light on the rectangles is worked out once, by Goral
et al. (1984) for what lamps send, and by obscurance (Zhukov et al. 1998) in place of all further reflections.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from armsight._numba import borrowing_kernel, inner_kernel, kernel
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


class Panels(NamedTuple):
    """A scene's rectangles and what is on them; a NamedTuple within compiled code costs nothing.

    geometry (n, 12): corner at texture (0, 0), unit axes x (right) and y (down), z = x cross y, away from who sees it.
    size (n, 2) m. texture (n,) number. density (n, 2): texels of the finest level per m. look (n, 4): glow, gloss,
    exponent of the gloss, 1 for cut-outs. place (n, 3): first entry, columns and rows of its part of light (k, 3)
    float32, which falls on it. texels (m, 4) uint8: square roots of blue, green, red; coverage. levels (textures,
    LEVELS, 3): first texel, columns and rows of each level, no rows where there is none. lamps (l, 6): place, and blue,
    green, red intensity, for highlights.
    """

    geometry: Any
    size: Any
    texture: Any
    density: Any
    look: Any
    pose: Any
    texels: Any
    levels: Any
    light: Any
    lamps: Any


class Ray(NamedTuple):
    """A ray from (ox, oy, oz) along (dx, dy, dz), of any length."""

    ox: float
    oy: float
    oz: float
    dx: float
    dy: float
    dz: float


class Hit(NamedTuple):
    """Which rectangle a ray meets first (-1: none), how far along it, and where on the rectangle, in m."""

    k: int
    along: float
    a: float
    b: float


class Candidates(NamedTuple):
    """Numbers (n,) of the rectangles that a ray may meet, nearest first, and the least depth of each."""

    numbers: Any
    depths: Any


class Shading(NamedTuple):
    """Rectangles `numbers` (n,) in boxes within boxes, from the outermost on, each before those within it.

    boxes (m, 6): least and greatest x, y, z. links (m, 3): first and past the last place in `numbers` of those that are
    in no box within, and the next box that is not within this one.
    """

    boxes: Any
    links: Any
    numbers: Any


class View(NamedTuple):
    """A camera in the scene: its pose R (3, 3), t (3,), and rays and origins as cast_scene takes them."""

    R: Any
    t: Any
    rays: Any
    origins: Any


class Spot(NamedTuple):
    """A place (x, y, z) on a rectangle, and that rectangle's geometry (12,)."""

    x: float
    y: float
    z: float
    g: Any


@borrowing_kernel
def _covers(panels, k, a, b):
    """Tell whether a cut-out covers its own point (a, b) m."""
    number = panels.texture[k]
    first, columns, rows = panels.levels[number, 0, 0], panels.levels[number, 0, 1], panels.levels[number, 0, 2]
    i, j = int(a * panels.density[k, 0]) % columns, int(b * panels.density[k, 1]) % rows
    return panels.texels[first + j * columns + i, 3] >= MOSTLY


@borrowing_kernel
def _meets(panels, k, ray, along, both):
    """Return how far along a ray meets rectangle k, and where (a, b) m, or inf where not up to `along`.

    both: rectangles are met from either side.
    """
    geometry, size = panels.geometry, panels.size
    # p = o + t d lies in the plane where (p - corner) . n = 0: t = (corner - o) . n / (d . n)
    towards = ray.dx * geometry[k, 9] + ray.dy * geometry[k, 10] + ray.dz * geometry[k, 11]
    if towards <= 1e-9 and not (both and towards < -1e-9):
        return np.inf, 0.0, 0.0
    px, py, pz = geometry[k, 0] - ray.ox, geometry[k, 1] - ray.oy, geometry[k, 2] - ray.oz
    t = (px * geometry[k, 9] + py * geometry[k, 10] + pz * geometry[k, 11]) / towards
    if t <= 1e-4 or t > along:
        return np.inf, 0.0, 0.0
    # coordinates on the rectangle: projections onto its axes, for these are at right angles and of unit length
    hx, hy, hz = t * ray.dx - px, t * ray.dy - py, t * ray.dz - pz
    a = hx * geometry[k, 3] + hy * geometry[k, 4] + hz * geometry[k, 5]
    if a < 0.0 or a >= size[k, 0]:
        return np.inf, 0.0, 0.0
    b = hx * geometry[k, 6] + hy * geometry[k, 7] + hz * geometry[k, 8]
    if b < 0.0 or b >= size[k, 1]:
        return np.inf, 0.0, 0.0
    if panels.look[k, 3] > 0.0 and not _covers(panels, k, a, b):
        return np.inf, 0.0, 0.0
    return t, a, b


@borrowing_kernel
def _nearest(panels, candidates, count, pace, ray, both):
    """Return the Hit of a ray among the first `count` candidates; both: rectangles are met from either side.

    depths: no less deep is the candidate of the same place, and none behind it; the ray goes `pace` deep in its unit.
    """
    best, along, at_a, at_b = -1, 1e30, 0.0, 0.0
    for c in range(count):
        # what comes now begins behind what was met: the candidates are in the order of their least depth
        if along * pace < candidates.depths[c]:
            break
        t, a, b = _meets(panels, candidates.numbers[c], ray, along, both)
        if t < along:
            best, along, at_a, at_b = candidates.numbers[c], t, a, b
    return Hit(best, along, at_a, at_b)


@borrowing_kernel
def _slope(d):
    """Return 1 / d, or of a d so small that it moves nothing out of a box (Shading) a large number in its place."""
    return 1.0 / d if abs(d) > 1e-12 else 1e12


@borrowing_kernel
def _enters(box, ray, ix, iy, iz, before):
    """Tell whether a ray of slopes (ix, iy, iz) is in a box (6,) anywhere up to `before`.

    Kay and Kajiya (1986): where it is between both of each of three pairs of planes.
    """
    x0, x1 = (box[0] - ray.ox) * ix, (box[3] - ray.ox) * ix
    y0, y1 = (box[1] - ray.oy) * iy, (box[4] - ray.oy) * iy
    z0, z1 = (box[2] - ray.oz) * iz, (box[5] - ray.oz) * iz
    enter = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
    return enter <= min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), before))


@borrowing_kernel
def _first_of(panels, shading, ray, before, any_will_do):
    """Return the rectangle that a ray meets first before `before`, from either side, and how far along; or -1, before.

    Of two as far it is the first. any_will_do: it need not be the nearest.
    """
    ix, iy, iz = _slope(ray.dx), _slope(ray.dy), _slope(ray.dz)
    best, along, box = -1, before, 0
    while box < shading.boxes.shape[0]:
        if not _enters(shading.boxes[box], ray, ix, iy, iz, along):
            box = shading.links[box, 2]
            continue
        for place in range(shading.links[box, 0], shading.links[box, 1]):
            k = shading.numbers[place]
            t, _, _ = _meets(panels, k, ray, along, True)
            if t < along or (t == along and k < best):
                best, along = k, t
                if any_will_do:
                    return best, along
        box += 1
    return best, along


@borrowing_kernel
def _reflectance(panels, hit, footprint_m, out):
    """Fill out (3,) with the texture at a hit, of the level that a footprint asks for."""
    density, levels, texels = panels.density, panels.levels, panels.texels
    number, level = panels.texture[hit.k], 0
    # Williams (1983): a pixel that covers several texels takes the level whose texels are about as wide as itself
    wide = footprint_m * min(density[hit.k, 0], density[hit.k, 1])
    while wide > 1.5 and level + 1 < LEVELS and levels[number, level + 1, 2] > 0:
        wide *= 0.5
        level += 1
    first, columns, rows = levels[number, level, 0], levels[number, level, 1], levels[number, level, 2]
    # half a texel: their values belong to their middles, and the texture repeats beyond its edges
    s = hit.a * density[hit.k, 0] * columns / levels[number, 0, 1] - 0.5
    t = hit.b * density[hit.k, 1] * rows / levels[number, 0, 2] - 0.5
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


@borrowing_kernel
def _fallen(panels, hit, out):
    """Fill out (3,) with the light that falls on a rectangle at a hit."""
    size, light = panels.size, panels.light
    first, columns, rows = panels.pose[hit.k, 0], panels.pose[hit.k, 1], panels.pose[hit.k, 2]
    # unlike a texture, the light does not repeat: beyond the outermost entries' middles it stays as it is there
    s = min(max(hit.a / size[hit.k, 0] * columns - 0.5, 0.0), columns - 1.0)
    t = min(max(hit.b / size[hit.k, 1] * rows - 0.5, 0.0), rows - 1.0)
    i, j = int(s), int(t)
    fs, ft = np.float32(s - i), np.float32(t - j)
    one = np.float32(1.0)
    i1, j1 = min(i + 1, columns - 1), min(j + 1, rows - 1)
    for c in range(3):
        upper = (one - fs) * light[first + j * columns + i, c] + fs * light[first + j * columns + i1, c]
        lower = (one - fs) * light[first + j1 * columns + i, c] + fs * light[first + j1 * columns + i1, c]
        out[c] = (one - ft) * upper + ft * lower


@inner_kernel
def _add_gloss(panels, hit, ray, out):
    """Add the lamps' highlights at a hit to out (3,): Phong's lobe about the ray that leaves a mirror."""
    g, look, lamps = panels.geometry[hit.k], panels.look, panels.lamps
    a, b = hit.a, hit.b
    x, y, z = g[0] + a * g[3] + b * g[6], g[1] + a * g[4] + b * g[7], g[2] + a * g[5] + b * g[8]
    # the mirrored direction: r = d - 2 (d . n) n
    towards = 2.0 * (ray.dx * g[9] + ray.dy * g[10] + ray.dz * g[11])
    rx, ry, rz = ray.dx - towards * g[9], ray.dy - towards * g[10], ray.dz - towards * g[11]
    length = np.sqrt(rx * rx + ry * ry + rz * rz)
    for lamp in range(lamps.shape[0]):
        lx, ly, lz = lamps[lamp, 0] - x, lamps[lamp, 1] - y, lamps[lamp, 2] - z
        rr = lx * lx + ly * ly + lz * lz
        cosine = (rx * lx + ry * ly + rz * lz) / (length * np.sqrt(rr))
        if cosine > 0.0:
            # Phong (1975): gloss (r . l)^exponent, and the lamp's light thins out with its distance squared; within
            # 0.2 m it grows no further, where a lamp is no point
            lobe = look[hit.k, 1] * cosine ** look[hit.k, 2] / max(rr, 0.04)
            for c in range(3):
                out[c] += np.float32(lobe * lamps[lamp, 3 + c])


@borrowing_kernel
def _radiance(panels, hit, ray, spread, colour, fallen):
    """Fill colour (3,) with the light that leaves a hit against the ray; fallen (3,): room for what falls there."""
    k, geometry, look = hit.k, panels.geometry, panels.look
    length = np.sqrt(ray.dx * ray.dx + ray.dy * ray.dy + ray.dz * ray.dz)
    # the pixel's cone covers distance x spread across the ray, and that over the cosine on a slanted rectangle
    slant = max((ray.dx * geometry[k, 9] + ray.dy * geometry[k, 10] + ray.dz * geometry[k, 11]) / length, 0.15)
    _reflectance(panels, hit, hit.along * length * spread / slant, colour)
    if look[k, 0] > 0.0:
        for c in range(3):
            colour[c] *= np.float32(look[k, 0])
        return
    # Lambert: what leaves is reflectance times what falls, the same into all directions
    _fallen(panels, hit, fallen)
    for c in range(3):
        colour[c] *= fallen[c]
    if look[k, 1] > 0.0:
        _add_gloss(panels, hit, ray, colour)


@inner_kernel
def _tile_planes(view, rows, columns, planes, o):
    """Fill planes (5, 3) with the unit normals of a tile's four sides and its middle, o (3,) with its rays' origin.

    rows, columns: first and last of the corners between which the tile's rays go.
    """
    corner = np.empty((4, 3))
    jj, ii = (rows[0], rows[0], rows[1], rows[1]), (columns[0], columns[1], columns[1], columns[0])
    several = view.origins.shape[0] > 1
    o[:] = 0.0
    for q in range(4):
        for r in range(3):
            corner[q, r] = 0.0
            for c in range(3):
                corner[q, r] += view.R[r, c] * view.rays[jj[q], ii[q], c]
                o[r] += 0.25 * view.R[r, c] * (view.origins[jj[q], ii[q], c] if several else view.origins[0, 0, c])
    middle = np.empty(3)
    for r in range(3):
        middle[r] = corner[0, r] + corner[1, r] + corner[2, r] + corner[3, r]
        o[r] += view.t[r]
    for q in range(4):
        # two neighbouring corner rays span a side; its normal points to where the middle is
        cross(corner[q], corner[(q + 1) % 4], planes[q])
        length = np.sqrt(dot(planes[q], planes[q]))
        sign = -1.0 if dot(planes[q], middle) < 0.0 else 1.0
        for r in range(3):
            planes[q, r] = sign * (planes[q, r] / length)
    length = np.sqrt(dot(middle, middle))
    for r in range(3):
        planes[4, r] = middle[r] / length


@borrowing_kernel
def _least_depth(panels, k, planes, o):
    """Return whether rectangle k lies wholly outside one of a tile's planes, and its least depth along the middle.

    A rectangle with all corners outside one plane cannot be met; one that is kept may still be missed, which costs a
    test a ray and no picture (Assarsson and Moeller 2000).
    """
    g = panels.geometry[k]
    depth = 1e30
    for q in range(5):
        all_out = True
        for v in range(4):
            sa, sb = panels.size[k, 0] * (v & 1), panels.size[k, 1] * (v >> 1)
            off = 0.0
            for r in range(3):
                off += planes[q, r] * (g[r] + sa * g[3 + r] + sb * g[6 + r] - o[r])
            if off > -0.01:  # the origins behind glass differ by less than this
                all_out = False
                if q < 4:
                    break
            depth = min(depth, off) if q == 4 else depth
        if all_out:
            return True, depth
    return False, depth


@inner_kernel
def _sort_out(panels, planes, o, candidates):
    """Fill candidates with the rectangles that a tile's rays may meet, nearest first; return how many there are."""
    count = 0
    for k in range(panels.geometry.shape[0]):
        g = panels.geometry[k]
        if (g[0] - o[0]) * g[9] + (g[1] - o[1]) * g[10] + (g[2] - o[2]) * g[11] < -0.01:  # seen from behind
            continue
        outside, depth = _least_depth(panels, k, planes, o)
        if outside:
            continue
        at = count  # inserted where it belongs: a tile has few of them
        while at > 0 and candidates.depths[at - 1] > depth:
            candidates.depths[at], candidates.numbers[at] = candidates.depths[at - 1], candidates.numbers[at - 1]
            at -= 1
        candidates.depths[at], candidates.numbers[at] = depth - 0.02, k
        count += 1
    return count


@borrowing_kernel
def _between(rays, j, i, fx, fy, c):
    """Return coordinate c of the ray through (fx, fy) of pixel (j, i), bilinear between those of its corners."""
    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return w00 * rays[j, i, c] + w01 * rays[j, i + 1, c] + w10 * rays[j + 1, i, c] + w11 * rays[j + 1, i + 1, c]


@borrowing_kernel
def _turned(R, r, x, y, z):
    """Return coordinate r of the vector (x, y, z) turned by R (3, 3)."""
    return R[r, 0] * x + R[r, 1] * y + R[r, 2] * z


@kernel
def cast_scene(scene, R, t, rays, origins, lattice, spread, out):
    """Fill out (h, w, 4) float32 with blue, green, red and the share covered, as a camera sees a scene.

    R (3, 3), t (3,): pose of the camera in the scene. rays (h + 1, w + 1, 3), origins of the same shape or (1, 1, 3):
    in camera axes, through the corners of the pixels. lattice (n, 2): samples in the unit square. spread: angle of a
    pixel in rad.
    """
    panels, view = Panels(*scene), View(R, t, rays, origins)
    height, width, n = out.shape[0], out.shape[1], panels.geometry.shape[0]
    candidates = Candidates(np.empty(n, np.int64), np.empty(n))
    planes, o = np.empty((5, 3)), np.empty(3)
    colour, fallen = np.empty(3, np.float32), np.empty(3, np.float32)
    last, samples = (1 if origins.shape[0] > 1 else 0), lattice.shape[0]
    for tile in range(-(-height // TILE) * -(-width // TILE)):
        j0, i0 = tile // -(-width // TILE) * TILE, tile % -(-width // TILE) * TILE
        j1, i1 = min(j0 + TILE, height), min(i0 + TILE, width)
        _tile_planes(view, (j0, j1), (i0, i1), planes, o)
        count = _sort_out(panels, planes, o, candidates)
        for j in range(j0, j1):
            for i in range(i0, i1):
                e0, e1, e2 = (
                    origins[j * last, i * last, 0],
                    origins[j * last, i * last, 1],
                    origins[j * last, i * last, 2],
                )
                ox = _turned(R, 0, e0, e1, e2) + t[0]
                oy = _turned(R, 1, e0, e1, e2) + t[1]
                oz = _turned(R, 2, e0, e1, e2) + t[2]
                blue, green, red, covered = 0.0, 0.0, 0.0, 0.0
                for s in range(samples):
                    fx, fy = lattice[s, 0], lattice[s, 1]
                    x, y, z = (
                        _between(rays, j, i, fx, fy, 0),
                        _between(rays, j, i, fx, fy, 1),
                        _between(rays, j, i, fx, fy, 2),
                    )
                    ray = Ray(ox, oy, oz, _turned(R, 0, x, y, z), _turned(R, 1, x, y, z), _turned(R, 2, x, y, z))
                    pace = ray.dx * planes[4, 0] + ray.dy * planes[4, 1] + ray.dz * planes[4, 2]
                    hit = _nearest(panels, candidates, count, pace, ray, False)
                    if hit.k >= 0:
                        _radiance(panels, hit, ray, spread, colour, fallen)
                        blue, green, red, covered = blue + colour[0], green + colour[1], red + colour[2], covered + 1.0
                # the share covered goes along, so that what stands before the room can be laid over it
                out[j, i, 0], out[j, i, 1] = np.float32(blue / samples), np.float32(green / samples)
                out[j, i, 2], out[j, i, 3] = np.float32(red / samples), np.float32(covered / samples)


@kernel
def meet_scene(scene, origin, ends, out):
    """Fill out (n,) with the number of the rectangle that stands between origin (3,) and each of ends (n, 3), or -1."""
    panels = Panels(*scene)
    n = panels.geometry.shape[0]
    everything = Candidates(np.arange(n), np.zeros(n))
    for i in range(ends.shape[0]):
        dx, dy, dz = ends[i, 0] - origin[0], ends[i, 1] - origin[1], ends[i, 2] - origin[2]
        ray = Ray(origin[0], origin[1], origin[2], dx, dy, dz)
        hit = _nearest(panels, everything, n, 0.0, ray, True)
        # the ray's unit is the way to its end: what is met at 1 is the end itself
        out[i] = hit.k if hit.along < 1.0 - 1e-6 else -1


@inner_kernel
def _indirect(panels, shading, mean, spot, directions, ambient, total):
    """Add what comes from all sides to a spot: the colour of what is there, less from what is near."""
    g = spot.g
    for q in range(directions.shape[0]):
        # directions are as dense as the cosine (Malley's method), so that their plain mean is the integral over pi
        p, r, s = directions[q, 0], directions[q, 1], directions[q, 2]
        dx = p * g[3] + r * g[6] - s * g[9]
        dy = p * g[4] + r * g[7] - s * g[10]
        dz = p * g[5] + r * g[8] - s * g[11]
        k, along = _first_of(panels, shading, Ray(spot.x, spot.y, spot.z, dx, dy, dz), 1e30, False)
        # obscurance (Zhukov et al. 1998): what is near receives little itself; beyond 0.6 m nothing is taken off
        near = min(1.0, 0.25 + along / 0.8)
        for c in range(3):
            seen = mean[k, c] if k >= 0 else 0.7
            total[c] += ambient * near * (0.3 + 0.7 * seen) / directions.shape[0]


@inner_kernel
def _direct(panels, shading, spot, emitters, total):
    """Add what falls on a spot from samples of lamps (m, 9): place, normal, bgr times area over pi."""
    g = spot.g
    for s in range(emitters.shape[0]):
        dx, dy, dz = emitters[s, 0] - spot.x, emitters[s, 1] - spot.y, emitters[s, 2] - spot.z
        rr = dx * dx + dy * dy + dz * dz
        here = -(dx * g[9] + dy * g[10] + dz * g[11])
        there = dx * emitters[s, 3] + dy * emitters[s, 4] + dz * emitters[s, 5]
        if here <= 0.0 or there <= 0.0 or rr < 1e-6:
            continue
        # its own lamp stands behind a sample, and so beyond the ray's end
        if _first_of(panels, shading, Ray(spot.x, spot.y, spot.z, dx, dy, dz), 0.999, True)[0] >= 0:
            continue
        # form factor of two small areas (Goral et al. 1984): cos cos' dA' / (pi r^2), both cosines being here and
        # there over r; within 0.3 m of a sample it grows no further, where the lamp is no longer a set of points
        for c in range(3):
            total[c] += emitters[s, 6 + c] * here * there / max(rr * rr, 0.01)


@kernel
def light_scene(scene, mean, emitters, directions, ambient, boxes, out):
    """Fill out (k, 3) float32 with the light on every entry of the maps: from the lamps, and from all around.

    mean (n, 3): mean reflectance of each rectangle. emitters (m, 9): see _direct. directions (turns, q, 3): spread
    about z, weighted by its cosine; entries take one turn after the other. boxes: the Shading of what throws shadows.
    """
    panels = Panels(*scene)
    size, pose = panels.size, panels.pose
    shading = Shading(*boxes)
    total, turn = np.empty(3), 0
    for k in range(panels.geometry.shape[0]):
        g = panels.geometry[k]
        first, columns, rows = pose[k, 0], pose[k, 1], pose[k, 2]
        for j in range(rows):
            for i in range(columns):
                a, b = (i + 0.5) / columns * size[k, 0], (j + 0.5) / rows * size[k, 1]
                # a millimetre before its rectangle, or the rays from it would meet that first
                x = g[0] + a * g[3] + b * g[6] - 1e-3 * g[9]
                y = g[1] + a * g[4] + b * g[7] - 1e-3 * g[10]
                z = g[2] + a * g[5] + b * g[8] - 1e-3 * g[11]
                spot = Spot(x, y, z, g)
                total[:] = 0.0
                # another turn of the directions for each entry: their scatter is noise, which is smoothed, not stripes
                turn = (turn + 1) % directions.shape[0]
                _indirect(panels, shading, mean, spot, directions[turn], ambient, total)
                _direct(panels, shading, spot, emitters, total)
                for c in range(3):
                    out[first + j * columns + i, c] = np.float32(total[c])
