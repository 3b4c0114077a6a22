// The network's operations on a GPU, each for f32 and bf16. All sums are in f32. Results do not depend on the order in which
// blocks run: nothing is added atomically.
#include <cuda_bf16.h>
#include <stdint.h>

typedef __nv_bfloat16 bf16;

// Threads that share a row of a layer norm.
#define ROW_THREADS 128
// A block of a sum over rows: columns beside each other, and rows that are summed at once.
#define COLUMNS 32
#define ROWS 16

template <typename T> __device__ T to(float x);
template <> __device__ float to<float>(float x) { return x; }
template <> __device__ bf16 to<bf16>(float x) { return __float2bfloat16(x); }
__device__ float at(float x) { return x; }
__device__ float at(bf16 x) { return __bfloat162float(x); }

#define FOR_EACH(i, count) \
    for (uint64_t i = blockIdx.x * (uint64_t)blockDim.x + threadIdx.x; i < (count); i += (uint64_t)gridDim.x * blockDim.x)

__device__ float warp_sum(float x) {
    for (int step = 16; step > 0; step /= 2) x += __shfl_xor_sync(0xffffffff, x, step);
    return x;
}

__device__ float warp_max(float x) {
    for (int step = 16; step > 0; step /= 2) x = fmaxf(x, __shfl_xor_sync(0xffffffff, x, step));
    return x;
}

// Sum over the ROW_THREADS threads of a block, known to all of them.
__device__ float block_sum(float x) {
    __shared__ float parts[ROW_THREADS / 32];
    x = warp_sum(x);
    __syncthreads(); // the previous sum has been read
    if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = x;
    __syncthreads();
    float sum = 0;
    for (int i = 0; i < ROW_THREADS / 32; i++) sum += parts[i];
    return sum;
}

// W values beside each other, read and written at once.
template <typename T, int W> struct alignas(sizeof(T) * W) Pack { T value[W]; };

// Values in 16 bytes.
#define WIDTH(T) (16 / (int)sizeof(T))

__device__ bool aligned(const void *p) { return (uint64_t)p % 16 == 0; }

template <int W, typename T, typename F>
__device__ void map_packs(const T *a, const T *b, const T *columns, T *out, uint32_t n, uint32_t count, F f) {
    typedef Pack<T, W> P;
    for (uint32_t i = (blockIdx.x * blockDim.x + threadIdx.x) * W; i < count; i += gridDim.x * blockDim.x * W) {
        P x = *(const P *)(a + i), y, z, result;
        if (b) y = *(const P *)(b + i);
        if (columns) z = *(const P *)(columns + i % n);
        for (int k = 0; k < W; k++)
            result.value[k] = to<T>(f(at(x.value[k]), b ? at(y.value[k]) : 0.0f, columns ? at(z.value[k]) : 0.0f));
        *(P *)(out + i) = result;
    }
}

// out[i] = f(a[i], b[i], columns[i % n]); without b or columns, f is given 0. `out` may be `a` or `b`.
template <typename T, typename F>
__device__ void map(const T *a, const T *b, const T *columns, T *out, uint32_t n, uint32_t count, F f) {
    const int W = WIDTH(T);
    if (n % W == 0 && aligned(a) && aligned(b) && aligned(columns) && aligned(out)) // count is a multiple of n
        map_packs<W>(a, b, columns, out, n, count, f);
    else
        map_packs<1>(a, b, columns, out, n, count, f);
}

// y (count / n, n) += bias (n)
template <typename T> __device__ void add_bias(T *y, const T *bias, uint32_t n, uint32_t count) {
    map<T>(y, nullptr, bias, y, n, count, [](float y, float, float bias) { return y + bias; });
}

// Sizes of heads that are sorted.
struct Heads {
    uint32_t parts, images, heads, tokens, size;
};

