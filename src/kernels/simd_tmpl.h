/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The bodies of the vector kernels, included once by each instruction set's file after it has defined:
 *
 *   vf                     a vector of QL_W floats (4, 8 or 16)
 *   v_load v_store         unaligned; v_load_n v_store_n (p, n): the first n < QL_W lanes, others read as 0
 *   v_set1 v_add v_sub v_mul v_div v_min v_max v_round
 *   v_fma(a, b, c)         a * b + c, fused
 *   v_pow2(n)              2^n for whole n in [-126, 127]
 *   v_frexp1(z, &e)        mantissa in [1, 2) and exponent of z >= 1
 *   v_gt_select(a, b, x, y) a > b ? x : y
 *   v_twice(p, n)          lanes p[0] p[0] p[1] p[1] ...; reads n / 2 floats for n lanes
 *   v_deinterleave(p, n, &even, &odd)  p[0] p[2] ..., p[1] p[3] ...; reads 2 n floats for n lanes
 *   v_transpose(r)         r[i][j] <-> r[j][i] of QL_W vectors
 *   v_transpose_pairs(r)   the same of QL_W / 2 vectors of QL_W / 2 pairs of floats
 *   QL_TILE1 .. QL_TILE4   pixels per register tile at 1 to 4 vectors of channels
 *
 * A lane's operations do not depend on where it stands, so tails and tiles give the same bits.
 */
#include "kernels/kernels.h"
#include "kernels/poly.h"

static inline vf v_exp(vf x)
{
    x = v_min(v_max(x, v_set1(QL_EXP_MIN)), v_set1(QL_EXP_MAX));
    const vf n = v_round(v_mul(x, v_set1(QL_LOG2E)));
    vf r = v_fma(n, v_set1(-QL_LN2_HIGH), x);
    r = v_fma(n, v_set1(-QL_LN2_LOW), r);
    vf p = v_set1(QL_EXP_C7);
    p = v_fma(p, r, v_set1(QL_EXP_C6));
    p = v_fma(p, r, v_set1(QL_EXP_C5));
    p = v_fma(p, r, v_set1(QL_EXP_C4));
    p = v_fma(p, r, v_set1(QL_EXP_C3));
    p = v_fma(p, r, v_set1(QL_EXP_C2));
    p = v_fma(p, r, v_set1(1.0f));
    p = v_fma(p, r, v_set1(1.0f));
    return v_mul(p, v_pow2(n));
}

static inline vf v_log(vf z) /* z >= 1 */
{
    vf e, m = v_frexp1(z, &e);
    e = v_gt_select(m, v_set1(QL_SQRT2), v_add(e, v_set1(1.0f)), e);
    m = v_gt_select(m, v_set1(QL_SQRT2), v_mul(m, v_set1(0.5f)), m);
    const vf s = v_div(v_sub(m, v_set1(1.0f)), v_add(m, v_set1(1.0f))), s2 = v_mul(s, s);
    vf p = v_set1(QL_LOG_C9);
    p = v_fma(p, s2, v_set1(QL_LOG_C7));
    p = v_fma(p, s2, v_set1(QL_LOG_C5));
    p = v_fma(p, s2, v_set1(QL_LOG_C3));
    p = v_fma(p, s2, v_set1(2.0f));
    return v_fma(e, v_set1(QL_LN2), v_mul(p, s));
}

static inline vf v_sigmoid(vf x)
{
    return v_div(v_set1(1.0f), v_add(v_set1(1.0f), v_exp(v_sub(v_set1(0.0f), x))));
}

static inline vf v_load_some(const float *p, size_t n)
{
    return n >= QL_W ? v_load(p) : v_load_n(p, n);
}

static inline void v_store_some(float *p, vf v, size_t n)
{
    if (n >= QL_W)
        v_store(p, v);
    else
        v_store_n(p, v, n);
}

/* ---- Convolution: P pixels x V vectors of output channels in registers -------------------------------------------- */

