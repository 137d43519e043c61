/* SPDX-License-Identifier: Apache-2.0 */
/* Maps of blocks and cells become rows of pixels. Both lie on the image's own grid, so tiles and threads do not show. */
#include "denoise/debug_layers.h"

#include "filter/blend.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { NOISE, CONFIDENCE, SKIPPED, NUM_KINDS, MAX_NAME_BYTES = 600 };

#define UNKNOWN_NOISE (-1.0f)
#define COMPUTED_IN_PASSING 0.5f /* needs no work, but lies in a rectangle that is computed for its neighbours */

static const char *const passes[NUM_KINDS] = {"Quell Noise", "Quell Confidence", "Quell Skipped"};

static int has_layers(const ql_plan *plan, uint32_t set)
{
    return plan->sets[set].beauty != QL_PLAN_NONE;
}

/* As the files of Blender name a pass of the same view layer and view. */
static void make_name(const ql_frame *frame, const ql_plan_set *set, int kind, char name[MAX_NAME_BYTES])
{
    const ql_layer *const beauty = &frame->layers[set->beauty];
    snprintf(name, MAX_NAME_BYTES, "%s%s%s%s%s", beauty->view_layer, beauty->view_layer[0] ? "." : "", passes[kind],
             beauty->view[0] ? "." : "", beauty->view);
}

quell_status ql_debug_layers_check(const ql_frame *frame, const ql_plan *plan, ql_error *err)
{
    for (uint32_t s = 0; s < plan->num_sets; ++s)
        for (int kind = 0; kind < NUM_KINDS && has_layers(plan, s); ++kind) {
            char name[MAX_NAME_BYTES];
            make_name(frame, &plan->sets[s], kind, name);
            for (uint32_t i = 0; i < frame->num_layers; ++i)
                if (strcmp(frame->layers[i].full_name, name) == 0)
                    return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT,
                                   "the frame already has a layer '%s'; remove it, or leave the debug layers out",
                                   name);
        }
    return QUELL_OK;
}

/* The layer whose noise is shown: Combined, or the first one measured where Combined was not. NULL: none was. */
static const ql_survey_layer *shown_layer(const ql_plan *plan, const ql_survey *survey, uint32_t set)
{
    const int32_t combined = plan->sets[set].role_layer[QUELL_ROLE_COMBINED];
    if (combined != QL_PLAN_NONE && survey->layers[combined].noise.variance) return &survey->layers[combined];
    for (uint32_t i = 0; i < plan->num_layers; ++i)
        if (plan->layers[i].set == (int32_t)set && survey->layers[i].noise.variance) return &survey->layers[i];
    return NULL;
}

static void noise_row(const ql_survey_layer *layer, uint32_t width, uint32_t y, float *out)
{
    for (uint32_t x = 0; x < width; ++x) {
        const float variance =
            layer ? layer->noise.variance[(size_t)(y / QL_NOISE_BLOCK) * layer->noise.across + x / QL_NOISE_BLOCK]
                  : INFINITY;
        out[x] = isfinite(variance) ? sqrtf(variance) : UNKNOWN_NOISE;
    }
}

/* scratch: width floats */
static void confidence_row(const ql_survey_layer *layer, uint32_t width, uint32_t y, float *scratch, float *out)
{
    const int is_one =
        layer && ql_blend_weight_row(layer->weight, layer->noise.across, layer->noise.down, width, y, scratch, out);
    if (layer && !is_one) return;
    for (uint32_t x = 0; x < width; ++x) out[x] = is_one ? 1.0f : 0.0f;
}

static void skipped_row(const ql_plan_cells *cells, const ql_plan_rect *rects, uint32_t num_rects, uint32_t y,
                        float *out)
{
    for (uint32_t x = 0; x < cells->width; ++x) out[x] = 1.0f;
    for (uint32_t i = 0; i < num_rects; ++i)
        for (uint32_t x = rects[i].x0; x < rects[i].x1 && y >= rects[i].y0 && y < rects[i].y1; ++x) {
            const size_t cell = (size_t)(y / QL_PLAN_CELL) * cells->across + x / QL_PLAN_CELL;
            out[x] = cells->active[cell] ? 0.0f : COMPUTED_IN_PASSING;
        }
}

/* rows: two of the frame's width */
static quell_status add_set(ql_frame *frame, const ql_plan *plan, const ql_survey *survey, uint32_t set, uint32_t halo,
                            float *rows, ql_error *err)
{
    const ql_survey_layer *const shown = shown_layer(plan, survey, set);
    ql_plan_cells *const cells = &survey->cells[set];
    ql_plan_rect rects[QL_PLAN_MAX_RECTS];
    const uint32_t width = frame->width, num_rects = ql_plan_cells_cover(cells, halo, rects, QL_PLAN_MAX_RECTS);
    float *const row = rows + width;
    for (int kind = 0; kind < NUM_KINDS; ++kind) {
        const ql_layer *const beauty = &frame->layers[plan->sets[set].beauty];
        const char *const views[] = {beauty->view[0] ? beauty->view : NULL, NULL};
        const uint32_t samples = beauty->samples;
        char name[MAX_NAME_BYTES];
        ql_layer *layer;
        make_name(frame, &plan->sets[set], kind, name);
        QL_TRY(ql_frame_append_layer(frame, name, views, &layer, err)); /* may move the frame's layers */
        layer->num_channels = 1;
        layer->format = QUELL_FORMAT_HALF;
        layer->channels[0] = 'Y';
        layer->channels[1] = '\0';
        layer->samples = samples;
        QL_TRY(ql_layer_alloc_pixels(frame, layer, err));
        for (uint32_t y = 0; y < frame->height; ++y) {
            if (kind == NOISE) noise_row(shown, width, y, row);
            if (kind == CONFIDENCE) confidence_row(shown, width, y, rows, row);
            if (kind == SKIPPED) skipped_row(cells, rects, num_rects, y, row);
            ql_view_write_row(&layer->pixels, width, 0, y, row);
        }
    }
    return QUELL_OK;
}

quell_status ql_debug_layers_add(ql_env *env, ql_frame *frame, const ql_plan *plan, const ql_survey *survey,
                                 uint32_t halo, ql_error *err)
{
    const uint32_t before = frame->num_layers;
    quell_status status = QUELL_OK;
    float *const rows = ql_alloc(env->memory, frame->width, 2 * sizeof *rows);
    if (rows == NULL) status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: debug layers");
    for (uint32_t s = 0; s < plan->num_sets && status == QUELL_OK; ++s)
        if (has_layers(plan, s)) status = add_set(frame, plan, survey, s, halo, rows, err);
    while (status != QUELL_OK && frame->num_layers > before) ql_frame_remove_last_layer(frame);
    ql_free(env->memory, rows);
    return status;
}