template <int W, typename T> __device__ void split_packs(const T *x, const T *bias, T *y, Heads h) {
    typedef Pack<T, W> P;
    uint32_t count = h.parts * h.images * h.heads * h.tokens * h.size;
    for (uint32_t i = (blockIdx.x * blockDim.x + threadIdx.x) * W; i < count; i += gridDim.x * blockDim.x * W) {
        uint32_t row = i / h.size, s = i % h.size, token = row % h.tokens;
        row /= h.tokens;
        uint32_t head = row % h.heads, image = row / h.heads % h.images, part = row / h.heads / h.images;
        uint32_t column = (part * h.heads + head) * h.size + s;
        P value = *(const P *)(x + (image * h.tokens + token) * h.parts * h.heads * h.size + column);
        if (bias) {
            P add = *(const P *)(bias + column);
            for (int k = 0; k < W; k++) value.value[k] = to<T>(at(value.value[k]) + at(add.value[k]));
        }
        *(P *)(y + i) = value;
    }
}

// y (parts, images, heads, tokens, size) = x (images, tokens, parts, heads, size) + bias (parts, heads, size), or null
template <typename T> __device__ void split_heads(const T *x, const T *bias, T *y, Heads h) {
    if (h.size % WIDTH(T) == 0 && aligned(x) && aligned(bias) && aligned(y))
        split_packs<WIDTH(T)>(x, bias, y, h);
    else
        split_packs<1>(x, bias, y, h);
}

template <int W, typename T> __device__ void join_packs(const T *x, T *y, Heads h) {
    typedef Pack<T, W> P;
    uint32_t count = h.parts * h.images * h.heads * h.tokens * h.size;
    for (uint32_t i = (blockIdx.x * blockDim.x + threadIdx.x) * W; i < count; i += gridDim.x * blockDim.x * W) {
        uint32_t row = i / h.size, s = i % h.size, head = row % h.heads;
        row /= h.heads;
        uint32_t part = row % h.parts, token = row / h.parts % h.tokens, image = row / h.parts / h.tokens;
        *(P *)(y + i) = *(const P *)(x + (((part * h.images + image) * h.heads + head) * h.tokens + token) * h.size + s);
    }
}

// The inverse of split_heads, without bias.
template <typename T> __device__ void join_heads(const T *x, T *y, Heads h) {
    if (h.size % WIDTH(T) == 0 && aligned(x) && aligned(y))
        join_packs<WIDTH(T)>(x, y, h);
    else
        join_packs<1>(x, y, h);
}

// Values of a row that each thread of a warp keeps in registers.
#define KEPT 16

// Softmax of scale x in each row of n values, `stride` apart, one warp per row.
template <typename T> __device__ void softmax(T *x, uint32_t n, uint32_t stride, uint32_t rows, float scale) {
    uint32_t row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows) return;
    x += (uint64_t)row * stride;
    float largest = -INFINITY, sum = 0;
    if (n <= 32 * KEPT) {
        float kept[KEPT];
#pragma unroll
        for (int k = 0; k < KEPT; k++) {
            kept[k] = lane + 32 * k < n ? at(x[lane + 32 * k]) : -INFINITY;
            largest = fmaxf(largest, kept[k]);
        }
        largest = warp_max(largest);
#pragma unroll
        for (int k = 0; k < KEPT; k++) {
            kept[k] = lane + 32 * k < n ? expf(scale * (kept[k] - largest)) : 0;
            sum += kept[k];
        }
        float share = 1 / warp_sum(sum);
#pragma unroll
        for (int k = 0; k < KEPT; k++)
            if (lane + 32 * k < n) x[lane + 32 * k] = to<T>(kept[k] * share);
        return;
    }
    for (uint32_t j = lane; j < n; j += 32) largest = fmaxf(largest, at(x[j]));
    largest = warp_max(largest);
    for (uint32_t j = lane; j < n; j += 32) sum += expf(scale * (at(x[j]) - largest));
    float share = 1 / warp_sum(sum);
    for (uint32_t j = lane; j < n; j += 32) x[j] = to<T>(expf(scale * (at(x[j]) - largest)) * share);
}

