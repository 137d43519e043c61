/* SPDX-License-Identifier: Apache-2.0 */
/*
 * How noisy a layer is, before any work: docs/NUMERICS.md has the derivation and what it measures on real renders.
 *
 * Noise of a path tracer is independent from pixel to pixel. A second difference along a line removes what is flat or
 * linear along that line and leaves the noise, with 6 times its variance:
 *
 *     h_e(p) = (x(p - e) - 2 x(p) + x(p + e)) / sqrt(6),   E[h_e^2] = noise variance + curvature along e
 *
 * Edges, lines and stripes are straight in at least one direction, so the smallest of four directions is taken. What is
 * left of texture can only make the estimate too large, never too small: a layer that is called clean is clean.
 */
#ifndef QL_FILTER_NOISE_H
#define QL_FILTER_NOISE_H

#include "base/pool.h"
#include "filter/scan.h"
#include "frame/frame.h"

enum { QL_NOISE_BLOCK = 8 }; /* edge of a block in pixels; the blocks are the image's own, whatever the tiles */

typedef struct ql_noise {
    uint32_t across, down; /* blocks */
    float *variance; /* [down][across]: of luminance relative to its local mean, over 3x3 blocks; INFINITY: unknown */
    float *scale;    /* [down][across]: 1 / (local mean + floor) */
    double level;    /* root of the mean variance over blocks of known variance */
} ql_noise;

/* scan: the layer's, made with QL_SCAN_BINS. num_colors: as for the scan. */
quell_status ql_noise_measure(ql_env *env, const ql_layer *layer, const ql_scan *scan, uint32_t num_colors,
                              uint32_t width, uint32_t height, ql_noise *noise, ql_error *err);
/* Variance below which a quarter of the blocks lie, those without any noise left out; at most a fifth too small. */
float ql_noise_quiet(const float *variance, size_t num_blocks);
void ql_noise_free(ql_noise *noise, ql_memory *memory);

uint32_t ql_noise_blocks(uint32_t pixels); /* blocks along an edge of that many pixels */

/* ql_noise_measure for what a filter changed: variance of result - layer, which leaves out the detail that the filter kept, and
 * residual, its whole energy. Both [blocks], in units of noise->variance. result: [num_colors][height][width] and more. */
quell_status ql_noise_measure_change(ql_env *env, const ql_layer *layer, const ql_scan *scan, const ql_noise *noise,
                                     uint32_t num_colors, uint32_t width, uint32_t height, const float *result,
                                     float *variance, float *residual, ql_error *err);

#endif
