/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Vector bodies of what DGAN-KPN needs (wide_c.c is the specification), included after simd_tmpl.h, whose helpers they
 * use. A lane's operations do not depend on where it stands.
 */

static void softmax_row(float *planes, size_t stride, uint32_t num_planes, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; x += QL_W) {
        const size_t n = num_pixels - x;
        float *const at = planes + x;
        vf top = v_load_some(at, n), sum = v_set1(0.0f);
        for (size_t k = 1; k < num_planes; ++k) top = v_max(top, v_load_some(at + k * stride, n));
        for (size_t k = 0; k < num_planes; ++k) {
            const vf e = v_exp(v_sub(v_load_some(at + k * stride, n), top));
            v_store_some(at + k * stride, e, n);
            sum = v_add(sum, e);
        }
        const vf scale = v_div(v_set1(1.0f), sum);
        for (size_t k = 0; k < num_planes; ++k)
            v_store_some(at + k * stride, v_mul(v_load_some(at + k * stride, n), scale), n);
    }
}

/* Up to three channels at a time share the loads of the weights. */
static inline __attribute__((always_inline)) void gather_channels(const ql_gather_row *gather, size_t x, size_t n,
                                                                  size_t first, size_t num)
{
    const ptrdiff_t radius = (ptrdiff_t)gather->radius, side = 2 * radius + 1;
    const float *weight = gather->weights + x;
    vf sum[3];
    for (size_t c = 0; c < num; ++c) sum[c] = v_set1(0.0f);
    for (ptrdiff_t dy = -radius; dy <= radius; ++dy) {
        for (ptrdiff_t dx = 0; dx < side; ++dx, weight += gather->weights_stride) {
            const vf w = v_load_some(weight, n);
            const ptrdiff_t at = (ptrdiff_t)x + dy * gather->in_stride + dx - radius;
            for (size_t c = 0; c < num; ++c) sum[c] = v_fma(w, v_load_some(gather->in[first + c] + at, n), sum[c]);
        }
    }
    for (size_t c = 0; c < num; ++c) v_store_some(gather->out[first + c] + x, sum[c], n);
}

static void gather_row(const ql_gather_row *gather)
{
    for (size_t x = 0; x < gather->num_pixels; x += QL_W) {
        const size_t n = gather->num_pixels - x;
        size_t c = 0;
        for (; c + 3 <= gather->num_channels; c += 3) {
            if (n >= QL_W)
                gather_channels(gather, x, QL_W, c, 3);
            else
                gather_channels(gather, x, n, c, 3);
        }
        for (; c < gather->num_channels; ++c) gather_channels(gather, x, n, c, 1);
    }
}

/* Plain loops over the channels, which the compiler makes vectors of: each channel's sum keeps its order. */
static void moments_row(const float *restrict in, uint32_t num_channels, uint32_t num_pixels, double *restrict sums,
                        double *restrict squares)
{
    for (size_t x = 0; x < num_pixels; ++x, in += num_channels) {
        for (size_t c = 0; c < num_channels; ++c) sums[c] += (double)in[c];
        for (size_t c = 0; c < num_channels; ++c) squares[c] += (double)in[c] * (double)in[c];
    }
}

static void norm_row(const ql_norm_row *norm)
{
    for (size_t c = 0; c < norm->num_channels; c += QL_W) {
        const vf mean = v_load(norm->mean + c), scale = v_load(norm->scale + c);
        for (size_t x = 0; x < norm->num_pixels; ++x) {
            const size_t at = x * norm->num_channels + c;
            vf value = v_max(v_mul(v_sub(v_load(norm->in + at), mean), scale), v_set1(0.0f));
            if (norm->add) value = v_add(value, v_load(norm->add + at));
            v_store(norm->out + at, value);
        }
    }
}

static void expm1_row(const float *in, float top, float scale, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; x += QL_W) {
        const size_t n = num_pixels - x;
        const vf y = v_min(v_max(v_load_some(in + x, n), v_set1(0.0f)), v_set1(top));
        v_store_some(out + x, v_mul(v_set1(scale), v_sub(v_exp(y), v_set1(1.0f))), n);
    }
}

static void fill_wide(ql_kernels *kernels)
{
    kernels->softmax_row = softmax_row;
    kernels->gather_row = gather_row;
    kernels->moments_row = moments_row;
    kernels->norm_row = norm_row;
    kernels->expm1_row = expm1_row;
}
