"""The preset `paper` in Python: place, edges, borders, gradient vector flow, deformable meshes, wall and measures of every gate.

Arrays where numpy and scipy have a function, numba where a loop is shorter or faster. `by_libraries` takes scikit-image's Canny operator and
scipy's conjugate gradients in place of numba's loops. Left out, which is kind: what tells gaps from found border, the rest of particles
that never freeze (none is left on the phantom), the repair of inverted tetrahedra (they are counted).
"""

import math
import time

import numpy as np
from numba import njit
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage import feature

import field
import place
from place import at

SECTORS = 36
BAND_OF_RADIUS, BAND_PIXELS = 0.3, 2.0
LEAST_COVERAGE, FULL_COVERAGE = 0.4, 0.75
NEIGHBOURS_AGREE, FAINT, ACROSS = 0.3, 0.2, math.sqrt(0.5)
AROUND, OUTLIER_OF_RADIUS, OUTLIER_PIXELS = 3, 0.15, 1.25
MARGIN_MM, FIELD_FORCE, LAMBDA, MU = 12.0, 10.0, 0.5, -0.53


class Clock:
    """Adds up processor time by stage."""

    def __init__(self):
        self.stages, self.since, self.stage = {}, 0.0, None

    def begin(self, stage):
        now = time.process_time()
        if self.stage:
            self.stages[self.stage] = self.stages.get(self.stage, 0.0) + now - self.since
        self.since, self.stage = now, stage


class Extent:
    """Where the ventricle of a gate is."""

    def __init__(self, told, spacing_mm):
        self.at, self.slope = np.array(told["axis_at_mm"]), np.array(told["axis_slope"])
        self.radius_mm, self.apex_mm, self.base_mm = told["radius_mm"], told["apex_mm"], told["base_mm"]
        self.dz = spacing_mm[0]
        self.towards_base = 1.0 if self.base_mm >= self.apex_mm[1] else -1.0

    def from_axis(self, points):
        return points[..., :2] - self.at - self.slope * points[..., 2:3]

    def at_axis(self, offsets, z_mm):
        """Points at offsets from the axis at heights."""
        z_mm = np.broadcast_to(z_mm, len(offsets))[:, None]
        return np.hstack([self.at + self.slope * z_mm + offsets, z_mm])


# Edges.


def gradient(counts, spacing_mm, sigma):
    """The gradient of the counts in the plane of the slices, smoothed by the Gaussian as far as it is inside, and its length."""
    known = [np.ones(length) for length in counts.shape]
    smooth = counts
    for axis in (1, 2):
        smooth = ndimage.gaussian_filter1d(smooth, sigma, axis=axis, mode="constant")
        known[axis] = ndimage.gaussian_filter1d(known[axis], sigma, mode="constant")
    smooth = (smooth / (known[1][:, None] * known[2])).astype(np.float32)
    along_y, along_x = np.gradient(smooth, spacing_mm[1], spacing_mm[2], axis=(1, 2))
    return along_x, along_y, np.sqrt(along_x * along_x + along_y * along_y)


@njit(cache=True)
def thin(length, gx, gy, inside, dx, dy, dz):
    """Local maxima of the gradient's length along the gradient: voxels, places to a part of a voxel, directions, lengths."""
    slices, rows, columns = length.shape
    voxels = np.empty((length.size, 3), np.int64)
    places = np.empty((length.size, 3))
    uphill = np.empty((length.size, 2))
    strength = np.empty(length.size)
    count = 0
    for z in range(slices):
        for y in range(rows):
            for x in range(columns):
                here = length[z, y, x]
                if not inside[z, y, x] or here == 0:
                    continue
                ux, uy = gx[z, y, x] / here, gy[z, y, x] / here
                step = 1 / max(abs(ux) / dx, abs(uy) / dy)
                before = at(length[z], x - step * ux / dx, y - step * uy / dy)
                after = at(length[z], x + step * ux / dx, y + step * uy / dy)
                if here < before or here <= after:
                    continue
                bend = before - 2 * here + after
                offset = min(max(0.5 * (before - after) / bend, -0.5), 0.5) if bend < 0 else 0.0
                voxels[count] = z, y, x
                places[count] = x * dx + ux * offset * step, y * dy + uy * offset * step, z * dz
                uphill[count] = ux, uy
                strength[count] = here
                count += 1
    return voxels[:count].copy(), places[:count].copy(), uphill[:count].copy(), strength[:count].copy()


