// Direct alignment of a panorama to a reference: photometric/align.py, with its whole loop on the device.
//
// align_sums adds up the normal equations at the pose that is on trial, by all pixels; align_judge, one block, decides
// by them and puts the next pose on trial. They are launched in turn, as often as the loop may run; once it has ended
// they return at once. So the host waits once a level, for the answer.

// The state, doubles in device memory. Poses are the rotation by rows, then the translation. X: the last step.
enum {
    POSE = 0, TRIAL = 12, DAMPING = 24, HUBER, CUT, COST, SEEN, SIGMA, COUNT, ENDED,
    H_NOW = 32, B_NOW = 53, X = 59, STATE = 65
};
// Sums: H's upper triangle by rows (21), b (6), cost, weight seen; the histogram of absolute residuals follows.
enum { SUM_B = 21, SUM_COST = 27, SUM_SEEN, SUMS = 32, BINS = 1024 };
#define BINS_PER_UNIT 4096.0f
#define NO_COST 1e300
// What align_judge makes of the sums: thresholds from the first residuals, the first costs, or a trial's.
enum { THRESHOLDS, FIRST, NEXT, LAST };

// points (3, n), jacobian (6, n), value, weight (n,): the reference. image (h, w). gain: the factor on the reference.
extern "C" __global__ void align_sums(int n, const float* points, const float* jacobian, const float* value,
                                      const float* weight, const float* image, int w, int h, float gain, float offset,
                                      const double* state, double* sums) {
    __shared__ float bins[BINS], part[WARPS][32];
    if (state[ENDED] != 0) return;
    for (int i = threadIdx.x; i < BINS; i += blockDim.x) bins[i] = 0.0f;
    __syncthreads();
    float T[12], s[32], huber = (float)state[HUBER], cut = (float)state[CUT], worst = huber * (cut - 0.5f * huber);
#pragma unroll
    for (int i = 0; i < 12; i++) T[i] = (float)state[TRIAL + i];
#pragma unroll
    for (int i = 0; i < 32; i++) s[i] = 0.0f;
    for (int k = blockIdx.x * blockDim.x + threadIdx.x; k < n; k += gridDim.x * blockDim.x) {
        Vec p = rotate(T, vec(points[k], points[n + k], points[2 * n + k])) + vec(T + 9);
        float u = w * (0.5f + atan2f(p.x, p.z) * (0.5f / PI_F)) - 0.5f;
        float v = h * (0.5f + atan2f(p.y, sqrtf(p.x * p.x + p.z * p.z)) * (1.0f / PI_F)) - 0.5f;
        if (!(fabsf(u) < 1e6f && fabsf(v) < 1e6f)) continue;
        float left = floorf(u), top = floorf(v), a = u - left, b = v - top;
        int x0 = (int)left, x1 = x0 + 1, y0 = min(max((int)top, 0), h - 1), y1 = min(max((int)top + 1, 0), h - 1);
        x0 = x0 < 0 ? x0 + w : (x0 >= w ? x0 - w : x0);
        x1 = x1 < 0 ? x1 + w : (x1 >= w ? x1 - w : x1);
        x0 = min(max(x0, 0), w - 1);
        x1 = min(max(x1, 0), w - 1);
        float p00 = image[y0 * w + x0], p01 = image[y0 * w + x1], p10 = image[y1 * w + x0], p11 = image[y1 * w + x1];
        float above = p00 + a * (p01 - p00), below = p10 + a * (p11 - p10);
        float r = above + b * (below - above) - gain * value[k] - offset, size = fabsf(r), wk = weight[k];
        if (!(size < 10.0f)) continue;  // masked, or not a number
        atomicAdd(&bins[min((int)(size * BINS_PER_UNIT), BINS - 1)], wk);
        s[SUM_SEEN] += wk;
        if (size > cut) {
            s[SUM_COST] += wk * worst;
            continue;
        }
        bool linear = size > huber;
        s[SUM_COST] += wk * (linear ? huber * (size - 0.5f * huber) : 0.5f * size * size);
        if (linear) wk *= huber / size;
        float J[6];
#pragma unroll
        for (int i = 0; i < 6; i++) J[i] = jacobian[i * n + k];
        int at = 0;
#pragma unroll
        for (int i = 0; i < 6; i++) {
            float f = wk * J[i];
#pragma unroll
            for (int j = i; j < 6; j++) s[at++] += f * J[j];
            s[SUM_B + i] += f * r;
        }
    }
    int lane = threadIdx.x & 31, warp = threadIdx.x >> 5;
    share<16>(s, lane, 16);
    share<8>(s, lane, 8);
    share<4>(s, lane, 4);
    share<2>(s, lane, 2);
    share<1>(s, lane, 1);
    part[warp][lane] = s[0];  // lane i holds value i
    __syncthreads();
    for (int i = threadIdx.x; i < BINS; i += blockDim.x)
        if (bins[i] != 0.0f) atomicAdd(&sums[SUMS + i], (double)bins[i]);
    if (threadIdx.x >= 32) return;
    float sum = 0.0f;
    for (int i = 0; i < (int)(blockDim.x >> 5); i++) sum += part[i][lane];
    if (sum != 0.0f) atomicAdd(&sums[lane], (double)sum);
}

