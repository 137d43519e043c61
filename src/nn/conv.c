/* SPDX-License-Identifier: Apache-2.0 */
/* Layers on feature maps. */
#include "nn/conv.h"

#include <stdio.h>
#include <string.h>

size_t ql_map_bytes(uint32_t width, uint32_t height, uint32_t channels)
{
    return ((size_t)width + 2) * ((size_t)height + 2) * channels * sizeof(float);
}

quell_status ql_map_create(ql_map *map, uint32_t width, uint32_t height, uint32_t channels, ql_memory *memory,
                           ql_error *err)
{
    map->width = width;
    map->height = height;
    map->channels = channels;
    map->data = ql_alloc(memory, ((size_t)width + 2) * ((size_t)height + 2), channels * sizeof *map->data);
    if (map->data == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: a feature map of %ux%u with %u channels", width,
                       height, channels);
    /* Only the border must be zero; rows are written whole. */
    const size_t row = ((size_t)width + 2) * channels;
    memset(map->data, 0, row * sizeof *map->data);
    memset(map->data + row * (height + 1), 0, row * sizeof *map->data);
    for (size_t y = 1; y <= height; ++y) {
        memset(map->data + y * row, 0, channels * sizeof *map->data);
        memset(map->data + (y + 1) * row - channels, 0, channels * sizeof *map->data);
    }
    return QUELL_OK;
}

void ql_map_destroy(ql_map *map, ql_memory *memory)
{
    ql_free(memory, map->data);
    map->data = NULL;
}

float *ql_map_row(const ql_map *map, int64_t y)
{
    return map->data + ((size_t)(y + 1) * (map->width + 2) + 1) * map->channels;
}

void ql_conv_pack(ql_conv *conv, const float *file, uint32_t file_out, const uint32_t *order, uint32_t num)
{
    const size_t num_k = (size_t)conv->size * conv->size * conv->num_in;
    memset(conv->weights, 0, num_k * conv->num_out * sizeof *conv->weights);
    for (uint32_t c = 0; c < num; ++c) {
        const uint32_t from = order ? order[c] : c;
        for (size_t k = 0; k < num_k; ++k)
            conv->weights[((size_t)(c / QL_BLOCK) * num_k + k) * QL_BLOCK + c % QL_BLOCK] = file[k * file_out + from];
    }
}

quell_status ql_conv_load(ql_conv *conv, const ql_weights *weights, const char *name, uint32_t size, uint32_t num_in,
                          uint32_t num_out, const uint32_t *order, uint32_t num_order, ql_memory *memory, ql_error *err)
{
    char key[QL_RECORD_NAME_BYTES];
    const uint32_t num = order ? num_order : num_out;
    const size_t num_k = (size_t)size * size * num_in, num_file = num_k * num_out;
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    conv->size = size;
    conv->num_in = num_in;
    conv->num_out = (num + QL_BLOCK - 1) / QL_BLOCK * QL_BLOCK;
    conv->weights = ql_alloc(memory, num_k * conv->num_out, sizeof *conv->weights);
    conv->bias = ql_alloc_zero(memory, conv->num_out, sizeof *conv->bias);
    float *const file = ql_alloc(memory, num_file > num_out ? num_file : num_out, sizeof *file);
    if (conv->weights == NULL || conv->bias == NULL || file == NULL) {
        ql_fail(err, status, "%s: out of memory for layer '%s'", weights->origin, name);
        goto fail;
    }
    snprintf(key, sizeof key, "%s.weight", name);
    QL_TRY_GOTO(ql_weights_get_floats(weights, key, file, num_file, err));
    ql_conv_pack(conv, file, num_out, order, num);
    snprintf(key, sizeof key, "%s.bias", name);
    if (ql_weights_find(weights, key) != NULL) {
        QL_TRY_GOTO(ql_weights_get_floats(weights, key, file, num_out, err));
        for (uint32_t c = 0; c < num; ++c) conv->bias[c] = file[order ? order[c] : c];
    }
    ql_free(memory, file);
    return QUELL_OK;
fail:
    ql_free(memory, file);
    ql_conv_free(conv, memory);
    return status;
}

