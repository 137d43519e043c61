/* SPDX-License-Identifier: Apache-2.0 */
/* What a job saw and decided, as layers of the frame: docs/cli.md, --debug-layers. */
#ifndef QL_DENOISE_DEBUG_LAYERS_H
#define QL_DENOISE_DEBUG_LAYERS_H

#include "denoise/survey.h"

/* QUELL_ERR_INVALID_ARGUMENT where a name of a debug layer is taken: to be asked before any work. */
quell_status ql_debug_layers_check(const ql_frame *frame, const ql_plan *plan, ql_error *err);

/* Appends three half-float layers to the frame for each set of the plan that has a Combined to look at, all of them or,
 * on failure, none. survey: after the blend. halo: that the covering rectangles were made with. */
quell_status ql_debug_layers_add(ql_env *env, ql_frame *frame, const ql_plan *plan, const ql_survey *survey,
                                 uint32_t halo, ql_error *err);

#endif
