"""From Gaussians in the world to packed instances a tile can composite, and the way back for gradients.

Sphere: the exact tangent-plane footprint. With m = mu/|mu|, an orthonormal tangent basis E (2x3) and
S = E Sigma E^T / |mu|^2 + low-pass, the offset of a ray r is d = E r / (m.r), weight exp(-d^T S^-1 d / 2).
First order: Sigma_2D = J Sigma J^T + low-pass with the projection's Jacobian J (Zwicker et al., EWA splatting, 2002;
the panoramic J as in ODGS/OmniGS and the PanoGS-SLAM paper).

Derivatives: moving mu by dmu turns the basis; with (a, b) = E dmu / |mu| the offset of a fixed ray changes by
-(I + d d^T)(a, b), and E by -(a, b) m^T. Covariances are whitened as S^-1 = W^T W, t = W d.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from panobench.photometric.warp import atan2_fast
from panobench.splat.kernel_options import ALPHA_MIN, COS_MIN, JIT, PARALLEL
from panobench.splat.view import BOUND_CONES, BOUND_FLAT, BOUND_LATLON, CONIC_ERP, CONIC_PINHOLE, SPHERE

#: Largest tangent offset of a footprint: further out m.r < COS_MIN and nothing is drawn.
OFFSET_MAX = float(np.sqrt(1.0 / COS_MIN**2 - 1.0))

# Small vectors and matrices are tuples of floats here: arrays would be heap allocations, millions a second.


@njit(**JIT)
def rotation(q):  # type: ignore[no-untyped-def]
    """Quaternion (w, x, y, z), any length -> 3x3 row-major tuple, and 1/|q|."""
    a, b, c, d = float(q[0]), float(q[1]), float(q[2]), float(q[3])
    s = 1.0 / np.sqrt(max(a * a + b * b + c * c + d * d, 1e-24))
    w, x, y, z = a * s, b * s, c * s, d * s
    return (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ), s  # fmt: skip


@njit(**JIT)
def rotate(R, x, y, z):  # type: ignore[no-untyped-def]
    """R (3, 3) array times (x, y, z)."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@njit(**JIT)
def axes_in_camera(quats, log_scales, k, R_cw):  # type: ignore[no-untyped-def]
    """Gaussian k's three unit axes in the camera frame (tuples) and their standard deviations.

    Whole arrays and an index, not rows: a row would be a view, and counting references to it costs more than this.
    """
    R, _ = rotation((quats[k, 0], quats[k, 1], quats[k, 2], quats[k, 3]))
    s0 = np.exp(min(max(float(log_scales[k, 0]), -20.0), 8.0))
    s1 = np.exp(min(max(float(log_scales[k, 1]), -20.0), 8.0))
    s2 = np.exp(min(max(float(log_scales[k, 2]), -20.0), 8.0))
    return (
        rotate(R_cw, R[0], R[3], R[6]),
        rotate(R_cw, R[1], R[4], R[7]),
        rotate(R_cw, R[2], R[5], R[8]),
        (s0, s1, s2),
    )


@njit(**JIT)
def camera_covariance(axes):  # type: ignore[no-untyped-def]
    """Upper triangle (xx, xy, xz, yy, yz, zz) of the covariance with those axes."""
    a, b, c, s = axes
    u, v, w = s[0] * s[0], s[1] * s[1], s[2] * s[2]
    return (
        u * a[0] * a[0] + v * b[0] * b[0] + w * c[0] * c[0],
        u * a[0] * a[1] + v * b[0] * b[1] + w * c[0] * c[1],
        u * a[0] * a[2] + v * b[0] * b[2] + w * c[0] * c[2],
        u * a[1] * a[1] + v * b[1] * b[1] + w * c[1] * c[1],
        u * a[1] * a[2] + v * b[1] * b[2] + w * c[1] * c[2],
        u * a[2] * a[2] + v * b[2] * b[2] + w * c[2] * c[2],
    )


