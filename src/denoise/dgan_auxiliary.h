/* SPDX-License-Identifier: Apache-2.0 */
/* Which layers of a set are DGAN-KPN's auxiliary features, and their rows. */
#ifndef QL_DENOISE_DGAN_AUXILIARY_H
#define QL_DENOISE_DGAN_AUXILIARY_H

#include "base/pool.h"
#include "frame/frame.h"
#include "models/dgan_features.h"
#include "plan/plan.h"

enum { QL_AUXILIARY_PASSES = 6 };

typedef struct ql_auxiliary {
    const ql_frame *frame;
    const ql_layer *pass[QL_AUXILIARY_PASSES]; /* normal, position, textures (albedo, glossy, transmission), depth */
    ql_dgan_scale scale;
    float *scratch; /* [workers] rows of all passes */
} ql_auxiliary;

/* Finds the passes and measures the frame's scale. Free with ql_auxiliary_destroy in any case. */
quell_status ql_auxiliary_create(ql_auxiliary *auxiliary, ql_env *env, const ql_frame *frame, const ql_plan_set *set,
                                 ql_error *err);
void ql_auxiliary_destroy(ql_auxiliary *auxiliary, ql_memory *memory);

/* A ql_auxiliary_fn; user: the ql_auxiliary. */
void ql_auxiliary_row(void *user, uint32_t y, uint32_t worker, float *out);

/* Index of the layer of a set that pass i is read from, or QL_PLAN_NONE; its name for people. */
int32_t ql_auxiliary_layer(const ql_plan_set *set, uint32_t i);
const char *ql_auxiliary_name(uint32_t i);

#endif
