/* SPDX-License-Identifier: Apache-2.0 */
/* Runs DGAN-KPN on the layers of a frame. */
#ifndef QL_DENOISE_DGAN_H
#define QL_DENOISE_DGAN_H

#include "base/pool.h"
#include "filter/scan.h"
#include "frame/frame.h"
#include "kernels/kernels.h"
#include "models/dgan.h"
#include "plan/plan.h"

typedef struct ql_dgan_job {
    const ql_kernels *kernels;
    const ql_dgan *net;
    const ql_frame *frame;
    const ql_plan *plan;
    const ql_scan *scans; /* [num_layers], with bins; of layers that are filtered */
    float **results;      /* [num_layers], [channels][height][width] each: the source's pixels, bad ones as 0 */
    quell_dgan_options options;
    uint32_t band_rows;                     /* of the kernel predictor; a multiple of QL_WIDE_STEP */
    uint32_t iterations_run;                /* the most that any set needed */
    double seconds_network, seconds_filter; /* wall clock, summed up */
} ql_dgan_job;

/* Checks what the caller gave (NULL: defaults) and fills in what was left 0. */
quell_status ql_dgan_options_read(const quell_dgan_options *given, quell_dgan_options *options, ql_error *err);

/* The largest bands whose working memory stays below max_bytes; tile_size: the caller's wish, 0 for none. Fails when even
 * the smallest need more. *planned_bytes: what the choice needs. */
quell_status ql_dgan_choose_bands(ql_dgan_job *job, ql_env *env, uint32_t tile_size, uint64_t max_bytes,
                                  uint64_t *planned_bytes, ql_error *err);

/* Names of auxiliary passes that the set lacks, as a sentence's end ("Position, Denoising Depth"); "" when none. */
void ql_dgan_missing_passes(const ql_plan_set *set, char *out, size_t size_bytes);

/* Denoises every layer of a set that the plan says to. */
quell_status ql_dgan_run_set(ql_dgan_job *job, ql_env *env, uint32_t set, ql_error *err);

#endif
