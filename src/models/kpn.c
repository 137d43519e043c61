/* SPDX-License-Identifier: Apache-2.0 */
/* Source encoder, feature encoder, kernel predictor. Rows outside the image are zeros for every layer, as PyTorch's zero
 * padding has them; rows inside it but beyond a layer's share of the halo are never read. */
#include "models/kpn.h"

#include <stdio.h>
#include <string.h>

enum { BORDER = 2, SPAN = 64, SOURCE_SIZE = 5 };

/* ---- Weights ------------------------------------------------------------------------------------------------------ */

static quell_status load_layers(ql_kpn *kpn, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    char name[QL_RECORD_NAME_BYTES];
    int32_t shape[3];
    QL_TRY(ql_weights_get_ints(weights, "config.kpn", shape, 3, err));
    const int32_t width = shape[0], blocks = shape[1], hidden = shape[2];
    if (width < QL_BLOCK || width > 1024 || width % QL_BLOCK || blocks < 0 || blocks > QL_KPN_MAX_BLOCKS ||
        hidden < 1 || hidden > 1024)
        return ql_fail(err, QUELL_ERR_BAD_MODEL,
                       "%s: a kernel predictor of %d channels, %d blocks and %d hidden is none that this library runs",
                       weights->origin, width, blocks, hidden);
    const uint32_t w = (uint32_t)width, h = (uint32_t)hidden;
    kpn->width = w;
    kpn->num_blocks = (uint32_t)blocks;
    QL_TRY(ql_conv_load(&kpn->source[0], weights, "source.0", SOURCE_SIZE, QL_KPN_AUXILIARY, w, NULL, 0, memory, err));
    QL_TRY(ql_conv_load(&kpn->source[1], weights, "source.1", SOURCE_SIZE, w, w, NULL, 0, memory, err));
    QL_TRY(ql_conv_load(&kpn->source_skip, weights, "source.skip", 1, QL_KPN_AUXILIARY, w, NULL, 0, memory, err));
    for (uint32_t i = 0; i < kpn->num_blocks; ++i)
        for (uint32_t j = 0; j < 2; ++j) {
            snprintf(name, sizeof name, "feature.%u.%u", i, j);
            QL_TRY(ql_conv_load(&kpn->blocks[i][j], weights, name, 3, w, w, NULL, 0, memory, err));
        }
    QL_TRY(ql_conv_load(&kpn->predictor[0], weights, "predictor.0", 1, w, h, NULL, 0, memory, err));
    QL_TRY(ql_conv_load(&kpn->predictor[1], weights, "predictor.1", 1, h, h, NULL, 0, memory, err));
    return ql_conv_load(&kpn->predictor[2], weights, "predictor.2", 1, h, QL_KPN_TAPS, NULL, 0, memory, err);
}

quell_status ql_kpn_load(ql_kpn *kpn, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    memset(kpn, 0, sizeof *kpn);
    const quell_status status = load_layers(kpn, weights, memory, err);
    if (status != QUELL_OK) ql_kpn_free(kpn, memory);
    return status;
}

void ql_kpn_free(ql_kpn *kpn, ql_memory *memory)
{
    for (uint32_t i = 0; i < 2; ++i) ql_conv_free(&kpn->source[i], memory);
    ql_conv_free(&kpn->source_skip, memory);
    for (uint32_t i = 0; i < QL_KPN_MAX_BLOCKS; ++i)
        for (uint32_t j = 0; j < 2; ++j) ql_conv_free(&kpn->blocks[i][j], memory);
    for (uint32_t i = 0; i < 3; ++i) ql_conv_free(&kpn->predictor[i], memory);
}

static double conv_macs(const ql_conv *conv)
{
    return (double)conv->size * conv->size * conv->num_in * conv->num_out;
}

double ql_kpn_macs_per_pixel(const ql_kpn *kpn)
{
    double macs = conv_macs(&kpn->source[0]) + conv_macs(&kpn->source[1]) + conv_macs(&kpn->source_skip);
    for (uint32_t i = 0; i < kpn->num_blocks; ++i) macs += 2.0 * conv_macs(&kpn->blocks[i][0]);
    for (uint32_t i = 0; i < 3; ++i) macs += conv_macs(&kpn->predictor[i]);
    return macs;
}

