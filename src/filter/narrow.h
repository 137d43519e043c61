/* SPDX-License-Identifier: Apache-2.0 */
/* One level of 5x5 kernels, for colours: their noise is thin, and a wide kernel would only cost texture. */
#ifndef QL_FILTER_NARROW_H
#define QL_FILTER_NARROW_H

#include "filter/pyramid.h"

enum { QL_NARROW_REACH = 16 /* 2, rounded up to what regions are aligned to */ };

/* source->fine gives sharpness and centre for part 0; importance is NULL in source->values; coarse is not called. Only
 * level 0 is used. Sizes and planes as in ql_pyramid_run. */
quell_status ql_narrow_run(const ql_kernels *kernels, ql_env *env, uint32_t width, uint32_t height, uint32_t num_planes,
                           const ql_pyramid_source *source, ql_error *err);
uint64_t ql_narrow_bytes(uint32_t width, uint32_t height, uint32_t num_planes, uint32_t num_dims, uint32_t num_workers);

#endif
