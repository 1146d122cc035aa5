// CUDA on a CPU, for tests: the threads of a block are fibers, which change at barriers and at operations of a warp.
//
// It is slow, and strict where it matters. A barrier or a warp operation that not all threads reach ends the launch with
// an error. Between barriers the threads run in a chosen order, so that a result that depends on the order shows; and
// any one barrier of the source can be dropped, by number, to see whether a test would notice. Shared memory holds NaN
// where a block has written nothing.
#pragma once
#include <math.h>
#include <setjmp.h>
#include <string.h>
#include <ucontext.h>

#include <algorithm>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#define EMULATED
#define __global__
#define __device__
#define __forceinline__ inline
// All shared memory in one section, so that it can be filled with NaN before each block.
#define __shared__ static __attribute__((section("shared_memory")))
extern "C" char __start_shared_memory[], __stop_shared_memory[];
#define __launch_bounds__(...)
using std::max;
using std::min;

struct float2 { float x, y; };
struct float4 { float x, y, z, w; };
struct int2 { int x, y; };
static inline float2 make_float2(float x, float y) { return float2{x, y}; }
static inline float4 make_float4(float x, float y, float z, float w) { return float4{x, y, z, w}; }
static inline int2 make_int2(int x, int y) { return int2{x, y}; }
static inline int __float_as_int(float f) { int i; memcpy(&i, &f, 4); return i; }
static inline float __int_as_float(int i) { float f; memcpy(&f, &i, 4); return f; }
static inline void sincospif(float x, float* s, float* c) { *s = (float)sin(M_PI * x); *c = (float)cos(M_PI * x); }
static inline int __popc(unsigned x) { return __builtin_popcount(x); }
static inline int __ffs(unsigned x) { return __builtin_ffs((int)x); }
template <class T> static inline T atomicAdd(T* p, T v) { T old = *p; *p = old + v; return old; }

struct Dimension { unsigned x = 1; };
static Dimension threadIdx, blockIdx, blockDim, gridDim;

namespace emulator {
enum Order { FORWARD, REVERSE, RANDOM };
struct Fiber {
    ucontext_t context;  // used to start it
    jmp_buf jump;        // and this to go on: swapcontext would make two system calls
    std::vector<char> stack;
    bool started, finished;
};
struct Barrier { unsigned arrived = 0, round = 0; };
static std::vector<Fiber> fibers;
static jmp_buf home;
static unsigned current, alive;
static unsigned long events;  // arrivals at barriers and ends of threads: a round without any is a deadlock
static Barrier of_block;
static std::vector<Barrier> of_warp;
static std::vector<float> values;    // one of each thread, for shuffles
static std::vector<unsigned> votes;  // likewise, for ballots
static std::function<void()> body;
static int order = FORWARD, dropped = -1;
static unsigned random_state = 1;

static void yield() {
    if (!_setjmp(fibers[current].jump)) _longjmp(home, 1);
}
static void wait(Barrier& b, unsigned size) {
    unsigned mine = b.round, me = current;
    events++;
    if (++b.arrived == size) { b.arrived = 0; b.round++; }
    else while (b.round == mine) { yield(); }
    threadIdx.x = me;
}
static void run_fiber() {
    body();
    fibers[current].finished = true;
    alive--;
    events++;
    _longjmp(home, 1);
}
__attribute__((noinline)) static void resume(unsigned i) {
    current = i;
    threadIdx.x = i;
    if (_setjmp(home)) return;
    if (fibers[i].started) _longjmp(fibers[i].jump, 1);
    fibers[i].started = true;
    setcontext(&fibers[i].context);
}
// False if the threads wait for each other for ever.
static bool run_block() {
    unsigned n = blockDim.x;
    if (fibers.size() < n) fibers.resize(n);
    of_warp.assign((n + 31) / 32, Barrier());
    of_block = Barrier();
    memset(__start_shared_memory, 0xff, __stop_shared_memory - __start_shared_memory);
    values.assign(n, 0);
    votes.assign(n, 0);
    alive = n;
    for (unsigned i = 0; i < n; i++) {
        Fiber& f = fibers[i];
        if (f.stack.empty()) f.stack.resize(64 << 10);
        f.started = f.finished = false;
        getcontext(&f.context);
        f.context.uc_stack.ss_sp = f.stack.data();
        f.context.uc_stack.ss_size = f.stack.size();
        f.context.uc_link = nullptr;
        makecontext(&f.context, run_fiber, 0);
    }
    std::vector<unsigned> turn(n);
    for (unsigned i = 0; i < n; i++) turn[i] = order == REVERSE ? n - 1 - i : i;
    while (alive) {
        unsigned long before = events;
        if (order == RANDOM)
            for (unsigned i = n - 1; i > 0; i--) {
                random_state = random_state * 1664525u + 1013904223u;
                std::swap(turn[i], turn[(random_state >> 8) % (i + 1)]);
            }
        for (unsigned i : turn)
            if (!fibers[i].finished) resume(i);
        if (alive && events == before) return false;
    }
    return true;
}
static unsigned lanes() { return std::min(32u, blockDim.x - (threadIdx.x & ~31u)); }
static void wait_for_warp() { wait(of_warp[threadIdx.x / 32], lanes()); }
static void block_barrier(int number) {
    if (number != dropped) wait(of_block, blockDim.x);
}
static int block_vote(int number, int p) {
    if (number == dropped) return p != 0;
    votes[threadIdx.x] = p != 0;
    wait(of_block, blockDim.x);
    int all = 1;
    for (unsigned i = 0; i < blockDim.x; i++) all &= votes[i];
    wait(of_block, blockDim.x);
    return all;
}
}  // namespace emulator

// Barriers are numbered in the order of the source.
#define __syncthreads() emulator::block_barrier(__COUNTER__)
#define __syncthreads_and(p) emulator::block_vote(__COUNTER__, p)
static inline float __shfl_xor_sync(unsigned, float v, int mask) {
    emulator::values[threadIdx.x] = v;
    emulator::wait_for_warp();
    float other = emulator::values[threadIdx.x ^ mask];
    emulator::wait_for_warp();
    return other;
}
static inline unsigned __ballot_sync(unsigned, int p) {
    emulator::votes[threadIdx.x] = p != 0;
    emulator::wait_for_warp();
    unsigned word = 0, first = threadIdx.x & ~31u;
    for (unsigned i = 0; i < emulator::lanes(); i++) word |= emulator::votes[first + i] << i;
    emulator::wait_for_warp();
    return word;
}
static inline int __any_sync(unsigned mask, int p) { return __ballot_sync(mask, p) != 0; }

namespace emulator {
using Kernel = std::function<bool(unsigned, unsigned, void**)>;
template <class... A, size_t... I>
static bool call(void (*kernel)(A...), unsigned blocks, unsigned threads, void** p, std::index_sequence<I...>) {
    body = [=] { kernel(*(A*)p[I]...); };
    gridDim.x = blocks;
    blockDim.x = threads;
    for (unsigned b = 0; b < blocks; b++) {
        blockIdx.x = b;
        if (!run_block()) return false;
    }
    return true;
}
template <class... A>
static Kernel entry(void (*kernel)(A...)) {
    return [kernel](unsigned blocks, unsigned threads, void** p) {
        return call(kernel, blocks, threads, p, std::index_sequence_for<A...>{});
    };
}
}  // namespace emulator