#define QL_CONV_TILE(P, V)                                                                                             \
    static inline __attribute__((always_inline)) void conv_tile_##P##_##V(const ql_conv_row *conv, size_t x, size_t c) \
    {                                                                                                                  \
        const size_t num_weights = (size_t)conv->num_rows * conv->num_k;                                               \
        const float *w[V];                                                                                             \
        vf acc[P][V];                                                                                                  \
        _Pragma("GCC unroll 32") for (size_t v = 0; v < V; ++v)                                                        \
        {                                                                                                              \
            const size_t channel = c + v * QL_W;                                                                       \
            w[v] = conv->weights + channel / QL_BLOCK * num_weights * QL_BLOCK + channel % QL_BLOCK;                   \
            const vf bias = v_load(conv->bias + channel);                                                              \
            _Pragma("GCC unroll 32") for (size_t p = 0; p < P; ++p) acc[p][v] = bias;                                  \
        }                                                                                                              \
        size_t offset = 0;                                                                                             \
        for (size_t r = 0; r < conv->num_rows; ++r) {                                                                  \
            const float *in = conv->rows[r] + x * conv->stride;                                                        \
            for (size_t k = 0; k < conv->num_k; ++k, offset += QL_BLOCK, ++in) {                                       \
                vf weight[V];                                                                                          \
                _Pragma("GCC unroll 32") for (size_t v = 0; v < V; ++v) weight[v] = v_load(w[v] + offset);             \
                _Pragma("GCC unroll 32") for (size_t p = 0; p < P; ++p)                                                \
                {                                                                                                      \
                    const vf value = v_set1(in[p * conv->stride]);                                                     \
                    _Pragma("GCC unroll 32") for (size_t v = 0; v < V; ++v) acc[p][v] =                                \
                        v_fma(value, weight[v], acc[p][v]);                                                            \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
        _Pragma("GCC unroll 32") for (size_t p = 0; p < P; ++p)                                                        \
        {                                                                                                              \
            _Pragma("GCC unroll 32") for (size_t v = 0; v < V; ++v)                                                    \
            {                                                                                                          \
                const size_t at = (x + p) * conv->num_out + c + v * QL_W;                                              \
                vf sum = acc[p][v];                                                                                    \
                if (conv->add) sum = v_add(sum, v_load(conv->add + at));                                               \
                if (conv->relu) sum = v_max(sum, v_set1(0.0f));                                                        \
                v_store(conv->out + at, sum);                                                                          \
            }                                                                                                          \
        }                                                                                                              \
    }                                                                                                                  \
    static void conv_columns_##V(const ql_conv_row *conv, size_t c)                                                    \
    {                                                                                                                  \
        size_t x = 0;                                                                                                  \
        for (; x + P <= conv->num_pixels; x += P) conv_tile_##P##_##V(conv, x, c);                                     \
        for (; x < conv->num_pixels; ++x) conv_tile_1_##V(conv, x, c);                                                 \
    }

/* The single-pixel tiles, made by the same text. */
#define QL_CONV_SINGLE(V) QL_CONV_SINGLE_(1, V)
#define QL_CONV_SINGLE_(P, V)                                                                                          \
    static void conv_tile_##P##_##V(const ql_conv_row *conv, size_t x, size_t c)                                       \
    {                                                                                                                  \
        const size_t num_weights = (size_t)conv->num_rows * conv->num_k;                                               \
        for (size_t v = 0; v < V; ++v) {                                                                               \
            const size_t channel = c + v * QL_W, at = x * conv->num_out + channel;                                     \
            const float *w = conv->weights + channel / QL_BLOCK * num_weights * QL_BLOCK + channel % QL_BLOCK;         \
            vf sum = v_load(conv->bias + channel);                                                                     \
            for (size_t r = 0; r < conv->num_rows; ++r)                                                                \
                for (size_t k = 0; k < conv->num_k; ++k, w += QL_BLOCK)                                                \
                    sum = v_fma(v_set1(conv->rows[r][x * conv->stride + k]), v_load(w), sum);                          \
            if (conv->add) sum = v_add(sum, v_load(conv->add + at));                                                   \
            if (conv->relu) sum = v_max(sum, v_set1(0.0f));                                                            \
            v_store(conv->out + at, sum);                                                                              \
        }                                                                                                              \
    }

#define QL_CONV(P, V) QL_CONV_TILE(P, V)
QL_CONV_SINGLE(1)
QL_CONV_SINGLE(2)
QL_CONV(QL_TILE1, 1)
QL_CONV(QL_TILE2, 2)
#if defined(QL_TILE4)
QL_CONV_SINGLE(3)
QL_CONV_SINGLE(4)
QL_CONV(QL_TILE3, 3)
QL_CONV(QL_TILE4, 4)
#endif

static void conv_row(const ql_conv_row *conv)
{
    size_t c = 0, left = conv->num_out / QL_W;
#if defined(QL_TILE4)
    /* Columns of 3 vectors have the best ratio of multiply-adds to loads that still leaves registers for the weights;
     * a remainder of 1 is better shared out as 2 + 2. */
    while (left > 4 || left == 3) {
        conv_columns_3(conv, c);
        c += 3 * QL_W;
        left -= 3;
    }
    if (left == 4) {
        conv_columns_4(conv, c);
        left = 0;
    }
#endif
    for (; left >= 2; left -= 2, c += 2 * QL_W) conv_columns_2(conv, c);
    if (left) conv_columns_1(conv, c);
}

/* Taps are unrolled so that their places are constants. */
#define QL_UNROLL _Pragma("GCC unroll 32")

/* Floats ahead: of the rows that a kernel reads, the lowest is new to the cache. */
#define QL_PREFETCH 96

/* ---- Kernels applied ---------------------------------------------------------------------------------------------- */

/* Replaces num logits by exp(logit - max) and returns 1 / their sum. */
static inline vf softmax(vf *weights, size_t num)
{
    vf top = weights[0], sum = v_set1(0.0f);
    for (size_t k = 1; k < num; ++k) top = v_max(top, weights[k]);
    for (size_t k = 0; k < num; ++k) {
        weights[k] = v_exp(v_sub(weights[k], top));
        sum = v_add(sum, weights[k]);
    }
    return v_div(v_set1(1.0f), sum);
}

/* What a block of pixels needs of an affinity: its own embedding and minus its sharpness. */
typedef struct own_affinity {
    vf embedding[QL_MAX_DIMS], sharpness[QL_MAX_DIMS];
} own_affinity;

static inline __attribute__((always_inline)) void load_own(const ql_affinity *a, size_t x, size_t n, own_affinity *own)
{
    for (size_t e = 0; e < a->num_dims; ++e) {
        own->embedding[e] = v_load_some(a->embedding + e * a->embedding_plane + x, n);
        own->sharpness[e] = v_sub(v_set1(0.0f), v_load_some(a->sharpness + e * a->sharpness_plane + x, n));
    }
}

/* Channels side by side: their sums do not wait for one another. */
static inline __attribute__((always_inline)) void
filter_channels(const ql_filter_row *filter, const vf *weights, vf scale, size_t first, size_t num, size_t x, size_t n)
{
    vf sums[4];
    for (size_t c = 0; c < num; ++c) {
        sums[c] = v_set1(0.0f);
        __builtin_prefetch(filter->in[first + c] + (ptrdiff_t)x + 2 * filter->in_stride + QL_PREFETCH);
    }
    QL_UNROLL for (ptrdiff_t k = 0; k < 25; ++k)
    {
        const ptrdiff_t at = (k / 5 - 2) * filter->in_stride + k % 5 - 2 + (ptrdiff_t)x;
        for (size_t c = 0; c < num; ++c)
            sums[c] = v_fma(weights[k], v_load_some(filter->in[first + c] + at, n), sums[c]);
    }
    for (size_t c = 0; c < num; ++c) v_store_some(filter->out[first + c] + x, v_mul(sums[c], scale), n);
}

/* n lanes; a constant QL_W for whole blocks, so that no load asks again how many there are. */
static inline __attribute__((always_inline)) void filter_block(const ql_filter_row *filter, size_t x, size_t n)
{
    const ql_affinity *const a = &filter->affinity;
    own_affinity own;
    vf weights[25];
    load_own(a, x, n, &own);
    QL_UNROLL for (size_t k = 0; k < 25; ++k) weights[k] = v_set1(filter->table[k]);
    weights[12] = v_add(weights[12], v_load_some(filter->centre + x, n));
    for (size_t e = 0; e < a->num_dims; ++e) {
        const float *const other = a->other + e * a->other_plane + x;
        __builtin_prefetch(other + 2 * a->other_stride + QL_PREFETCH);
        QL_UNROLL for (ptrdiff_t k = 0; k < 25; ++k)
        {
            const vf d = v_sub(own.embedding[e], v_load_some(other + (k / 5 - 2) * a->other_stride + k % 5 - 2, n));
            weights[k] = v_fma(v_mul(own.sharpness[e], d), d, weights[k]);
        }
    }
    const vf scale = softmax(weights, 25);
    size_t c = 0;
    for (; c + 4 <= filter->num_channels; c += 4) filter_channels(filter, weights, scale, c, 4, x, n);
    for (; c < filter->num_channels; ++c) filter_channels(filter, weights, scale, c, 1, x, n);
}

static void filter_row(const ql_filter_row *filter)
{
    size_t x = 0;
    for (; x + QL_W <= filter->num_pixels; x += QL_W) filter_block(filter, x, QL_W);
    if (x < filter->num_pixels) filter_block(filter, x, filter->num_pixels - x);
}

static inline __attribute__((always_inline)) void upsample_block(const ql_upsample_row *up, vf odd, size_t x, size_t n)
{
    const ql_affinity *const a = &up->affinity;
    own_affinity own;
    vf weights[9];
    load_own(a, x, n, &own);
    for (ptrdiff_t k = 0; k < 9; ++k) {
        const float *const other = a->other + x / 2 + (k / 3 - 1) * a->other_stride + k % 3 - 1;
        vf logit = v_gt_select(odd, v_set1(0.0f), v_set1(up->table[1][k]), v_set1(up->table[0][k]));
        for (size_t e = 0; e < a->num_dims; ++e) {
            const vf d = v_sub(own.embedding[e], v_twice(other + e * a->other_plane, n));
            logit = v_fma(v_mul(own.sharpness[e], d), d, logit);
        }
        weights[k] = logit;
    }
    const vf scale = softmax(weights, 9);
    const vf blend = v_sigmoid(v_load_some(up->blend + x, n)), rest = v_sub(v_set1(1.0f), blend);
    for (size_t c = 0; c < up->num_channels; ++c) {
        const float *const in = up->in[c] + x / 2;
        vf sum = v_set1(0.0f);
        for (ptrdiff_t k = 0; k < 9; ++k)
            sum = v_fma(weights[k], v_twice(in + (k / 3 - 1) * up->in_stride + k % 3 - 1, n), sum);
        const vf old = v_load_some(up->out[c] + x, n);
        v_store_some(up->out[c] + x, v_fma(rest, old, v_mul(blend, v_mul(sum, scale))), n);
    }
}

static void upsample_row(const ql_upsample_row *up)
{
    float parity[QL_W];
    for (size_t i = 0; i < QL_W; ++i) parity[i] = (float)(i % 2);
    const vf odd = v_load(parity);
    size_t x = 0;
    for (; x + QL_W <= up->num_pixels; x += QL_W) upsample_block(up, odd, x, QL_W);
    if (x < up->num_pixels) upsample_block(up, odd, x, up->num_pixels - x);
}

static void partition_row(const ql_partition_row *partition)
{
    for (size_t x = 0; x < partition->num_cells; x += QL_W) {
        const size_t n = partition->num_cells - x < QL_W ? partition->num_cells - x : QL_W;
        vf l[4], in[4];
        v_deinterleave(partition->logits[0] + 2 * x, n, &l[0], &l[1]);
        v_deinterleave(partition->logits[1] + 2 * x, n, &l[2], &l[3]);
        const vf top = v_max(v_max(v_max(l[0], l[1]), l[2]), l[3]);
        vf total = v_set1(0.0f);
        for (size_t k = 0; k < 4; ++k) {
            l[k] = v_exp(v_sub(l[k], top));
            total = v_add(total, l[k]);
        }
        const vf scale = v_div(v_set1(1.0f), total);
        for (size_t c = 0; c < partition->num_channels; ++c) {
            const float *const row = partition->in[c] + 2 * x;
            v_deinterleave(row, n, &in[0], &in[1]);
            v_deinterleave(row + partition->in_stride, n, &in[2], &in[3]);
            vf sum = v_mul(l[0], in[0]);
            for (size_t k = 1; k < 4; ++k) sum = v_fma(l[k], in[k], sum);
            v_store_some(partition->out[c] + x, v_mul(sum, scale), n);
        }
    }
}

static void sigmoid_row(const float *logits, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; x += QL_W) {
        const size_t n = num_pixels - x;
        const vf z = v_min(v_max(v_load_some(logits + x, n), v_set1(-QL_SIGMOID_RANGE)), v_set1(QL_SIGMOID_RANGE));
        v_store_some(out + x, v_sigmoid(z), n);
    }
}

static void exp_row(const float *logits, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; x += QL_W) {
        const size_t n = num_pixels - x;
        const vf range = v_set1(QL_SHARPNESS_RANGE), z = v_max(v_load_some(logits + x, n), v_sub(v_set1(0.0f), range));
        v_store_some(out + x, v_exp(v_min(z, range)), n);
    }
}

static void tone_row(const float *in, float scale, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; x += QL_W) {
        const size_t n = num_pixels - x;
        const vf z = v_max(v_mul(v_load_some(in + x, n), v_set1(scale)), v_set1(0.0f));
        v_store_some(out + x, v_mul(v_set1(0.5f), v_log(v_fma(v_set1(8.0f), z, v_set1(1.0f)))), n);
    }
}

