/* SPDX-License-Identifier: Apache-2.0 */
/* Which network: the options --model and --quality, and how the tool names a network. */
#ifndef CLI_MODEL_H
#define CLI_MODEL_H

#include "cli/cli.h"

/* Takes the argument of --quality. 0: taken; else CLI_EXIT_USAGE, after a message. */
int cli_quality_option(cli_common *common, const char *command, const char *argument);

/* Opens what --model or --quality ask for, or the default. Returns an exit code, after a message. */
int cli_model_open(const cli_common *common, const char *command, quell_context *ctx, quell_model **out);

/* The level and the weight file: "quality high, quell-high.qwt"; the file alone where there is no level. */
void cli_model_describe(const quell_model_info *info, char *text, size_t size_bytes);

#endif
