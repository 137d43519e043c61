/* SPDX-License-Identifier: Apache-2.0 */
/* A stack of planes with a margin of zeros on every side: what kernels with several taps read. */
#ifndef QL_NN_PLANES_H
#define QL_NN_PLANES_H

#include "base/memory.h"
#include "base/status.h"

typedef struct ql_planes {
    float *data;      /* plane 0, pixel (-margin, -margin) */
    uint32_t width, height, num, margin;
    ptrdiff_t stride; /* floats between rows */
    size_t plane;     /* floats between planes */
} ql_planes;

/* All zero at first. */
quell_status ql_planes_create(ql_planes *planes, uint32_t width, uint32_t height, uint32_t num, uint32_t margin,
                              ql_memory *memory, ql_error *err);
void ql_planes_destroy(ql_planes *planes, ql_memory *memory);
float *ql_planes_row(const ql_planes *planes, uint32_t plane, uint32_t y); /* pixel (0, y) */
size_t ql_planes_bytes(uint32_t width, uint32_t height, uint32_t num, uint32_t margin);

#endif
