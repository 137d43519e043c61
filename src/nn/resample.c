/* SPDX-License-Identifier: Apache-2.0 */
/* Layers that change the resolution, and instance normalisation. */
#include "nn/resample.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define NORM_EPSILON 1e-5 /* training/dgan/generator.py: NORM_EPSILON */

/* ---- Stride 2 ----------------------------------------------------------------------------------------------------- */

typedef struct down_job {
    const ql_conv *conv;
    const ql_kernels *kernels;
    const ql_map *in;
    ql_map *out;
} down_job;

static void down_task(void *user, uint32_t task, uint32_t worker)
{
    const down_job *const job = user;
    const uint32_t channels = job->in->channels;
    (void)worker;
    ql_conv_row row = {
        .weights = job->conv->weights,
        .bias = job->conv->bias,
        .out = ql_map_row(job->out, task),
        .num_rows = 3,
        .num_k = 3 * channels,
        .stride = 2 * channels,
        .num_pixels = job->out->width,
        .num_out = job->conv->num_out,
    };
    for (uint32_t r = 0; r < 3; ++r) row.rows[r] = ql_map_row(job->in, 2 * (int64_t)task + r - 1) - channels;
    job->kernels->conv_row(&row);
}

quell_status ql_conv_down_apply(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, const ql_map *in,
                                ql_map *out)
{
    down_job job = {conv, kernels, in, out};
    return ql_env_run(env, out->height, down_task, &job);
}

/* ---- Nearest neighbour, then 3x3 ---------------------------------------------------------------------------------- */

/* Which of the two coarse rows (or columns) tap t of 3 falls on, for an output of the given parity: the taps of an even
 * output are coarse -1, 0, 0; of an odd one 0, 0, 1. */
static uint32_t coarse_tap(uint32_t parity, uint32_t t)
{
    return (t + 1 + parity) / 2 - parity;
}

static quell_status load_phase(ql_conv *conv, const float *file, uint32_t dy, uint32_t dx, uint32_t num_in,
                               uint32_t num_out, ql_memory *memory)
{
    const size_t tap = (size_t)num_in * num_out;
    conv->size = 2;
    conv->num_in = num_in;
    conv->num_out = num_out;
    conv->weights = ql_alloc(memory, 4 * (size_t)num_in * num_out, sizeof *conv->weights);
    conv->bias = ql_alloc_zero(memory, num_out, sizeof *conv->bias);
    conv->bf16_weights = NULL;
    float *const merged = ql_alloc_zero(memory, 4 * tap, sizeof *merged);
    if (conv->weights == NULL || conv->bias == NULL || merged == NULL) {
        ql_free(memory, merged);
        return QUELL_ERR_OUT_OF_MEMORY;
    }
    for (uint32_t ty = 0; ty < 3; ++ty)
        for (uint32_t tx = 0; tx < 3; ++tx) {
            float *const to = merged + (coarse_tap(dy, ty) * 2 + coarse_tap(dx, tx)) * tap;
            for (size_t i = 0; i < tap; ++i) to[i] += file[(ty * 3 + tx) * tap + i];
        }
    ql_conv_pack(conv, merged, num_out, NULL, num_out);
    ql_free(memory, merged);
    return QUELL_OK;
}

quell_status ql_upconv_load(ql_upconv *up, const ql_weights *weights, const char *name, uint32_t num_in,
                            uint32_t num_out, ql_memory *memory, ql_error *err)
{
    char key[QL_RECORD_NAME_BYTES];
    const size_t num_file = 9 * (size_t)num_in * num_out;
    float *const file = ql_alloc(memory, num_file, sizeof *file);
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    snprintf(key, sizeof key, "%s.weight", name);
    if (file != NULL) status = ql_weights_get_floats(weights, key, file, num_file, err);
    for (uint32_t p = 0; p < 4 && status == QUELL_OK; ++p)
        status = load_phase(&up->phase[p / 2][p % 2], file, p / 2, p % 2, num_in, num_out, memory);
    ql_free(memory, file);
    if (status == QUELL_ERR_OUT_OF_MEMORY)
        ql_fail(err, status, "%s: out of memory for layer '%s'", weights->origin, name);
    return status;
}

void ql_upconv_free(ql_upconv *up, ql_memory *memory)
{
    for (uint32_t p = 0; p < 4; ++p) ql_conv_free(&up->phase[p / 2][p % 2], memory);
}

typedef struct up_job {
    const ql_upconv *up[2];
    const ql_map *in[2];
    const ql_kernels *kernels;
    ql_map *out;
    float *scratch; /* [workers][coarse width][channels] */
} up_job;