/* ---- Channels to planes ------------------------------------------------------------------------------------------- */

/* num_pixels x num_planes, each at most QL_W / group. */
static inline __attribute__((always_inline)) void planes_block(const float *in, size_t in_stride, size_t num_planes,
                                                               size_t group, float *out, size_t out_stride,
                                                               size_t num_pixels)
{
    vf rows[QL_W];
    for (size_t i = 0; i < QL_W / group; ++i)
        rows[i] = i < num_pixels ? v_load_some(in + i * in_stride, num_planes * group) : v_set1(0.0f);
    if (group == 1)
        v_transpose(rows);
    else
        v_transpose_pairs(rows);
    for (size_t k = 0; k < num_planes; ++k) v_store_some(out + k * out_stride, rows[k], num_pixels * group);
}

static inline __attribute__((always_inline)) void planes_blocks(const float *in, size_t in_stride, size_t num_planes,
                                                                size_t group, float *out, size_t out_stride,
                                                                size_t num_pixels)
{
    const size_t step = QL_W / group;
    for (size_t x = 0; x < num_pixels; x += step) {
        const size_t n = num_pixels - x < step ? num_pixels - x : step;
        for (size_t k = 0; k < num_planes; k += step) {
            const float *const from = in + x * in_stride + k * group;
            float *const to = out + k * out_stride + x * group;
            if (n == step && num_planes - k >= step)
                planes_block(from, in_stride, step, group, to, out_stride, step);
            else
                planes_block(from, in_stride, num_planes - k < step ? num_planes - k : step, group, to, out_stride, n);
        }
    }
}

static void planes_row(const float *in, size_t in_stride, uint32_t num_planes, uint32_t group, float *out,
                       size_t out_stride, uint32_t num_pixels)
{
    if (group == 1)
        planes_blocks(in, in_stride, num_planes, 1, out, out_stride, num_pixels);
    else
        planes_blocks(in, in_stride, num_planes, 2, out, out_stride, num_pixels);
}

static void fill_table(ql_kernels *kernels, const char *name)
{
    kernels->name = name;
    kernels->conv_row = conv_row;
    kernels->filter_row = filter_row;
    kernels->upsample_row = upsample_row;
    kernels->partition_row = partition_row;
    kernels->sigmoid_row = sigmoid_row;
    kernels->exp_row = exp_row;
    kernels->tone_row = tone_row;
    kernels->planes_row = planes_row;
    kernels->bf16 = QL_BF16_NONE;
}