// g = scale a (g - sum(a g)) in each row: the gradient before softmax from that behind it, with the weights a.
template <typename T>
__device__ void softmax_gradient(const T *a, T *g, uint32_t n, uint32_t stride, uint32_t rows, float scale) {
    uint32_t row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows) return;
    a += (uint64_t)row * stride, g += (uint64_t)row * stride;
    float along = 0;
    if (n <= 32 * KEPT) {
        float weight[KEPT], grad[KEPT];
#pragma unroll
        for (int k = 0; k < KEPT; k++) {
            bool inside = lane + 32 * k < n;
            weight[k] = inside ? at(a[lane + 32 * k]) : 0;
            grad[k] = inside ? at(g[lane + 32 * k]) : 0;
            along += weight[k] * grad[k];
        }
        along = warp_sum(along);
#pragma unroll
        for (int k = 0; k < KEPT; k++)
            if (lane + 32 * k < n) g[lane + 32 * k] = to<T>(scale * weight[k] * (grad[k] - along));
        return;
    }
    for (uint32_t j = lane; j < n; j += 32) along += at(a[j]) * at(g[j]);
    along = warp_sum(along);
    for (uint32_t j = lane; j < n; j += 32) g[j] = to<T>(scale * at(a[j]) * (at(g[j]) - along));
}

// Mean and one over the standard deviation of the row of this block.
template <typename T> __device__ float2 statistics(const T *x, uint32_t d, float eps) {
    float sum = 0, squares = 0;
    for (uint32_t j = threadIdx.x; j < d; j += ROW_THREADS) sum += at(x[j]);
    float mean = block_sum(sum) / d;
    for (uint32_t j = threadIdx.x; j < d; j += ROW_THREADS) squares += (at(x[j]) - mean) * (at(x[j]) - mean);
    return make_float2(mean, rsqrtf(block_sum(squares) / d + eps));
}

// Layer norm of one row per block, times (one + weight), plus bias; `group` rows share weight and bias, which lie `stride`
// values behind those of the group before. Without `affine`, normalised values.
template <typename T>
__device__ void layer_norm(const T *x, const T *weight, const T *bias, T *y, uint32_t d, float eps, uint32_t affine, float one,
                           uint32_t group, uint32_t stride, uint32_t bias_at) {
    uint64_t row = (uint64_t)blockIdx.x * d, shared = (uint64_t)(blockIdx.x / group) * stride;
    float2 stats = statistics(x + row, d, eps);
    for (uint32_t j = threadIdx.x; j < d; j += ROW_THREADS) {
        float normal = (at(x[row + j]) - stats.x) * stats.y;
        y[row + j] = to<T>(affine ? normal * (one + at(weight[shared + j])) + at(bias[shared + bias_at + j]) : normal);
    }
}

// Gradient of the input of a layer norm: with n the normalised row and g the gradient times the weight,
// (g - mean(g) - n mean(g n)) / σ. Also writes the statistics of each row.
template <typename T>
__device__ void layer_norm_gradient(const T *x, const T *weight, const T *grad, T *dx, float2 *stats_out, uint32_t d, float eps,
                                    uint32_t affine) {
    uint64_t row = (uint64_t)blockIdx.x * d;
    float2 stats = statistics(x + row, d, eps);
    float sum = 0, along = 0;
    for (uint32_t j = threadIdx.x; j < d; j += ROW_THREADS) {
        float g = at(grad[row + j]) * (affine ? at(weight[j]) : 1.0f);
        sum += g, along += g * (at(x[row + j]) - stats.x) * stats.y;
    }
    sum = block_sum(sum) / d, along = block_sum(along) / d;
    for (uint32_t j = threadIdx.x; j < d; j += ROW_THREADS) {
        float g = at(grad[row + j]) * (affine ? at(weight[j]) : 1.0f);
        dx[row + j] = to<T>((g - sum - (at(x[row + j]) - stats.x) * stats.y * along) * stats.y);
    }
    if (threadIdx.x == 0) stats_out[blockIdx.x] = stats;
}