def thin_by_libraries(counts, sigma, length, gx, gy, inside, dx, dy, dz):
    """The same with the maxima that scikit-image's Canny operator finds in each slice."""
    maxima = np.stack([feature.canny(of, sigma, 0, 0) for of in counts]) & inside & (length > 0)
    voxels = np.argwhere(maxima)
    here = length[maxima]
    uphill = np.column_stack([gx[maxima], gy[maxima]]) / here[:, None]
    step = 1 / np.maximum(np.abs(uphill[:, 0]) / dx, np.abs(uphill[:, 1]) / dy)
    way = np.column_stack([np.zeros(len(here)), uphill[:, 1] * step / dy, uphill[:, 0] * step / dx])
    before, after = (ndimage.map_coordinates(length, (voxels + sign * way).T, order=1, mode="nearest") for sign in (-1, 1))
    bend = before - 2 * here + after
    offset = np.where(bend < 0, np.clip(0.5 * (before - after) / np.where(bend < 0, bend, 1), -0.5, 0.5), 0)
    places = voxels[:, ::-1] * (dx, dy, dz)
    places[:, :2] += uphill * (offset * step)[:, None]
    return voxels, places, uphill.astype(np.float64), here.astype(np.float64)


SAME_SLICE = np.array([np.zeros((3, 3)), np.ones((3, 3)), np.zeros((3, 3))])


class Edges:
    """Points on edges."""

    def __init__(self, voxels, places, uphill, strength):
        self.voxels, self.places, self.uphill, self.strength = voxels, places, uphill, strength

    def __getitem__(self, which):
        return Edges(self.voxels[which], self.places[which], self.uphill[which], self.strength[which])

    @property
    def slices(self):
        return self.voxels[:, 0]


def hysteresis(edges, shape, low, high):
    """Those of at least `low` and joined, in their slice, to one of at least `high` times the slice's largest."""
    largest = np.full(shape[0], np.finfo(np.float32).tiny)
    np.maximum.at(largest, edges.slices, edges.strength)
    part = edges.strength / largest[edges.slices]
    weak = np.zeros(shape, bool)
    weak[tuple(edges.voxels[part >= low].T)] = True
    labels, count = ndimage.label(weak, SAME_SLICE)
    of_points = labels[tuple(edges.voxels.T)]
    strong = np.zeros(count + 1, bool)
    strong[of_points[part >= high]] = True
    strong[0] = False
    return edges[strong[of_points]]


# Borders.


