// Compositing of the tiles, forward and backward. A block serves a tile, a thread a pixel; a warp owns 8 x 4 of them.
//
// A block stages its entries 256 at a time in shared memory. Each thread says of one entry which warps' pixels it may
// reach; ballots turn this into a word of bits per warp, so that a warp visits only the entries that concern it.

// Registers are bounded so that a multiprocessor holds at least this many blocks.
#define BLOCKS 4

struct Pixel {
    int u, v;
    bool inside;
    Vec ray;
};
__device__ __forceinline__ Pixel pixel_of(int tile, int W, int H, const float* rays) {
    int tiles_x = (W + TILE - 1) / TILE, lane = threadIdx.x & 31, warp = threadIdx.x >> 5;
    Pixel p;
    p.u = (tile % tiles_x) * TILE + (warp & 1) * SUB_W + (lane & 7);
    p.v = (tile / tiles_x) * TILE + (warp >> 1) * SUB_H + (lane >> 3);
    p.inside = p.u < W && p.v < H;
    int at = p.v * W + p.u, n = W * H;
    p.ray = p.inside ? vec(rays[at], rays[at + n], rays[at + 2 * n]) : vec(0, 0, 0);
    return p;
}

// Alpha before it is clipped to ALPHA_MAX, 0 below ALPHA_MIN; t1, t2: the scaled offset.
__device__ __forceinline__ float alpha_at(float4 p1, float4 p2, float4 m, Vec ray, float& t1, float& t2) {
    float cosine = dot(m, ray), inv = reciprocal_fast(fmaxf(cosine, COS_MIN));
    t1 = dot(p1, ray) * inv;
    t2 = dot(p2, ray) * inv;
    float alpha = exp2_fast(p1.w - t1 * t1 - t2 * t2);
    return alpha >= ALPHA_MIN && cosine > COS_MIN ? alpha : 0.0f;
}

// Up to 256 entries of a tile in shared memory.
struct Stage {
    float4 p1[THREADS], p2[THREADS], m[THREADS], colour[THREADS];
    int id[THREADS];
    unsigned words[WARPS][WARPS];  // [warp][k]: bit j is set where entry 32 k + j concerns the warp
};
// Fill it with the entries from base on. All threads take part, and wait for each other afterwards.
__device__ __forceinline__ void fill(Stage& stage, int tile, int base, int end, const int* entries,
                                     const float4* packed, const float* cam, int W, int H) {
    int thread = threadIdx.x, lane = thread & 31, warp = thread >> 5, tiles_x = (W + TILE - 1) / TILE;
    unsigned reached = 0;
    if (base + thread < end) {
        int id = entries[base + thread];
        Footprint f;
        f.p1 = packed[4 * id]; f.p2 = packed[4 * id + 1]; f.m = packed[4 * id + 2];
        stage.id[thread] = id;
        stage.p1[thread] = f.p1; stage.p2[thread] = f.p2; stage.m[thread] = f.m;
        stage.colour[thread] = packed[4 * id + 3];
        reached = warps_reached(f, (tile % tiles_x) * TILE, (tile / tiles_x) * TILE, W, H, cam);
    }
#pragma unroll
    for (int w = 0; w < WARPS; w++) {
        unsigned word = __ballot_sync(FULL, (reached >> w) & 1);
        if (lane == 0) stage.words[w][warp] = word;
    }
    __syncthreads();
}

