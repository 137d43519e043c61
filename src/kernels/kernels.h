/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The table of hot loops, filled once for the machine and then constant. Kernels know arrays, no frames and no network.
 *
 * Each works on one row. The C version is the specification; a SIMD version differs only by the rounding of fused
 * multiply-adds (docs/NUMERICS.md), and gives each value the same bits wherever it stands in a row, so that tiles do not
 * show. No kernel reads or writes outside its stated extents. Buffers need no alignment unless said.
 */
#ifndef QL_KERNELS_KERNELS_H
#define QL_KERNELS_KERNELS_H

#include <stddef.h>
#include <stdint.h>

enum { QL_BLOCK = 16 };        /* output channels come in blocks of this many */
enum { QL_MAX_CONV_ROWS = 5 }; /* 5x5 */
enum { QL_MAX_DIMS = 16 };      /* of an embedding */

/* A convolution of one row, whatever its size: out[x][c] = act(bias[c] + sum over rows r and k < num_k of
 * rows[r][x * stride + k] * weights[c / 16][r * num_k + k][c % 16] + add[x][c]).
 * 3x3: 3 rows, num_k = 3 * channels, stride = channels, rows starting one pixel left of x = 0. 2x2 stride 2: 2 rows,
 * num_k = stride = 2 * channels. 1x1: 1 row, num_k = stride = channels.
 * weights, bias and out are aligned to 64 bytes; out is [num_pixels][num_out], num_out a multiple of QL_BLOCK. add has
 * out's shape, or is NULL; it may be out itself. relu: 0 or 1. */
typedef struct ql_conv_row {
    const float *rows[QL_MAX_CONV_ROWS];
    const float *weights, *bias, *add;
    float *out;
    uint32_t num_rows, num_k, stride, num_pixels, num_out;
    int32_t relu;
} ql_conv_row;
typedef void ql_conv_row_fn(const ql_conv_row *conv);

/* How alike two pixels are: planes of an embedding, and how sharply each of its dimensions is looked at. Used below as
 * distance(x, q) = sum_e sharpness[e][x] * (embedding[e][x] - other[e][q])^2. */
typedef struct ql_affinity {
    const float *embedding; /* dimension 0 at pixel 0 of the row */
    size_t embedding_plane; /* floats between dimensions */
    const float *other;     /* dimension 0 at the central tap of pixel 0 */
    size_t other_plane;
    ptrdiff_t other_stride; /* floats between rows */
    const float *sharpness; /* dimension 0 at pixel 0, >= 0 */
    size_t sharpness_plane;
    uint32_t num_dims; /* at most QL_MAX_DIMS */
} ql_affinity;

/* Guided kernels applied: out[c][x] = sum_k softmax_k(logit)[k][x] * in[c][y + dy][x + dx],
 * logit[k][x] = table[k] + [k = 12] * centre[x] - distance(x, k).
 * in[c] and affinity.other point at (x, y), of which 2 pixels on every side are readable; in_stride: floats between the
 * rows of in. */
typedef struct ql_filter_row {
    ql_affinity affinity;
    const float *centre, *table; /* [num_pixels], [25] */
    const float *const *in;      /* [num_channels] */
    ptrdiff_t in_stride;
    float *const *out; /* [num_channels] */
    uint32_t num_channels, num_pixels;
} ql_filter_row;
typedef void ql_filter_row_fn(const ql_filter_row *filter);

/* out[c][x] = (1 - a) * out[c][x] + a * sum_k softmax_k(logit)[k][x] * in[c][y/2 + dy][x/2 + dx], a = sigmoid(blend[x]),
 * logit[k][x] = table[x % 2][k] - distance(x, k). in[c] and affinity.other point at the parent of pixel 0 (x is even
 * there), 1 pixel on every side is readable. num_pixels is even. */
typedef struct ql_upsample_row {
    ql_affinity affinity;
    const float *blend, *table[2]; /* [num_pixels], [9] each */
    const float *const *in;
    ptrdiff_t in_stride;
    float *const *out;
    uint32_t num_channels, num_pixels;
} ql_upsample_row;
typedef void ql_upsample_row_fn(const ql_upsample_row *upsample);

/* out[c][x] = sum over the 2x2 cell of softmax(logits) * in[c]; x < num_cells. logits and in each have two rows. */
typedef struct ql_partition_row {
    const float *logits[2];
    const float *const *in; /* [num_channels], row 0 of the cells */
    ptrdiff_t in_stride;
    float *const *out;
    uint32_t num_channels, num_cells;
} ql_partition_row;
typedef void ql_partition_row_fn(const ql_partition_row *partition);

/* out[x] = sigmoid(clamp(logits[x], -12, 12)). in may be out. */
typedef void ql_sigmoid_row_fn(const float *logits, float *out, uint32_t num_pixels);

/* out[x] = exp(clamp(logits[x], -8, 8)). in may be out. */
typedef void ql_exp_row_fn(const float *logits, float *out, uint32_t num_pixels);

/* out[x] = 0.5 * log(1 + 8 * max(0, scale * in[x])): radiance as the network sees it. in may be out. */
typedef void ql_tone_row_fn(const float *in, float scale, float *out, uint32_t num_pixels);

/* Softmax of each pixel over planes, in place: planes[k][x] = exp(planes[k][x]) / sum over k. [dgan-kpn] eq. 1. stride:
 * floats between planes. */
typedef void ql_softmax_row_fn(float *planes, size_t stride, uint32_t num_planes, uint32_t num_pixels);

