/* SPDX-License-Identifier: Apache-2.0 */
#include "cli/layers.h"

#include "cli/cli.h"

#include <stdlib.h>
#include <string.h>

int cli_layer_pixels(quell_context *ctx, const char *path, const quell_frame *frame, uint32_t index,
                     uint32_t num_channels, quell_image *image)
{
    quell_layer_info info = {.struct_size = sizeof info};
    quell_status status = quell_frame_get_layer(frame, index, &info);
    if (status != QUELL_OK) return cli_error_status(path, ctx, status);
    if (num_channels == 0 || num_channels > info.num_channels) num_channels = info.num_channels;

    *image = (quell_image){
        .struct_size = sizeof *image,
        .format = QUELL_FORMAT_FLOAT,
        .width = info.width,
        .height = info.height,
        .num_channels = num_channels,
        /* The library has the layer in memory already, so this product is that of a size that exists. */
        .data = malloc((size_t)info.width * info.height * num_channels * sizeof(float)),
    };
    if (!image->data) {
        cli_error(path, "no memory for the layer '%s'", info.full_name);
        return CLI_EXIT_MEMORY;
    }
    status = quell_frame_copy_layer(ctx, frame, index, image);
    if (status == QUELL_OK) return CLI_EXIT_OK;
    free(image->data);
    image->data = NULL;
    return cli_error_status(path, ctx, status);
}

static int64_t match_by_pass(const quell_frame *other, const quell_layer_info *info)
{
    quell_layer_info candidate = {.struct_size = sizeof candidate};
    for (uint32_t i = 0; quell_frame_get_layer(other, i, &candidate) == QUELL_OK; i++) {
        if (strcmp(candidate.pass, info->pass) == 0 && strcmp(candidate.view, info->view) == 0) return i;
    }
    return -1;
}

static int64_t match_by_role(const quell_frame *other, const quell_layer_info *info)
{
    /* Light groups of one file share a role, so only their names tell them apart. */
    if (info->role == QUELL_ROLE_OTHER || info->role == QUELL_ROLE_LIGHT_GROUP) return -1;
    quell_layer_info candidate = {.struct_size = sizeof candidate};
    for (uint32_t i = 0; quell_frame_get_layer(other, i, &candidate) == QUELL_OK; i++) {
        if (candidate.role == info->role && strcmp(candidate.view, info->view) == 0) return i;
    }
    return -1;
}

int64_t cli_layer_match(const quell_frame *other, const quell_layer_info *info)
{
    quell_layer_info candidate = {.struct_size = sizeof candidate};
    for (uint32_t i = 0; quell_frame_get_layer(other, i, &candidate) == QUELL_OK; i++) {
        if (strcmp(candidate.full_name, info->full_name) == 0) return i;
    }
    const int64_t by_pass = match_by_pass(other, info);
    return by_pass >= 0 ? by_pass : match_by_role(other, info);
}

int cli_layer_listed(const char *list, const quell_layer_info *info)
{
    for (const char *item = list; item;) {
        const char *comma = strchr(item, ',');
        const size_t length = comma ? (size_t)(comma - item) : strlen(item);
        if ((strlen(info->full_name) == length && strncmp(item, info->full_name, length) == 0) ||
            (strlen(info->pass) == length && strncmp(item, info->pass, length) == 0)) {
            return 1;
        }
        item = comma ? comma + 1 : NULL;
    }
    return 0;
}
