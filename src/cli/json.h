/* SPDX-License-Identifier: Apache-2.0 */
/* What the subcommands say, as JSON by cJSON. docs/cli.md describes the objects. */
#ifndef CLI_JSON_H
#define CLI_JSON_H

#include "quell.h"

#include <cJSON.h>

/* Adds a number; infinities and NaN, which JSON lacks, become null. */
void cli_json_number(cJSON *object, const char *name, double value);

/* Each returns a new object, or NULL without memory. */
cJSON *cli_json_model(const quell_model_info *info);
cJSON *cli_json_layer(const quell_layer_info *layer);
cJSON *cli_json_report_layer(const quell_report_layer *layer);
cJSON *cli_json_summary(const quell_report_summary *summary);
cJSON *cli_json_stages(const quell_report_summary *summary); /* seconds of each; the caller knows of encode */
cJSON *cli_json_metrics(const quell_metrics *metrics);

const char *cli_action_name(int32_t action);
const char *cli_format_name(int32_t format);

/* Writes json to path, which appears whole or not at all; "-": standard output. Returns an exit code, after a message.
 * Frees json. */
int cli_json_write(cJSON *json, const char *path);

#endif
