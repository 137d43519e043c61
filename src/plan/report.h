/* SPDX-License-Identifier: Apache-2.0 */
/* What was decided and done, layer by layer. Texts are owned by the report. */
#ifndef QL_PLAN_REPORT_H
#define QL_PLAN_REPORT_H

#include "base/memory.h"
#include "base/status.h"

typedef struct ql_report {
    quell_report_summary summary; /* its texts are static, or live in names */
    quell_report_layer *layers;   /* [summary.num_layers], one for each layer of the frame, in its order */
    char **names;                 /* [num_layers], behind layers[i].full_name */
    char *model_name;
    ql_memory memory;
} ql_report;

void ql_report_destroy(ql_report *report);

#endif
