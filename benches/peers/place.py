"""Where the ventricle is, in Python: rings with a dark centre in the sum of the gates, an axis through their centres, and each gate's ends.

Left out: the mask of the field of view and the axis of rings with gaps, which the phantom does not need.
"""

import math

import numpy as np
from numba import njit
from scipy import ndimage

SMOOTHING_MM, BEYOND_WALL_MM, CIRCLE_MARGIN_MM, BASE_MOTION_MM = 4.0, 14.0, 30.0, 18.0
RADII_MM = np.array([12.0, 15.0, 18.0, 21.0, 24.0, 28.0, 32.0, 36.0, 41.0, 46.0])
LEAST_CONTRAST, CAPPED, CLEAR_RATIO, APEX_STANDS_OUT = 0.12, 0.4, 1.3, 0.1
TURN_16 = np.exp(2j * np.pi * np.arange(16) / 16)
TURN_8 = np.exp(2j * np.pi * np.arange(8) / 8)
COS_16, SIN_16, COS_8, SIN_8 = TURN_16.real.copy(), TURN_16.imag.copy(), TURN_8.real.copy(), TURN_8.imag.copy()


@njit(cache=True)
def at(image, x, y):
    """Linear interpolation in a slice at fractions of pixels, the faces' values outside."""
    rows, columns = image.shape
    y, x = min(max(y, 0.0), rows - 1.0), min(max(x, 0.0), columns - 1.0)
    j, i = min(int(y), rows - 2), min(int(x), columns - 2)
    v, u = y - j, x - i
    return (1 - v) * ((1 - u) * image[j, i] + u * image[j, i + 1]) + v * ((1 - u) * image[j + 1, i] + u * image[j + 1, i + 1])


@njit(cache=True)
def mean_around(image, x, y, rx, ry, cosines, sines):
    total = 0.0
    for k in range(len(cosines)):
        total += at(image, x + rx * cosines[k], y + ry * sines[k])
    return total / len(cosines)


@njit(cache=True)
def ring_at(image, x_mm, y_mm, dx, dy):
    """Contrast, radius and wall of the best ring about a centre."""
    x, y = x_mm / dx, y_mm / dy
    centre = at(image, x, y)
    best, best_radius, best_wall = -math.inf, 0.0, 0.0
    for radius in RADII_MM:
        wall = mean_around(image, x, y, radius / dx, radius / dy, COS_16, SIN_16)
        cavity = 0.5 * (centre + mean_around(image, x, y, 0.3 * radius / dx, 0.3 * radius / dy, COS_8, SIN_8))
        if cavity >= wall:
            continue
        outside = mean_around(image, x, y, (radius + BEYOND_WALL_MM) / dx, (radius + BEYOND_WALL_MM) / dy, COS_8, SIN_8)
        contrast = wall - 0.5 * (cavity + outside)
        if contrast > best:
            best, best_radius, best_wall = contrast, radius, wall
    return best, best_radius, best_wall


@njit(cache=True)
def best_centre(smooth, dx, dy, stride):
    slices, rows, columns = smooth.shape
    most, x_mm, y_mm = 0.0, 0.0, 0.0
    for y in range(0, rows, stride):
        for x in range(0, columns, stride):
            score = 0.0
            for z in range(slices):
                score += max(ring_at(smooth[z], x * dx, y * dy, dx, dy)[0], 0.0)
            if score > most:
                most, x_mm, y_mm = score, x * dx, y * dy
    return x_mm, y_mm


@njit(cache=True)
def follow_rings(smooth, start_x, start_y, dx, dy, dz):
    """The best ring of each slice within 12 mm: height, centre, radius, contrast, wall."""
    rings = np.zeros((len(smooth), 6))
    for z in range(len(smooth)):
        for v in range(-4, 5):
            for u in range(-4, 5):
                x, y = start_x + 3.0 * u, start_y + 3.0 * v
                contrast, radius, wall = ring_at(smooth[z], x, y, dx, dy)
                if contrast > rings[z, 4]:
                    rings[z] = np.array([z * dz, x, y, radius, contrast, wall])
    return rings


def fit_axis(rings):
    """Line through the rings' centres, weighted by contrast, twice: then without those more than 6 mm off."""
    z, centres, weights = rings[:, 0], rings[:, 1:3], rings[:, 4]
    for turn in range(2):
        mean_z, mean_c = np.average(z, weights=weights), np.average(centres, axis=0, weights=weights)
        spread = np.sum(weights * (z - mean_z) ** 2)
        slope = weights * (z - mean_z) @ (centres - mean_c) / spread if spread > 0 else np.zeros(2)
        axis = mean_c - slope * mean_z, slope
        near = np.linalg.norm(centres - axis[0] - np.outer(z, slope), axis=1) < 6
        if turn or near.sum() < 3:
            return axis
        weights = weights * near
    return axis


@njit(cache=True)
def profiles(smooth, at_mm, slope, reach, dx, dy, dz):
    """The wall's uptake in each slice (median of the maxima along 16 directions), and the mean about the axis."""
    slices = len(smooth)
    wall, axial = np.empty(slices), np.empty(slices)
    maxima = np.empty(16)
    for z in range(slices):
        x, y = (at_mm[0] + slope[0] * z * dz) / dx, (at_mm[1] + slope[1] * z * dz) / dy
        for k in range(16):
            best = 0.0
            for i in range(int(reach / 2) + 1):
                best = max(best, at(smooth[z], x + 2 * i * COS_16[k] / dx, y + 2 * i * SIN_16[k] / dy))
            maxima[k] = best
        wall[z] = np.sort(maxima)[8]
        axial[z] = (8 * mean_around(smooth[z], x, y, 4 / dx, 4 / dy, COS_8, SIN_8) + at(smooth[z], x, y)) / 9
    return wall, axial


