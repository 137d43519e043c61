/* SPDX-License-Identifier: Apache-2.0 */
/* Three 3x3 convolutions at full resolution, on bands of rows: nothing of that size is kept but the embedding. Features
 * are made a second time, which costs less than keeping them. */
#include "models/quell_detail.h"

#include <string.h>

enum {
    BAND = 24,            /* rows of a task */
    REACH = 3,            /* rows beyond it that three 3x3 convolutions see */
    MARGIN = 1,           /* pixels of zeros on either side of a row that a 3x3 convolution reads */
    SPAN = 128,           /* pixels taken at a time from a convolution to planes */
    INPUTS = QL_NET_DETAIL_INPUTS,
    DIRECT_FEATURE = 28,  /* direct diffuse light; training/features.py: DETAIL_PLANES */
    EMISSION_FEATURE = 31
};

typedef struct detail_job {
    const ql_net *net;
    const ql_kernels *kernels;
    ql_feature_source_fn *source;
    void *user;
    const ql_net_maps *maps;
    uint32_t width, height;
    float *scratch;
    size_t scratch_floats;
} detail_job;

/* One worker's rows; those of `rows` have MARGIN pixels on either side. */
typedef struct band {
    float *features; /* [width][QL_NUM_FEATURES] */
    float *seen;     /* [BAND + 6][..][INPUTS]: what the first convolution reads */
    float *first;    /* [BAND + 4][..][detail] */
    float *second;   /* [BAND + 2][..][detail] */
    float *around;   /* [width / 2][detail]: what the U-Net says of a row */
    float *buffer;   /* [SPAN][QL_BLOCK], then [QL_NET_DIMS][SPAN] */
    size_t seen_row, row;
} band;

static size_t row_floats(uint32_t width, uint32_t channels)
{
    return ((size_t)width + 2 * MARGIN) * channels;
}

static size_t scratch_floats(const ql_net *net, uint32_t width)
{
    return (size_t)width * QL_NUM_FEATURES + (BAND + 2 * REACH) * row_floats(width, INPUTS) +
           (2 * BAND + 6) * row_floats(width, net->detail) + (size_t)width / 2 * net->detail +
           SPAN * (QL_BLOCK + QL_NET_DIMS);
}

static band worker_band(const detail_job *job, uint32_t worker)
{
    float *const base = job->scratch + worker * job->scratch_floats;
    band b = {.features = base, .row = row_floats(job->width, job->net->detail)};
    b.seen_row = row_floats(job->width, INPUTS);
    b.seen = b.features + (size_t)job->width * QL_NUM_FEATURES;
    b.first = b.seen + (BAND + 2 * REACH) * b.seen_row;
    b.second = b.first + (BAND + 4) * b.row;
    b.around = b.second + (BAND + 2) * b.row;
    b.buffer = b.around + (size_t)job->width / 2 * job->net->detail;
    return b;
}

/* Guides, direct diffuse light, emission and the mean of beauty. */
static void pick_inputs(const float *features, uint32_t width, float *out)
{
    memset(out, 0, INPUTS * sizeof *out);
    out += INPUTS;
    for (size_t x = 0; x < width; ++x, features += QL_NUM_FEATURES, out += INPUTS) {
        memcpy(out, features + QL_FIRST_GUIDE, QL_NUM_GUIDES * sizeof *out);
        out[QL_NUM_GUIDES] = features[DIRECT_FEATURE];
        out[QL_NUM_GUIDES + 1] = features[EMISSION_FEATURE];
        out[QL_NUM_GUIDES + 2] = (features[0] + features[1] + features[2]) / 3.0f;
    }
    memset(out, 0, INPUTS * sizeof *out);
}

/* A row of the embedding: to its planes, or added to what is there. conv has its rows set for pixel 0. */
static void embedding_row(const detail_job *job, ql_conv_row conv, int adds, uint32_t y, float *buffer)
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

/* A 3x3 convolution over three rows that follow each other. */
static ql_conv_row three_rows(const ql_conv *conv, const float *rows, size_t row_floats)
{
    return (ql_conv_row){
        .rows = {rows, rows + row_floats, rows + 2 * row_floats},
        .weights = conv->weights,
        .bias = conv->bias,
        .num_rows = 3,
        .num_k = 3 * conv->num_in,
        .stride = conv->num_in,
        .num_out = conv->num_out,
    };
}