// Sums of `term(row)` over the rows of this block, for the column of this thread; valid where threadIdx.y is 0.
template <typename F> __device__ float column_sum(F term, uint32_t first, uint32_t last, bool inside) {
    __shared__ float parts[ROWS][COLUMNS];
    float sum = 0;
    if (inside)
        for (uint32_t row = first + threadIdx.y; row < last; row += ROWS) sum += term(row);
    __syncthreads(); // the previous sum has been read
    parts[threadIdx.y][threadIdx.x] = sum;
    __syncthreads();
    if (threadIdx.y == 0)
        for (int i = 1; i < ROWS; i++) sum += parts[i][threadIdx.x];
    return sum;
}

// Sums over `chunk` rows of g (rows, n), of g y if `with` is 1, and of g times the normalised x if it is 2, of which y are the
// values before normalisation. partial: (chunks, n).
template <typename T>
__device__ void column_sums(const T *g, const T *y, const float2 *stats, float *partial, uint32_t rows, uint32_t n, uint32_t chunk,
                            uint32_t with) {
    uint32_t column = blockIdx.x * COLUMNS + threadIdx.x, first = blockIdx.y * chunk;
    uint32_t last = min(first + chunk, rows);
    float sum = column_sum(
        [&](uint32_t row) {
            uint64_t i = (uint64_t)row * n + column;
            float value = at(g[i]);
            if (with == 1) value *= at(y[i]);
            if (with == 2) value *= (at(y[i]) - stats[row].x) * stats[row].y;
            return value;
        },
        first, last, column < n);
    if (threadIdx.y == 0 && column < n) partial[(uint64_t)blockIdx.y * n + column] = sum;
}

// out (n): the sum over the rows of partial (chunks, n)
template <typename T> __device__ void sum_partial(const float *partial, T *out, uint32_t chunks, uint32_t n) {
    FOR_EACH(i, n) {
        float sum = 0;
        for (uint32_t chunk = 0; chunk < chunks; chunk++) sum += partial[(uint64_t)chunk * n + i];
        out[i] = to<T>(sum);
    }
}

// y = x Φ(x), exact
template <typename T> __device__ void gelu(const T *x, T *y, uint32_t count) {
    map<T>(x, nullptr, nullptr, y, count, count, [](float x, float, float) { return x * normcdff(x); });
}

// g *= Φ(x) + x φ(x)
template <typename T> __device__ void gelu_gradient(const T *x, T *g, uint32_t count) {
    map<T>(g, x, nullptr, g, count, count, [](float g, float x, float) {
        return g * (normcdff(x) + x * 0.3989422804014327f * expf(-0.5f * x * x));
    });
}

// out = h + y lambda (n)
template <typename T> __device__ void residual(const T *h, const T *y, const T *lambda, T *out, uint32_t n, uint32_t count) {
    map<T>(h, y, lambda, out, n, count, [](float h, float y, float lambda) { return h + y * lambda; });
}

// out = g lambda (n)
template <typename T> __device__ void scale_columns(const T *g, const T *lambda, T *out, uint32_t n, uint32_t count) {
    map<T>(g, nullptr, lambda, out, n, count, [](float g, float, float lambda) { return g * lambda; });
}

