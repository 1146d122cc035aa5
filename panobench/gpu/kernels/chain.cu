// The chain rule from a Gaussian's moments to its parameters and the pose; formulas in splat/chain.py.

// g (PARAMETERS,), and what the pose receives: translation and rotation of tau.
__device__ __forceinline__ void gradients_of(const Shape& s, const float* M, const float* quat, float opacity,
                                             const float* cam, float* g, Vec& translation, Vec& rotation) {
    // The moments are of the scaled offset.
    const float f1 = 1.0f / OFFSET_SCALE, f2 = f1 * f1, f3 = f2 * f1;
    float t1 = f1 * M[1], t2 = f1 * M[2], t11 = f2 * M[3], t12 = f2 * M[4], t22 = f2 * M[5];
    float q1 = f3 * M[6], q2 = f3 * M[7], inv2 = s.inv * s.inv;
    // dL/dS, and dL/d(offset of the mean).
    float a00 = t11 * s.w00, a01 = t11 * s.w01 + t12 * s.w11, a11 = t12 * s.w01 + t22 * s.w11;
    float g00 = 0.5f * s.w00 * a00, g01 = 0.5f * s.w00 * a01, g11 = 0.5f * (s.w01 * a01 + s.w11 * a11);
    float i00 = 1.0f / s.w00, i11 = 1.0f / s.w11, i01 = -s.w01 * i00 * i11;
    float n0 = 0.0f, n1 = 0.0f;
#pragma unroll
    for (int q = 0; q < 3; q++) {
        float radial = s.sd[q] * s.sd[q] * inv2 * s.r[q];
        n0 += s.e[q] * radial;
        n1 += s.s[q] * radial;
    }
    float d0 = s.w00 * t1 + i00 * q1 + i01 * q2 - 2 * (g00 * n0 + g01 * n1);
    float d1 = s.w01 * t1 + s.w11 * t2 + i11 * q2 - 2 * (g01 * n0 + g11 * n1);
    float radial = -2 * (g00 * s.S00 + 2 * g01 * s.S01 + g11 * s.S11);
    Vec by_mu = s.inv * (d0 * s.east + d1 * s.south + radial * s.m) + M[11] * s.m;
    translation = by_mu;
    rotation = cross(s.mu, by_mu);
    Vec by_axis[3];
#pragma unroll
    for (int q = 0; q < 3; q++) {
        float twice = 2 * s.sd[q] * s.sd[q] * inv2, e = g00 * s.e[q] + g01 * s.s[q], d = g01 * s.e[q] + g11 * s.s[q];
        Vec b = twice * (e * s.east + d * s.south);
        g[3 + q] = twice * (s.e[q] * e + s.s[q] * d);
        rotation = rotation + cross(s.axis[q], b);
        by_axis[q] = unrotate(cam + CAM_R, b);
    }
    Vec by_mean = unrotate(cam + CAM_R, by_mu);
    g[0] = by_mean.x; g[1] = by_mean.y; g[2] = by_mean.z;
    float norm;
    Quaternion q = unit_quaternion(quat, norm);
    Vec X = by_axis[0], Y = by_axis[1], Z = by_axis[2];  // the columns of dL/dR
    float d21 = Y.z - Z.y, d02 = Z.x - X.z, d10 = X.y - Y.x, s01 = Y.x + X.y, s02 = Z.x + X.z, s12 = Z.y + Y.z;
    float gw = 2 * (q.x * d21 + q.y * d02 + q.z * d10);
    float gx = 2 * (-2 * q.x * (Y.y + Z.z) + q.y * s01 + q.z * s02 + q.w * d21);
    float gy = 2 * (q.x * s01 - 2 * q.y * (X.x + Z.z) + q.z * s12 + q.w * d02);
    float gz = 2 * (q.x * s02 + q.y * s12 - 2 * q.z * (X.x + Y.y) + q.w * d10);
    float along = gw * q.w + gx * q.x + gy * q.y + gz * q.z;
    g[6] = (gw - along * q.w) / norm;
    g[7] = (gx - along * q.x) / norm;
    g[8] = (gy - along * q.y) / norm;
    g[9] = (gz - along * q.z) / norm;
    g[10] = M[0] * (1.0f - opacity);
    g[11] = M[8]; g[12] = M[9]; g[13] = M[10];
}

// The moments M (12,) of Gaussian k; false where no pixel touched it.
__device__ __forceinline__ bool load_moments(const float* moments, int k, float* M) {
    const float4* row = (const float4*)(moments + MOMENT_ROW * k);
    float size = 0.0f;
#pragma unroll
    for (int i = 0; i < 3; i++) {
        float4 v = row[i];
        M[4 * i] = v.x; M[4 * i + 1] = v.y; M[4 * i + 2] = v.z; M[4 * i + 3] = v.w;
        size += fabsf(v.x) + fabsf(v.y) + fabsf(v.z) + fabsf(v.w);
    }
    return size != 0.0f;
}

// pose (6,) += the sum over a block of up to 1024 threads, each with what its Gaussians say.
__device__ __forceinline__ void add_to_pose(Vec translation, Vec rotation, double* pose) {
    __shared__ float part[6][32];
    float value[6] = {translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z};
    int lane = threadIdx.x & 31, warp = threadIdx.x >> 5;
#pragma unroll
    for (int i = 0; i < 6; i++) {
        float sum = warp_sum(value[i]);
        if (lane == 0) part[i][warp] = sum;
    }
    __syncthreads();
    if (threadIdx.x >= 6) return;
    float sum = 0.0f;
    for (int w = 0; w < (int)(blockDim.x >> 5); w++) sum += part[threadIdx.x][w];
    atomicAdd(&pose[threadIdx.x], (double)sum);
}

// grads (N, PARAMETERS): zero rows for what no pixel touched. pose (6,) += dL/dtau.
extern "C" __global__ void parameter_gradients(int N, const float* means, const float* log_scales, const float* quats,
                                               const float4* packed, const float* cam, const float* moments,
                                               float* grads, double* pose) {
    Vec translation = vec(0, 0, 0), rotation = vec(0, 0, 0);
    for (int k = blockIdx.x * blockDim.x + threadIdx.x; k < N; k += gridDim.x * blockDim.x) {
        float M[12], g[PARAMETERS];
#pragma unroll
        for (int i = 0; i < PARAMETERS; i++) g[i] = 0.0f;
        if (load_moments(moments, k, M)) {
            Shape s;
            Vec t, r;
            shape_of(means, log_scales, quats, k, cam, s);
            gradients_of(s, M, quats + 4 * k, packed[4 * k + 3].w, cam, g, t, r);
            translation = translation + t;
            rotation = rotation + r;
        }
#pragma unroll
        for (int i = 0; i < PARAMETERS; i++) grads[PARAMETERS * k + i] = g[i];
    }
    add_to_pose(translation, rotation, pose);
}
