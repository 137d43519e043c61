/* SPDX-License-Identifier: Apache-2.0 */
/* Layers on feature maps. */
#include "nn/conv.h"

#include "base/bf16.h"

#include <stdio.h>
#include <string.h>

static size_t value_bytes(ql_values values)
{
    return values == QL_VALUES_BF16 ? sizeof(uint16_t) : sizeof(float);
}

size_t ql_map_bytes(ql_values values, uint32_t width, uint32_t height, uint32_t channels)
{
    return ((size_t)width + 2) * ((size_t)height + 2) * channels * value_bytes(values);
}

/* Of a row with its pixels of zeros. */
static size_t row_bytes(ql_values values, uint32_t width, uint32_t channels)
{
    return ((size_t)width + 2) * channels * value_bytes(values);
}

/* Row y with its pixels of zeros. */
static void *whole_row(const ql_map *map, int64_t y)
{
    return (uint8_t *)map->data + (size_t)(y + 1) * row_bytes(map->values, map->width, map->channels);
}

quell_status ql_map_create_of(ql_map *map, ql_values values, uint32_t width, uint32_t height, uint32_t channels,
                              ql_memory *memory, ql_error *err)
{
    *map = (ql_map){.width = width, .height = height, .channels = channels, .values = values};
    const size_t row = row_bytes(values, width, channels), pixel = channels * value_bytes(values);
    map->data = ql_alloc(memory, (size_t)height + 2, row);
    if (map->data == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: a feature map of %ux%u with %u channels", width,
                       height, channels);
    /* Only the border must be zero; rows are written whole. */
    memset(whole_row(map, -1), 0, row);
    memset(whole_row(map, height), 0, row);
    for (int64_t y = 0; y < height; ++y) {
        uint8_t *const left = whole_row(map, y);
        memset(left, 0, pixel);
        memset(left + row - pixel, 0, pixel);
    }
    return QUELL_OK;
}

quell_status ql_map_create(ql_map *map, uint32_t width, uint32_t height, uint32_t channels, ql_memory *memory,
                           ql_error *err)
{
    return ql_map_create_of(map, QL_VALUES_FLOAT, width, height, channels, memory, err);
}

void ql_map_destroy(ql_map *map, ql_memory *memory)
{
    ql_free(memory, map->data);
    map->data = NULL;
}

float *ql_map_row(const ql_map *map, int64_t y)
{
    return (float *)whole_row(map, y) + map->channels;
}

uint16_t *ql_map_bf16_row(const ql_map *map, int64_t y)
{
    return (uint16_t *)whole_row(map, y) + map->channels;
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
    conv->bf16_weights = NULL;
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
    ql_free(memory, conv->bf16_weights);
    conv->weights = conv->bias = NULL;
    conv->bf16_weights = NULL;
}