def upper_median(values):
    return np.sort(values)[len(values) // 2]


def wall_ends(profile, middle_mm, dz):
    """Where the wall's uptake falls half way to the background on either side of the middle; None where it does not stand out."""
    last = len(profile) - 1
    middle = min(max(round(middle_mm / dz), 0), last)
    background = np.sort(profile)[len(profile) // 20]
    reach = math.ceil(15 / dz)
    wall = upper_median(profile[max(middle - reach, 0) : middle + reach + 1])
    level = background + 0.5 * (wall - background)
    if wall <= background * 1.05 or profile[middle] <= level:
        return None

    def crossing(inside, outside):
        return (inside + (profile[inside] - level) / (profile[inside] - profile[outside]) * (outside - inside)) * dz

    low = next((crossing(i, i - 1) for i in range(middle, 0, -1) if profile[i - 1] < level), -0.5 * dz)
    high = next((crossing(i, i + 1) for i in range(middle, last) if profile[i + 1] < level), (last + 0.5) * dz)
    return low, high


def base_is_last(axial, wall, low, high, dz, told):
    """Whether the base is at the high end: the end whose centre is darker against its wall, else as the patient's axes tell."""
    z = np.arange(len(wall)) * dz
    third = (high - low) / 3

    def level(start, end):
        of = (z >= start) & (z <= end) & (wall > 0)
        return np.sum(axial[of] / wall[of]) / max(of.sum(), 1)

    top, bottom = level(high - third, high), level(low, low + third)
    if max(top, bottom) >= CAPPED and (top * CLEAR_RATIO < bottom or bottom * CLEAR_RATIO < top):
        return bool(top < bottom)
    return told


def apices(axial, wall, end_mm, base_mm, dz):
    """Heights of the endocardial and the epicardial apex: where the counts change most on either side of the apical wall."""
    up = np.sign(base_mm - end_mm)
    unseen = [end_mm + 10 * up, end_mm]
    length = abs(base_mm - end_mm)
    heights = -20 + 0.5 * np.arange(int((length * 0.6 + 20) / 0.5) + 1)
    index = (end_mm + up * heights) / dz
    heights = heights[(index >= 0) & (index <= len(axial) - 1)]

    def value(height):
        return np.interp((end_mm + up * height) / dz, np.arange(len(axial)), axial)

    near = heights[(heights >= -4) & (heights <= length * 0.45)]
    if not len(near):
        return unseen
    values = value(near)
    peak = near[len(near) - 1 - np.argmax(values[::-1])]
    above = heights[(heights >= peak) & (heights <= peak + 25)]
    if value(peak) - np.min(value(above)) < APEX_STANDS_OUT * wall:
        return unseen
    slopes = value(heights + 1) - value(heights - 1)

    def steepest(start, end, sign):
        of = (heights >= start) & (heights <= end)
        rising = sign * slopes[of]
        k = len(rising) - 1 - np.argmax(rising[::-1])
        return heights[of][k] if rising[k] > 0 else None

    inner, outer = steepest(peak, peak + 25, -1), steepest(peak - 25, peak, 1)
    if inner is None or outer is None or inner - outer <= 4:
        return unseen
    return [end_mm + up * inner, end_mm + up * outer]


def locate(gates, spacing_mm, base_at_last_slice):
    """For each gate: the axis, the filtering circle, the apices and the valve plane. `base_at_last_slice` is what the patient's axes tell."""
    dz, dy, dx = spacing_mm
    sigmas = [SMOOTHING_MM / spacing for spacing in spacing_mm]

    def smoothed(counts):
        known = [ndimage.gaussian_filter1d(np.ones(length), sigma, mode="constant") for length, sigma in zip(counts.shape, sigmas)]
        weight = known[0][:, None, None] * known[1][:, None] * known[2]
        return (ndimage.gaussian_filter(counts, sigmas, mode="constant") / weight).astype(np.float32)

    smooth = smoothed(gates.sum(axis=0))
    stride = max(round(4 / min(dx, dy)), 1)
    rings = follow_rings(smooth, *best_centre(smooth, dx, dy, stride), dx, dy, dz)
    rings = rings[rings[:, 4] > 0]
    rings = rings[rings[:, 4] >= LEAST_CONTRAST * rings[:, 5].max()]
    mid_wall = upper_median(rings[:, 3])
    at_mm, slope = fit_axis(rings)
    middle = np.average(rings[:, 0], weights=rings[:, 4])
    wall, axial = profiles(smooth, at_mm, slope, mid_wall + BEYOND_WALL_MM, dx, dy, dz)
    low, high = wall_ends(wall, middle, dz)
    last = base_is_last(axial, wall, low, high, dz, base_at_last_slice)
    single = []
    for counts in gates:
        profile, axial = profiles(smoothed(counts), at_mm, slope, mid_wall + BEYOND_WALL_MM, dx, dy, dz)
        found = wall_ends(profile, (low + high) / 2, dz) or (low, high)
        own = [new if abs(new - old) <= BASE_MOTION_MM else old for new, old in zip(found, (low, high))]
        z = np.arange(len(profile)) * dz
        brightest = profile[(z >= own[0]) & (z <= own[1])].max()
        apex, base = own if last else own[::-1]
        single.append([base, *apices(axial, brightest, apex, base, dz)])
    single = np.array(single)
    typical = np.median([np.roll(single, shift, axis=0) for shift in (-1, 0, 1)], axis=0) if len(single) >= 3 else single
    return [
        {"axis_at_mm": at_mm, "axis_slope": slope, "radius_mm": mid_wall + CIRCLE_MARGIN_MM, "base_mm": base, "apex_mm": [inner, outer]}
        for base, inner, outer in typical
    ]
