/* SPDX-License-Identifier: Apache-2.0 */
/* Reports own their texts, so that they outlive the frame. */
#include "plan/report.h"

#include <stdlib.h>

void ql_report_destroy(ql_report *report)
{
    if (report == NULL) return;
    for (uint32_t i = 0; report->names && i < report->summary.num_layers; ++i)
        ql_free(&report->memory, report->names[i]);
    ql_free(&report->memory, report->names);
    ql_free(&report->memory, report->layers);
    ql_free(&report->memory, report->model_name);
    free(report);
}
