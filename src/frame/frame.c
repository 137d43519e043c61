/* SPDX-License-Identifier: Apache-2.0 */
/* Frames: a list of named layers of one size, and the memory behind them. Knows neither files nor what is done to the
 * pixels. */
#include "frame/frame.h"

#include "frame/roles.h"

#include <stdlib.h>
#include <string.h>

quell_status ql_frame_create(uint32_t width, uint32_t height, ql_frame **out, ql_error *err)
{
    *out = NULL;
    if (width == 0 || height == 0) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "a frame of %u x %u pixels is empty", width, height);
    }
    ql_memory *memory = calloc(1, sizeof *memory); /* it counts itself least of all */
    if (!memory) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a frame");
    ql_memory_init(memory, 0);

    ql_frame *frame = ql_alloc_zero(memory, 1, sizeof *frame);
    if (!frame) {
        free(memory);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a frame");
    }
    frame->memory = memory;
    frame->width = width;
    frame->height = height;
    *out = frame;
    return QUELL_OK;
}

static void free_layer(ql_memory *memory, ql_layer *layer)
{
    ql_free(memory, layer->view_layer);
    ql_free(memory, layer->pass);
    ql_free(memory, layer->view);
    ql_free(memory, layer->full_name);
    ql_free(memory, layer->owned);
    ql_free(memory, layer->result);
}

void ql_frame_destroy(ql_frame *frame)
{
    if (!frame) return;
    if (frame->source && frame->source_destroy) frame->source_destroy(frame->source);
    ql_memory *memory = frame->memory;
    for (uint32_t i = 0; i < frame->num_layers; i++) free_layer(memory, &frame->layers[i]);
    ql_free(memory, frame->layers);
    ql_free(memory, frame);
    free(memory);
}

static quell_status grow(ql_frame *frame, ql_error *err)
{
    if (frame->num_layers < frame->capacity) return QUELL_OK;
    const uint32_t capacity = frame->capacity ? frame->capacity * 2 : 16;
    ql_layer *layers = ql_alloc_zero(frame->memory, capacity, sizeof *layers);
    if (!layers) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for %u layers", capacity);
    if (frame->num_layers) memcpy(layers, frame->layers, frame->num_layers * sizeof *layers);
    ql_free(frame->memory, frame->layers);
    frame->layers = layers;
    frame->capacity = capacity;
    return QUELL_OK;
}

quell_status ql_frame_append_layer(ql_frame *frame, const char *full_name, const char *const *multi_view,
                                   ql_layer **out, ql_error *err)
{
    *out = NULL;
    if (!full_name || !full_name[0]) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "a layer needs a name");
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        if (strcmp(frame->layers[i].full_name, full_name) == 0) {
            return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "the frame already has a layer '%s'", full_name);
        }
    }
    QL_TRY(grow(frame, err));

    ql_layer layer = {0};
    ql_memory *memory = frame->memory;
    const char *view_layer, *pass, *view;
    layer.full_name = ql_strdup(memory, full_name);
    char *buffer = ql_strdup(memory, full_name);
    if (!layer.full_name || !buffer) goto fail;
    ql_split_layer_name(full_name, multi_view, buffer, &view_layer, &pass, &view);
    layer.view_layer = ql_strdup(memory, view_layer);
    layer.pass = ql_strdup(memory, pass);
    layer.view = ql_strdup(memory, view);
    if (!layer.view_layer || !layer.pass || !layer.view) goto fail;
    ql_free(memory, buffer);

    layer.role = ql_role_from_pass(layer.pass);
    layer.compression = "";
    for (size_t c = 0; c < 4; c++) layer.channel_index[c] = -1;
    *out = &frame->layers[frame->num_layers];
    **out = layer;
    frame->num_layers++;
    return QUELL_OK;

fail:
    ql_free(memory, buffer);
    free_layer(memory, &layer);
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for the layer '%s'", full_name);
}

void ql_frame_remove_last_layer(ql_frame *frame)
{
    frame->num_layers--;
    free_layer(frame->memory, &frame->layers[frame->num_layers]);
}

quell_status ql_layer_alloc_pixels(ql_frame *frame, ql_layer *layer, ql_error *err)
{
    const size_t value_bytes = ql_format_bytes(layer->format);
    size_t values, total;
    if (ql_mul_size(frame->width, frame->height, &values) != 0 ||
        ql_mul_size(values, layer->num_channels, &total) != 0 || ql_mul_size(total, value_bytes, &total) != 0) {
        return ql_fail(err, QUELL_ERR_LIMIT, "layer '%s': %u x %u pixels are too many", layer->full_name, frame->width,
                       frame->height);
    }
    void *pixels = ql_alloc(frame->memory, total, 1);
    if (!pixels) {
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "layer '%s': no memory for %zu bytes of pixels", layer->full_name,
                       total);
    }
    ql_free(frame->memory, layer->owned);
    layer->owned = pixels;
    layer->pixels = (ql_view){
        .data = pixels,
        .format = layer->format,
        .num_channels = layer->num_channels,
        .channel_stride = (int64_t)(values * value_bytes),
        .pixel_stride = (int64_t)value_bytes,
        .row_stride = (int64_t)(frame->width * value_bytes),
    };
    return QUELL_OK;
}

int64_t ql_frame_find_layer(const ql_frame *frame, const char *name)
{
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        if (strcmp(frame->layers[i].full_name, name) == 0) return i;
    }
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        if (strcmp(frame->layers[i].pass, name) == 0) return i;
    }
    return -1;
}