/* Kernels of any size applied, [dgan-kpn] eq. 2: out[c][x] = sum_k weights[k][x] * in[c][y + dy][x + dx], k running over
 * (2 radius + 1)^2 taps row by row. in[c] points at (x, y) of channel c, of which radius pixels on every side are
 * readable. */
typedef struct ql_gather_row {
    const float *weights;
    size_t weights_stride; /* floats between taps */
    const float *const *in;
    ptrdiff_t in_stride;
    float *const *out;
    uint32_t radius, num_channels, num_pixels;
} ql_gather_row;
typedef void ql_gather_row_fn(const ql_gather_row *gather);

/* Adds to sums[c] and squares[c] the sum and the sum of squares of in[x][c]. */
typedef void ql_moments_row_fn(const float *in, uint32_t num_channels, uint32_t num_pixels, double *sums,
                               double *squares);

/* out[x][c] = max(0, (in[x][c] - mean[c]) * scale[c]) + add[x][c]. num_channels is a multiple of QL_BLOCK; add may be
 * NULL; out may be in or add. */
typedef struct ql_norm_row {
    const float *in, *mean, *scale, *add;
    float *out;
    uint32_t num_channels, num_pixels;
} ql_norm_row;
typedef void ql_norm_row_fn(const ql_norm_row *norm);

/* out[x] = scale * (exp(min(max(in[x], 0), top)) - 1): the inverse of a logarithm. in may be out. */
typedef void ql_expm1_row_fn(const float *in, float top, float scale, float *out, uint32_t num_pixels);

/* Channels to planes: out[k][x * group + j] = in[x][k * group + j], group 1 or 2, k < num_planes. in_stride: floats
 * between pixels; out_stride: floats between planes. */
typedef void ql_planes_row_fn(const float *in, size_t in_stride, uint32_t num_planes, uint32_t group, float *out,
                              size_t out_stride, uint32_t num_pixels);

/* ---- bfloat16: maps and weights in it, sums in float -------------------------------------------------------------- */

/* The convolution of ql_conv_row on bfloat16. Two neighbouring values of k go into one step, as VDPBF16PS does it:
 * sum = (sum + a[k + 1] * w[k + 1]) + a[k] * w[k], rounded to nearest after each product, which is exact by itself; values
 * and sums below 2^-126 count as 0. All versions give the same bits where no product leaves the range of normal floats.
 * weights: [num_out / 16][num_rows * num_k / 2][16][2], num_k even, aligned to 64 bytes as bias is. The result goes to out,
 * rounded, or, where that is NULL, to sums. rows and out may not overlap. */
typedef struct ql_bf16_conv_row {
    const uint16_t *rows[QL_MAX_CONV_ROWS];
    const uint16_t *weights;
    const float *bias;
    uint16_t *out;
    float *sums;
    uint32_t num_rows, num_k, stride, num_pixels, num_out;
    int32_t relu;
} ql_bf16_conv_row;
typedef void ql_bf16_conv_row_fn(const ql_bf16_conv_row *conv);

/* out[i] = in[i] rounded; out[i] = in[i]. */
typedef void ql_bf16_round_row_fn(const float *in, uint16_t *out, uint32_t num);
typedef void ql_bf16_expand_row_fn(const uint16_t *in, float *out, uint32_t num);

/* map[x][c] = max(0, map[x][c] + add[x / 2][c]) rounded, x < num_pixels. num_channels is a multiple of QL_BLOCK. */
typedef void ql_bf16_add_row_fn(const float *add, uint16_t *map, uint32_t num_channels, uint32_t num_pixels);

/* Whether a set of kernels has bfloat16. Its slots are filled in any case, with the C versions where it has none. */
enum { QL_BF16_NONE = 0, QL_BF16_SPECIFICATION = 1 /* in C, slowly */, QL_BF16_FAST = 2 };

typedef struct ql_kernels {
    const char *name; /* "c", "avx2", "avx512", "avx512bf16", "neon" */
    ql_conv_row_fn *conv_row;
    ql_filter_row_fn *filter_row;
    ql_upsample_row_fn *upsample_row;
    ql_partition_row_fn *partition_row;
    ql_sigmoid_row_fn *sigmoid_row;
    ql_exp_row_fn *exp_row;
    ql_tone_row_fn *tone_row;
    ql_planes_row_fn *planes_row;
    ql_softmax_row_fn *softmax_row;
    ql_gather_row_fn *gather_row;
    ql_moments_row_fn *moments_row;
    ql_norm_row_fn *norm_row;
    ql_expm1_row_fn *expm1_row;
    int32_t bf16; /* QL_BF16_* */
    ql_bf16_conv_row_fn *bf16_conv_row;
    ql_bf16_round_row_fn *bf16_round_row;
    ql_bf16_expand_row_fn *bf16_expand_row;
    ql_bf16_add_row_fn *bf16_add_row;
} ql_kernels;

void ql_kernels_init(ql_kernels *kernels, uint32_t cpu); /* cpu: QL_CPU_* bits that may be used */

/* Each fills its own slots; the table keeps the slower version where an instruction set has none. */
void ql_kernels_init_c(ql_kernels *kernels);
void ql_kernels_init_wide_c(ql_kernels *kernels); /* the part of DGAN-KPN; the first one calls it */
void ql_kernels_init_bf16_c(ql_kernels *kernels); /* bfloat16; the first one calls it */
void ql_kernels_init_avx2(ql_kernels *kernels);
void ql_kernels_init_avx512(ql_kernels *kernels);
void ql_kernels_init_avx512bf16(ql_kernels *kernels); /* on top of the one above: bfloat16 alone */
void ql_kernels_init_neon(ql_kernels *kernels);

#endif
