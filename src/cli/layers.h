/* SPDX-License-Identifier: Apache-2.0 */
/* A layer's pixels as packed floats, and which layer of another file is the same. */
#ifndef CLI_LAYERS_H
#define CLI_LAYERS_H

#include "quell.h"

/* Fills *image with `num_channels` (at most the layer's; 0: all) of a layer; image->data is to be freed. Returns an
 * exit code, after a message. */
int cli_layer_pixels(quell_context *ctx, const char *path, const quell_frame *frame, uint32_t index,
                     uint32_t num_channels, quell_image *image);

/* Index in `other` of the layer that `info` describes: by full name, else by pass and view, else by role; -1: none. */
int64_t cli_layer_match(const quell_frame *other, const quell_layer_info *info);

/* Whether a comma-separated list has the layer, by its full name or its pass. */
int cli_layer_listed(const char *list, const quell_layer_info *info);

#endif
