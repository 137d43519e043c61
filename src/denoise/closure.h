/* SPDX-License-Identifier: Apache-2.0 */
/* How well the light passes of a frame add up to its Combined. */
#ifndef QL_DENOISE_CLOSURE_H
#define QL_DENOISE_CLOSURE_H

#include "base/pool.h"
#include "filter/scan.h"
#include "plan/plan.h"

/* closure[env]: mean of |sum of a set's passes - Combined| over the mean of Combined, without and with Environment, of the
 * pixels that no scan found fault with. The set has all light passes, and scans of them. */
quell_status ql_measure_closure(ql_env *env, const ql_frame *frame, const ql_scan *scans, const ql_plan_set *set,
                                double closure[2], ql_error *err);

#endif
