/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The kernel pyramid: every filtered pixel is a convex combination of valid input pixels.
 *
 * Values travel in homogeneous form, planes of v * x and of v, with a weight v >= 0 that is 0 for bad pixels and outside
 * the image. Each step is linear with non-negative weights, so one division at the end gives a convex combination:
 *
 *     x_(l+1) = sum over 2x2 cells of d_l * x_l                   d_l: softmax over the four
 *     y_l     = (1 - a_l) * K_l x_l + a_l * U_l y_(l+1)           K_l: softmax over 5x5, U_l: over 3x3 parents
 *     result  = y_0[v x] / y_0[v]
 *
 * training/models/pyramid.py is the same in PyTorch. Where logits come from is the caller's business.
 */
#ifndef QL_FILTER_PYRAMID_H
#define QL_FILTER_PYRAMID_H

#include "base/pool.h"
#include "kernels/kernels.h"

enum { QL_PYRAMID_LEVELS = 5, QL_PYRAMID_SPAN = 64, QL_PYRAMID_MAX_PLANES = 24 };

/* Pixels of the finest level from which one result is made, in each direction; a multiple of 16. */
enum { QL_PYRAMID_REACH = 80 };

typedef struct ql_pyramid_source {
    void *user;
    /* Logits of fine rows 2y and 2y + 1 at fine pixels 2x .. 2x + 2 num - 1, num <= QL_PYRAMID_SPAN, as
     * [2][planes][2 num]. part 0: partition, importance (2 planes); part 1: kernel, upsampling, blend (35). */
    void (*fine)(void *user, uint32_t part, uint32_t x, uint32_t y, uint32_t num, uint32_t worker, float *out);
    /* Row y of level 1 .. 4 as [planes][width]: kernel 25, upsampling 9, blend, partition; level 4: kernel alone. */
    void (*coarse)(void *user, uint32_t level, uint32_t y, uint32_t worker, float *out);
    /* Values of fine row y, each plane num_columns long: planes[p][x] = v * x and v, given importance[x]. */
    void (*values)(void *user, uint32_t y, const float *importance, uint32_t worker, float *const *planes);
    /* Takes filtered planes of fine row y, pixels x .. x + num - 1. */
    void (*finish)(void *user, uint32_t y, uint32_t x, uint32_t num, uint32_t worker, const float *const *planes);
} ql_pyramid_source;

/* Runs the pyramid for num_planes planes of a region; width and height are multiples of 16. */
quell_status ql_pyramid_run(const ql_kernels *kernels, ql_env *env, uint32_t width, uint32_t height,
                            uint32_t num_planes, const ql_pyramid_source *source, ql_error *err);
uint64_t ql_pyramid_peak_bytes(uint32_t width, uint32_t height, uint32_t num_planes, uint32_t num_workers);

#endif
