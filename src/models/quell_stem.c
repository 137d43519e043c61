/* SPDX-License-Identifier: Apache-2.0 */
/* Features are made row by row and never kept whole: two rows of them are one row of the stem. */
#include "models/quell_stem.h"

enum {
    BAND = 8, /* rows of the stem that a task makes */
    SPAN = 64 /* its pixels that are floats at a time, where the map is bfloat16 */
};

typedef struct stem_job {
    const ql_net *net;
    const ql_kernels *kernels;
    const float *bias; /* the stem's, with the flags' share */
    ql_feature_source_fn *source;
    void *user;
    const ql_map *out;
    float *scratch; /* per worker: two rows of features, SPAN pixels of the result */
    size_t scratch_floats;
} stem_job;

static size_t row_floats(uint32_t width)
{
    return (size_t)width * QL_NUM_FEATURES;
}

static size_t scratch_floats(const ql_net *net, uint32_t width)
{
    return 2 * row_floats(width) + (size_t)SPAN * net->widths[0];
}

/* The sums are floats, as everywhere: what is kept of them is rounded. */
static void rounded_row(const stem_job *job, ql_conv_row conv, float *sums, uint16_t *out)
{
    const uint32_t width = conv.num_pixels;
    conv.out = sums;
    for (uint32_t x = 0; x < width; x += SPAN, out += (size_t)SPAN * conv.num_out) {
        conv.num_pixels = width - x < SPAN ? width - x : SPAN;
        job->kernels->conv_row(&conv);
        job->kernels->bf16_round_row(sums, out, conv.num_pixels * conv.num_out);
        for (uint32_t r = 0; r < conv.num_rows; ++r) conv.rows[r] += (size_t)SPAN * conv.stride;
    }
}

static void band_task(void *user, uint32_t task, uint32_t worker)
{
    const stem_job *const job = user;
    const size_t row = row_floats(2 * job->out->width);
    float *const features = job->scratch + worker * job->scratch_floats;
    for (uint32_t y = task * BAND; y < (task + 1) * BAND && y < job->out->height; ++y) {
        job->source(job->user, 2 * y, worker, features);
        job->source(job->user, 2 * y + 1, worker, features + row);
        ql_conv_row conv = {
            .rows = {features, features + row},
            .weights = job->net->stem.weights,
            .bias = job->bias,
            .num_rows = 2,
            .num_k = 2 * QL_NUM_FEATURES,
            .stride = 2 * QL_NUM_FEATURES,
            .num_pixels = job->out->width,
            .num_out = job->net->stem.num_out,
            .relu = 1,
        };
        if (job->out->values == QL_VALUES_BF16) {
            rounded_row(job, conv, features + 2 * row, ql_map_bf16_row(job->out, y));
        } else {
            conv.out = ql_map_row(job->out, y);
            job->kernels->conv_row(&conv);
        }
    }
}

uint64_t ql_net_stem_bytes(const ql_net *net, uint32_t width, uint32_t num_workers)
{
    return (uint64_t)num_workers * scratch_floats(net, width) * sizeof(float);
}

quell_status ql_net_stem(const ql_net *net, const ql_kernels *kernels, ql_env *env, const float *flags,
                         ql_feature_source_fn *source, void *user, const ql_map *out, ql_error *err)
{
    stem_job job = {.net = net, .kernels = kernels, .source = source, .user = user, .out = out};
    float *const bias = ql_alloc(env->memory, net->widths[0], sizeof *bias);
    job.scratch_floats = scratch_floats(net, 2 * out->width);
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job.scratch_floats * sizeof *job.scratch);
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    if (bias == NULL || job.scratch == NULL) {
        ql_fail(err, status, "out of memory: features of a region %u pixels wide", 2 * out->width);
    } else {
        for (uint32_t c = 0; c < net->widths[0]; ++c) {
            bias[c] = net->stem.bias[c];
            for (uint32_t f = 0; f < QL_NUM_FLAGS; ++f) bias[c] += flags[f] * net->flags[f * net->widths[0] + c];
        }
        job.bias = bias;
        status = ql_env_run(env, (out->height + BAND - 1) / BAND, band_task, &job);
    }
    ql_free(env->memory, job.scratch);
    ql_free(env->memory, bias);
    return status;
}