// Robust standard deviation of the residuals, and the share of the weight whose residuals exceed `size`.
__device__ double robust_sigma(const double* bins) {
    double all = 0, below = 0;
    for (int i = 0; i < BINS; i++) all += bins[i];
    int k = 0;
    for (; k < BINS; k++) {
        below += bins[k];
        if (below >= 0.5 * all) break;
    }
    return 1.4826 * (k + 0.5) / BINS_PER_UNIT;
}
__device__ double share_above(const double* bins, double size) {
    if (!(size * BINS_PER_UNIT < BINS - 1)) return 0;
    double all = 0, below = 0;
    int last = (int)(size * BINS_PER_UNIT);
    for (int i = 0; i < BINS; i++) {
        all += bins[i];
        if (i <= last) below += bins[i];
    }
    return 1 - below / fmax(all, 1e-12);
}

// out = a exp(-x) for a pose and a twist (translation, rotation).
__device__ void moved_by(const double* a, const double* x, double* out) {
    double r[3] = {-x[0], -x[1], -x[2]}, v[3] = {-x[3], -x[4], -x[5]};
    double squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], angle = sqrt(squared);
    double A = 1 - squared / 6, B = 0.5 - squared / 24, C = 1.0 / 6 - squared / 120;
    if (angle > 1e-4) {
        A = sin(angle) / angle;
        B = (1 - cos(angle)) / squared;
        C = (1 - A) / squared;
    }
    double K[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0}, R[9], t[3];
    for (int i = 0; i < 3; i++) {
        t[i] = 0;
        for (int j = 0; j < 3; j++) {
            double kk = 0, one = i == j ? 1 : 0;
            for (int l = 0; l < 3; l++) kk += K[3 * i + l] * K[3 * l + j];
            R[3 * i + j] = one + A * K[3 * i + j] + B * kk;
            t[i] += (one + B * K[3 * i + j] + C * kk) * r[j];
        }
    }
    for (int i = 0; i < 3; i++) {
        out[9 + i] = a[9 + i];
        for (int j = 0; j < 3; j++) {
            out[9 + i] += a[3 * i + j] * t[j];
            out[3 * i + j] = 0;
            for (int l = 0; l < 3; l++) out[3 * i + j] += a[3 * i + l] * R[3 * l + j];
        }
    }
}

