// Projection, and the lists of Gaussians of every tile. One thread serves one Gaussian, or one entry of the lists.

// packed (N, 16): the footprint as in Footprint, then colour and opacity. box (N, 2): first and last column, which may
// pass either edge. key (N,): bits of the distance, NOT_DRAWN for what is not drawn. count (N,): tiles reached.
// slopes (N, 2): change of the distance per unit of the scaled offset, or null. culled (N,): left out, or null.
extern "C" __global__ void project(int N, const float* means, const float* log_scales, const float* quats,
                                   const float* logits, const float* colours, const unsigned char* culled,
                                   const float* cam, int W, int H, float4* packed, float2* slopes, int2* box, int* key,
                                   int* count) {
    int k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k >= N) return;
    key[k] = NOT_DRAWN;
    count[k] = 0;
    if (culled && culled[k]) return;
    Shape g;
    shape_of(means, log_scales, quats, k, cam, g);
    float o = 1.0f / (1.0f + expf(-logits[k])), S00 = g.S00 + cam[CAM_LOW], S11 = g.S11 + cam[CAM_LOW];
    float spread = 0.5f * (S00 + S11) + sqrtf(fmaxf(0.25f * (S00 - S11) * (S00 - S11) + g.S01 * g.S01, 0.0f));
    if (!(g.dist >= cam[CAM_NEAR] && g.dist < 1e9f && o > ALPHA_MIN && spread < 1e20f)) return;  // NaN fails too
    // The rectangle of latitude and longitude around the footprint.
    float cut = 2.0f * logf(o * 255.0f), reach = atanf(fminf(sqrtf(cut * spread), OFFSET_MAX));
    float reach_e = sqrtf(cut * S00), reach_s = sqrtf(cut * S11);
    float sin_lat = -g.m.y, cos_lat = sqrtf(g.m.x * g.m.x + g.m.z * g.m.z), lat = atan2f(sin_lat, cos_lat);
    float up = sin_lat + reach_s * cos_lat, down = sin_lat - reach_s * cos_lat;
    float h_up = cos_lat - reach_s * sin_lat, h_down = cos_lat + reach_s * sin_lat;
    float north = atan2f(up, up >= 0 ? h_up : sqrtf(h_up * h_up + reach_e * reach_e));
    float south = atan2f(down, down <= 0 ? h_down : sqrtf(h_down * h_down + reach_e * reach_e));
    float half = atan2f(reach_e, fminf(h_up, h_down));
    bool polar = fabsf(lat) + reach >= 0.5f * PI_F - 1e-3f || h_up <= 1e-6f || h_down <= 1e-6f;
    south = polar ? lat - reach : fmaxf(south, lat - reach);
    north = polar ? lat + reach : fminf(north, lat + reach);
    int row0 = max((int)ceilf(H * (0.5f - north / PI_F) - 0.501f), 0);
    int row1 = min((int)floorf(H * (0.5f - south / PI_F) - 0.499f), H - 1), col0 = 0, col1 = W - 1;
    if (!polar) {
        float u = W * (0.5f + atan2f(g.m.x, g.m.z) / (2 * PI_F)) - 0.5f, wide = half * W / (2 * PI_F) + 1e-3f;
        col0 = (int)ceilf(u - wide);
        col1 = (int)floorf(u + wide);
    }
    if (row1 < row0 || col1 < col0) return;
    float a = OFFSET_SCALE * g.w00, b = OFFSET_SCALE * g.w01, c = OFFSET_SCALE * g.w11;
    Vec p1 = a * g.east + b * g.south, p2 = c * g.south;
    Footprint f;
    f.p1 = make_float4(p1.x, p1.y, p1.z, log2f(o));
    f.p2 = make_float4(p2.x, p2.y, p2.z, __int_as_float(row0 | (row1 << 16)));
    f.m = make_float4(g.m.x, g.m.y, g.m.z, g.dist);
    packed[4 * k] = f.p1;
    packed[4 * k + 1] = f.p2;
    packed[4 * k + 2] = f.m;
    packed[4 * k + 3] = make_float4(colours[3 * k], colours[3 * k + 1], colours[3 * k + 2], o);
    if (slopes) {
        float ce = 0.0f, cs = 0.0f;
#pragma unroll
        for (int q = 0; q < 3; q++) {
            float radial = g.r[q] * g.sd[q] * g.sd[q] * g.inv;
            ce += g.e[q] * radial;
            cs += g.s[q] * radial;
        }
        slopes[k] = make_float2((g.w00 * ce + g.w01 * cs) / OFFSET_SCALE, g.w11 * cs / OFFSET_SCALE);
    }
    box[k] = make_int2(col0, col1);
    key[k] = __float_as_int(g.dist);
    int from[2], to[2], first, last, tiles = 0;
    tile_columns(col0, col1, W, from, to);
    for (int run = 0; run < 2; run++)
        for (int x = from[run]; x <= to[run]; x++) {
            tile_rows(f, x, W, H, cam, first, last);
            tiles += last - first + 1;
        }
    count[k] = tiles;
}

// The tiles of every Gaussian, nearest first. order (N,): by distance. ends (N,): inclusive prefix sums of the counts
// in that order. tile, owner (capacity,): what an entry belongs to.
//
// The compiler may round the tile rows differently here than in `project`, hence the two guards: entries beyond the
// count are dropped, and slots left over get NO_TILE.
extern "C" __global__ void list_tiles(int N, const long long* order, const int* ends, const float4* packed,
                                      const int2* box, const int* key, const float* cam, int W, int H, int capacity,
                                      short* tile, int* owner) {
    int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= N) return;
    int k = (int)order[i], at = i ? ends[i - 1] : 0, end = min(ends[i], capacity), tiles_x = (W + TILE - 1) / TILE;
    if (key[k] == NOT_DRAWN) return;
    Footprint f;
    f.p1 = packed[4 * k]; f.p2 = packed[4 * k + 1]; f.m = packed[4 * k + 2];
    int from[2], to[2], first, last;
    tile_columns(box[k].x, box[k].y, W, from, to);
    for (int run = 0; run < 2; run++)
        for (int x = from[run]; x <= to[run]; x++) {
            tile_rows(f, x, W, H, cam, first, last);
            for (int y = first; y <= last && at < end; y++, at++) {
                tile[at] = (short)(y * tiles_x + x);
                owner[at] = k;
            }
        }
    for (; at < end; at++) {
        tile[at] = NO_TILE;
        owner[at] = k;
    }
}

// Where each tile's entries begin and end in the sorted list. tile (L,): sorted; permutation (L,): what sorted it.
// starts, ends (tiles,): stay 0 for a tile without entries. entries (L,): the Gaussians.
extern "C" __global__ void tile_ranges(int L, const short* tile, const long long* permutation, const int* owner,
                                       int* starts, int* ends, int* entries) {
    int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= L) return;
    int t = tile[i];
    if (t != NO_TILE) {
        if (i == 0 || tile[i - 1] != t) starts[t] = i;
        if (i == L - 1 || tile[i + 1] != t) ends[t] = i + 1;
    }
    entries[i] = owner[permutation[i]];
}