/* Features of rows y0 - REACH to y1 + REACH - 1, and the guides' own share of the embedding. */
static void feature_rows(const detail_job *job, const band *b, uint32_t y0, uint32_t y1, uint32_t worker)
{
    for (int64_t y = (int64_t)y0 - REACH; y < (int64_t)y1 + REACH; ++y) {
        float *const seen = b->seen + (size_t)(y - y0 + REACH) * b->seen_row;
        if (y < 0 || y >= job->height) {
            memset(seen, 0, b->seen_row * sizeof *seen);
            continue;
        }
        job->source(job->user, (uint32_t)y, worker, b->features);
        pick_inputs(b->features, job->width, seen);
        if (y < y0 || y >= y1) continue;
        const ql_conv_row guides = {
            .rows = {b->features + QL_FIRST_GUIDE},
            .weights = job->net->guides.weights,
            .bias = job->net->guides.bias,
            .num_rows = 1,
            .num_k = QL_NUM_GUIDES,
            .stride = QL_NUM_FEATURES,
            .num_out = job->net->guides.num_out,
        };
        embedding_row(job, guides, 0, (uint32_t)y, b->buffer);
    }
}

/* max(0, row + what the U-Net says of it), for a row of the image; two pixels share one of the U-Net's. */
static void add_around(const detail_job *job, uint32_t y, float *around, float *row)
{
    const size_t channels = job->net->detail;
    ql_conv_apply_row(&job->net->detail_up, job->kernels, &job->maps->level[0], 0, y / 2, job->width / 2, 0, around);
    for (size_t x = 0; x < job->width; ++x)
        for (size_t c = 0; c < channels; ++c) {
            const float sum = row[x * channels + c] + around[x / 2 * channels + c];
            row[x * channels + c] = sum > 0.0f ? sum : 0.0f;
        }
}

/* Rows y0 - reach to y1 + reach - 1 of a convolution's result, zeros outside the region. */
static void conv_rows(const detail_job *job, const band *b, const ql_conv *conv, const float *in, size_t in_row,
                      float *out, uint32_t y0, uint32_t y1, int64_t reach)
{
    const int is_first = conv == &job->net->detail_in;
    for (int64_t y = (int64_t)y0 - reach; y < (int64_t)y1 + reach; ++y) {
        const size_t index = (size_t)(y - y0 + reach);
        float *const row = out + index * b->row;
        memset(row, 0, b->row * sizeof *row);
        if (y < 0 || y >= job->height) continue;
        ql_conv_row one = three_rows(conv, in + index * in_row, in_row);
        one.out = row + (size_t)MARGIN * job->net->detail;
        one.num_pixels = job->width;
        one.relu = !is_first;
        job->kernels->conv_row(&one);
        if (is_first) add_around(job, (uint32_t)y, b->around, one.out);
    }
}

static void band_task(void *user, uint32_t task, uint32_t worker)
{
    const detail_job *const job = user;
    const band b = worker_band(job, worker);
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < job->height ? y0 + BAND : job->height;
    feature_rows(job, &b, y0, y1, worker);
    conv_rows(job, &b, &job->net->detail_in, b.seen, b.seen_row, b.first, y0, y1, 2);
    conv_rows(job, &b, &job->net->detail_mid, b.first, b.row, b.second, y0, y1, 1);
    for (uint32_t y = y0; y < y1; ++y)
        embedding_row(job, three_rows(&job->net->detail_out, b.second + (y - y0) * b.row, b.row), 1, y, b.buffer);
}

uint64_t ql_net_detail_bytes(const ql_net *net, uint32_t width, uint32_t num_workers)
{
    return (uint64_t)num_workers * scratch_floats(net, width) * sizeof(float);
}

quell_status ql_net_detail(const ql_net *net, const ql_kernels *kernels, ql_env *env, ql_feature_source_fn *source,
                           void *user, const ql_net_maps *maps, ql_error *err)
{
    detail_job job = {.net = net, .kernels = kernels, .source = source, .user = user, .maps = maps};
    job.width = maps->embedding.width;
    job.height = maps->embedding.height;
    job.scratch_floats = scratch_floats(net, job.width);
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job.scratch_floats * sizeof *job.scratch);
    if (job.scratch == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: details of a region %u pixels wide", job.width);
    const quell_status status = ql_env_run(env, (job.height + BAND - 1) / BAND, band_task, &job);
    ql_free(env->memory, job.scratch);
    return status;
}
