/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Image reconstruction of DGAN-KPN, section 3.1.3 of the paper: one 19x19 softmax kernel per pixel, applied to planes of
 * an image once or several times over (eq. 1 and 2, filter reading of the iterations).
 *
 * The 361 weights of a pixel are computed once for all iterations and never held for the whole image: rows advance in
 * steps, iteration r being 9 r rows behind the weights, so that a ring of rows is all there is. Taps outside the image
 * are dropped and the others weighed anew.
 */
#ifndef QL_FILTER_WIDE_H
#define QL_FILTER_WIDE_H

#include "base/pool.h"
#include "kernels/kernels.h"

enum { QL_WIDE_RADIUS = 9, QL_WIDE_TAPS = 361, QL_WIDE_STEP = 32 };

/* Planes with QL_WIDE_RADIUS zeros on every side. */
typedef struct ql_wide_planes {
    float *data;
    uint32_t width, height, num;
} ql_wide_planes;

quell_status ql_wide_planes_create(ql_wide_planes *planes, uint32_t width, uint32_t height, uint32_t num,
                                   ql_memory *memory, ql_error *err);
void ql_wide_planes_destroy(ql_wide_planes *planes, ql_memory *memory);
float *ql_wide_row(const ql_wide_planes *planes, uint32_t plane, uint32_t y);
size_t ql_wide_stride(uint32_t width); /* floats between rows */
uint64_t ql_wide_planes_bytes(uint32_t width, uint32_t height, uint32_t num);

typedef struct ql_wide_source {
    void *user;
    /* Called before the logits of rows y0 .. y1 - 1 are asked for; y0 is a multiple of QL_WIDE_STEP, in rising order. */
    quell_status (*prepare)(void *user, uint32_t y0, uint32_t y1);
    void (*logits)(void *user, uint32_t y, uint32_t worker, float *out); /* [QL_WIDE_TAPS][width] */
} ql_wide_source;

/* Applies the kernels iterations times (at least once) to *image. other: planes of the same shape, whose content is lost;
 * the two trade places so that *image holds the result. */
quell_status ql_wide_run(const ql_kernels *kernels, ql_env *env, const ql_wide_source *source, uint32_t iterations,
                         ql_wide_planes *image, ql_wide_planes *other, ql_error *err);
uint64_t ql_wide_ring_bytes(uint32_t width, uint32_t height, uint32_t iterations);

#endif