static void up_task(void *user, uint32_t task, uint32_t worker)
{
    const up_job *const job = user;
    const uint32_t parity = task % 2, num_out = job->out->channels, width = job->in[0]->width;
    float *const scratch = job->scratch + (size_t)worker * width * num_out;
    float *const out = ql_map_row(job->out, task);
    for (uint32_t dx = 0; dx < 2; ++dx) {
        for (uint32_t i = 0; i < 2; ++i) {
            const ql_conv *const conv = &job->up[i]->phase[parity][dx];
            const uint32_t channels = job->in[i]->channels;
            ql_conv_row row = {
                .weights = conv->weights,
                .bias = conv->bias,
                .add = i ? scratch : NULL,
                .out = scratch,
                .num_rows = 2,
                .num_k = 2 * channels,
                .stride = channels,
                .num_pixels = width,
                .num_out = num_out,
            };
            for (uint32_t r = 0; r < 2; ++r)
                row.rows[r] = ql_map_row(job->in[i], (int64_t)(task / 2) + r + parity - 1) +
                              ((ptrdiff_t)dx - 1) * (ptrdiff_t)channels;
            job->kernels->conv_row(&row);
        }
        for (size_t x = 0; x < width; ++x)
            memcpy(out + (2 * x + dx) * num_out, scratch + x * num_out, num_out * sizeof *out);
    }
}

quell_status ql_upconv_apply(const ql_upconv *first, const ql_map *a, const ql_upconv *second, const ql_map *b,
                             const ql_kernels *kernels, ql_env *env, ql_map *out, ql_error *err)
{
    up_job job = {{first, second}, {a, b}, kernels, out, NULL};
    job.scratch =
        ql_alloc(env->memory, (size_t)ql_pool_num_threads(env->pool) * a->width, out->channels * sizeof *job.scratch);
    if (job.scratch == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: a row of %u channels", out->channels);
    const quell_status status = ql_env_run(env, out->height, up_task, &job);
    ql_free(env->memory, job.scratch);
    return status;
}

/* ---- Instance normalisation --------------------------------------------------------------------------------------- */

typedef struct norm_job {
    const ql_kernels *kernels;
    ql_map *map;
    const ql_map *add;
    double *moments; /* [height][2][channels] */
    float *mean, *scale;
} norm_job;

static void moments_task(void *user, uint32_t task, uint32_t worker)
{
    const norm_job *const job = user;
    const size_t channels = job->map->channels;
    double *const sums = job->moments + 2 * channels * task;
    (void)worker;
    memset(sums, 0, 2 * channels * sizeof *sums);
    job->kernels->moments_row(ql_map_row(job->map, task), job->map->channels, job->map->width, sums, sums + channels);
}

static void norm_task(void *user, uint32_t task, uint32_t worker)
{
    const norm_job *const job = user;
    const ql_norm_row row = {
        .in = ql_map_row(job->map, task),
        .mean = job->mean,
        .scale = job->scale,
        .add = job->add ? ql_map_row(job->add, task) : NULL,
        .out = ql_map_row(job->map, task),
        .num_channels = job->map->channels,
        .num_pixels = job->map->width,
    };
    (void)worker;
    job->kernels->norm_row(&row);
}

static void join_moments(norm_job *job)
{
    const size_t channels = job->map->channels;
    const double count = (double)job->map->width * (double)job->map->height;
    for (size_t c = 0; c < channels; ++c) {
        double sum = 0.0, squares = 0.0;
        for (size_t y = 0; y < job->map->height; ++y) {
            sum += job->moments[2 * channels * y + c];
            squares += job->moments[2 * channels * y + channels + c];
        }
        const double mean = sum / count, variance = fmax(0.0, squares / count - mean * mean);
        job->mean[c] = (float)mean;
        job->scale[c] = (float)(1.0 / sqrt(variance + NORM_EPSILON));
    }
}

quell_status ql_instance_norm_relu(const ql_kernels *kernels, ql_env *env, ql_map *map, const ql_map *add,
                                   ql_error *err)
{
    const size_t channels = map->channels;
    norm_job job = {.kernels = kernels, .map = map, .add = add};
    job.moments = ql_alloc(env->memory, (size_t)map->height * 2 * channels, sizeof *job.moments);
    job.mean = ql_alloc(env->memory, 2 * channels, sizeof *job.mean);
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    if (job.moments == NULL || job.mean == NULL) {
        ql_fail(err, status, "out of memory: statistics of %u channels", map->channels);
    } else {
        job.scale = job.mean + channels;
        status = ql_env_run(env, map->height, moments_task, &job);
        if (status == QUELL_OK) {
            join_moments(&job);
            status = ql_env_run(env, map->height, norm_task, &job);
        }
    }
    ql_free(env->memory, job.moments);
    ql_free(env->memory, job.mean);
    return status;
}
