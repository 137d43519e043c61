/* SPDX-License-Identifier: Apache-2.0 */
/* The specification of what DGAN-KPN needs beside the other kernels: wide softmax kernels, instance normalisation. */
#include "kernels/kernels.h"
#include "kernels/poly_c.h"

static void softmax_row(float *planes, size_t stride, uint32_t num_planes, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x) {
        float top = planes[x], sum = 0.0f;
        for (size_t k = 1; k < num_planes; ++k) top = top < planes[k * stride + x] ? planes[k * stride + x] : top;
        for (size_t k = 0; k < num_planes; ++k) {
            planes[k * stride + x] = exp_poly(planes[k * stride + x] - top);
            sum += planes[k * stride + x];
        }
        const float scale = 1.0f / sum;
        for (size_t k = 0; k < num_planes; ++k) planes[k * stride + x] *= scale;
    }
}

static void gather_row(const ql_gather_row *gather)
{
    const ptrdiff_t radius = (ptrdiff_t)gather->radius, side = 2 * radius + 1;
    for (size_t c = 0; c < gather->num_channels; ++c) {
        for (size_t x = 0; x < gather->num_pixels; ++x) {
            float sum = 0.0f;
            for (ptrdiff_t k = 0; k < side * side; ++k)
                sum += gather->weights[(size_t)k * gather->weights_stride + x] *
                       gather->in[c][(ptrdiff_t)x + (k / side - radius) * gather->in_stride + k % side - radius];
            gather->out[c][x] = sum;
        }
    }
}

static void moments_row(const float *in, uint32_t num_channels, uint32_t num_pixels, double *sums, double *squares)
{
    for (size_t x = 0; x < num_pixels; ++x, in += num_channels) {
        for (size_t c = 0; c < num_channels; ++c) {
            sums[c] += (double)in[c];
            squares[c] += (double)in[c] * (double)in[c];
        }
    }
}

static void norm_row(const ql_norm_row *norm)
{
    for (size_t x = 0; x < norm->num_pixels; ++x) {
        for (size_t c = 0; c < norm->num_channels; ++c) {
            const size_t at = x * norm->num_channels + c;
            const float value = (norm->in[at] - norm->mean[c]) * norm->scale[c];
            norm->out[at] = (value > 0.0f ? value : 0.0f) + (norm->add ? norm->add[at] : 0.0f);
        }
    }
}

static void expm1_row(const float *in, float top, float scale, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x) {
        float y = in[x] > 0.0f ? in[x] : 0.0f;
        y = y < top ? y : top;
        out[x] = scale * (exp_poly(y) - 1.0f);
    }
}

void ql_kernels_init_wide_c(ql_kernels *kernels)
{
    kernels->softmax_row = softmax_row;
    kernels->gather_row = gather_row;
    kernels->moments_row = moments_row;
    kernels->norm_row = norm_row;
    kernels->expm1_row = expm1_row;
}