void ql_conv_free(ql_conv *conv, ql_memory *memory)
{
    ql_free(memory, conv->weights);
    ql_free(memory, conv->bias);
    conv->weights = conv->bias = NULL;
}

void ql_conv_apply_row(const ql_conv *conv, const ql_kernels *kernels, const ql_map *in, uint32_t x, uint32_t y,
                       uint32_t num, int32_t relu, float *out)
{
    const uint32_t channels = in->channels;
    ql_conv_row row = {
        .weights = conv->weights,
        .bias = conv->bias,
        .out = out,
        .num_rows = conv->size,
        .num_k = conv->size * channels,
        .stride = conv->size == 2 ? 2 * channels : channels,
        .num_pixels = num,
        .num_out = conv->num_out,
        .relu = relu,
    };
    for (uint32_t r = 0; r < conv->size; ++r) {
        const int64_t line = conv->size == 3 ? (int64_t)y + r - 1 : conv->size == 2 ? 2 * (int64_t)y + r : (int64_t)y;
        row.rows[r] = ql_map_row(in, line) + (size_t)x * row.stride - (conv->size == 3 ? channels : 0);
    }
    kernels->conv_row(&row);
}

typedef struct apply_job {
    const ql_conv *conv;
    const ql_kernels *kernels;
    const ql_map *in;
    ql_map *out;
    int32_t relu;
} apply_job;

static void apply_task(void *user, uint32_t task, uint32_t worker)
{
    const apply_job *const job = user;
    (void)worker;
    ql_conv_apply_row(job->conv, job->kernels, job->in, 0, task, job->out->width, job->relu,
                      ql_map_row(job->out, task));
}

quell_status ql_conv_apply(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, const ql_map *in, ql_map *out,
                           int32_t relu)
{
    apply_job job = {conv, kernels, in, out, relu};
    return ql_env_run(env, out->height, apply_task, &job);
}

/* ---- In place ----------------------------------------------------------------------------------------------------- */

enum { BAND = 32 }; /* rows of a task */

typedef struct in_place_job {
    const ql_conv *conv;
    const ql_kernels *kernels;
    ql_map *map;
    float *edges; /* [bands][2][row]: the row above each band and the one below, as they were */
    float *rows;  /* [workers][2][row] */
    size_t row_floats;
} in_place_job;

static size_t row_floats(uint32_t width, uint32_t channels)
{
    return ((size_t)width + 2) * channels; /* with a pixel of zeros on either side */
}

static uint32_t num_bands(uint32_t height)
{
    return (height + BAND - 1) / BAND;
}

/* Row y with its zeros. */
static float *whole_row(const ql_map *map, int64_t y)
{
    return ql_map_row(map, y) - map->channels;
}

static void keep_edges_task(void *user, uint32_t task, uint32_t worker)
{
    const in_place_job *const job = user;
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < job->map->height ? y0 + BAND : job->map->height;
    float *const edges = job->edges + 2 * task * job->row_floats;
    (void)worker;
    memcpy(edges, whole_row(job->map, (int64_t)y0 - 1), job->row_floats * sizeof *edges);
    memcpy(edges + job->row_floats, whole_row(job->map, y1), job->row_floats * sizeof *edges);
}

