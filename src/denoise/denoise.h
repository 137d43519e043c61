/* SPDX-License-Identifier: Apache-2.0 */
/* Runs a plan: features, network, filters, recombination. */
#ifndef QL_DENOISE_DENOISE_H
#define QL_DENOISE_DENOISE_H

#include "base/pool.h"
#include "frame/frame.h"
#include "kernels/kernels.h"
#include "models/model.h"
#include "plan/report.h"

/* options: full size, checked. dry: plan only. On success each denoised layer has its result, and *report (never NULL
 * then) is the caller's. */
quell_status ql_denoise_frame(ql_env *env, const ql_kernels *kernels, const ql_model *model, ql_frame *frame,
                              const quell_options *options, uint64_t max_memory_bytes, int dry, ql_report **report,
                              ql_error *err);

#endif