// tiles: those that are drawn, one for each block. colour (3, H, W), depth, opacity (H, W). used (tiles, WARPS): where
// each warp stopped in its tile's list.
// MEASURED: depth along slopes (N, 2), pixels touched (N,) and sums of weights (N,); each of these may be null.
template <bool MEASURED>
__device__ __forceinline__ void forward_tile(const int* tiles, const int* starts, const int* ends, const int* entries,
                                             const float4* packed, const float* rays, const float* cam, int W, int H,
                                             float* colour, float* depth, float* opacity, int* used,
                                             const float2* slopes, int* touched, float* weights) {
    __shared__ Stage stage;
    int tile = tiles[blockIdx.x], lane = threadIdx.x & 31, warp = threadIdx.x >> 5, end = ends[tile], until = end;
    float stop = cam[CAM_STOP];
    Pixel p = pixel_of(tile, W, H, rays);
    float T = p.inside ? 1.0f : 0.0f, R = 0.0f, G = 0.0f, B = 0.0f, D = 0.0f;
    bool done = !__any_sync(FULL, p.inside);
    for (int base = starts[tile]; base < end; base += THREADS) {
        if (__syncthreads_and(done)) break;
        fill(stage, tile, base, end, entries, packed, cam, W, H);
        for (int k = 0; k < WARPS && !done; k++) {
            unsigned word = stage.words[warp][k];
            if (!word) continue;
            while (word) {
                int j = 32 * k + __ffs(word) - 1;
                word &= word - 1;
                float4 m = stage.m[j], c = stage.colour[j];
                float t1, t2, alpha = alpha_at(stage.p1[j], stage.p2[j], m, p.ray, t1, t2);
                float w = fminf(alpha, ALPHA_MAX) * T, d = m.w;
                if (MEASURED) {
                    int id = stage.id[j];
                    if (slopes) d += slopes[id].x * t1 + slopes[id].y * t2;
                    if (touched) {
                        unsigned hit = __ballot_sync(FULL, alpha > 0 && T > 0.5f);
                        if (lane == 0 && hit) atomicAdd(&touched[id], __popc(hit));
                    }
                    if (weights) {
                        float sum = warp_sum(w);
                        if (lane == 0 && sum > 0) atomicAdd(&weights[id], sum);
                    }
                }
                R += w * c.x; G += w * c.y; B += w * c.z; D += w * d;
                T -= w;
            }
            if (!__any_sync(FULL, T >= stop && T > 0)) {
                done = true;
                until = min(base + 32 * (k + 1), end);
            }
        }
    }
    if (lane == 0) used[tile * WARPS + warp] = until;
    if (!p.inside) return;
    int at = p.v * W + p.u, n = W * H;
    colour[at] = R; colour[at + n] = G; colour[at + 2 * n] = B;
    depth[at] = D;
    opacity[at] = 1.0f - T;
}

extern "C" __global__ void __launch_bounds__(THREADS, BLOCKS)
forward(const int* tiles, const int* starts, const int* ends, const int* entries, const float4* packed,
        const float* rays, const float* cam, int W, int H, float* colour, float* depth, float* opacity, int* used) {
    forward_tile<false>(tiles, starts, ends, entries, packed, rays, cam, W, H, colour, depth, opacity, used, 0, 0, 0);
}
extern "C" __global__ void __launch_bounds__(THREADS, BLOCKS)
forward_measured(const int* tiles, const int* starts, const int* ends, const int* entries, const float4* packed,
                 const float* rays, const float* cam, int W, int H,
                 float* colour, float* depth, float* opacity, int* used,
                 const float2* slopes, int* touched, float* weights) {
    forward_tile<true>(tiles, starts, ends, entries, packed, rays, cam, W, H, colour, depth, opacity, used, slopes,
                       touched, weights);
}

// One step of a sum of values over a warp in which each lane keeps half of the values: those of the first COUNT if bit
// DISTANCE of its number is clear, else the COUNT after these.
template <int COUNT>
__device__ __forceinline__ void share(float* v, int lane, int distance) {
    bool upper = lane & distance;
#pragma unroll
    for (int i = 0; i < COUNT; i++) {
        float give = upper ? v[i] : v[i + COUNT], keep = upper ? v[i + COUNT] : v[i];
        v[i] = keep + __shfl_xor_sync(FULL, give, distance);
    }
}
// Which of twelve values a lane holds after sum_of_twelve; -1 for a lane that holds none of its own.
__device__ __forceinline__ int value_held(int lane) {
    int low = ((lane >> 1) & 1) + 2 * ((lane >> 2) & 1);
    return (lane & 1) || low == 3 ? -1 : low + 3 * ((lane >> 3) & 1) + 6 * (lane >> 4);
}
// Sums of twelve values over a warp by 13 shuffles; v is used up.
__device__ __forceinline__ float sum_of_twelve(float* v, int lane) {
    share<6>(v, lane, 16);
    share<3>(v, lane, 8);
    v[3] = 0.0f;
    share<2>(v, lane, 4);
    share<1>(v, lane, 2);
    return v[0] + __shfl_xor_sync(FULL, v[0], 1);
}