/* A row is kept before it is written over: the next one needs it as it was. */
static void in_place_task(void *user, uint32_t task, uint32_t worker)
{
    const in_place_job *const job = user;
    const ql_map *const map = job->map;
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < map->height ? y0 + BAND : map->height;
    const float *const edges = job->edges + 2 * task * job->row_floats;
    float *const kept[2] = {job->rows + 2 * worker * job->row_floats, job->rows + (2 * worker + 1) * job->row_floats};
    ql_conv_row row = {
        .weights = job->conv->weights,
        .bias = job->conv->bias,
        .num_rows = 3,
        .num_k = 3 * map->channels,
        .stride = map->channels,
        .num_pixels = map->width,
        .num_out = job->conv->num_out,
        .relu = 1,
    };
    for (uint32_t y = y0; y < y1; ++y) {
        memcpy(kept[y % 2], whole_row(map, y), job->row_floats * sizeof(float));
        row.rows[0] = y > y0 ? kept[(y + 1) % 2] : edges;
        row.rows[1] = kept[y % 2];
        row.rows[2] = y + 1 < y1 ? whole_row(map, (int64_t)y + 1) : edges + job->row_floats;
        row.out = ql_map_row(map, y);
        job->kernels->conv_row(&row);
    }
}

uint64_t ql_conv_in_place_bytes(uint32_t width, uint32_t height, uint32_t channels, uint32_t num_workers)
{
    return 2 * ((uint64_t)num_bands(height) + num_workers) * row_floats(width, channels) * sizeof(float);
}

quell_status ql_conv_relu_in_place(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, ql_map *map,
                                   ql_error *err)
{
    in_place_job job = {.conv = conv, .kernels = kernels, .map = map};
    const uint32_t bands = num_bands(map->height);
    job.row_floats = row_floats(map->width, map->channels);
    job.edges = ql_alloc(env->memory, 2 * (size_t)bands, job.row_floats * sizeof *job.edges);
    job.rows = ql_alloc(env->memory, 2 * (size_t)ql_pool_num_threads(env->pool), job.row_floats * sizeof *job.rows);
    quell_status status = QUELL_OK;
    if (job.edges == NULL || job.rows == NULL)
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of a feature map %u wide", map->width);
    if (status == QUELL_OK) status = ql_env_run(env, bands, keep_edges_task, &job);
    if (status == QUELL_OK) status = ql_env_run(env, bands, in_place_task, &job);
    ql_free(env->memory, job.edges);
    ql_free(env->memory, job.rows);
    return status;
}

/* ---- Upsampling --------------------------------------------------------------------------------------------------- */

typedef struct add_job {
    const ql_conv *conv;
    const ql_kernels *kernels;
    const ql_map *coarse;
    ql_map *map;
    float *rows; /* [workers][coarse->width][channels] */
} add_job;

/* One row of the coarse map and the two that it becomes. */
static void add_task(void *user, uint32_t task, uint32_t worker)
{
    const add_job *const job = user;
    const uint32_t channels = job->map->channels;
    float *const row = job->rows + (size_t)worker * job->coarse->width * channels;
    ql_conv_apply_row(job->conv, job->kernels, job->coarse, 0, task, job->coarse->width, 0, row);
    for (uint32_t y = 2 * task; y < 2 * task + 2 && y < job->map->height; ++y) {
        float *out = ql_map_row(job->map, y);
        for (uint32_t x = 0; x < job->map->width; ++x, out += channels) {
            const float *const from = row + (size_t)(x / 2) * channels;
            for (uint32_t c = 0; c < channels; ++c) {
                const float sum = out[c] + from[c];
                out[c] = sum > 0.0f ? sum : 0.0f;
            }
        }
    }
}

quell_status ql_conv_upsample_add_relu(const ql_conv *conv, const ql_kernels *kernels, ql_env *env,
                                       const ql_map *coarse, ql_map *map, ql_error *err)
{
    add_job job = {.conv = conv, .kernels = kernels, .coarse = coarse, .map = map};
    job.rows =
        ql_alloc(env->memory, ql_pool_num_threads(env->pool), (size_t)coarse->width * map->channels * sizeof *job.rows);
    if (job.rows == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of a feature map %u wide", coarse->width);
    const quell_status status = ql_env_run(env, coarse->height, add_task, &job);
    ql_free(env->memory, job.rows);
    return status;
}
