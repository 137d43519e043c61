/* SPDX-License-Identifier: Apache-2.0 */
/* Puts Combined together from its denoised parts. */
#ifndef QL_DENOISE_RECOMBINE_H
#define QL_DENOISE_RECOMBINE_H

#include "denoise/region.h"

/* Combined = (direct + indirect) * colour of diffuse, glossy and transmission light + volume + emission + environment.
 * The results of all parts must be there; set->combined must not be QL_COMBINED_DIRECT. */
quell_status ql_recombine(const ql_job *job, ql_env *env, const ql_plan_set *set, const ql_region *region,
                          ql_error *err);

#endif
