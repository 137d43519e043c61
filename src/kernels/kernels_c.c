/* SPDX-License-Identifier: Apache-2.0 */
/* The specification: every kernel as plain loops. Sums run in the order that the vector versions keep. */
#include "kernels/kernels.h"
#include "kernels/poly_c.h"

static float sigmoid(float x)
{
    return 1.0f / (1.0f + exp_poly(-x));
}

static void conv_row(const ql_conv_row *conv)
{
    const size_t num_weights = (size_t)conv->num_rows * conv->num_k;
    for (size_t x = 0; x < conv->num_pixels; ++x) {
        for (size_t c = 0; c < conv->num_out; ++c) {
            const float *w = conv->weights + c / QL_BLOCK * num_weights * QL_BLOCK + c % QL_BLOCK;
            float sum = conv->bias[c];
            for (size_t r = 0; r < conv->num_rows; ++r)
                for (size_t k = 0; k < conv->num_k; ++k, w += QL_BLOCK) sum += conv->rows[r][x * conv->stride + k] * *w;
            if (conv->add) sum += conv->add[x * conv->num_out + c];
            conv->out[x * conv->num_out + c] = conv->relu && sum < 0.0f ? 0.0f : sum;
        }
    }
}

/* Replaces num logits by exp(logit - max) and returns 1 / their sum. */
static float softmax_one(float *weights, size_t num)
{
    float top = weights[0], sum = 0.0f;
    for (size_t k = 1; k < num; ++k) top = top < weights[k] ? weights[k] : top;
    for (size_t k = 0; k < num; ++k) {
        weights[k] = exp_poly(weights[k] - top);
        sum += weights[k];
    }
    return 1.0f / sum;
}

/* logit - distance of pixel x to the tap at `offset` from the affinity's central tap. */
static float less_distance(const ql_affinity *a, size_t x, ptrdiff_t offset, float logit)
{
    for (size_t e = 0; e < a->num_dims; ++e) {
        const float d = a->embedding[e * a->embedding_plane + x] - (a->other + e * a->other_plane)[offset];
        logit += -a->sharpness[e * a->sharpness_plane + x] * d * d;
    }
    return logit;
}

static void filter_row(const ql_filter_row *filter)
{
    for (size_t x = 0; x < filter->num_pixels; ++x) {
        float weights[25];
        for (ptrdiff_t k = 0; k < 25; ++k) {
            const ptrdiff_t offset = (ptrdiff_t)x + (k / 5 - 2) * filter->affinity.other_stride + k % 5 - 2;
            const float logit = k == 12 ? filter->table[k] + filter->centre[x] : filter->table[k];
            weights[k] = less_distance(&filter->affinity, x, offset, logit);
        }
        const float scale = softmax_one(weights, 25);
        for (size_t c = 0; c < filter->num_channels; ++c) {
            float sum = 0.0f;
            for (ptrdiff_t k = 0; k < 25; ++k)
                sum += weights[k] * filter->in[c][(ptrdiff_t)x + (k / 5 - 2) * filter->in_stride + k % 5 - 2];
            filter->out[c][x] = sum * scale;
        }
    }
}

static void upsample_row(const ql_upsample_row *up)
{
    for (size_t x = 0; x < up->num_pixels; ++x) {
        float weights[9];
        for (ptrdiff_t k = 0; k < 9; ++k) {
            const ptrdiff_t offset = (ptrdiff_t)(x / 2) + (k / 3 - 1) * up->affinity.other_stride + k % 3 - 1;
            weights[k] = less_distance(&up->affinity, x, offset, up->table[x % 2][k]);
        }
        const float scale = softmax_one(weights, 9);
        const float a = sigmoid(up->blend[x]);
        for (size_t c = 0; c < up->num_channels; ++c) {
            float sum = 0.0f;
            for (ptrdiff_t k = 0; k < 9; ++k)
                sum += weights[k] * up->in[c][(ptrdiff_t)(x / 2) + (k / 3 - 1) * up->in_stride + k % 3 - 1];
            up->out[c][x] = (1.0f - a) * up->out[c][x] + a * (sum * scale);
        }
    }
}

static void partition_row(const ql_partition_row *partition)
{
    for (size_t x = 0; x < partition->num_cells; ++x) {
        const float *const *l = partition->logits;
        float weights[4] = {l[0][2 * x], l[0][2 * x + 1], l[1][2 * x], l[1][2 * x + 1]};
        const float scale = softmax_one(weights, 4);
        for (size_t c = 0; c < partition->num_channels; ++c) {
            const float *const in = partition->in[c] + 2 * x, *const below = in + partition->in_stride;
            const float sum = weights[0] * in[0] + weights[1] * in[1] + weights[2] * below[0] + weights[3] * below[1];
            partition->out[c][x] = sum * scale;
        }
    }
}

static void sigmoid_row(const float *logits, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x) {
        float z = logits[x] < -QL_SIGMOID_RANGE ? -QL_SIGMOID_RANGE : logits[x];
        z = z > QL_SIGMOID_RANGE ? QL_SIGMOID_RANGE : z;
        out[x] = sigmoid(z);
    }
}

static void exp_row(const float *logits, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x) {
        float z = logits[x] < -QL_SHARPNESS_RANGE ? -QL_SHARPNESS_RANGE : logits[x];
        z = z > QL_SHARPNESS_RANGE ? QL_SHARPNESS_RANGE : z;
        out[x] = exp_poly(z);
    }
}

static void tone_row(const float *in, float scale, float *out, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x) {
        const float z = in[x] * scale;
        out[x] = 0.5f * log_poly(1.0f + 8.0f * (z > 0.0f ? z : 0.0f));
    }
}

static void planes_row(const float *in, size_t in_stride, uint32_t num_planes, uint32_t group, float *out,
                       size_t out_stride, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x)
        for (size_t k = 0; k < num_planes; ++k)
            for (size_t j = 0; j < group; ++j) out[k * out_stride + x * group + j] = in[x * in_stride + k * group + j];
}

void ql_kernels_init_c(ql_kernels *kernels)
{
    kernels->name = "c";
    kernels->conv_row = conv_row;
    kernels->filter_row = filter_row;
    kernels->upsample_row = upsample_row;
    kernels->partition_row = partition_row;
    kernels->sigmoid_row = sigmoid_row;
    kernels->exp_row = exp_row;
    kernels->tone_row = tone_row;
    kernels->planes_row = planes_row;
    ql_kernels_init_wide_c(kernels);
    ql_kernels_init_bf16_c(kernels);
}