#define EXPORT(T, S) \
    extern "C" __global__ void add_bias_##S(T *y, const T *bias, uint32_t n, uint32_t count) { add_bias(y, bias, n, count); } \
    extern "C" __global__ void split_heads_##S(const T *x, const T *bias, T *y, uint32_t parts, uint32_t images, uint32_t heads, \
                                               uint32_t tokens, uint32_t size) { \
        split_heads(x, bias, y, Heads{parts, images, heads, tokens, size}); \
    } \
    extern "C" __global__ void join_heads_##S(const T *x, T *y, uint32_t parts, uint32_t images, uint32_t heads, uint32_t tokens, \
                                              uint32_t size) { \
        join_heads(x, y, Heads{parts, images, heads, tokens, size}); \
    } \
    extern "C" __global__ void softmax_##S(T *x, uint32_t n, uint32_t stride, uint32_t rows, float scale) { \
        softmax(x, n, stride, rows, scale); \
    } \
    extern "C" __global__ void softmax_gradient_##S(const T *a, T *g, uint32_t n, uint32_t stride, uint32_t rows, float scale) { \
        softmax_gradient(a, g, n, stride, rows, scale); \
    } \
    extern "C" __global__ void layer_norm_##S(const T *x, const T *weight, const T *bias, T *y, uint32_t d, float eps, \
                                              uint32_t affine, float one, uint32_t group, uint32_t stride, uint32_t bias_at) { \
        layer_norm(x, weight, bias, y, d, eps, affine, one, group, stride, bias_at); \
    } \
    extern "C" __global__ void layer_norm_gradient_##S(const T *x, const T *weight, const T *grad, T *dx, float2 *stats, uint32_t d, \
                                                       float eps, uint32_t affine) { \
        layer_norm_gradient(x, weight, grad, dx, stats, d, eps, affine); \
    } \
    extern "C" __global__ void column_sums_##S(const T *g, const T *y, const float2 *stats, float *partial, uint32_t rows, \
                                               uint32_t n, uint32_t chunk, uint32_t with) { \
        column_sums(g, y, stats, partial, rows, n, chunk, with); \
    } \
    extern "C" __global__ void sum_partial_##S(const float *partial, T *out, uint32_t chunks, uint32_t n) { \
        sum_partial(partial, out, chunks, n); \
    } \
    extern "C" __global__ void gelu_##S(const T *x, T *y, uint32_t count) { gelu(x, y, count); } \
    extern "C" __global__ void gelu_gradient_##S(const T *x, T *g, uint32_t count) { gelu_gradient(x, g, count); } \
    extern "C" __global__ void residual_##S(const T *h, const T *y, const T *lambda, T *out, uint32_t n, uint32_t count) { \
        residual(h, y, lambda, out, n, count); \
    } \
    extern "C" __global__ void scale_columns_##S(const T *g, const T *lambda, T *out, uint32_t n, uint32_t count) { \
        scale_columns(g, lambda, out, n, count); \
    }

EXPORT(float, f32)
EXPORT(bf16, bf16)

// Blocks that share an array of the kernels below.
#define SHARED_BLOCKS 64

// A weight and what its step reads and writes: `count` values each.
struct Weight {
    float *weight;
    const float *grad;
    float *moment1, *moment2, *average;
    uint64_t count;
    float rate, shrink;
};

// One step of AdamW with a moving average of the weights, on all arrays at once: blockIdx.y is the array.
extern "C" __global__ void adamw(const Weight *weights, float scale, float correction1, float correction2, float beta1, float beta2,
                                 float eps, float decay) {
    Weight w = weights[blockIdx.y];
    FOR_EACH(i, w.count) {
        float g = w.grad[i] * scale;
        float m = w.moment1[i] += (1 - beta1) * (g - w.moment1[i]);
        float v = w.moment2[i] += (1 - beta2) * (g * g - w.moment2[i]);
        float x = w.weight[i] = w.weight[i] * w.shrink - w.rate * (m / correction1) / (sqrtf(v / correction2) + eps);
        w.average[i] += (1 - decay) * (x - w.average[i]);
    }
}

// Sum of squares of the values that each block takes of the array blockIdx.y, in f64. out: (arrays, SHARED_BLOCKS)
extern "C" __global__ void squares(const Weight *weights, double *out) {
    __shared__ double parts[256];
    Weight w = weights[blockIdx.y];
    double sum = 0;
    FOR_EACH(i, w.count) sum += (double)w.grad[i] * w.grad[i];
    parts[threadIdx.x] = sum;
    for (int half = 128; half > 0; half /= 2) {
        __syncthreads();
        if (threadIdx.x < half) parts[threadIdx.x] += parts[threadIdx.x + half];
    }
    if (threadIdx.x == 0) out[blockIdx.y * SHARED_BLOCKS + blockIdx.x] = parts[0];
}