quell_status ql_conv_add_bf16(ql_conv *conv, ql_memory *memory, ql_error *err)
{
    const size_t num_k = (size_t)conv->size * conv->size * conv->num_in, num = num_k * conv->num_out;
    conv->bf16_weights = ql_alloc(memory, num, sizeof *conv->bf16_weights);
    if (conv->bf16_weights == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: weights in bfloat16");
    for (size_t i = 0; i < num; ++i) { /* [block][k][channel] to [block][k / 2][channel][k % 2] */
        const size_t row = i / QL_BLOCK, channel = i % QL_BLOCK;
        conv->bf16_weights[(row / 2 * QL_BLOCK + channel) * 2 + row % 2] = ql_bf16_from_float(conv->weights[i]);
    }
    return QUELL_OK;
}

/* What the rows of a convolution over a map have in common. */
static ql_conv_row float_row(const ql_conv *conv, uint32_t channels, uint32_t num_pixels, int32_t relu)
{
    return (ql_conv_row){
        .weights = conv->weights,
        .bias = conv->bias,
        .num_rows = conv->size,
        .num_k = conv->size * channels,
        .stride = conv->size == 2 ? 2 * channels : channels,
        .num_pixels = num_pixels,
        .num_out = conv->num_out,
        .relu = relu,
    };
}

static ql_bf16_conv_row bf16_row(const ql_conv *conv, uint32_t channels, uint32_t num_pixels, int32_t relu)
{
    return (ql_bf16_conv_row){
        .weights = conv->bf16_weights,
        .bias = conv->bias,
        .num_rows = conv->size,
        .num_k = conv->size * channels,
        .stride = conv->size == 2 ? 2 * channels : channels,
        .num_pixels = num_pixels,
        .num_out = conv->num_out,
        .relu = relu,
    };
}

/* The row of the input that row r of the kernel meets. */
static int64_t line_of(const ql_conv *conv, uint32_t y, uint32_t r)
{
    return conv->size == 3 ? (int64_t)y + r - 1 : conv->size == 2 ? 2 * (int64_t)y + r : (int64_t)y;
}

/* A 1x1 convolution in float on bfloat16: pixels become floats a few at a time. */
static void expand_and_apply(const ql_conv *conv, const ql_kernels *kernels, const uint16_t *in, uint32_t channels,
                             uint32_t num, int32_t relu, float *out)
{
    enum { FLOATS = 4096 };
    float pixels[FLOATS];
    const uint32_t step = FLOATS / channels; /* ql_net_load allows 1024 channels */
    ql_conv_row row = float_row(conv, channels, step, relu);
    row.rows[0] = pixels;
    row.out = out;
    for (uint32_t x = 0; x < num; x += step, in += (size_t)step * channels, row.out += (size_t)step * conv->num_out) {
        row.num_pixels = num - x < step ? num - x : step;
        kernels->bf16_expand_row(in, pixels, row.num_pixels * channels);
        kernels->conv_row(&row);
    }
}

void ql_conv_apply_row(const ql_conv *conv, const ql_kernels *kernels, const ql_map *in, uint32_t x, uint32_t y,
                       uint32_t num, int32_t relu, float *out)
{
    const uint32_t channels = in->channels;
    if (in->values == QL_VALUES_BF16) {
        const uint16_t *const from = ql_map_bf16_row(in, y) + (size_t)x * channels;
        if (conv->bf16_weights == NULL) {
            expand_and_apply(conv, kernels, from, channels, num, relu, out);
            return;
        }
        ql_bf16_conv_row row = bf16_row(conv, channels, num, relu);
        row.rows[0] = from;
        row.sums = out;
        kernels->bf16_conv_row(&row);
        return;
    }
    ql_conv_row row = float_row(conv, channels, num, relu);
    row.out = out;
    for (uint32_t r = 0; r < conv->size; ++r)
        row.rows[r] = ql_map_row(in, line_of(conv, y, r)) + (size_t)x * row.stride - (conv->size == 3 ? channels : 0);
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
    if (job->out->values == QL_VALUES_BF16) {
        ql_bf16_conv_row row = bf16_row(job->conv, job->in->channels, job->out->width, job->relu);
        for (uint32_t r = 0; r < job->conv->size; ++r)
            row.rows[r] =
                ql_map_bf16_row(job->in, line_of(job->conv, task, r)) - (job->conv->size == 3 ? job->in->channels : 0);
        row.out = ql_map_bf16_row(job->out, task);
        job->kernels->bf16_conv_row(&row);
        return;
    }
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
    uint8_t *edges; /* [bands][2][row]: the row above each band and the one below, as they were */
    uint8_t *rows;  /* [workers][2][row] */
    size_t row_bytes;
} in_place_job;

static uint32_t num_bands(uint32_t height)
{
    return (height + BAND - 1) / BAND;
}

static void keep_edges_task(void *user, uint32_t task, uint32_t worker)
{
    const in_place_job *const job = user;
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < job->map->height ? y0 + BAND : job->map->height;
    uint8_t *const edges = job->edges + 2 * task * job->row_bytes;
    (void)worker;
    memcpy(edges, whole_row(job->map, (int64_t)y0 - 1), job->row_bytes);
    memcpy(edges + job->row_bytes, whole_row(job->map, y1), job->row_bytes);
}

/* Row y of the map from three rows as they were, with their zeros. */
static void convolve_row(const in_place_job *job, const void *const *from, uint32_t y)
{
    const ql_map *const map = job->map;
    if (map->values == QL_VALUES_BF16) {
        ql_bf16_conv_row row = bf16_row(job->conv, map->channels, map->width, 1);
        for (uint32_t r = 0; r < 3; ++r) row.rows[r] = from[r];
        row.out = ql_map_bf16_row(map, y);
        job->kernels->bf16_conv_row(&row);
    } else {
        ql_conv_row row = float_row(job->conv, map->channels, map->width, 1);
        for (uint32_t r = 0; r < 3; ++r) row.rows[r] = from[r];
        row.out = ql_map_row(map, y);
        job->kernels->conv_row(&row);
    }
}

/* A row is kept before it is written over: the next one needs it as it was. */
static void in_place_task(void *user, uint32_t task, uint32_t worker)
{
    const in_place_job *const job = user;
    const ql_map *const map = job->map;
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < map->height ? y0 + BAND : map->height;
    const uint8_t *const edges = job->edges + 2 * task * job->row_bytes;
    uint8_t *const kept[2] = {job->rows + 2 * worker * job->row_bytes, job->rows + (2 * worker + 1) * job->row_bytes};
    for (uint32_t y = y0; y < y1; ++y) {
        memcpy(kept[y % 2], whole_row(map, y), job->row_bytes);
        const void *const from[3] = {
            y > y0 ? kept[(y + 1) % 2] : edges,
            kept[y % 2],
            y + 1 < y1 ? whole_row(map, (int64_t)y + 1) : edges + job->row_bytes,
        };
        convolve_row(job, from, y);
    }
}

uint64_t ql_conv_in_place_bytes(ql_values values, uint32_t width, uint32_t height, uint32_t channels,
                                uint32_t num_workers)
{
    return 2 * ((uint64_t)num_bands(height) + num_workers) * row_bytes(values, width, channels);
}

quell_status ql_conv_relu_in_place(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, ql_map *map,
                                   ql_error *err)
{
    in_place_job job = {.conv = conv, .kernels = kernels, .map = map};
    const uint32_t bands = num_bands(map->height);
    job.row_bytes = row_bytes(map->values, map->width, map->channels);
    job.edges = ql_alloc(env->memory, 2 * (size_t)bands, job.row_bytes);
    job.rows = ql_alloc(env->memory, 2 * (size_t)ql_pool_num_threads(env->pool), job.row_bytes);
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
        if (job->map->values == QL_VALUES_BF16) {
            job->kernels->bf16_add_row(row, ql_map_bf16_row(job->map, y), channels, job->map->width);
            continue;
        }
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
