/* SPDX-License-Identifier: Apache-2.0 */
/* Decides, before any work, which layers are filtered with which kernels, how Combined is put together, and what is
 * skipped and why. No I/O, no side effects: same facts and settings, same plan. */
#ifndef QL_PLAN_PLAN_H
#define QL_PLAN_PLAN_H

#include "base/memory.h"
#include "frame/frame.h"
#include "frame/roles.h"

enum { QL_NUM_ROLES = QUELL_ROLE_VOLUME_TRANSMIT + 1, QL_PLAN_NONE = -1 };

/* How the denoised Combined is made. */
enum { QL_COMBINED_DIRECT = 0, QL_COMBINED_PASSES = 1, QL_COMBINED_PASSES_ENVIRONMENT = 2 };

/* What the pixels say about one layer; src/filter/scan.h measures it. */
typedef struct ql_layer_facts {
    int32_t is_zero, is_constant;
} ql_layer_facts;

/* What happens to one layer of the frame. */
typedef struct ql_plan_layer {
    int32_t action;     /* QUELL_ACTION_* */
    const char *reason; /* static text */
    int32_t group;      /* QL_GROUP_* whose kernels filter it; QL_GROUP_NONE */
    int32_t source;     /* index of the layer whose pixels are filtered: itself, or its noisy original */
    int32_t set;        /* index of its set, or QL_PLAN_NONE */
} ql_plan_layer;

/* The layers of one view of one view layer: they share features and kernels. */
typedef struct ql_plan_set {
    int32_t role_layer[QL_NUM_ROLES]; /* index of the layer with that role, or QL_PLAN_NONE */
    int32_t beauty;                   /* the noisy Combined that features are made from */
    int32_t has_light;                /* all of diffuse, glossy and transmission: direct, indirect, colour */
    int32_t combined;                 /* QL_COMBINED_* */
    uint32_t samples;
} ql_plan_set;

typedef struct ql_plan {
    ql_plan_layer *layers; /* [frame->num_layers] */
    ql_plan_set *sets;
    uint32_t num_sets, num_layers;
    uint32_t num_denoised;
} ql_plan;

/* Groups layers into sets and chooses what was asked for. wanted: quell_options.layers. */
quell_status ql_plan_create(const ql_frame *frame, const char *wanted, ql_memory *memory, ql_plan *plan, ql_error *err);

/* Takes layers out that their facts say need no work. facts: [num_layers], those of layers that the plan denoises. */
void ql_plan_skip(ql_plan *plan, const ql_frame *frame, const ql_layer_facts *facts);

/* Takes out one layer whose noise leaves nothing to do; is_finished: because of its number of samples. */
void ql_plan_skip_clean(ql_plan *plan, uint32_t layer, int32_t is_finished);

/* closure[env]: mean difference of the passes' sum and Combined relative to Combined's mean, without and with
 * Environment. Chooses how a set's Combined is made. */
void ql_plan_choose_combined(ql_plan *plan, uint32_t set, const double closure[2]);

const char *ql_plan_combined_name(int32_t combined); /* as quell_report_summary.combined says it */
void ql_plan_free(ql_plan *plan, ql_memory *memory);

#endif
