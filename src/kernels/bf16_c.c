/* SPDX-License-Identifier: Apache-2.0 */
/* The specification of the bfloat16 kernels, in the order of VDPBF16PS (Intel SDM volume 2): of each pair of products the
 * odd one is added first. A product of two bfloat16 numbers fits into a float, so an addition rounds once, as a fused
 * multiply-add does. */
#include "base/bf16.h"
#include "kernels/kernels.h"

#include <float.h>
#include <math.h>

static float flushed(float x)
{
    return fabsf(x) < FLT_MIN ? copysignf(0.0f, x) : x;
}

static float factor(uint16_t x)
{
    return flushed(ql_bf16_to_float(x));
}

static void bf16_conv_row(const ql_bf16_conv_row *conv)
{
    const size_t num_weights = (size_t)conv->num_rows * conv->num_k;
    for (size_t x = 0; x < conv->num_pixels; ++x) {
        for (size_t c = 0; c < conv->num_out; ++c) {
            const uint16_t *w = conv->weights + c / QL_BLOCK * num_weights * QL_BLOCK + c % QL_BLOCK * 2;
            float sum = flushed(conv->bias[c]);
            for (size_t r = 0; r < conv->num_rows; ++r) {
                const uint16_t *const in = conv->rows[r] + x * conv->stride;
                for (size_t k = 0; k < conv->num_k; k += 2, w += 2 * QL_BLOCK) {
                    sum = flushed(sum + factor(in[k + 1]) * factor(w[1]));
                    sum = flushed(sum + factor(in[k]) * factor(w[0]));
                }
            }
            const float result = conv->relu && sum < 0.0f ? 0.0f : sum;
            if (conv->out)
                conv->out[x * conv->num_out + c] = ql_bf16_from_float(result);
            else
                conv->sums[x * conv->num_out + c] = result;
        }
    }
}

static void bf16_round_row(const float *in, uint16_t *out, uint32_t num)
{
    for (size_t i = 0; i < num; ++i) out[i] = ql_bf16_from_float(in[i]);
}

static void bf16_expand_row(const uint16_t *in, float *out, uint32_t num)
{
    for (size_t i = 0; i < num; ++i) out[i] = ql_bf16_to_float(in[i]);
}

static void bf16_add_row(const float *add, uint16_t *map, uint32_t num_channels, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x, map += num_channels) {
        const float *const from = add + x / 2 * num_channels;
        for (size_t c = 0; c < num_channels; ++c) {
            const float sum = ql_bf16_to_float(map[c]) + from[c];
            map[c] = ql_bf16_from_float(sum > 0.0f ? sum : 0.0f);
        }
    }
}

void ql_kernels_init_bf16_c(ql_kernels *kernels)
{
    kernels->bf16 = QL_BF16_SPECIFICATION;
    kernels->bf16_conv_row = bf16_conv_row;
    kernels->bf16_round_row = bf16_round_row;
    kernels->bf16_expand_row = bf16_expand_row;
    kernels->bf16_add_row = bf16_add_row;
}
