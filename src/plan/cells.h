/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Which parts of an image need work. Decided on the image's own grid, before any work and whatever the tiles, so that
 * tiles and threads cannot change a result: 8x8 blocks say how much of a filtered layer may be used at most, and a cell
 * of 4x4 blocks in which no layer may use any is not computed at all.
 */
#ifndef QL_PLAN_CELLS_H
#define QL_PLAN_CELLS_H

#include "base/memory.h"
#include "base/status.h"

#include <stdint.h>

enum { QL_PLAN_BLOCK = 8, QL_PLAN_CELL = 32 };

/* The most of a kernel's result that a block may use, 0 to 1. variance: of the noise, relative to the mean
 * (filter/noise.h; INFINITY: unknown). samples: per pixel; 0: unknown. docs/NUMERICS.md says why these limits. */
float ql_plan_share(float variance, float samples);

/* How far kernels are to be trusted at that many samples per pixel (0: unknown), 0 to 1. quiet_variance: of the noise in
 * the quiet quarter of the layer, which tells when fewer samples were taken. */
float ql_plan_trust(float samples, float quiet_variance);

typedef struct ql_plan_cells {
    uint32_t width, height; /* of the image, in pixels */
    uint32_t across, down;  /* cells */
    uint8_t *active;        /* [down][across]: 1: computed */
    uint32_t num_active;
    uint32_t *sums; /* of ql_plan_cells_cover */
} ql_plan_cells;

/* All cells inactive. */
quell_status ql_plan_cells_create(ql_plan_cells *cells, uint32_t width, uint32_t height, ql_memory *memory,
                                  ql_error *err);
void ql_plan_cells_free(ql_plan_cells *cells, ql_memory *memory);
void ql_plan_cells_fill(ql_plan_cells *cells); /* all active */

/* Activates the cells that a block with a share above 0 is computed from: its own and its neighbours', because weights
 * are made from 3x3 blocks. share: [blocks down][blocks across]. */
void ql_plan_cells_add(ql_plan_cells *cells, const float *share);

/* Pixels x0 <= x < x1, y0 <= y < y1; x0 and y0 are multiples of QL_PLAN_CELL. */
typedef struct ql_plan_rect {
    uint32_t x0, y0, x1, y1;
} ql_plan_rect;

/* Rectangles that hold all active cells: more than one where computing them one by one, each with halo more pixels on
 * every side, is less work. At most `capacity` of them; returns how many. */
enum { QL_PLAN_MAX_RECTS = 64 };
uint32_t ql_plan_cells_cover(ql_plan_cells *cells, uint32_t halo, ql_plan_rect *rects, uint32_t capacity);

#endif
