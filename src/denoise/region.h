/* SPDX-License-Identifier: Apache-2.0 */
/* Filters one set of layers on one region of the image. */
#ifndef QL_DENOISE_REGION_H
#define QL_DENOISE_REGION_H

#include "base/pool.h"
#include "filter/scan.h"
#include "frame/frame.h"
#include "kernels/kernels.h"
#include "models/quell_net.h"
#include "plan/plan.h"

/* A whole job: what every region of it reads. */
typedef struct ql_job {
    const ql_kernels *kernels;
    const ql_net *net;
    ql_values values; /* of the network's maps */
    const ql_frame *frame;
    const ql_plan *plan;
    const ql_scan *scans; /* [num_layers]; empty for layers that nothing reads */
    uint32_t strip_width; /* most columns that are filtered at a time; a multiple of 32 */
    float **results;      /* [num_layers], [channels][height][width] each; NULL for layers that are not filtered */
    /* Wall clock, summed up by ql_region_run. Features are made inside the network's tasks: theirs is the workers' mean. */
    double seconds_features, seconds_network, seconds_filter, seconds_recombine;
} ql_job;

/* The pixels x0 <= x < x1, y0 <= y < y1 whose results are wanted, and the region that is computed for them: (rx, ry)
 * and the sizes are multiples of 16; it may end beyond the image, whose outside is black and weightless. */
typedef struct ql_region {
    uint32_t x0, y0, x1, y1;
    uint32_t rx, ry, width, height;
} ql_region;

quell_status ql_region_run(ql_job *job, ql_env *env, uint32_t set, const ql_feature_setup *setup,
                           const ql_region *region, ql_error *err);

/* Whether layers of a set are divided by the albedo while they are filtered: Combined that is no sum, light groups. */
int ql_region_divides(const ql_frame *frame, const ql_plan *plan, uint32_t set);

/* Working memory of ql_region_run for a region of that size, in bytes, as an upper bound. strip_width: as in ql_job, whose
 * own is not read; nor are its results. */
uint64_t ql_region_peak_bytes(const ql_job *job, uint32_t width, uint32_t height, uint32_t strip_width,
                              uint32_t num_workers);

/* The part of it that the network takes, however the filters are cut. */
uint64_t ql_region_network_bytes(const ql_job *job, uint32_t width, uint32_t height, uint32_t num_workers);

/* Pixels round a tile that its results are made from; a multiple of 16. */
uint32_t ql_region_halo(const ql_net *net);

#endif
