/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Blends a filtered layer with what it was made from, so that no render comes out worse: docs/NUMERICS.md.
 *
 * With x the render of noise variance s^2 and f what the kernels made of it, Stein's lemma gives the error of
 * x + w (f - x) without a reference; it is smallest near w = s^2 / E[(f - x)^2], the share of the change that is noise.
 * A change no larger than the noise is taken whole; detail that the kernels blurred makes the change larger than the
 * noise, and lowers w. s^2 is measured on the layer and on the change, of which detail that the kernels kept is no part. 0 <= w <= 1, so the result is a convex combination as the filtered layer is.
 */
#ifndef QL_FILTER_BLEND_H
#define QL_FILTER_BLEND_H

#include "filter/noise.h"

/* What to blend, all [blocks] of ql_noise. */
typedef struct ql_blend {
    const float *variance; /* of the layer's noise: ql_noise.variance */
    const float *changed;  /* noise in the change, and */
    const float *residual; /* energy of the change: ql_noise_measure_change */
    const float *limit;    /* 0 to 1, the most that w may be */
    float *weights;        /* receives w at the middle of each block */
    uint32_t across, down;
} ql_blend;

/* result: [num_channels][height][width], filtered; becomes the blend. Where w is 0 the layer's own pixels come back bit for
 * bit, save bad ones. */
quell_status ql_blend_layer(ql_env *env, const ql_layer *layer, const ql_scan *scan, const ql_blend *blend,
                            uint32_t num_colors, uint32_t num_channels, uint32_t width, uint32_t height, float *result,
                            ql_error *err);

/* The weights of one row of pixels: those of block centres, linear between them. Returns 1 where all are 1, out then being
 * left as it is. blocks: scratch of `across` floats. */
int ql_blend_weight_row(const float *weights, uint32_t across, uint32_t down, uint32_t width, uint32_t y, float *blocks,
                        float *out);

#endif
