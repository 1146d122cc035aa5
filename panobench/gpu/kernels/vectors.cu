// Constants, small vectors and the approximations of the special function units, for all kernels.
//
// The files of this folder are compiled as one, in the order of `source.py`: by NVRTC for a GPU, by g++ behind
// `emulator.h` for tests. They include nothing.

#define TILE 16                // pixels: width and height of a tile
#define SUB_W 8                // pixels that a warp owns: 8 columns of 4 rows
#define SUB_H 4
#define WARPS 8                // of a block that owns a tile
#define THREADS 256
#define FULL 0xffffffffu
#define ALPHA_MIN (1.0f / 255.0f)
#define ALPHA_MAX 0.99f
#define COS_MIN 0.1f
#define OFFSET_MAX 9.9498744f  // sqrt(1 / COS_MIN^2 - 1)
// Offsets are scaled by sqrt(log2(e) / 2), so that alpha = 2^(log2(opacity) - |t|^2).
#define OFFSET_SCALE 0.84932180f
#define LOG2_255 7.9943534f
#define PI_F 3.14159265358979f
#define PARAMETERS 14          // mean 0-2, log scale 3-5, quaternion 6-9, logit 10, colour 11-13
#define MOMENT_ROW 16          // 12 are used; a row is 64 bytes
#define NOT_DRAWN 0x7fffffff   // key of a Gaussian that is not drawn
#define NO_TILE (-1)

// The camera, floats in device memory: world to camera, the low pass in rad^2, the least distance, the transmittance
// at which a pixel is finished; then of a column of tiles and of a column of sub-tiles the tangent of half its width,
// and 1 / sqrt(1 + its square), by which parallels bend.
enum {
    CAM_R = 0, CAM_T = 9, CAM_LOW = 12, CAM_NEAR, CAM_STOP, CAM_TILE_HALF, CAM_TILE_BEND, CAM_SUB_HALF, CAM_SUB_BEND
};

#ifdef EMULATED
static inline float exp2_fast(float x) { return exp2f(x); }
static inline float reciprocal_fast(float x) { return 1.0f / x; }
#else
__device__ __forceinline__ float exp2_fast(float x) {
    float y;
    asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
}
__device__ __forceinline__ float reciprocal_fast(float x) {
    float y;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
}
#endif

struct Vec {
    float x, y, z;
};
__device__ __forceinline__ Vec vec(float x, float y, float z) {
    Vec v;
    v.x = x; v.y = y; v.z = z;
    return v;
}
__device__ __forceinline__ Vec vec(const float* p) { return vec(p[0], p[1], p[2]); }
__device__ __forceinline__ Vec operator+(Vec a, Vec b) { return vec(a.x + b.x, a.y + b.y, a.z + b.z); }
__device__ __forceinline__ Vec operator*(float f, Vec a) { return vec(f * a.x, f * a.y, f * a.z); }
__device__ __forceinline__ float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
__device__ __forceinline__ float dot(float4 a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
__device__ __forceinline__ Vec cross(Vec a, Vec b) {
    return vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
// R v and R^T v for a matrix (3, 3) by rows.
__device__ __forceinline__ Vec rotate(const float* R, Vec v) {
    return vec(R[0] * v.x + R[1] * v.y + R[2] * v.z, R[3] * v.x + R[4] * v.y + R[5] * v.z,
               R[6] * v.x + R[7] * v.y + R[8] * v.z);
}
__device__ __forceinline__ Vec unrotate(const float* R, Vec v) {
    return vec(R[0] * v.x + R[3] * v.y + R[6] * v.z, R[1] * v.x + R[4] * v.y + R[7] * v.z,
               R[2] * v.x + R[5] * v.y + R[8] * v.z);
}

struct Quaternion {
    float w, x, y, z;
};
// The quaternion p (w, x, y, z), normalised; norm receives the length it had.
__device__ __forceinline__ Quaternion unit_quaternion(const float* p, float& norm) {
    norm = sqrtf(fmaxf(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3], 1e-24f));
    float f = 1.0f / norm;
    Quaternion q;
    q.w = f * p[0]; q.x = f * p[1]; q.y = f * p[2]; q.z = f * p[3];
    return q;
}
// Columns of a unit quaternion's rotation: the Gaussian's axes in the world.
__device__ __forceinline__ void axes_of(Quaternion q, Vec* axis) {
    axis[0] = vec(1 - 2 * (q.y * q.y + q.z * q.z), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y));
    axis[1] = vec(2 * (q.x * q.y - q.w * q.z), 1 - 2 * (q.x * q.x + q.z * q.z), 2 * (q.y * q.z + q.w * q.x));
    axis[2] = vec(2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x * q.x + q.y * q.y));
}

// Sum of v over a warp, in every lane.
__device__ __forceinline__ float warp_sum(float v) {
#pragma unroll
    for (int distance = 16; distance; distance >>= 1) v += __shfl_xor_sync(FULL, v, distance);
    return v;
}
