/* SPDX-License-Identifier: Apache-2.0 */
/* What a job knows about noise before it starts, layer by layer, and what follows for the plan: layers and cells of the
 * image that need no work. */
#ifndef QL_DENOISE_SURVEY_H
#define QL_DENOISE_SURVEY_H

#include "base/pool.h"
#include "filter/noise.h"
#include "plan/cells.h"
#include "plan/plan.h"

/* One layer that the plan denoises. */
typedef struct ql_survey_layer {
    ql_noise noise;  /* of the pixels that are filtered; empty where the layer is not */
    float *share;    /* [blocks] the most of the kernels' result that may be used */
    float *weight;   /* [blocks] what was used of it; after ql_survey_blend */
    float *residual; /* [blocks] energy of the change, in units of noise.variance; after ql_survey_blend */
} ql_survey_layer;

typedef struct ql_survey {
    ql_survey_layer *layers; /* [num_layers] */
    ql_plan_cells *cells;    /* [num_sets] */
    float **samples;         /* [num_sets][blocks] per pixel; 0: unknown */
    uint32_t num_layers, num_sets;
} ql_survey;

enum {
    QL_SURVEY_ALL_CELLS = 1, /* every layer and cell is active */
    QL_SURVEY_NO_BLEND = 2   /* every share is 1 */
};

/* Measures the noise of what the plan denoises, takes clean layers out of it, and finds each set's active cells. scans:
 * [num_layers], of every layer that is filtered, with bins. survey is freed by ql_survey_free in any case. */
quell_status ql_survey_frame(ql_env *env, const ql_frame *frame, const ql_scan *scans, uint32_t flags, ql_plan *plan,
                             ql_survey *survey, ql_error *err);

/* Blends a filtered layer with its pixels. */
quell_status ql_survey_blend(ql_env *env, const ql_frame *frame, const ql_scan *scans, const ql_plan *plan,
                             uint32_t index, float *result, ql_survey *survey, ql_error *err);

/* Means over the image of what was used, and root of the mean energy of what was changed, relative to the local mean. */
void ql_survey_layer_means(const ql_survey_layer *layer, double *weight, double *change);

void ql_survey_free(ql_survey *survey, ql_memory *memory);

#endif
