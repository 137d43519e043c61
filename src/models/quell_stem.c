/* SPDX-License-Identifier: Apache-2.0 */
/* Features are made row by row and never kept whole: two rows of them are one row of the stem. */
#include "models/quell_stem.h"

enum { BAND = 8 /* rows of the stem that a task makes */ };

typedef struct stem_job {
    const ql_net *net;
    const ql_kernels *kernels;
    const float *bias; /* the stem's, with the flags' share */
    ql_feature_source_fn *source;
    void *user;
    const ql_map *out;
    float *scratch; /* per worker: two rows of features */
} stem_job;

static size_t row_floats(uint32_t width)
{
    return (size_t)width * QL_NUM_FEATURES;
}

static void band_task(void *user, uint32_t task, uint32_t worker)
{
    const stem_job *const job = user;
    const size_t row = row_floats(2 * job->out->width);
    float *const features = job->scratch + worker * 2 * row;
    for (uint32_t y = task * BAND; y < (task + 1) * BAND && y < job->out->height; ++y) {
        job->source(job->user, 2 * y, worker, features);
        job->source(job->user, 2 * y + 1, worker, features + row);
        const ql_conv_row conv = {
            .rows = {features, features + row},
            .weights = job->net->stem.weights,
            .bias = job->bias,
            .out = ql_map_row(job->out, y),
            .num_rows = 2,
            .num_k = 2 * QL_NUM_FEATURES,
            .stride = 2 * QL_NUM_FEATURES,
            .num_pixels = job->out->width,
            .num_out = job->net->stem.num_out,
            .relu = 1,
        };
        job->kernels->conv_row(&conv);
    }
}

uint64_t ql_net_stem_bytes(uint32_t width, uint32_t num_workers)
{
    return (uint64_t)num_workers * 2 * row_floats(width) * sizeof(float);
}

quell_status ql_net_stem(const ql_net *net, const ql_kernels *kernels, ql_env *env, const float *flags,
                         ql_feature_source_fn *source, void *user, const ql_map *out, ql_error *err)
{
    stem_job job = {.net = net, .kernels = kernels, .source = source, .user = user, .out = out};
    float *const bias = ql_alloc(env->memory, net->widths[0], sizeof *bias);
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), 2 * row_floats(2 * out->width) * sizeof(float));
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
