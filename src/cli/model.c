/* SPDX-License-Identifier: Apache-2.0 */
#include "cli/model.h"

#include <stdio.h>
#include <string.h>

int cli_quality_option(cli_common *common, const char *command, const char *argument)
{
    char known[64] = "";
    for (int32_t quality = QUELL_QUALITY_FAST; quell_quality_name(quality); quality++) {
        const char *const name = quell_quality_name(quality);
        if (strcmp(argument, name) == 0) {
            common->quality = quality;
            return 0;
        }
        const size_t length = strlen(known);
        snprintf(known + length, sizeof known - length, "%s%s", length ? ", " : "", name);
    }
    return cli_usage_error(command, "--quality: '%s' is none of %s", argument, known);
}

int cli_model_open(const cli_common *common, const char *command, quell_context *ctx, quell_model **out)
{
    const char *const model = common->model;
    const int32_t quality = common->quality;
    *out = NULL;
    if (model && quality) {
        return cli_usage_error(command,
                               "--model %s --quality %s: each level is a network of its own, and so is the model: "
                               "give one of the two",
                               model, quell_quality_name(quality));
    }
    const quell_status status = model ? quell_model_open(ctx, model, out) : quell_model_open_quality(ctx, quality, out);
    if (status == QUELL_OK) return CLI_EXIT_OK;
    const int code = cli_error_status(model, ctx, status);
    /* Not a missing input: the weight file. */
    return status == QUELL_ERR_FILE_NOT_FOUND || status == QUELL_ERR_FILE_READ ? CLI_EXIT_MODEL : code;
}

void cli_model_describe(const quell_model_info *info, char *text, size_t size_bytes)
{
    const char *const level = quell_quality_name(info->quality);
    snprintf(text, size_bytes, "%s%s%s%s", level ? "quality " : "", level ? level : "", level ? ", " : "",
             info->weight_file);
}
