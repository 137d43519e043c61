/* SPDX-License-Identifier: Apache-2.0 */
/* Features are made row by row and never kept whole: a task makes a band of rows, with two more on either side for the
 * 3x3 convolutions at full resolution, and takes all that is wanted from them. */
#include "models/quell_stem.h"

#include <string.h>

enum {
    BAND = 16,            /* rows of a task */
    REACH = 2,            /* rows beyond it that two 3x3 convolutions see */
    MARGIN = 1,           /* pixels of zeros on either side of a row that a 3x3 convolution reads */
    SPAN = 128,           /* pixels taken at a time from a convolution to planes */
    DIRECT_FEATURE = 28,  /* direct diffuse light; training/features.py: DETAIL_PLANES */
    EMISSION_FEATURE = 31
};

typedef struct stem_job {
    const ql_net *net;
    const ql_kernels *kernels;
    const float *bias; /* the stem's, with the flags' share */
    ql_feature_source_fn *source;
    void *user;
    ql_net_maps *maps;
    uint32_t width, height;
    float *scratch;
    size_t scratch_floats;
} stem_job;

/* One worker's rows. */
typedef struct band {
    float *features; /* [2][width][QL_NUM_FEATURES] */
    float *detail;   /* [BAND + 2 REACH][width + 2 MARGIN][QL_NET_DETAIL] */
    float *inner;    /* [BAND + REACH][width + 2 MARGIN][QL_NET_DETAIL] */
    float *buffer;   /* [SPAN][QL_BLOCK], then [QL_NET_DIMS][SPAN] */
    size_t detail_row;
} band;

static size_t detail_row_floats(uint32_t width)
{
    return ((size_t)width + 2 * MARGIN) * QL_NET_DETAIL;
}

static size_t scratch_floats(uint32_t width)
{
    return 2 * (size_t)width * QL_NUM_FEATURES + (2 * BAND + 3 * REACH) * detail_row_floats(width) +
           SPAN * (QL_BLOCK + QL_NET_DIMS);
}

static band worker_band(const stem_job *job, uint32_t worker)
{
    float *const base = job->scratch + worker * job->scratch_floats;
    band b = {.features = base, .detail_row = detail_row_floats(job->width)};
    b.detail = b.features + 2 * (size_t)job->width * QL_NUM_FEATURES;
    b.inner = b.detail + (BAND + 2 * REACH) * b.detail_row;
    b.buffer = b.inner + (BAND + REACH) * b.detail_row;
    return b;
}

/* Guides, direct diffuse light, emission and the mean of beauty. */
static void pick_detail(const float *features, uint32_t width, float *out)
{
    memset(out, 0, QL_NET_DETAIL * sizeof *out);
    out += QL_NET_DETAIL;
    for (size_t x = 0; x < width; ++x, features += QL_NUM_FEATURES, out += QL_NET_DETAIL) {
        memcpy(out, features + QL_FIRST_GUIDE, QL_NUM_GUIDES * sizeof *out);
        out[QL_NUM_GUIDES] = features[DIRECT_FEATURE];
        out[QL_NUM_GUIDES + 1] = features[EMISSION_FEATURE];
        out[QL_NUM_GUIDES + 2] = (features[0] + features[1] + features[2]) / 3.0f;
    }
    memset(out, 0, QL_NET_DETAIL * sizeof *out);
}

static void stem_row(const stem_job *job, const float *features, uint32_t y)
{
    const size_t row = (size_t)job->width * QL_NUM_FEATURES;
    ql_map *const out = &job->maps->level[0];
    const ql_conv_row conv = {
        .rows = {features, features + row},
        .weights = job->net->stem.weights,
        .bias = job->bias,
        .out = ql_map_row(out, y),
        .num_rows = 2,
        .num_k = 2 * QL_NUM_FEATURES,
        .stride = 2 * QL_NUM_FEATURES,
        .num_pixels = out->width,
        .num_out = job->net->stem.num_out,
        .relu = 1,
    };
    job->kernels->conv_row(&conv);
}

/* A row of the embedding: to its planes, or added to what is there. conv has its rows set for pixel 0. */
static void embedding_row(const stem_job *job, ql_conv_row conv, int adds, uint32_t y, float *buffer)
{
    const ql_planes *const out = &job->maps->embedding;
    float *const planes = buffer + SPAN * QL_BLOCK;
    conv.out = buffer;
    for (uint32_t x = 0; x < job->width; x += SPAN) {
        float *const to = ql_planes_row(out, 0, y) + x;
        conv.num_pixels = job->width - x < SPAN ? job->width - x : SPAN;
        job->kernels->conv_row(&conv);
        if (adds) {
            job->kernels->planes_row(buffer, conv.num_out, QL_NET_DIMS, 1, planes, SPAN, conv.num_pixels);
            for (uint32_t e = 0; e < QL_NET_DIMS; ++e)
                for (size_t i = 0; i < conv.num_pixels; ++i) to[e * out->plane + i] += planes[e * SPAN + i];
        } else {
            job->kernels->planes_row(buffer, conv.num_out, QL_NET_DIMS, 1, to, out->plane, conv.num_pixels);
        }
        for (uint32_t r = 0; r < conv.num_rows; ++r) conv.rows[r] += (size_t)SPAN * conv.stride;
    }
}