uint32_t ql_kpn_reach(const ql_kpn *kpn)
{
    return 2 * (SOURCE_SIZE / 2) + 2 * kpn->num_blocks;
}

/* ---- Bands -------------------------------------------------------------------------------------------------------- */

static size_t row_floats(const ql_band_map *map)
{
    return ((size_t)map->width + 2 * BORDER) * map->channels;
}

static float *band_row(const ql_band_map *map, int64_t y) /* pixel (0, y) */
{
    return map->data + (size_t)(y - map->first_row) * row_floats(map) + BORDER * map->channels;
}

/* The predictor reads channels that its own padding to QL_BLOCK made: rows of SPAN pixels of each of its layers. */
static size_t scratch_floats(const ql_kpn *kpn)
{
    return (size_t)SPAN * (kpn->predictor[0].num_out + kpn->predictor[1].num_out + kpn->predictor[2].num_out);
}

quell_status ql_kpn_band_create(ql_kpn_band *band, const ql_kpn *kpn, ql_env *env, uint32_t width, uint32_t height,
                                uint32_t max_rows, ql_error *err)
{
    const uint32_t num_rows = max_rows + 2 * ql_kpn_reach(kpn);
    memset(band, 0, sizeof *band);
    band->width = width;
    band->height = height;
    band->max_rows = max_rows;
    ql_band_map *const maps[3] = {&band->input, &band->features, &band->hidden};
    int failed = 0;
    for (uint32_t i = 0; i < 3; ++i) {
        *maps[i] = (ql_band_map){.num_rows = num_rows, .width = width};
        maps[i]->channels = i ? kpn->width : QL_KPN_AUXILIARY;
        maps[i]->data = ql_alloc_zero(env->memory, row_floats(maps[i]), num_rows * sizeof(float));
        failed |= maps[i]->data == NULL;
    }
    band->scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), scratch_floats(kpn) * sizeof(float));
    if (!failed && band->scratch != NULL) return QUELL_OK;
    ql_kpn_band_destroy(band, env->memory);
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: %u rows of %u pixels of the kernel predictor",
                   num_rows, width);
}

void ql_kpn_band_destroy(ql_kpn_band *band, ql_memory *memory)
{
    ql_free(memory, band->input.data);
    ql_free(memory, band->features.data);
    ql_free(memory, band->hidden.data);
    ql_free(memory, band->scratch);
    memset(band, 0, sizeof *band);
}

uint64_t ql_kpn_band_bytes(const ql_kpn *kpn, uint32_t width, uint32_t max_rows, uint32_t num_workers)
{
    const uint64_t pixels = ((uint64_t)width + 2 * BORDER) * (max_rows + 2 * (uint64_t)ql_kpn_reach(kpn));
    return sizeof(float) *
           (pixels * (QL_KPN_AUXILIARY + 2 * (uint64_t)kpn->width) + num_workers * (uint64_t)scratch_floats(kpn));
}

typedef struct layer_job {
    const ql_conv *conv;
    const ql_kernels *kernels;
    const ql_band_map *in;
    ql_band_map *out;
    int32_t adds, relu; /* adds: to what out holds */
    uint32_t from;      /* row of task 0 */
    ql_auxiliary_fn *source;
    void *user;
} layer_job;

static void input_task(void *user, uint32_t task, uint32_t worker)
{
    const layer_job *const job = user;
    job->source(job->user, job->from + task, worker, band_row(job->out, job->from + task));
}

static void layer_task(void *user, uint32_t task, uint32_t worker)
{
    const layer_job *const job = user;
    const ql_conv *const conv = job->conv;
    const uint32_t channels = job->in->channels, reach = conv->size / 2, y = job->from + task;
    float *const out = band_row(job->out, y);
    (void)worker;
    ql_conv_row row = {
        .weights = conv->weights,
        .bias = conv->bias,
        .add = job->adds ? out : NULL,
        .out = out,
        .num_rows = conv->size,
        .num_k = conv->size * channels,
        .stride = channels,
        .num_pixels = job->out->width,
        .num_out = conv->num_out,
        .relu = job->relu,
    };
    for (uint32_t r = 0; r < conv->size; ++r)
        row.rows[r] = band_row(job->in, (int64_t)y + r - reach) - (size_t)reach * channels;
    job->kernels->conv_row(&row);
}

