// Adam in the Gaussians' own axes; what and why is in splat/adam.py.

// rates: of each parameter (PARAMETERS), then these.
enum { LIFT = PARAMETERS, TILT, ISOTROPY, BETA1, BETA2, SCALE_MIN, SCALE_MAX };

// One step of Gaussian k along g (PARAMETERS,), which is used up. m, v (N, PARAMETERS), steps (N,): Adam's state.
__device__ __forceinline__ void adam_step(int k, float* g, float* means, float* log_scales, float* quats,
                                          float* logits, float* colours, float* m, float* v, int* steps,
                                          const float* rates) {
    float size = 0.0f;
#pragma unroll
    for (int i = 0; i < PARAMETERS; i++) size += fabsf(g[i]);
    if (!(size > 0.0f && size < 1e20f)) return;
    float s[3] = {log_scales[3 * k], log_scales[3 * k + 1], log_scales[3 * k + 2]};
    int thin = s[0] <= s[1] && s[0] <= s[2] ? 0 : (s[1] <= s[2] ? 1 : 2);
    // The two longer axes are drawn to equal length.
    int a = (thin + 1) % 3, b = (thin + 2) % 3;
    float pull = s[a] > s[b] ? rates[ISOTROPY] : -rates[ISOTROPY];
#pragma unroll
    for (int i = 0; i < 3; i++) g[3 + i] += i == a ? pull * expf(s[i]) : (i == b ? -pull * expf(s[i]) : 0.0f);
    float norm;
    Quaternion q = unit_quaternion(quats + 4 * k, norm);
    Vec axis[3], by_mean = vec(g[0], g[1], g[2]);
    axes_of(q, axis);
#pragma unroll
    for (int i = 0; i < 3; i++) g[i] = dot(axis[i], by_mean);
    // q (1, r / 2) is a rotation by the small vector r about the own axes.
    float half = 0.5f * norm, w = half * g[6], x = half * g[7], y = half * g[8], z = half * g[9];
    g[6] = -q.x * w + q.w * x + q.z * y - q.y * z;
    g[7] = -q.y * w - q.z * x + q.w * y + q.x * z;
    g[8] = -q.z * w + q.y * x - q.x * y + q.w * z;
    g[9] = 0.0f;
    float b1 = rates[BETA1], b2 = rates[BETA2];
    int step = steps[k] + 1;
    steps[k] = step;
    float correct_m = 1.0f / (1.0f - powf(b1, (float)step)), correct_v = 1.0f / (1.0f - powf(b2, (float)step));
#pragma unroll
    for (int i = 0; i < PARAMETERS; i++) {
        float first = m[PARAMETERS * k + i], second = v[PARAMETERS * k + i];
        first += (1.0f - b1) * (g[i] - first);
        second += (1.0f - b2) * (g[i] * g[i] - second);
        m[PARAMETERS * k + i] = first;
        v[PARAMETERS * k + i] = second;
        g[i] = rates[i] * (first * correct_m) / (sqrtf(second * correct_v) + 1e-15f);
    }
    // Leaving the plane of the longer axes, by moving and by tilting, has rates of its own.
    float r[3];
    Vec moved = vec(0, 0, 0);
#pragma unroll
    for (int i = 0; i < 3; i++) {
        moved = moved + (g[i] * (i == thin ? rates[LIFT] : 1.0f)) * axis[i];
        r[i] = -0.5f * g[6 + i] * (i == thin ? 1.0f : rates[TILT]);
        log_scales[3 * k + i] = fminf(fmaxf(s[i] - g[3 + i], rates[SCALE_MIN]), rates[SCALE_MAX]);
        colours[3 * k + i] -= g[11 + i];
    }
    means[3 * k] -= moved.x;
    means[3 * k + 1] -= moved.y;
    means[3 * k + 2] -= moved.z;
    logits[k] -= g[10];
    float nw = q.w - q.x * r[0] - q.y * r[1] - q.z * r[2], nx = q.x + q.w * r[0] + q.y * r[2] - q.z * r[1];
    float ny = q.y + q.w * r[1] + q.z * r[0] - q.x * r[2], nz = q.z + q.w * r[2] + q.x * r[1] - q.y * r[0];
    float inv = 1.0f / sqrtf(nw * nw + nx * nx + ny * ny + nz * nz);
    quats[4 * k] = inv * nw;
    quats[4 * k + 1] = inv * nx;
    quats[4 * k + 2] = inv * ny;
    quats[4 * k + 3] = inv * nz;
}

// One step along grads (N, PARAMETERS).
extern "C" __global__ void adam(int N, float* means, float* log_scales, float* quats, float* logits, float* colours,
                                const float* grads, float* m, float* v, int* steps, const float* rates) {
    int k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k >= N) return;
    float g[PARAMETERS];
#pragma unroll
    for (int i = 0; i < PARAMETERS; i++) g[i] = grads[PARAMETERS * k + i];
    adam_step(k, g, means, log_scales, quats, logits, colours, m, v, steps, rates);
}

// parameter_gradients and adam in one.
extern "C" __global__ void adam_from_moments(int N, float* means, float* log_scales, float* quats, float* logits,
                                             float* colours, const float4* packed, const float* cam,
                                             const float* moments, float* m, float* v, int* steps, const float* rates,
                                             double* pose) {
    Vec translation = vec(0, 0, 0), rotation = vec(0, 0, 0);
    for (int k = blockIdx.x * blockDim.x + threadIdx.x; k < N; k += gridDim.x * blockDim.x) {
        float M[12], g[PARAMETERS];
        if (!load_moments(moments, k, M)) continue;
        Shape s;
        Vec t, r;
        shape_of(means, log_scales, quats, k, cam, s);
        gradients_of(s, M, quats + 4 * k, packed[4 * k + 3].w, cam, g, t, r);
        translation = translation + t;
        rotation = rotation + r;
        adam_step(k, g, means, log_scales, quats, logits, colours, m, v, steps, rates);
    }
    add_to_pose(translation, rotation, pose);
}