static ql_conv_row detail_conv(const ql_conv *conv, const float *rows, size_t row_floats)
{
    return (ql_conv_row){
        .rows = {rows, rows + row_floats, rows + 2 * row_floats},
        .weights = conv->weights,
        .bias = conv->bias,
        .num_rows = 3,
        .num_k = 3 * QL_NET_DETAIL,
        .stride = QL_NET_DETAIL,
        .num_out = conv->num_out,
    };
}

/* Features of rows y0 - REACH to y1 + REACH - 1, and what needs no more than two of them. */
static void feature_rows(const stem_job *job, const band *b, uint32_t y0, uint32_t y1, uint32_t worker)
{
    const size_t row = (size_t)job->width * QL_NUM_FEATURES;
    for (int64_t y = (int64_t)y0 - REACH; y < (int64_t)y1 + REACH; ++y) {
        float *const detail = b->detail + (size_t)(y - y0 + REACH) * b->detail_row;
        if (y < 0 || y >= job->height) {
            memset(detail, 0, b->detail_row * sizeof *detail);
            continue;
        }
        float *const features = b->features + (size_t)(y % 2) * row;
        job->source(job->user, (uint32_t)y, worker, features);
        pick_detail(features, job->width, detail);
        if (y < y0 || y >= y1) continue;
        const ql_conv_row guides = {
            .rows = {features + QL_FIRST_GUIDE},
            .weights = job->net->guides.weights,
            .bias = job->net->guides.bias,
            .num_rows = 1,
            .num_k = QL_NUM_GUIDES,
            .stride = QL_NUM_FEATURES,
            .num_out = job->net->guides.num_out,
        };
        embedding_row(job, guides, 0, (uint32_t)y, b->buffer);
        if (y % 2 == 1) stem_row(job, b->features, (uint32_t)y / 2);
    }
}

static void band_task(void *user, uint32_t task, uint32_t worker)
{
    const stem_job *const job = user;
    const band b = worker_band(job, worker);
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < job->height ? y0 + BAND : job->height;
    feature_rows(job, &b, y0, y1, worker);
    for (int64_t y = (int64_t)y0 - 1; y <= y1; ++y) {
        const size_t index = (size_t)(y - y0 + 1);
        float *const inner = b.inner + index * b.detail_row;
        memset(inner, 0, b.detail_row * sizeof *inner);
        if (y < 0 || y >= job->height) continue;
        ql_conv_row conv = detail_conv(&job->net->detail_in, b.detail + index * b.detail_row, b.detail_row);
        conv.out = inner + QL_NET_DETAIL;
        conv.num_pixels = job->width;
        conv.relu = 1;
        job->kernels->conv_row(&conv);
    }
    for (uint32_t y = y0; y < y1; ++y)
        embedding_row(job, detail_conv(&job->net->detail_out, b.inner + (y - y0) * b.detail_row, b.detail_row), 1, y,
                      b.buffer);
}

uint64_t ql_net_stem_bytes(uint32_t width, uint32_t num_workers)
{
    return (uint64_t)num_workers * scratch_floats(width) * sizeof(float);
}

quell_status ql_net_stem(const ql_net *net, const ql_kernels *kernels, ql_env *env, const float *flags,
                         ql_feature_source_fn *source, void *user, ql_net_maps *maps, ql_error *err)
{
    stem_job job = {.net = net, .kernels = kernels, .source = source, .user = user, .maps = maps};
    job.width = maps->embedding.width;
    job.height = maps->embedding.height;
    job.scratch_floats = scratch_floats(job.width);
    float *const bias = ql_alloc(env->memory, net->widths[0], sizeof *bias);
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job.scratch_floats * sizeof *job.scratch);
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    if (bias == NULL || job.scratch == NULL) {
        ql_fail(err, status, "out of memory: features of a region %u pixels wide", job.width);
    } else {
        for (uint32_t c = 0; c < net->widths[0]; ++c) {
            bias[c] = net->stem.bias[c];
            for (uint32_t f = 0; f < QL_NUM_FLAGS; ++f) bias[c] += flags[f] * net->flags[f * net->widths[0] + c];
        }
        job.bias = bias;
        status = ql_env_run(env, (job.height + BAND - 1) / BAND, band_task, &job);
    }
    ql_free(env->memory, job.scratch);
    ql_free(env->memory, bias);
    return status;
}