// moments (N, MOMENT_ROW) += as MomentColumns, of the scaled offset. DEEP: with d_depth and d_opacity (H, W), which
// mapping lacks; the other arguments as forward_tile got and wrote them.
template <bool DEEP>
__device__ __forceinline__ void backward_tile(const int* tiles, const int* starts, const int* ends, const int* entries,
                                              const float4* packed, const float* rays, const float* cam, int W, int H,
                                              const float* colour, const float* depth, const float* opacity,
                                              const int* used, const float* d_colour, const float* d_depth,
                                              const float* d_opacity, float* moments) {
    __shared__ Stage stage;
    int tile = tiles[blockIdx.x], lane = threadIdx.x & 31, warp = threadIdx.x >> 5, end = ends[tile];
    int until = used[tile * WARPS + warp], held = value_held(lane), n = W * H;
    Pixel p = pixel_of(tile, W, H, rays);
    float T = 0.0f, behind = 0.0f, dr = 0.0f, dg = 0.0f, db = 0.0f, dd = 0.0f, d_o = 0.0f;
    if (p.inside) {
        int at = p.v * W + p.u;
        T = 1.0f;
        dr = d_colour[at]; dg = d_colour[at + n]; db = d_colour[at + 2 * n];
        behind = dr * colour[at] + dg * colour[at + n] + db * colour[at + 2 * n];
        if (DEEP) {
            dd = d_depth[at]; d_o = d_opacity[at];
            behind += dd * depth[at] + d_o * opacity[at];
        }
    }
    for (int base = starts[tile]; base < end; base += THREADS) {
        if (__syncthreads_and(base >= until)) break;
        fill(stage, tile, base, end, entries, packed, cam, W, H);
        for (int k = 0; k < WARPS && base + 32 * k < until; k++) {
            unsigned word = stage.words[warp][k];
            while (word) {
                int j = 32 * k + __ffs(word) - 1;
                word &= word - 1;
                float4 m = stage.m[j];
                float t1, t2, raw = alpha_at(stage.p1[j], stage.p2[j], m, p.ray, t1, t2);
                if (!__any_sync(FULL, raw > 0 && p.inside)) continue;
                float4 c = stage.colour[j];
                float alpha = fminf(raw, ALPHA_MAX), w = alpha * T;
                float value = dr * c.x + dg * c.y + db * c.z;
                if (DEEP) value += dd * m.w + d_o;
                behind -= w * value;
                // dL/d(alpha) = T value - behind / (1 - alpha); times alpha it is dL/d(exponent), 0 where clipped.
                float g = raw < ALPHA_MAX ? alpha * (T * value - behind * reciprocal_fast(1.0f - alpha)) : 0.0f;
                T -= w;
                float g1 = g * t1, g2 = g * t2, g3 = g * (t1 * t1 + t2 * t2);
                float v[12] = {g,       g1,      g2,     g1 * t1, g1 * t2, g2 * t2,
                               g3 * t1, g3 * t2, w * dr, w * dg,  w * db,  DEEP ? w * dd : 0.0f};
                float sum = sum_of_twelve(v, lane);
                if (held >= 0) atomicAdd(&moments[MOMENT_ROW * stage.id[j] + held], sum);
            }
        }
    }
}

extern "C" __global__ void __launch_bounds__(THREADS, BLOCKS)
backward(const int* tiles, const int* starts, const int* ends, const int* entries, const float4* packed,
         const float* rays, const float* cam, int W, int H,
         const float* colour, const float* depth, const float* opacity,
         const int* used, const float* d_colour, float* moments) {
    backward_tile<false>(tiles, starts, ends, entries, packed, rays, cam, W, H, colour, depth, opacity, used, d_colour,
                         0, 0, moments);
}
extern "C" __global__ void __launch_bounds__(THREADS, BLOCKS)
backward_deep(const int* tiles, const int* starts, const int* ends, const int* entries, const float4* packed,
              const float* rays, const float* cam, int W, int H,
              const float* colour, const float* depth, const float* opacity,
              const int* used, const float* d_colour, const float* d_depth, const float* d_opacity, float* moments) {
    backward_tile<true>(tiles, starts, ends, entries, packed, rays, cam, W, H, colour, depth, opacity, used, d_colour,
                        d_depth, d_opacity, moments);
}
