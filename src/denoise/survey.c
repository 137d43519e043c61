/* SPDX-License-Identifier: Apache-2.0 */
/* Noise, shares and cells of a frame; the blend that follows from them. */
#include "denoise/survey.h"

#include "filter/blend.h"

#include <math.h>
#include <string.h>

static uint32_t num_colors(const ql_layer *layer)
{
    return layer->num_channels < 3 ? layer->num_channels : 3;
}

static size_t num_blocks(const ql_frame *frame)
{
    return (size_t)ql_noise_blocks(frame->width) * ql_noise_blocks(frame->height);
}

/* ---- Samples ------------------------------------------------------------------------------------------------------- */

/* Mean samples of each block. Cycles' "Debug Sample Count" is the fraction of the samples that were taken, 0 to 1; larger
 * values are counts. */
static quell_status read_samples(ql_env *env, const ql_frame *frame, const ql_plan_set *set, float **out, ql_error *err)
{
    const uint32_t across = ql_noise_blocks(frame->width), down = ql_noise_blocks(frame->height);
    float *const samples = *out = ql_alloc(env->memory, num_blocks(frame), sizeof *samples);
    if (samples == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: sample counts");
    for (size_t i = 0; i < num_blocks(frame); ++i) samples[i] = (float)set->samples;
    const int32_t index = set->role_layer[QUELL_ROLE_SAMPLE_COUNT];
    if (index == QL_PLAN_NONE || set->samples == 0) return QUELL_OK;
    float *const row = ql_alloc(env->memory, frame->width, sizeof *row);
    float *const sums = ql_alloc(env->memory, across, sizeof *sums);
    if (row && sums) {
        for (uint32_t b = 0; b < down; ++b) {
            const uint32_t y0 = b * QL_NOISE_BLOCK;
            const uint32_t y1 = y0 + QL_NOISE_BLOCK < frame->height ? y0 + QL_NOISE_BLOCK : frame->height;
            memset(sums, 0, across * sizeof *sums);
            for (uint32_t y = y0; y < y1; ++y) {
                ql_layer_read_row(&frame->layers[index], frame->width, 0, y, row);
                for (uint32_t x = 0; x < frame->width; ++x) {
                    const float full = (float)set->samples;
                    const float count = row[x] > 1.0f ? row[x] : row[x] * full;
                    sums[x / QL_NOISE_BLOCK] += count > 0.0f && count <= full ? count : full;
                }
            }
            for (uint32_t i = 0; i < across; ++i) {
                const uint32_t x0 = i * QL_NOISE_BLOCK;
                const uint32_t x1 = x0 + QL_NOISE_BLOCK < frame->width ? x0 + QL_NOISE_BLOCK : frame->width;
                samples[(size_t)b * across + i] = sums[i] / (float)((y1 - y0) * (x1 - x0));
            }
        }
    }
    const int failed = row == NULL || sums == NULL;
    ql_free(env->memory, row);
    ql_free(env->memory, sums);
    return failed ? ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: sample counts") : QUELL_OK;
}

/* ---- Layers -------------------------------------------------------------------------------------------------------- */

static quell_status survey_layer(ql_env *env, const ql_frame *frame, const ql_layer *source, const ql_scan *scan,
                                 const float *samples, uint32_t flags, ql_survey_layer *layer, ql_error *err)
{
    const size_t num = num_blocks(frame);
    layer->share = ql_alloc(env->memory, num, sizeof *layer->share);
    layer->weight = ql_alloc_zero(env->memory, num, sizeof *layer->weight);
    layer->residual = ql_alloc_zero(env->memory, num, sizeof *layer->residual);
    if (layer->share == NULL || layer->weight == NULL || layer->residual == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory: noise estimate", source->full_name);
    QL_TRY(ql_noise_measure(env, source, scan, num_colors(source), frame->width, frame->height, &layer->noise, err));
    for (size_t i = 0; i < num; ++i) {
        if (flags & QL_SURVEY_NO_BLEND)
            layer->share[i] = layer->weight[i] = 1.0f;
        else
            layer->share[i] = ql_plan_share(layer->noise.variance[i], samples[i]);
    }
    return QUELL_OK;
}

/* Whether nothing of the layer can change. *is_finished: because of the samples rather than the noise. Bad pixels are
 * work in any case. */
static int is_clean(const ql_frame *frame, const ql_survey_layer *layer, const ql_scan *scan, int32_t *is_finished)
{
    *is_finished = 0;
    if (scan->num_bad > 0) return 0;
    for (size_t i = 0; i < num_blocks(frame); ++i) {
        if (layer->share[i] > 0.0f) return 0;
        if (ql_plan_share(layer->noise.variance[i], 0.0f) > 0.0f) *is_finished = 1;
    }
    return 1;
}

/* Activates cells where something of the layer can change, bad pixels among them. */
static void add_cells(const ql_frame *frame, const ql_scan *scan, ql_survey_layer *layer, ql_plan_cells *cells)
{
    const uint32_t across = ql_noise_blocks(frame->width);
    float *const needs = layer->weight; /* not in use before the blend */
    memcpy(needs, layer->share, num_blocks(frame) * sizeof *needs);
    for (uint64_t i = 0; i < scan->num_fixes && scan->num_bad > 0; ++i) {
        const ql_fix *const fix = &scan->fixes[i];
        if (fix->scale <= 0.0f) needs[(size_t)(fix->y / QL_NOISE_BLOCK) * across + fix->x / QL_NOISE_BLOCK] = 1.0f;
    }
    ql_plan_cells_add(cells, needs);
}

quell_status ql_survey_frame(ql_env *env, const ql_frame *frame, const ql_scan *scans, uint32_t flags, ql_plan *plan,
                             ql_survey *survey, ql_error *err)
{
    *survey = (ql_survey){.num_layers = frame->num_layers, .num_sets = plan->num_sets};
    survey->layers = ql_alloc_zero(env->memory, frame->num_layers, sizeof *survey->layers);
    survey->cells = ql_alloc_zero(env->memory, plan->num_sets, sizeof *survey->cells);
    survey->samples = ql_alloc_zero(env->memory, plan->num_sets, sizeof *survey->samples);
    quell_status status = QUELL_OK;
    if (survey->layers == NULL || survey->cells == NULL || survey->samples == NULL)
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: survey of the layers");
    for (uint32_t s = 0; s < plan->num_sets && status == QUELL_OK; ++s) {
        ql_plan_cells *const cells = &survey->cells[s];
        status = ql_plan_cells_create(cells, frame->width, frame->height, env->memory, err);
        if (status == QUELL_OK) status = read_samples(env, frame, &plan->sets[s], &survey->samples[s], err);
        for (uint32_t i = 0; i < frame->num_layers && status == QUELL_OK; ++i) {
            const ql_plan_layer *const entry = &plan->layers[i];
            if (entry->set != (int32_t)s || entry->action != QUELL_ACTION_DENOISED) continue;
            ql_survey_layer *const layer = &survey->layers[i];
            const ql_scan *const scan = &scans[entry->source];
            int32_t is_finished;
            status =
                survey_layer(env, frame, &frame->layers[entry->source], scan, survey->samples[s], flags, layer, err);
            if (status != QUELL_OK || (flags & QL_SURVEY_ALL_CELLS)) continue;
            if (entry->source == (int32_t)i && is_clean(frame, layer, scan, &is_finished)) {
                ql_plan_skip_clean(plan, i, is_finished);
                continue;
            }
            add_cells(frame, scan, layer, cells);
        }
        if (status == QUELL_OK && (flags & QL_SURVEY_ALL_CELLS)) ql_plan_cells_fill(cells);
    }
    return status;
}

/* ---- Blend --------------------------------------------------------------------------------------------------------- */

quell_status ql_survey_blend(ql_env *env, const ql_frame *frame, const ql_scan *scans, const ql_plan *plan,
                             uint32_t index, float *result, ql_survey *survey, ql_error *err)
{
    ql_survey_layer *const layer = &survey->layers[index];
    const int32_t source = plan->layers[index].source;
    const ql_layer *const from = &frame->layers[source], *const to = &frame->layers[index];
    const uint32_t width = frame->width, height = frame->height, colors = num_colors(from);
    const float *const samples = survey->samples[plan->layers[index].set];
    const uint32_t channels = to->num_channels < from->num_channels ? to->num_channels : from->num_channels;
    const size_t num = num_blocks(frame);
    float *const changed = ql_alloc(env->memory, num, sizeof *changed);
    if (changed == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory: blending", to->full_name);
    quell_status status = ql_noise_measure_change(env, from, &scans[source], &layer->noise, colors, width, height,
                                                  result, changed, layer->residual, err);
    if (status == QUELL_OK) {
        const float quiet = ql_noise_quiet(changed, num);
        for (size_t i = 0; i < num; ++i) layer->share[i] *= ql_plan_trust(samples[i], quiet);
        const ql_blend blend = {layer->noise.variance, changed,          layer->residual, layer->share, layer->weight,
                                layer->noise.across,   layer->noise.down};
        status = ql_blend_layer(env, from, &scans[source], &blend, colors, channels, width, height, result, err);
    }
    ql_free(env->memory, changed);
    return status;
}

void ql_survey_layer_means(const ql_survey_layer *layer, double *weight, double *change)
{
    const size_t num = (size_t)layer->noise.across * layer->noise.down;
    double weights = 0.0, energy = 0.0;
    for (size_t i = 0; i < num; ++i) {
        const double w = (double)layer->weight[i];
        weights += w;
        if (isfinite(layer->residual[i])) energy += w * w * (double)layer->residual[i];
    }
    *weight = num ? weights / (double)num : 0.0;
    *change = num ? sqrt(energy / (double)num) : 0.0;
}

void ql_survey_free(ql_survey *survey, ql_memory *memory)
{
    for (uint32_t i = 0; survey->layers && i < survey->num_layers; ++i) {
        ql_noise_free(&survey->layers[i].noise, memory);
        ql_free(memory, survey->layers[i].share);
        ql_free(memory, survey->layers[i].weight);
        ql_free(memory, survey->layers[i].residual);
    }
    for (uint32_t s = 0; s < survey->num_sets; ++s) {
        if (survey->cells) ql_plan_cells_free(&survey->cells[s], memory);
        if (survey->samples) ql_free(memory, survey->samples[s]);
    }
    ql_free(memory, survey->samples);
    ql_free(memory, survey->layers);
    ql_free(memory, survey->cells);
    memset(survey, 0, sizeof *survey);
}
