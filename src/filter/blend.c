/* SPDX-License-Identifier: Apache-2.0 */
/* Chooses weights block by block, and blends row by row. */
#include "filter/blend.h"

#include <math.h>
#include <string.h>

enum { BLOCK = QL_NOISE_BLOCK, MAX_CHANNELS = 4 };

/* The four-direction estimate is some 20 % low (the smallest of four), and a change of which 30 % or less is noise is
 * nearly all lost detail. Both by series of renders: docs/NUMERICS.md. */
#define NOISE_GAIN 1.25f
#define LEAST_SHARE 0.3f
/* Noise as large as the picture itself: no detail that kernels lose is. */
#define LOUD_NOISE 0.4f
#define LOUDEST_NOISE 0.8f

typedef struct blend_job {
    const ql_layer *layer;
    const ql_scan *scan;
    const ql_blend *blend;
    uint32_t num_colors, num_channels, width, height;
    float *result;
    float *scratch; /* per worker */
    size_t scratch_floats;
} blend_job;

static float *result_row(const blend_job *job, uint32_t channel, uint32_t y)
{
    return job->result + ((size_t)channel * job->height + y) * job->width;
}

static float clamp(float value)
{
    return value < 0.0f ? 0.0f : value > 1.0f ? 1.0f : value;
}

static void choose_weights(const ql_blend *blend)
{
    const size_t num = (size_t)blend->across * blend->down;
    for (size_t i = 0; i < num; ++i) {
        const float least = blend->changed[i] < blend->variance[i] ? blend->changed[i] : blend->variance[i];
        const float residual = blend->residual[i];
        float weight = 1.0f;
        /* Unknown noise is trusted to the kernels, and so is a change too large for a float. */
        if (isfinite(least) && isfinite(residual) && residual > 0.0f) {
            const float loud = clamp((sqrtf(least) - LOUD_NOISE) / (LOUDEST_NOISE - LOUD_NOISE));
            weight = clamp((NOISE_GAIN * least / residual - LEAST_SHARE) / (1.0f - LEAST_SHARE));
            weight = weight > loud ? weight : loud;
        }
        blend->weights[i] = weight * blend->limit[i];
    }
}

int ql_blend_weight_row(const float *weights, uint32_t across, uint32_t down, uint32_t width, uint32_t y, float *blocks,
                        float *out)
{
    const float fy = ((float)y + 0.5f) / (float)BLOCK - 0.5f;
    const uint32_t top = fy > 0.0f ? (uint32_t)fy : 0, bottom = top + 1 < down ? top + 1 : down - 1;
    const float ty = fy > (float)top ? fy - (float)top : 0.0f;
    const float *const a = weights + (size_t)top * across, *const b = weights + (size_t)bottom * across;
    int is_one = 1;
    for (uint32_t i = 0; i < across; ++i) {
        blocks[i] = a[i] + ty * (b[i] - a[i]);
        is_one &= a[i] == 1.0f && b[i] == 1.0f;
    }
    if (is_one) return 1;
    /* From the centre of each block to the next; half a block at either end. */
    for (uint32_t i = 0; i <= across; ++i) {
        const float left = blocks[i > 0 ? i - 1 : 0], right = blocks[i < across ? i : across - 1];
        for (uint32_t k = i > 0 ? 0 : BLOCK / 2; k < BLOCK; ++k) {
            const uint32_t x = i * BLOCK + k - BLOCK / 2;
            if (x >= width) break;
            out[x] = left + ((float)k + 0.5f) / (float)BLOCK * (right - left);
        }
    }
    return 0;
}

static void blend_task(void *user, uint32_t task, uint32_t worker)
{
    const blend_job *const job = user;
    const size_t width = job->width;
    float *const weight = job->scratch + worker * job->scratch_floats, *const valid = weight + width;
    float *const raw = valid + width;
    float *rows[MAX_CHANNELS];
    for (size_t c = 0; c < MAX_CHANNELS; ++c) rows[c] = raw + (c + 1) * width;
    const ql_blend *const blend = job->blend;
    if (ql_blend_weight_row(blend->weights, blend->across, blend->down, job->width, task, raw, weight))
        return; /* the filtered row as it is */
    ql_read_fixed_row(job->layer, job->scan, job->width, task, job->num_colors, rows, valid);
    for (uint32_t c = 0; c < job->num_channels; ++c) {
        float *const out = result_row(job, c, task);
        if (c >= job->num_colors) ql_layer_read_row(job->layer, job->width, c, task, rows[c]);
        for (uint32_t x = 0; x < width; ++x) {
            const float w = weight[x], mixed = rows[c][x] + w * (out[x] - rows[c][x]);
            /* Whole weights give either side bit for bit. */
            out[x] = w == 1.0f || valid[x] == 0.0f || !isfinite(rows[c][x]) ? out[x] : w == 0.0f ? rows[c][x] : mixed;
        }
    }
    /* Limited fireflies come back at full strength where nothing may be filtered: a finished or clean image stays. Where
     * the kernels only were not believed they stay limited. */
    const int has_fixes = job->scan->row_start[task] < job->scan->row_start[task + 1];
    if (!has_fixes || ql_blend_weight_row(blend->limit, blend->across, blend->down, job->width, task, raw, weight))
        return;
    for (uint64_t i = job->scan->row_start[task]; i < job->scan->row_start[task + 1]; ++i) {
        const ql_fix *const fix = &job->scan->fixes[i];
        if (fix->scale <= 0.0f || weight[fix->x] != 0.0f) continue;
        for (uint32_t c = 0; c < job->num_colors; ++c) {
            ql_layer_read_row(job->layer, job->width, c, task, raw);
            result_row(job, c, task)[fix->x] = raw[fix->x];
        }
    }
}

quell_status ql_blend_layer(ql_env *env, const ql_layer *layer, const ql_scan *scan, const ql_blend *blend,
                            uint32_t num_colors, uint32_t num_channels, uint32_t width, uint32_t height, float *result,
                            ql_error *err)
{
    blend_job job = {
        .layer = layer,
        .scan = scan,
        .blend = blend,
        .num_colors = num_colors,
        .num_channels = num_channels,
        .width = width,
        .height = height,
        .result = result,
        .scratch_floats = (3 + MAX_CHANNELS) * (size_t)width,
    };
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job.scratch_floats * sizeof(float));
    if (job.scratch == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory: blending", layer->full_name);
    choose_weights(blend);
    const quell_status status = ql_env_run(env, height, blend_task, &job);
    ql_free(env->memory, job.scratch);
    return status;
}
