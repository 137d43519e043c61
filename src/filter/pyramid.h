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
 * K and U are guided: the logit of a tap falls with the distance of two embeddings (kernels/kernels.h). Where embeddings
 * and their sharpness come from is the caller's business. training/models/pyramid.py is the same in PyTorch.
 */
#ifndef QL_FILTER_PYRAMID_H
#define QL_FILTER_PYRAMID_H

#include "base/pool.h"
#include "kernels/kernels.h"

enum { QL_PYRAMID_LEVELS = 5, QL_PYRAMID_SPAN = 64, QL_PYRAMID_MAX_PLANES = 24 };

/* Planes of logits that the source gives for each pixel, in this order, after one of sharpness (its logarithm) for each
 * dimension of the embedding. The coarsest level ends with the centre; only the finest has an importance. */
enum { QL_FIELD_CENTRE, QL_FIELD_BLEND, QL_FIELD_PARTITION, QL_FIELD_IMPORTANCE };

/* What the pyramids of a region share at a level, and the group's tables. Embeddings have a margin of QL_PYRAMID_MARGIN
 * zeros on every side; `pooled` is that of the next level's pixels, as upsampling to this one sees them. */
enum { QL_PYRAMID_MARGIN = 2 };
typedef struct ql_pyramid_level {
    const float *embedding, *pooled; /* dimension 0, pixel (0, 0) */
    ptrdiff_t stride, pooled_stride; /* floats between rows */
    size_t plane, pooled_plane;      /* ... between dimensions */
    const float *table;              /* [25] */
    const float *up_table;           /* [2 y][2 x][9]; NULL at the coarsest level */
} ql_pyramid_level;

/* Pixels of the finest level from which one result is made, in each direction; a multiple of 16. */
enum { QL_PYRAMID_REACH = 80 };

typedef struct ql_pyramid_source {
    void *user;
    uint32_t num_dims; /* of the embedding */
    const ql_pyramid_level *levels; /* [QL_PYRAMID_LEVELS] */
    /* Logits of fine rows 2y and 2y + 1 at fine pixels 2x .. 2x + 2 num - 1, num <= QL_PYRAMID_SPAN, as
     * [2][planes][2 num]. part 0: partition, importance; part 1: sharpness, centre, blend. */
    void (*fine)(void *user, uint32_t part, uint32_t x, uint32_t y, uint32_t num, uint32_t worker, float *out);
    /* Row y of level 1 .. 4 as [planes][width]: sharpness, centre, blend, partition; level 4 ends with the centre. */
    void (*coarse)(void *user, uint32_t level, uint32_t y, uint32_t worker, float *out);
    /* Values of fine row y, each plane num_columns long: planes[p][x] = v * x and v, given importance[x]. */
    void (*values)(void *user, uint32_t y, const float *importance, uint32_t worker, float *const *planes);
    /* Takes filtered planes of fine row y, pixels x .. x + num - 1. */
    void (*finish)(void *user, uint32_t y, uint32_t x, uint32_t num, uint32_t worker, const float *const *planes);
} ql_pyramid_source;

/* Runs the pyramid for num_planes planes of a region; width and height are multiples of 16. */
quell_status ql_pyramid_run(const ql_kernels *kernels, ql_env *env, uint32_t width, uint32_t height,
                            uint32_t num_planes, const ql_pyramid_source *source, ql_error *err);
uint64_t ql_pyramid_peak_bytes(uint32_t width, uint32_t height, uint32_t num_planes, uint32_t num_dims,
                               uint32_t num_workers);

/* The affinity of a level's pixel (x, y) with its own level, or with its parents; sharpness at that pixel. */
ql_affinity ql_pyramid_affinity(const ql_pyramid_level *guide, uint32_t num_dims, uint32_t x, uint32_t y,
                                const float *sharpness, size_t sharpness_plane);
ql_affinity ql_pyramid_parent_affinity(const ql_pyramid_level *guide, uint32_t num_dims, uint32_t x, uint32_t y,
                                       const float *sharpness, size_t sharpness_plane);

#endif