// The damped step of the unknowns from `free` on: x (6,), zeros before. False where it has no solution.
__device__ bool damped_step(const double* upper, const double* b, double damping, int free, double* x) {
    double L[6][6], mean = 0;
    int at = 0;
    for (int i = 0; i < 6; i++)
        for (int j = i; j < 6; j++) L[j][i] = upper[at++];
    for (int i = free; i < 6; i++) mean += L[i][i] / (6 - free);
    for (int i = free; i < 6; i++) L[i][i] += damping * L[i][i] + 1e-9 * mean;
    for (int i = 0; i < free; i++) x[i] = 0;
    for (int i = free; i < 6; i++) {
        for (int j = free; j <= i; j++) {
            double v = L[i][j];
            for (int k = free; k < j; k++) v -= L[i][k] * L[j][k];
            if (i == j && !(v > 0)) return false;
            L[i][j] = i == j ? sqrt(v) : v / L[j][j];
        }
        x[i] = b[i];
        for (int k = free; k < i; k++) x[i] -= L[i][k] * x[k];
        x[i] /= L[i][i];
    }
    for (int i = 5; i >= free; i--) {
        for (int k = i + 1; k < 6; k++) x[i] -= L[k][i] * x[k];
        x[i] /= L[i][i];
    }
    return true;
}

// One block. options: least Huber threshold, its factor on sigma, factor of the cut (0: none), factor and least value
// of the cut that rejects what moves, share that must move, step_m, step_rad. gain: the factor on the reference, by
// which its Jacobian is multiplied. total: weight of the reference; free: the first unknown. sums are cleared.
extern "C" __global__ void align_judge(int task, int n, int free, double gain, double total, const double* options,
                                       double* state, double* sums) {
    __shared__ double bins[BINS];
    if (state[ENDED] != 0) return;
    for (int i = threadIdx.x; i < BINS; i += blockDim.x) bins[i] = sums[SUMS + i];
    __syncthreads();
    if (threadIdx.x == 0) {
        double weight = sums[SUM_SEEN], seen = total > 0 ? weight / total : 0;
        double cost = weight > 0 ? sums[SUM_COST] / weight : NO_COST;
        if (task == THRESHOLDS) {
            double sigma = robust_sigma(bins), huber = fmax(options[1] * sigma, options[0]);
            double cut = options[2] > 0 ? options[2] * huber : 10.0, moving = fmax(options[3] * huber, options[4]);
            if (share_above(bins, moving) > options[5]) cut = fmin(cut, moving);
            state[HUBER] = huber;
            state[CUT] = cut;
            state[DAMPING] = 1e-4;
        } else {
            bool better = task == FIRST || (cost < state[COST] && seen > 0.5 * state[SEEN]);
            if (better) {
                state[COST] = cost;
                state[SEEN] = seen;
                state[SIGMA] = robust_sigma(bins);
                for (int i = 0; i < 12; i++) state[POSE + i] = state[TRIAL + i];
                for (int i = 0; i < 21; i++) state[H_NOW + i] = gain * gain * sums[i];
                for (int i = 0; i < 6; i++) state[B_NOW + i] = gain * sums[SUM_B + i];
            }
            bool ended = task == LAST;
            if (task != FIRST) {
                state[DAMPING] = better ? fmax(0.2 * state[DAMPING], 1e-7) : 20 * state[DAMPING];
                const double* x = state + X;
                ended = ended || (!better && state[DAMPING] > 1e3) ||
                        (sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) < options[6] &&
                         sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5]) < options[7]);
            }
            if (!ended && (!(state[COST] < NO_COST) || n < 50)) ended = true;
            if (!ended) {
                state[COUNT] += 1;
                if (damped_step(state + H_NOW, state + B_NOW, state[DAMPING], free, state + X))
                    moved_by(state + POSE, state + X, state + TRIAL);
                else
                    ended = true;
            }
            if (ended) state[ENDED] = 1;
        }
    }
    __syncthreads();
    for (int i = threadIdx.x; i < SUMS + BINS; i += blockDim.x) sums[i] = 0.0;
}
