// What the forward and the backward pass both derive from a Gaussian and the camera; formulas in splat/project.py.
//
// Everything is float32. Determinants of 2x2 covariances are sums of squared minors (Cauchy-Binet) plus terms of the
// low pass, all of one sign, so that nothing cancels.

struct Shape {
    Vec mu, m, east, south;        // mean in the camera, its direction, basis of the tangent plane there
    float dist, inv;
    Vec axis[3];                   // the Gaussian's unit axes in the camera
    float sd[3];                   // its standard deviations
    float e[3], s[3], r[3];        // east, south and radial component of each axis
    float S00, S01, S11;           // covariance in the tangent plane without the low pass
    float w00, w01, w11;           // whitening of the covariance with it
};

__device__ __forceinline__ void tangent_basis(Vec m, Vec& east, Vec& south) {
    float rho = sqrtf(m.x * m.x + m.z * m.z), inv = 1.0f / fmaxf(rho, 1e-9f);
    bool pole = rho < 1e-9f;
    east = vec(pole ? 1.0f : m.z * inv, 0.0f, pole ? 0.0f : -m.x * inv);
    south = cross(m, east);
}

__device__ __forceinline__ void shape_of(const float* means, const float* log_scales, const float* quats, int k,
                                         const float* cam, Shape& g) {
    g.mu = rotate(cam + CAM_R, vec(means + 3 * k)) + vec(cam + CAM_T);
    g.dist = sqrtf(dot(g.mu, g.mu));
    g.inv = 1.0f / fmaxf(g.dist, 1e-20f);
    g.m = g.inv * g.mu;
    tangent_basis(g.m, g.east, g.south);
    float norm, u[3], v[3];
    Vec world[3];
    axes_of(unit_quaternion(quats + 4 * k, norm), world);
    g.S00 = g.S01 = g.S11 = 0.0f;
#pragma unroll
    for (int q = 0; q < 3; q++) {
        g.axis[q] = rotate(cam + CAM_R, world[q]);
        g.sd[q] = expf(fminf(fmaxf(log_scales[3 * k + q], -20.0f), 8.0f));
        g.e[q] = dot(g.east, g.axis[q]);
        g.s[q] = dot(g.south, g.axis[q]);
        g.r[q] = dot(g.m, g.axis[q]);
        u[q] = g.e[q] * g.sd[q] * g.inv;
        v[q] = g.s[q] * g.sd[q] * g.inv;
        g.S00 += u[q] * u[q];
        g.S01 += u[q] * v[q];
        g.S11 += v[q] * v[q];
    }
    float low = cam[CAM_LOW], det = low * (g.S00 + g.S11) + low * low;
#pragma unroll
    for (int q = 0; q < 3; q++) {
        float minor = u[q] * v[(q + 1) % 3] - u[(q + 1) % 3] * v[q];
        det += minor * minor;
    }
    float L11 = g.S11 + low;
    g.w00 = sqrtf(L11 / fmaxf(det, 1e-30f));
    g.w01 = -g.w00 * g.S01 / L11;
    g.w11 = 1.0f / sqrtf(L11);
}