/* Moves a map to a new place and makes its rows outside the image zeros. */
static void place(ql_band_map *map, int64_t first_row, uint32_t height)
{
    map->first_row = first_row;
    for (uint32_t i = 0; i < map->num_rows; ++i) {
        const int64_t y = first_row + i;
        if (y < 0 || y >= height) memset(map->data + i * row_floats(map), 0, row_floats(map) * sizeof(float));
    }
}

/* Runs a task on the rows of the band and halo rows beyond it, as far as the image goes. */
static quell_status run_rows(layer_job *job, ql_env *env, const ql_kpn_band *band, uint32_t halo, ql_task_fn task)
{
    const uint32_t y0 = band->y0, y1 = band->y1, height = band->height;
    const uint32_t end = height - y1 > halo ? y1 + halo : height;
    job->from = y0 > halo ? y0 - halo : 0;
    return ql_env_run(env, end - job->from, task, job);
}

typedef struct layer {
    const ql_conv *conv;
    const ql_band_map *in;
    ql_band_map *out;
    int32_t adds, relu;
} layer;

quell_status ql_kpn_run(const ql_kpn *kpn, const ql_kernels *kernels, ql_env *env, ql_kpn_band *band, uint32_t y0,
                        uint32_t y1, ql_auxiliary_fn *source, void *user)
{
    ql_band_map *const input = &band->input, *const features = &band->features, *const hidden = &band->hidden;
    layer layers[3 + 2 * QL_KPN_MAX_BLOCKS] = {
        {&kpn->source_skip, input, features, 0, 0},
        {&kpn->source[0], input, hidden, 0, 1},
        {&kpn->source[1], hidden, features, 1, 1},
    };
    uint32_t num_layers = 3, halo = ql_kpn_reach(kpn);
    for (uint32_t i = 0; i < kpn->num_blocks; ++i) {
        layers[num_layers++] = (layer){&kpn->blocks[i][0], features, hidden, 0, 1};
        layers[num_layers++] = (layer){&kpn->blocks[i][1], hidden, features, 1, 1};
    }
    band->y0 = y0;
    band->y1 = y1;
    place(input, (int64_t)y0 - halo, band->height);
    place(features, (int64_t)y0 - halo, band->height);
    place(hidden, (int64_t)y0 - halo, band->height);
    layer_job job = {.kernels = kernels, .out = input, .source = source, .user = user};
    QL_TRY(run_rows(&job, env, band, halo, input_task));
    for (uint32_t i = 0; i < num_layers; ++i) {
        job.conv = layers[i].conv;
        job.in = layers[i].in;
        job.out = layers[i].out;
        job.adds = layers[i].adds;
        job.relu = layers[i].relu;
        halo -= job.conv->size / 2; /* each layer makes just the rows that the layers after it read */
        QL_TRY(run_rows(&job, env, band, halo, layer_task));
    }
    return QUELL_OK;
}

void ql_kpn_logits_row(const ql_kpn *kpn, const ql_kernels *kernels, const ql_kpn_band *band, uint32_t y,
                       uint32_t worker, float *out)
{
    float *buffer = band->scratch + worker * scratch_floats(kpn);
    for (uint32_t x = 0; x < band->width; x += SPAN) {
        const uint32_t num = band->width - x < SPAN ? band->width - x : SPAN;
        const float *in = band_row(&band->features, y) + (size_t)x * kpn->width;
        uint32_t stride = kpn->width;
        float *to = buffer;
        for (uint32_t i = 0; i < 3; ++i) {
            const ql_conv *const conv = &kpn->predictor[i];
            const ql_conv_row row = {
                .rows = {in},
                .weights = conv->weights,
                .bias = conv->bias,
                .out = to,
                .num_rows = 1,
                .num_k = conv->num_in,
                .stride = stride,
                .num_pixels = num,
                .num_out = conv->num_out,
                .relu = i < 2,
            };
            kernels->conv_row(&row);
            in = to;
            stride = conv->num_out;
            to += (size_t)SPAN * conv->num_out;
        }
        kernels->planes_row(in, stride, QL_KPN_TAPS, 1, out + x, band->width, num);
    }
}
