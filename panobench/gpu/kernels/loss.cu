// The robust L1 loss of splat/loss.py. One thread serves a pixel.

// gradient (3, n): of the planes (3, n) of the render. sums[0..2] += the loss and its gradients by gain and offset.
// image (n, 3): 8 bit. gain: the factor on the render, exp(gain) elsewhere. opacity (n,) or null: a pixel counts only
// where it exceeds opaque.
extern "C" __global__ void photometric_loss(int n, const float* planes, const float* opacity, float opaque,
                                            const unsigned char* image, const float* weights, float gain, float offset,
                                            float knee, float* gradient, double* sums) {
    int i = blockIdx.x * blockDim.x + threadIdx.x;
    float loss = 0.0f, by_gain = 0.0f, by_offset = 0.0f;
    if (i < n) {
        float weight = weights[i] * (1.0f / 3.0f), steep = 1.0f / fmaxf(knee, 1e-30f);
        if (opacity && !(opacity[i] > opaque)) weight = 0.0f;
#pragma unroll
        for (int c = 0; c < 3; c++) {
            float seen = gain * planes[c * n + i], r = seen + offset - image[3 * i + c] * (1.0f / 255.0f);
            float t = fminf(fmaxf(r * steep, -1.0f), 1.0f), d = weight * t;
            loss += d * (r - 0.5f * knee * t);
            by_gain += d * seen;
            by_offset += d;
            gradient[c * n + i] = gain * d;
        }
    }
    loss = warp_sum(loss);
    by_gain = warp_sum(by_gain);
    by_offset = warp_sum(by_offset);
    if ((threadIdx.x & 31) == 0) {
        atomicAdd(&sums[0], (double)loss);
        atomicAdd(&sums[1], (double)by_gain);
        atomicAdd(&sums[2], (double)by_offset);
    }
}