@njit(**JIT)
def symmetric_times(C, v):  # type: ignore[no-untyped-def]
    """C v for C = (xx, xy, xz, yy, yz, zz)."""
    return (
        C[0] * v[0] + C[1] * v[1] + C[2] * v[2],
        C[1] * v[0] + C[3] * v[1] + C[4] * v[2],
        C[2] * v[0] + C[4] * v[1] + C[5] * v[2],
    )


@njit(**JIT)
def dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**JIT)
def tangent_basis(m):  # type: ignore[no-untyped-def]
    """East and south at unit direction m (any orthonormal pair at the poles themselves)."""
    rho = np.sqrt(m[0] * m[0] + m[2] * m[2])
    if rho < 1e-9:
        return (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    e = (m[2] / rho, 0.0, -m[0] / rho)
    return e, (m[1] * e[2], m[2] * e[0] - m[0] * e[2], -m[1] * e[0])


@njit(**JIT)
def whiten(S00, S01, S11):  # type: ignore[no-untyped-def]
    """Upper-triangular W with W^T W = S^-1, so that t = W d has unit covariance."""
    w00 = 1.0 / np.sqrt(max(S00 - S01 * S01 / S11, 1e-30))
    return w00, -w00 * S01 / S11, 1.0 / np.sqrt(S11)


@njit(**JIT)
def _atan2_bound(y, x):  # type: ignore[no-untyped-def]
    """atan2 good to 3e-7 rad; footprint bounds carry far more slack than that."""
    return float(atan2_fast(np.float32(y), np.float32(x)))


@njit(**JIT)
def latlon_extent(m, reach_e, reach_s, reach):  # type: ignore[no-untyped-def]
    """Southern and northern latitude and half width in longitude of a footprint (pi: the whole row).

    reach_e, reach_s: largest tangent offsets to the east and south; reach: angular radius. The corners of the
    tangent rectangle m + e de + s ds bound every footprint that stays clear of the poles.
    """
    sin_lat, cos_lat = -m[1], np.sqrt(m[0] * m[0] + m[2] * m[2])
    lat = _atan2_bound(sin_lat, cos_lat)
    if abs(lat) + reach >= 0.5 * np.pi - 1e-3:
        return lat - reach, lat + reach, np.pi
    up, down = sin_lat + reach_s * cos_lat, sin_lat - reach_s * cos_lat
    h_up, h_down = cos_lat - reach_s * sin_lat, cos_lat + reach_s * sin_lat
    if h_up <= 1e-6 or h_down <= 1e-6:
        return lat - reach, lat + reach, np.arcsin(min(np.sin(reach) / cos_lat, 1.0))
    north = _atan2_bound(up, h_up if up >= 0 else np.sqrt(h_up * h_up + reach_e * reach_e))
    south = _atan2_bound(down, h_down if down <= 0 else np.sqrt(h_down * h_down + reach_e * reach_e))
    half = _atan2_bound(reach_e, min(h_up, h_down))
    return max(south, lat - reach), min(north, lat + reach), half


@njit(**JIT)
def first_order(mu, code, intr):  # type: ignore[no-untyped-def]
    """First-order projection: u, v, rows of J, and whether x/z, y/z were clamped inside J (pinhole, as 3DGS)."""
    x, y, z = mu
    if code == CONIC_ERP:
        a, b = intr[0] / (2 * np.pi), intr[1] / np.pi
        rho2 = max(x * x + z * z, 1e-12)
        rho = np.sqrt(rho2)
        r2 = rho2 + y * y
        u, v = 0.5 * intr[0] + a * np.arctan2(x, z), 0.5 * intr[1] + b * np.arctan2(y, rho)
        J0 = (a * z / rho2, 0.0, -a * x / rho2)
        J1 = (-b * x * y / (r2 * rho), b * rho / r2, -b * z * y / (r2 * rho))
        return u, v, J0, J1, False, False
    fx, fy, lx, ly = intr[2], intr[3], intr[6], intr[7]
    tx, ty = x / z, y / z
    u, v = fx * tx + intr[4], fy * ty + intr[5]
    cx, cy = abs(tx) > lx, abs(ty) > ly
    tx, ty = min(max(tx, -lx), lx), min(max(ty, -ly), ly)
    return u, v, (fx / z, 0.0, -fx * tx / z), (0.0, fy / z, -fy * ty / z), cx, cy


@njit(**JIT)
def flat_extent(m, e, s, Q00, Q01, Q11, A22, axis, focal, centre, size):  # type: ignore[no-untyped-def]
    """First and last pixel column (axis 0) or row (1) of a footprint wholly in front of a pinhole camera.

    The planes x = t z through the eye that touch the ellipse m + E^T d, d^T Q^-1 d = 1, are the roots of
    n^T (m m^T - E^T Q E) n = 0 with n = (1, 0, -t).
    """
    A00 = m[axis] * m[axis] - (Q00 * e[axis] * e[axis] + 2.0 * Q01 * e[axis] * s[axis] + Q11 * s[axis] * s[axis])
    A02 = m[axis] * m[2] - (Q00 * e[axis] * e[2] + Q01 * (e[axis] * s[2] + s[axis] * e[2]) + Q11 * s[axis] * s[2])
    root = np.sqrt(max(A02 * A02 - A00 * A22, 0.0))
    low, high = focal * (A02 - root) / A22 + centre, focal * (A02 + root) / A22 + centre
    first = int(np.ceil(min(max(low, -1.0), size + 1.0) - 0.5 - 1e-3))
    last = int(np.floor(min(max(high, -1.0), size + 1.0) - 0.5 + 1e-3))
    return max(first, 0), min(last, int(size) - 1)


@njit(**JIT)
def side_extent(m, reach, sin_reach, axis, focal, centre, size):  # type: ignore[no-untyped-def]
    """As ``flat_extent`` for a cone that reaches behind the camera: planes through the eye at angle phi +- half."""
    h = np.sqrt(m[axis] * m[axis] + m[2] * m[2])
    if h <= sin_reach:
        return 0, int(size) - 1
    phi, half = np.arctan2(m[axis], m[2]), np.arcsin(min(sin_reach / h, 1.0)) + 1e-4
    low, high = phi - half, phi + half
    edge = 0.5 * np.pi - 1e-3
    first, last = 0, int(size) - 1
    if low >= edge or high <= -edge:
        return 1, 0
    if low > -edge:
        first = max(int(np.ceil(min(max(focal * np.tan(low) + centre, -1.0), size + 1.0) - 0.5)), 0)
    if high < edge:
        last = min(int(np.floor(min(max(focal * np.tan(high) + centre, -1.0), size + 1.0) - 0.5)), int(size) - 1)
    return first, last


@njit(**PARALLEL)
def project(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logits, colours, R_cw, t_cw, code, bound, intr, pixel_angle, low_pass, near,
    sloped, packed, rows, cols, key,
):  # fmt: skip
    """Project N Gaussians; writes one packed row each and key = distance (-1: not visible).

    packed columns: 0-2 p1, 3-5 p2, 6-8 m, 9 opacity, 10-12 colour, 13 distance, 14 largest |t|^2 that still
    gives alpha >= 1/255, 15 column of the mean (first-order ERP), 16 cos and 17 sin of the angular radius,
    18, 19 change of distance per unit of t: the mean of the distance given the direction, which on a Gaussian
    flattened along a wall is the wall's (zero unless ``sloped``: then every pixel gets the centre's distance).
    rows (N, 2), cols (N, 2): first and last pixel row and column; columns may run past the edge of a panorama.
    """
    W, H = intr[0], intr[1]
    low = low_pass * pixel_angle * pixel_angle
    for k in prange(means.shape[0]):
        key[k] = np.float32(-1.0)
        mx, my, mz = rotate(R_cw, float(means[k, 0]), float(means[k, 1]), float(means[k, 2]))
        mu = (mx + t_cw[0], my + t_cw[1], mz + t_cw[2])
        dist = np.sqrt(dot(mu, mu))
        if not (dist >= near and dist < 1e9) or (code == CONIC_PINHOLE and mu[2] < near):
            continue
        o = 1.0 / (1.0 + np.exp(-float(logits[k])))
        if not o > ALPHA_MIN:
            continue
        q_cut = 2.0 * np.log(o / ALPHA_MIN)
        C = camera_covariance(axes_in_camera(quats, log_scales, k, R_cw))
        packed[k, 18], packed[k, 19] = 0.0, 0.0
        if code == SPHERE:
            m = (mu[0] / dist, mu[1] / dist, mu[2] / dist)
            e, s = tangent_basis(m)
            Ce, Cs = symmetric_times(C, e), symmetric_times(C, s)
            inv2 = 1.0 / (dist * dist)
            S00, S01, S11 = dot(e, Ce) * inv2 + low, dot(s, Ce) * inv2, dot(s, Cs) * inv2 + low
            w00, w01, w11 = whiten(S00, S01, S11)
            for i in range(3):
                packed[k, i] = w00 * e[i] + w01 * s[i]
                packed[k, 3 + i] = w11 * s[i]
                packed[k, 6 + i] = m[i]
            if sloped:
                ce, cs = dot(m, Ce) / dist, dot(m, Cs) / dist
                packed[k, 18], packed[k, 19] = w00 * ce + w01 * cs, w11 * cs
            spread = 0.5 * (S00 + S11) + np.sqrt(max(0.25 * (S00 - S11) ** 2 + S01 * S01, 0.0))
            offset = min(np.sqrt(q_cut * spread), OFFSET_MAX)
            reach = _atan2_bound(offset, 1.0)
            packed[k, 16] = 1.0 / np.sqrt(1.0 + offset * offset)
            packed[k, 15], packed[k, 17] = 0.0, offset * packed[k, 16]
            if bound == BOUND_LATLON:
                south, north, half = latlon_extent(m, np.sqrt(q_cut * S00), np.sqrt(q_cut * S11), reach)
                rows[k, 0] = max(int(np.ceil(H * (0.5 - north / np.pi) - 0.5 - 1e-3)), 0)
                rows[k, 1] = min(int(np.floor(H * (0.5 - south / np.pi) - 0.5 + 1e-3)), int(H) - 1)
                if half >= np.pi:
                    cols[k, 0], cols[k, 1] = 0, int(W) - 1
                else:
                    u = W * (0.5 + _atan2_bound(m[0], m[2]) / (2 * np.pi)) - 0.5
                    half = half * W / (2 * np.pi) + 1e-3
                    cols[k, 0], cols[k, 1] = int(np.ceil(u - half)), int(np.floor(u + half))
            else:
                rows[k, 0], rows[k, 1], cols[k, 0], cols[k, 1] = 0, int(H) - 1, 0, int(W) - 1
                if bound == BOUND_FLAT:
                    Q00, Q01, Q11 = q_cut * S00, q_cut * S01, q_cut * S11
                    A22 = m[2] * m[2] - (Q00 * e[2] * e[2] + 2.0 * Q01 * e[2] * s[2] + Q11 * s[2] * s[2])
                    if A22 > 1e-6:
                        if m[2] < 0.0:
                            continue
                        cols[k, 0], cols[k, 1] = flat_extent(m, e, s, Q00, Q01, Q11, A22, 0, intr[2], intr[4], W)
                        rows[k, 0], rows[k, 1] = flat_extent(m, e, s, Q00, Q01, Q11, A22, 1, intr[3], intr[5], H)
                    else:
                        cols[k, 0], cols[k, 1] = side_extent(m, reach, packed[k, 17], 0, intr[2], intr[4], W)
                        rows[k, 0], rows[k, 1] = side_extent(m, reach, packed[k, 17], 1, intr[3], intr[5], H)
        else:
            u, v, J0, J1, _, _ = first_order(mu, code, intr)
            C0, C1 = symmetric_times(C, J0), symmetric_times(C, J1)
            S00, S01, S11 = dot(J0, C0) + low_pass, dot(J0, C1), dot(J1, C1) + low_pass
            w00, w01, w11 = whiten(S00, S01, S11)
            packed[k, 0], packed[k, 1], packed[k, 2] = w00, w01, -(w00 * u + w01 * v)
            packed[k, 3], packed[k, 4], packed[k, 5] = 0.0, w11, -w11 * v
            packed[k, 6], packed[k, 7], packed[k, 8] = 0.0, 0.0, 1.0
            packed[k, 15], packed[k, 16], packed[k, 17] = u, 0.0, 1.0
            if sloped:
                c0, c1 = dot(mu, C0) / dist, dot(mu, C1) / dist
                packed[k, 18], packed[k, 19] = w00 * c0 + w01 * c1, w11 * c1
            ru, rv = np.sqrt(q_cut * S00) + 1e-3, np.sqrt(q_cut * S11) + 1e-3
            rows[k, 0] = max(int(np.ceil(max(v - rv, -1.0) - 0.5)), 0)
            rows[k, 1] = min(int(np.floor(min(v + rv, H + 1.0) - 0.5)), int(H) - 1)
            if code == CONIC_ERP:
                ru = min(ru, 0.5 * W - 1.0)
                cols[k, 0], cols[k, 1] = int(np.ceil(u - ru - 0.5)), int(np.floor(u + ru - 0.5))
            else:
                cols[k, 0] = max(int(np.ceil(max(u - ru, -1.0) - 0.5)), 0)
                cols[k, 1] = min(int(np.floor(min(u + ru, W + 1.0) - 0.5)), int(W) - 1)
        if rows[k, 1] < rows[k, 0] or cols[k, 1] < cols[k, 0]:
            continue
        packed[k, 9], packed[k, 13], packed[k, 14] = o, dist, q_cut
        for c in range(3):
            packed[k, 10 + c] = colours[k, c]
        key[k] = np.float32(dist)


@njit(**JIT)
def radix_order(key):  # type: ignore[no-untyped-def]
    """Indices of the keys (N,) float32 >= 0 in ascending order; ties keep their index order."""
    n = 0
    for k in range(len(key)):
        if key[k] >= 0:
            n += 1
    a, b = np.empty(n, np.int32), np.empty(n, np.int32)
    n = 0
    for k in range(len(key)):
        if key[k] >= 0:
            a[n] = k
            n += 1
    bits = key.view(np.uint32)  # the bit patterns of non-negative floats sort like the floats
    for step in range(3):
        shift, mask = np.uint32(11 * step), np.uint32(0x7FF)
        counts = np.zeros(2049, np.int64)
        for i in range(n):
            counts[((bits[a[i]] >> shift) & mask) + 1] += 1
        for i in range(2048):
            counts[i + 1] += counts[i]
        for i in range(n):
            d = (bits[a[i]] >> shift) & mask
            b[counts[d]] = a[i]
            counts[d] += 1
        a, b = b, a
    return a


@njit(**PARALLEL)
def gather(order, packed, rows, cols):  # type: ignore[no-untyped-def]
    """Rows of the three arrays in ``order``; fancy indexing takes several times as long."""
    n = len(order)
    p, r, c = np.empty((n, packed.shape[1]), np.float32), np.empty((n, 2), np.int32), np.empty((n, 2), np.int32)
    for j in prange(n):
        k = order[j]
        for i in range(packed.shape[1]):
            p[j, i] = packed[k, i]
        r[j, 0], r[j, 1], c[j, 0], c[j, 1] = rows[k, 0], rows[k, 1], cols[k, 0], cols[k, 1]
    return p, r, c


@njit(**JIT)
def _cone_meets(p, cone):  # type: ignore[no-untyped-def]
    """Does the instance's cone meet the tile's? cos(angle) >= cos(reach + radius), unless the sum exceeds pi."""
    c = cone[3]
    if c > 1.5:
        return False
    s = np.sqrt(max(1.0 - c * c, 0.0))
    if p[17] * c + p[16] * s < 0:  # sin(reach + radius) < 0: together they span more than a half turn
        return True
    return p[6] * cone[0] + p[7] * cone[1] + p[8] * cone[2] >= p[16] * c - p[17] * s - 1e-6


@njit(**JIT)
def _visit(k, packed, rows, cols, W, tile_w, tile_h, tiles_x, tiles, bound, cones, drawn, cursor, entries):  # type: ignore[no-untyped-def]
    """Advance ``cursor`` of every drawn tile instance k may touch, writing k there unless ``entries`` is empty."""
    fill = len(entries) > 0
    if bound == BOUND_CONES:
        for t in range(tiles):
            if drawn[t] and _cone_meets(packed[k], cones[t]):
                if fill:
                    entries[cursor[t]] = k
                cursor[t] += 1
        return
    y0, y1 = rows[k, 0] // tile_h, rows[k, 1] // tile_h
    c0, c1 = cols[k, 0], cols[k, 1]
    if c1 - c0 >= W - 1:
        c0, c1 = 0, W - 1
    # A panorama's footprint may pass either edge: at most two runs of columns.
    for part in range(2):
        if part == 0:
            x0, x1 = max(c0, 0), min(c1, W - 1)
        elif c0 < 0:
            x0, x1 = max(c0 + W, c1 // tile_w * tile_w + tile_w), W - 1
        elif c1 >= W:
            x0, x1 = 0, min(c1 - W, c0 // tile_w * tile_w - 1)
        else:
            break
        if x1 < x0:
            continue
        for ty in range(y0, y1 + 1):
            for t in range(ty * tiles_x + x0 // tile_w, ty * tiles_x + x1 // tile_w + 1):
                if drawn[t]:
                    if fill:
                        entries[cursor[t]] = k
                    cursor[t] += 1


@njit(**PARALLEL)
def bin_tiles(packed, rows, cols, W, tile_w, tile_h, tiles_x, tiles_y, bound, cones, drawn, threads):  # type: ignore[no-untyped-def]
    """Tile lists in depth order for instances already sorted by depth: starts (tiles + 1,), entries (E,).

    drawn (tiles,): tiles that need a list; the others' stay empty.

    Each thread takes a run of instances; its entries stand behind those of nearer runs, so the lists do not depend
    on the number of threads.
    """
    tiles, n = tiles_x * tiles_y, len(rows)
    block = (n + threads - 1) // threads
    cursor = np.zeros((threads, tiles), np.int64)
    nothing = np.empty(0, np.int32)
    for th in prange(threads):
        for k in range(th * block, min((th + 1) * block, n)):
            _visit(k, packed, rows, cols, W, tile_w, tile_h, tiles_x, tiles, bound, cones, drawn, cursor[th], nothing)
    starts = np.zeros(tiles + 1, np.int64)
    for t in range(tiles):
        total = starts[t]
        for th in range(threads):
            count = cursor[th, t]
            cursor[th, t] = total
            total += count
        starts[t + 1] = total
    entries = np.empty(max(starts[tiles], 1), np.int32)
    for th in prange(threads):
        for k in range(th * block, min((th + 1) * block, n)):
            _visit(k, packed, rows, cols, W, tile_w, tile_h, tiles_x, tiles, bound, cones, drawn, cursor[th], entries)
    return starts, entries
