// Which rows of pixels a footprint reaches in a column of pixels; see splat/row_bounds.py and splat/footprint.py.

// The footprint of a Gaussian: p1 and log2(opacity); p2 and the bits of its first row | last row << 16; its direction
// and distance.
struct Footprint {
    float4 p1, p2, m;
};
__device__ __forceinline__ int first_row(Footprint f) { return __float_as_int(f.p2.w) & 0xffff; }
__device__ __forceinline__ int last_row(Footprint f) { return __float_as_int(f.p2.w) >> 16; }

// Rows [first, last], as floats, of an image with H rows that f reaches within atan(half) of the longitude whose sine
// and cosine are given; first exceeds last where it reaches none.
__device__ __forceinline__ void rows_in_column(Footprint f, float sn, float cs, float half, float bend, int H,
                                               float& first, float& last) {
    float cut = f.p1.w + LOG2_255;
    // a and x are the directions to the middle of the column and to the east of it.
    float p1a = f.p1.x * sn + f.p1.z * cs, p2a = f.p2.x * sn + f.p2.z * cs, ma = f.m.x * sn + f.m.z * cs;
    float p1x = f.p1.x * cs - f.p1.z * sn, p2x = f.p2.x * cs - f.p2.z * sn, mx = f.m.x * cs - f.m.z * sn;
    float qa = cut * ma, qx = cut * mx, qy = cut * f.m.y;
    float Qaa = p1a * p1a + p2a * p2a - qa * ma, Qax = p1a * p1x + p2a * p2x - qa * mx;
    float Qxx = p1x * p1x + p2x * p2x - qx * mx, Qay = p1a * f.p1.y + p2a * f.p2.y - qa * f.m.y;
    float Qxy = p1x * f.p1.y + p2x * f.p2.y - qx * f.m.y, Qyy = f.p1.y * f.p1.y + f.p2.y * f.p2.y - qy * f.m.y;
    float det = Qxx * Qyy - Qxy * Qxy;
    first = -1.0f;
    last = H + 1.0f;
    if (!(Qxx > 0 && Qyy > 0 && det > 1e-4f * Qxx * Qyy)) return;  // no ellipse, or too thin a one: every row
    float inv_det = 1.0f / det, inv = 1.0f / Qyy;
    float d0 = Qay * Qay - Qyy * Qaa, d1 = Qay * Qxy - Qyy * Qax, middle = d1 * inv_det;
    float wide = sqrtf(fmaxf(middle * middle + d0 * inv_det, 0.0f));
    float left = fmaxf(-half, middle - wide), right = fminf(half, middle + wide);
    if (!(left <= right)) {
        first = H + 1.0f;
        last = -1.0f;
        return;
    }
    float aside = -Qxy * wide / sqrtf(Qxx * Qyy);
    float low = fminf(fmaxf(middle - aside, left), right), high = fminf(fmaxf(middle + aside, left), right);
    float root_low = sqrtf(fmaxf(d0 + low * (d1 + d1 - det * low), 0.0f));
    float root_high = sqrtf(fmaxf(d0 + high * (d1 + d1 - det * high), 0.0f));
    float least = -(Qay + low * Qxy + root_low) * inv, largest = (root_high - Qay - high * Qxy) * inv;
    least *= least < 0 ? 1.0f : bend;
    largest *= largest < 0 ? bend : 1.0f;
    first = H * (atanf(least) * (1.0f / PI_F) + 0.5f) - 0.52f;  // half a pixel, and slack for rounding
    last = H * (atanf(largest) * (1.0f / PI_F) + 0.5f) - 0.48f;
}

// As rows_in_column for column c of columns that are `width` pixels wide, as whole rows within the footprint's own.
__device__ __forceinline__ void whole_rows(Footprint f, int c, int width, int W, int H, float half, float bend,
                                           int& first, int& last) {
    float sn, cs, a, b;
    sincospif((2.0f * (c + 0.5f) * width) / W - 1.0f, &sn, &cs);
    rows_in_column(f, sn, cs, half, bend, H, a, b);
    first = max((int)ceilf(fmaxf(a, -1.0f)), first_row(f));
    last = min((int)floorf(fminf(b, H + 1.0f)), last_row(f));
}

// Rows of tiles [first, last] in column c of tiles.
__device__ __forceinline__ void tile_rows(Footprint f, int c, int W, int H, const float* cam, int& first, int& last) {
    int a, b;
    whole_rows(f, c, TILE, W, H, cam[CAM_TILE_HALF], cam[CAM_TILE_BEND], a, b);
    first = a / TILE;
    last = b < a ? first - 1 : b / TILE;
}

// Columns of tiles as two runs [from[i], to[i]], of pixel columns c0..c1 that may pass either edge of the panorama.
__device__ __forceinline__ void tile_columns(int c0, int c1, int W, int* from, int* to) {
    int end = (W - 1) / TILE;
    from[0] = 0; to[0] = end; from[1] = 1; to[1] = 0;
    if (c1 - c0 >= W - 1) return;
    from[0] = max(c0, 0) / TILE;
    to[0] = min(c1, W - 1) / TILE;
    if (c0 < 0) {
        from[1] = max((c0 + W) / TILE, to[0] + 1);
        to[1] = end;
    } else if (c1 >= W) {
        from[1] = 0;
        to[1] = min((c1 - W) / TILE, from[0] - 1);
    }
}

// Bit w is set where warp w's pixels of the tile at (x0, y0) may be reached.
__device__ __forceinline__ unsigned warps_reached(Footprint f, int x0, int y0, int W, int H, const float* cam) {
    unsigned mask = 0;
#pragma unroll
    for (int c = 0; c < TILE / SUB_W; c++) {
        int a, b;
        whole_rows(f, x0 / SUB_W + c, SUB_W, W, H, cam[CAM_SUB_HALF], cam[CAM_SUB_BEND], a, b);
        a = max(a - y0, 0);
        b = min(b - y0, TILE - 1);
        if (b < a) continue;
#pragma unroll
        for (int r = 0; r < TILE / SUB_H; r++)
            if (r >= a / SUB_H && r <= b / SUB_H) mask |= 1u << (2 * r + c);
    }
    return mask;
}