@njit(cache=True)
def spanned(radius_mm, pixel_mm):
    return min(int(round(pixel_mm / max(radius_mm, pixel_mm / 2) * SECTORS / math.tau / 2)), SECTORS // 2)


@njit(cache=True)
def circumference(radii, sectors, pixel_mm, smallest_mm, largest_mm):
    """The radius that meets border in most sectors; nought where none meets enough."""
    best_radius, best_score = 0.0, -1.0
    radius = smallest_mm
    while radius <= largest_mm:
        band = max(BAND_OF_RADIUS * radius, BAND_PIXELS * pixel_mm)
        met = np.zeros(SECTORS)
        for k in range(len(radii)):
            off = abs(radii[k] - radius) / band
            if off <= 1:
                reach = spanned(radii[k], pixel_mm)
                for shift in range(-reach, reach + 1):
                    sector = (sectors[k] + shift) % SECTORS
                    met[sector] = max(met[sector], 1 - 0.5 * off)
        score = met.sum() / SECTORS
        if (met > 0).sum() / SECTORS >= LEAST_COVERAGE and score > best_score + 1e-9:
            best_radius, best_score = radius, score
        radius += pixel_mm / 2
    return best_radius


def polar(edges, extent):
    out = extent.from_axis(edges.places)
    turn = (np.arctan2(out[:, 1], out[:, 0]) + np.pi) / math.tau
    return np.hypot(out[:, 0], out[:, 1]), np.minimum((turn * SECTORS).astype(np.int64), SECTORS - 1)


def sector_radii(edges, extent, slices):
    """The mean radius in each sector of each slice, NaN where nothing was seen."""
    radius, sector = polar(edges, extent)
    place = edges.slices * SECTORS + sector
    count = np.bincount(place, minlength=slices * SECTORS)
    total = np.bincount(place, radius, minlength=slices * SECTORS)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(slices, SECTORS)


def upper_median(values):
    values = np.sort(values[~np.isnan(values)])
    return values[len(values) // 2] if len(values) else np.nan


@njit(cache=True)
def stand_out(slices, radius, sector, radii, pixel_mm):
    """Which points lie farther from the median of their surroundings than borders do."""
    result = np.zeros(len(radius), np.bool_)
    around = np.empty((2 * AROUND + 1) ** 2)
    for k in range(len(radius)):
        count = 0
        for z in range(max(slices[k] - AROUND, 0), min(slices[k] + AROUND, len(radii) - 1) + 1):
            for shift in range(-AROUND, AROUND + 1):
                value = radii[z, (sector[k] + shift) % SECTORS]
                if not math.isnan(value):
                    around[count] = value
                    count += 1
        typical = np.sort(around[:count])[count // 2]
        result[k] = abs(radius[k] - typical) > max(OUTLIER_OF_RADIUS * typical, OUTLIER_PIXELS * pixel_mm)
    return result


def coverage(radii, pixel_mm):
    """The part of the sectors of each slice that met border."""
    seen = np.zeros(radii.shape, bool)
    for z, sector in zip(*np.nonzero(~np.isnan(radii))):
        reach = spanned(radii[z, sector], pixel_mm)
        seen[z, (sector + np.arange(-reach, reach + 1)) % SECTORS] = True
    return seen.mean(axis=1)


def rings(edges, extent, spacing_mm, slices):
    """The edges on the best circumference of each slice, less those that stand out; mean radius and coverage of each slice."""
    pixel_mm = max(spacing_mm[1:])
    strongest = np.zeros(slices)
    np.maximum.at(strongest, edges.slices, edges.strength)
    present = np.sort(strongest[strongest > 0])
    edges = edges[strongest[edges.slices] >= FAINT * present[len(present) * 3 // 4]]
    radius, sector = polar(edges, extent)
    of_slice = [np.nonzero(edges.slices == z)[0] for z in range(slices)]
    first = np.array([circumference(radius[of], sector[of], pixel_mm, pixel_mm, extent.radius_mm) for of in of_slice])
    first[first == 0] = np.nan
    reach = math.ceil(10 / spacing_mm[0])
    kept = np.zeros(len(radius), bool)
    for z, of in enumerate(of_slice):
        typical = upper_median(first[max(z - reach, 0) : z + reach + 1])
        limits = (pixel_mm, extent.radius_mm) if np.isnan(typical) else (typical * (1 - NEIGHBOURS_AGREE), typical * (1 + NEIGHBOURS_AGREE))
        best = circumference(radius[of], sector[of], pixel_mm, *limits)
        if best > 0:
            kept[of] = np.abs(radius[of] - best) <= max(BAND_OF_RADIUS * best, BAND_PIXELS * pixel_mm)
    out = extent.from_axis(edges.places)
    kept &= np.abs(np.sum(out * edges.uphill, axis=1)) >= ACROSS * np.hypot(out[:, 0], out[:, 1])
    edges = edges[kept]
    radius, sector = polar(edges, extent)
    edges = edges[~stand_out(edges.slices, radius, sector, sector_radii(edges, extent, slices), pixel_mm)]
    radii = sector_radii(edges, extent, slices)
    covered = coverage(radii, pixel_mm)
    mean = np.array([np.nan if np.isnan(row).all() else np.nanmean(row) for row in radii])
    # The rings next to the apex that are not closed are no rings.
    with_ring = np.nonzero(~np.isnan(mean))[0]
    if extent.towards_base < 0:
        with_ring = with_ring[::-1]
    closed = np.nonzero(covered[with_ring] >= FULL_COVERAGE)[0]
    dropped = with_ring[: closed[0] if len(closed) else 0]
    mean[dropped] = np.nan
    radii[dropped] = np.nan
    return edges[~np.isin(edges.slices, dropped)], mean, covered, radii


class Border:
    """Border voxels, each once, with places and normals."""

    def __init__(self, shape, spacing_mm):
        self.shape, self.step = np.array(shape), np.array(spacing_mm[::-1])
        self.parts = []

    def add(self, places, normals, voxels=None, to_nearest_slice=False):
        if voxels is None:
            index = places / self.step
            if to_nearest_slice:
                clamped = np.clip(index[:, 2], 0, self.shape[0] - 1)
                index[:, 2] = np.where(np.abs(clamped - index[:, 2]) > 1, -9, clamped)
            voxels = np.floor(index + 0.5).astype(np.int64)[:, ::-1]
            inside = ((voxels >= 0) & (voxels < self.shape)).all(axis=1)
            places, normals, voxels = places[inside], np.broadcast_to(normals, places.shape)[inside], voxels[inside]
        self.parts.append((voxels, places, normals))

    def finish(self):
        voxels, places, normals = (np.concatenate(parts) for parts in zip(*self.parts))
        _, first = np.unique(np.ravel_multi_index(voxels.T, self.shape), return_index=True)
        first.sort()
        self.voxels, self.places, self.normals = voxels[first], places[first], np.ascontiguousarray(normals[first], np.float64)
        return self


def border(edges, mean, covered, radii, extent, spacing_mm, shape, apex_mm):
    """The rings with their gaps bridged, a disc in the valve plane and half an ellipsoid over the apex."""
    result = Border(shape, spacing_mm)
    result.add(edges.places, np.column_stack([edges.uphill, np.zeros(len(edges.places))]), edges.voxels)
    pixel_mm = min(spacing_mm[1:])
    for z in range(shape[0]):
        seen = np.nonzero(~np.isnan(radii[z]))[0]
        for start, end in zip(seen, np.roll(seen, -1)):
            gap = end - start if end > start else end + SECTORS - start
            near, far = radii[z, start], radii[z, end]
            if gap <= math.ceil(pixel_mm * 1.5 / max(min(near, far), pixel_mm) * SECTORS / math.tau):
                continue
            steps = math.ceil(gap * math.tau / SECTORS * max(near, far) / (pixel_mm / 2))
            part = np.arange(1, steps) / steps
            angle = (start + part * gap + 0.5) / SECTORS * math.tau - math.pi
            out = np.column_stack([np.cos(angle), np.sin(angle)])
            places = extent.at_axis(out * (near + part * (far - near))[:, None], z * spacing_mm[0])
            result.add(places, np.column_stack([out, np.zeros(len(out))]))
    y, x = np.mgrid[: shape[1], : shape[2]]
    flat = np.column_stack([x.ravel() * spacing_mm[2], y.ravel() * spacing_mm[1]])
    with_ring = np.nonzero(~np.isnan(mean))[0]
    ends = (with_ring[0], with_ring[-1]) if extent.towards_base > 0 else (with_ring[-1], with_ring[0])

    def end_ring(z):
        places = edges.places[edges.slices == z]
        centre = places.mean(axis=0)
        if covered[z] >= FULL_COVERAGE:
            return extent.from_axis(centre[None])[0], np.linalg.norm(places - centre, axis=1).mean()
        return np.zeros(2), mean[z]

    def inside(ring, z_mm):
        offsets = extent.from_axis(np.column_stack([flat, np.full(len(flat), z_mm)])) - ring[0]
        return offsets[np.hypot(offsets[:, 0], offsets[:, 1]) < ring[1]]

    basal = end_ring(ends[1])
    offsets = inside(basal, extent.base_mm)
    result.add(extent.at_axis(basal[0] + offsets, extent.base_mm), np.array([[0, 0, 1.0]]), to_nearest_slice=True)
    apical = end_ring(ends[0])
    ring_mm, down = ends[0] * spacing_mm[0], -extent.towards_base
    height = max((ring_mm - apex_mm) * extent.towards_base, spacing_mm[0] / 4)
    offsets = inside(apical, ring_mm)
    rise = np.sqrt(1 - np.sum(offsets * offsets, axis=1) / apical[1] ** 2)
    normals = np.column_stack([offsets / apical[1] ** 2, down * rise / height])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    result.add(extent.at_axis(apical[0] + offsets, ring_mm + down * height * rise), normals, to_nearest_slice=True)
    return result.finish()


# Field.


class Window:
    """The part of the grid around a border that the field is solved on; it may reach beyond the grid."""

    def __init__(self, found, spacing_mm):
        margin = np.ceil(MARGIN_MM / np.array(spacing_mm)).astype(np.int64)
        self.low = found.voxels.min(axis=0) - margin
        self.shape = tuple(found.voxels.max(axis=0) + margin - self.low + 1)
        self.edges = np.zeros(self.shape, np.float32)
        self.edges[tuple((found.voxels - self.low).T)] = 1
        self.origin_mm = self.low[::-1] * np.array(spacing_mm[::-1])


# Meshes.


class Topology:
    """An icosphere: unit vertices, triangles, and the neighbours of each vertex."""

    def __init__(self, level):
        t = (1 + math.sqrt(5)) / 2
        v = [(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t), (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1)]
        f = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8)]
        f += [(3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
        v = [np.array(p) / np.linalg.norm(p) for p in v]
        for _ in range(level):
            middle, finer = {}, []

            def between(a, b):
                key = (min(a, b), max(a, b))
                if key not in middle:
                    middle[key] = len(v)
                    v.append((v[a] + v[b]) / np.linalg.norm(v[a] + v[b]))
                return middle[key]

            for a, b, c in f:
                ab, bc, ca = between(a, b), between(b, c), between(c, a)
                finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
            f = finer
        self.unit, self.triangles = np.array(v), np.array(f)
        joined = [set() for _ in v]
        for a, b, c in f:
            joined[a] |= {b, c}
            joined[b] |= {a, c}
            joined[c] |= {a, b}
        self.degree = np.array([len(of) for of in joined])
        self.joined = np.array([sorted(of) + [0] * (6 - len(of)) for of in joined])
        self.tetrahedra = np.array([corner for triangle in f for corner in self.prism(triangle, len(v))])

    @staticmethod
    def prism(triangle, across):
        """The three tetrahedra between a triangle and its outer copy, diagonals from smaller inner to larger outer numbers."""
        a = min(range(3), key=lambda k: triangle[k])
        a, b, c = (triangle[(a + k) % 3] for k in range(3))
        p, q, r = a + across, b + across, c + across
        return [(a, b, c, r), (a, b, r, q), (a, q, r, p)] if b < c else [(a, b, c, q), (a, q, c, r), (a, q, r, p)]


@njit(cache=True)
def direction(fx, fy, fz, origin, step, place):
    """The field's direction at a place, by linear interpolation in its window."""
    nz, ny, nx = fx.shape
    x, y, z = (place[0] - origin[0]) / step[0], (place[1] - origin[1]) / step[1], (place[2] - origin[2]) / step[2]
    x, y, z = min(max(x, 0.0), nx - 1.0), min(max(y, 0.0), ny - 1.0), min(max(z, 0.0), nz - 1.0)
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    u, v, w = x - i, y - j, z - k
    a = b = c = 0.0
    for dk in range(2):
        for dj in range(2):
            for di in range(2):
                weight = (u if di else 1 - u) * (v if dj else 1 - v) * (w if dk else 1 - w)
                a += weight * fx[k + dk, j + dj, i + di]
                b += weight * fy[k + dk, j + dj, i + di]
                c += weight * fz[k + dk, j + dj, i + di]
    length = math.sqrt(a * a + b * b + c * c)
    return (a / length, b / length, c / length) if length > 0 else (0.0, 0.0, 0.0)


@njit(cache=True)
def taubin(positions, joined, degree, fixed):
    shift = np.zeros_like(positions)
    for factor in (LAMBDA, MU):
        for vertex in range(len(positions)):
            for axis in range(3):
                total = 0.0
                for k in range(degree[vertex]):
                    total += positions[joined[vertex, k], axis]
                shift[vertex, axis] = 0.0 if fixed[vertex] else (total / degree[vertex] - positions[vertex, axis]) * factor
        positions += shift


@njit(cache=True)
def evolve(positions, fx, fy, fz, origin, step, cells, places, normals, joined, degree, h, drag, most_steps):
    """Runge-Kutta 4 of free particles under the field's direction and drag, until every one is frozen on the border; the steps taken.

    `cells` has, for each voxel of the grid, the number of its border point, -1 beside the border, -2 elsewhere."""
    count = len(positions)
    velocities = np.zeros_like(positions)
    frozen = np.zeros(count, np.bool_)
    shape = cells.shape
    longest = 0.5 * min(step[0], step[1], step[2])
    left, steps = count, 0
    k_x, k_v = np.empty((4, 3)), np.empty((4, 3))
    nodes = (0.0, h / 2, h / 2, h)
    at_place, at_speed, way, speed = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    while left > 0 and steps < most_steps:
        steps += 1
        for p in range(count):
            if frozen[p]:
                continue
            for stage in range(4):
                for a in range(3):
                    at_place[a] = positions[p, a] + (nodes[stage] * k_x[stage - 1, a] if stage > 0 else 0.0)
                    at_speed[a] = velocities[p, a] + (nodes[stage] * k_v[stage - 1, a] if stage > 0 else 0.0)
                d = direction(fx, fy, fz, origin, step, at_place)
                for a in range(3):
                    k_x[stage, a] = at_speed[a]
                    k_v[stage, a] = d[a] * FIELD_FORCE - drag * at_speed[a]
            square_x = square_v = 0.0
            for a in range(3):
                way[a] = h / 6 * (k_x[0, a] + 2 * (k_x[1, a] + k_x[2, a]) + k_x[3, a])
                speed[a] = velocities[p, a] + h / 6 * (k_v[0, a] + 2 * (k_v[1, a] + k_v[2, a]) + k_v[3, a])
                square_x += way[a] * way[a]
                square_v += speed[a] * speed[a]
            shorter, slower = min(1.0, longest / max(math.sqrt(square_x), 1e-300)), min(1.0, longest / h / max(math.sqrt(square_v), 1e-300))
            for a in range(3):
                positions[p, a] += way[a] * shorter
                velocities[p, a] = speed[a] * slower
            # Has it reached the border? Particles may leave the grid by its first and last slice.
            height = positions[p, 2] / step[2]
            x, y, z = int(math.floor(positions[p, 0] / step[0] + 0.5)), int(math.floor(positions[p, 1] / step[1] + 0.5)), int(math.floor(height + 0.5))
            if -1 <= height <= shape[0]:
                z = min(max(z, 0), shape[0] - 1)
            if x < 0 or y < 0 or z < 0 or z >= shape[0] or y >= shape[1] or x >= shape[2]:
                continue
            point = cells[z, y, x]
            if point == -1:
                d = direction(fx, fy, fz, origin, step, positions[p])
                if d[0] * speed[0] + d[1] * speed[1] + d[2] * speed[2] < 0:
                    nearest = math.inf
                    for c in range(max(z - 1, 0), min(z + 2, shape[0])):
                        for b in range(max(y - 1, 0), min(y + 2, shape[1])):
                            for a in range(max(x - 1, 0), min(x + 2, shape[2])):
                                if cells[c, b, a] >= 0:
                                    square = 0.0
                                    for k in range(3):
                                        square += (places[cells[c, b, a], k] - positions[p, k]) ** 2
                                    if square < nearest:
                                        nearest, point = square, cells[c, b, a]
            if point >= 0:
                off = 0.0
                for k in range(3):
                    off += (places[point, k] - positions[p, k]) * normals[point, k]
                for k in range(3):
                    positions[p, k] += off * normals[point, k]
                frozen[p] = True
                left -= 1
        if steps % 4 == 0:
            taubin(positions, joined, degree, frozen)
    return steps, count - left


def cells_of(found, shape):
    on = np.zeros(shape, bool)
    on[tuple(found.voxels.T)] = True
    cells = np.where(ndimage.binary_dilation(on, np.ones((3, 3, 3))), -1, -2)
    cells[tuple(found.voxels.T)] = np.arange(len(found.voxels))
    return cells


def inverted(positions, triangles):
    a, b, c = np.moveaxis(positions[triangles] - positions.mean(axis=0), 1, 0)
    return int(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c)) <= 0))


def volume_ml(positions, triangles):
    a, b, c = np.moveaxis(positions[triangles], 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6000


def within_one_voxel(positions, found, spacing_mm):
    step = np.array(spacing_mm[::-1])
    distance, _ = cKDTree(found.voxels[:, ::-1].astype(float)).query(positions / step)
    mm, _ = cKDTree(found.voxels[:, ::-1] * step).query(positions)
    return np.mean(distance < 1), mm.mean()


# The whole.


def reconstruct(gates, told, topology, by_libraries=False):
    """Volumes of both surfaces of every gate, and the seconds of each stage."""
    spacing_mm, shape = told["spacing_mm"], tuple(told["shape"])
    dz, dy, dx = spacing_mm
    step = np.array(spacing_mm[::-1])
    z, y, x = np.meshgrid(*(np.arange(length) for length in shape), indexing="ij", sparse=True)
    clock = Clock()
    volumes, within, frozen, tetrahedra = [[], []], [], [], 0
    clock.begin("region")
    extents = place.locate(gates, spacing_mm, told["base_at_last_slice"])
    for counts, found in zip(gates, extents):
        clock.begin("edges")
        extent = Extent(found, spacing_mm)
        gx, gy, length = gradient(counts, spacing_mm, told["sigma"])
        clock.begin("borders")
        low, high = sorted([extent.base_mm, extent.apex_mm[1]])
        out_x, out_y = x * dx - extent.at[0] - extent.slope[0] * z * dz, y * dy - extent.at[1] - extent.slope[1] * z * dz
        radius = np.hypot(out_x, out_y)
        useful = (z * dz >= low - 1e-9) & (z * dz <= high + 1e-9) & (radius <= extent.radius_mm)
        rise = gx * out_x + gy * out_y
        if by_libraries:
            points = Edges(*thin_by_libraries(counts, told["sigma"], length, gx, gy, useful, dx, dy, dz))
        else:
            points = Edges(*thin(length, gx, gy, useful, dx, dy, dz))
        of_points = tuple(points.voxels.T)
        falls, rises = rise[of_points] < 0, rise[of_points] > 0
        outer = rings(hysteresis(points[falls], shape, told["low"], told["high"]), extent, spacing_mm, shape[0])
        rises &= radius[of_points] < np.nan_to_num(outer[1])[points.slices]
        inner = rings(hysteresis(points[rises], shape, told["low"], told["high"]), extent, spacing_mm, shape[0])
        borders = [border(*found, extent, spacing_mm, shape, apex) for found, apex in zip((inner, outer), extent.apex_mm)]
        meshes = []
        for found in borders:
            clock.begin("gradient_vector_flow")
            window = Window(found, spacing_mm)
            problem = field.Problem(window.edges, spacing_mm, told["mu"])
            if by_libraries:
                flow, _ = field.scipy_cg(problem, field.laplacian(window.shape, problem.weights), told["tolerance"])
            else:
                flow, _ = field.numba_cg(problem, told["tolerance"])
            clock.begin("deformation")
            ends = found.places.min(axis=0), found.places.max(axis=0)
            positions = (ends[0] + ends[1]) / 2 + topology.unit * (ends[1] - ends[0]) / 2
            _, held = evolve(
                positions, *flow, window.origin_mm, step, cells_of(found, shape), found.places, found.normals, topology.joined,
                topology.degree, told["time_step_s"], -math.log(1 - told["damping_percent"] / 100), told["max_steps"],
            )  # fmt: skip
            free = np.zeros(len(positions), bool)
            for turn in range(4):
                if turn > 0 and inverted(positions, topology.triangles) == 0:
                    break
                for _ in range(20):
                    taubin(positions, topology.joined, topology.degree, free)
            frozen.append(held / len(positions))
            meshes.append(positions)
        clock.begin("wall")
        a, b, c, d = np.moveaxis(np.concatenate(meshes)[topology.tetrahedra], 1, 0)
        tetrahedra += int(np.sum(np.einsum("ij,ij->i", d - a, np.cross(b - a, c - a)) <= 0))
        clock.begin("measurement")
        for surface, (positions, found) in enumerate(zip(meshes, borders)):
            volumes[surface].append(float(volume_ml(positions, topology.triangles)))
            within.append(within_one_voxel(positions, found, spacing_mm)[0])
    clock.begin(None)
    return {
        "endocardial_ml": volumes[0], "epicardial_ml": volumes[1], "stages": clock.stages, "frozen": min(frozen),
        "within_one_voxel": float(min(within)), "inverted_tetrahedra": tetrahedra,
    }  # fmt: skip
