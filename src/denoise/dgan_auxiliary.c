/* SPDX-License-Identifier: Apache-2.0 */
/* Auxiliary passes of a frame, with what takes their place where a file lacks them. */
#include "denoise/dgan_auxiliary.h"

#include "filter/scan.h"
#include "models/features.h"

#include <math.h>
#include <string.h>

enum { NORMAL, POSITION, ALBEDO, GLOSSY, TRANSMISSION, DEPTH };

/* The pass, and the one that does in its stead. */
static const struct {
    const char *name;
    int32_t role, instead;
    uint32_t num_channels;
} passes[QL_AUXILIARY_PASSES] = {
    [NORMAL] = {"Denoising Normal", QUELL_ROLE_DENOISING_NORMAL, QUELL_ROLE_NORMAL, 3},
    [POSITION] = {"Position", QUELL_ROLE_POSITION, QUELL_ROLE_POSITION, 3},
    [ALBEDO] = {"Denoising Albedo", QUELL_ROLE_DENOISING_ALBEDO, QUELL_ROLE_DIFFUSE_COLOR, 3},
    [GLOSSY] = {"Glossy Color", QUELL_ROLE_GLOSSY_COLOR, QUELL_ROLE_GLOSSY_COLOR, 3},
    [TRANSMISSION] = {"Transmission Color", QUELL_ROLE_TRANSMISSION_COLOR, QUELL_ROLE_TRANSMISSION_COLOR, 3},
    [DEPTH] = {"Denoising Depth", QUELL_ROLE_DENOISING_DEPTH, QUELL_ROLE_DEPTH, 1},
};

int32_t ql_auxiliary_layer(const ql_plan_set *set, uint32_t i)
{
    const int32_t layer = set->role_layer[passes[i].role];
    return layer != QL_PLAN_NONE ? layer : set->role_layer[passes[i].instead];
}

const char *ql_auxiliary_name(uint32_t i)
{
    return passes[i].name;
}

/* Reads row y of every pass into the worker's scratch. */
static void read_rows(const ql_auxiliary *auxiliary, uint32_t y, uint32_t worker, ql_dgan_rows *rows)
{
    const uint32_t width = auxiliary->frame->width;
    float *row = auxiliary->scratch + (size_t)worker * QL_AUXILIARY_PASSES * 3 * width;
    const float **const to[QL_AUXILIARY_PASSES] = {rows->normal,       rows->position,     rows->texture_1,
                                                   rows->texture_2[0], rows->texture_2[1], &rows->depth};
    memset(rows, 0, sizeof *rows);
    for (uint32_t i = 0; i < QL_AUXILIARY_PASSES; ++i) {
        if (auxiliary->pass[i] == NULL) continue;
        for (uint32_t c = 0; c < passes[i].num_channels; ++c, row += width) {
            ql_layer_read_row(auxiliary->pass[i], width, c, y, row);
            to[i][c] = row;
        }
    }
}

void ql_auxiliary_row(void *user, uint32_t y, uint32_t worker, float *out)
{
    const ql_auxiliary *const auxiliary = user;
    ql_dgan_rows rows;
    read_rows(auxiliary, y, worker, &rows);
    ql_dgan_feature_row(&auxiliary->scale, &rows, auxiliary->frame->width, out);
}

typedef struct box_job {
    const ql_auxiliary *auxiliary;
    float (*boxes)[6]; /* [height] low x, y, z, high x, y, z of a row's hits */
} box_job;

static void box_task(void *user, uint32_t task, uint32_t worker)
{
    const box_job *const job = user;
    float *const box = job->boxes[task];
    ql_dgan_rows rows;
    read_rows(job->auxiliary, task, worker, &rows);
    for (uint32_t c = 0; c < 3; ++c) {
        box[c] = INFINITY;
        box[3 + c] = -INFINITY;
        for (uint32_t x = 0; x < job->auxiliary->frame->width; ++x) {
            if (!ql_dgan_is_hit(&rows, x)) continue;
            const float value = isfinite(rows.position[c][x]) ? rows.position[c][x] : 0.0f;
            box[c] = value < box[c] ? value : box[c];
            box[3 + c] = value > box[3 + c] ? value : box[3 + c];
        }
    }
}

/* training/dgan/features.py: box_position */
static quell_status measure_box(ql_auxiliary *auxiliary, ql_env *env, ql_error *err)
{
    box_job job = {auxiliary, NULL};
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, half = 0.0f;
    job.boxes = ql_alloc(env->memory, auxiliary->frame->height, sizeof *job.boxes);
    if (job.boxes == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: box of Position");
    const quell_status status = ql_env_run(env, auxiliary->frame->height, box_task, &job);
    for (uint32_t y = 0; y < auxiliary->frame->height && status == QUELL_OK; ++y)
        for (uint32_t c = 0; c < 3; ++c) {
            low[c] = fminf(low[c], job.boxes[y][c]);
            high[c] = fmaxf(high[c], job.boxes[y][3 + c]);
        }
    ql_free(env->memory, job.boxes);
    QL_TRY(status);
    for (uint32_t c = 0; c < 3; ++c) {
        if (!(low[c] <= high[c])) return QUELL_OK; /* nothing was hit */
        half = fmaxf(half, 0.5f * (high[c] - low[c]));
        auxiliary->scale.center[c] = 0.5f * (low[c] + high[c]);
    }
    auxiliary->scale.position_scale = half > 0.0f ? 1.0f / half : 0.0f;
    return QUELL_OK;
}

quell_status ql_auxiliary_create(ql_auxiliary *auxiliary, ql_env *env, const ql_frame *frame, const ql_plan_set *set,
                                 ql_error *err)
{
    memset(auxiliary, 0, sizeof *auxiliary);
    auxiliary->frame = frame;
    for (uint32_t i = 0; i < QL_AUXILIARY_PASSES; ++i) {
        const int32_t layer = ql_auxiliary_layer(set, i);
        const int usable = layer != QL_PLAN_NONE && frame->layers[layer].num_channels >= passes[i].num_channels;
        auxiliary->pass[i] = usable ? &frame->layers[layer] : NULL;
    }
    auxiliary->scratch = ql_alloc(env->memory, (size_t)ql_pool_num_threads(env->pool) * QL_AUXILIARY_PASSES * 3,
                                  frame->width * sizeof *auxiliary->scratch);
    if (auxiliary->scratch == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of auxiliary passes");
    if (auxiliary->pass[DEPTH]) {
        ql_scan scan;
        QL_TRY(ql_scan_layer(env, auxiliary->pass[DEPTH], NULL, 1, frame->width, frame->height,
                             QL_SCAN_BINS | QL_SCAN_DEPTH, 0.0f, &scan, err));
        auxiliary->scale.depth_exponent = ql_log_exponent(scan.bins, scan.num_bins);
        ql_scan_free(&scan, env->memory);
    }
    return auxiliary->pass[POSITION] ? measure_box(auxiliary, env, err) : QUELL_OK;
}

void ql_auxiliary_destroy(ql_auxiliary *auxiliary, ql_memory *memory)
{
    ql_free(memory, auxiliary->scratch);
    auxiliary->scratch = NULL;
}
