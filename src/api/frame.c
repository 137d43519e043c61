/* SPDX-License-Identifier: Apache-2.0 */
/* Frames and their layers. A quell_frame is a ql_frame under its public name. */
#include "frame/frame.h"

#include "api/context.h"
#include "api/structs.h"
#include "exr/exr.h"
#include "frame/roles.h"

#include <string.h>

#define LAYER_INFO_V1 QL_STRUCT_V1(quell_layer_info, is_denoised)
#define WRITE_OPTIONS_V1 QL_STRUCT_V1(quell_write_options, codec)

static ql_frame *inner(quell_frame *frame)
{
    return (ql_frame *)frame;
}

static const ql_frame *inner_const(const quell_frame *frame)
{
    return (const ql_frame *)frame;
}

/* ---- Making and reading ------------------------------------------------------------------------------------------ */

static quell_status create_frame(const ql_call *call, uint32_t width, uint32_t height, quell_frame **out)
{
    if (!out) return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "out is NULL");
    if (width == 0 || height == 0) {
        return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "a frame of %u x %u pixels; both must be at least 1",
                       width, height);
    }
    if ((uint64_t)width * height > call->ctx->max_image_pixels || width > INT32_MAX || height > INT32_MAX) {
        return ql_fail(call->err, QUELL_ERR_LIMIT, "a frame of %u x %u pixels is over the limit of %llu", width, height,
                       (unsigned long long)call->ctx->max_image_pixels);
    }
    ql_frame *frame = NULL;
    QL_TRY(ql_frame_create(width, height, &frame, call->err));
    *out = (quell_frame *)frame;
    return QUELL_OK;
}

quell_status quell_frame_create(quell_context *ctx, uint32_t width, uint32_t height, quell_frame **out)
{
    ql_call call;
    if (out) *out = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    return ql_call_end(&call, create_frame(&call, width, height, out));
}

quell_status quell_frame_read_exr(quell_context *ctx, const char *path_utf8, quell_frame **out)
{
    ql_call call;
    if (out) *out = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    if (!path_utf8 || !out) {
        return ql_call_end(&call, ql_fail(call.err, QUELL_ERR_INVALID_ARGUMENT, "path_utf8 or out is NULL"));
    }
    ql_frame *frame = NULL;
    const quell_status status = ql_exr_read(&call.env, path_utf8, ctx->max_image_pixels, &frame, call.err);
    if (status == QUELL_OK) *out = (quell_frame *)frame;
    return ql_call_end(&call, status);
}

void quell_frame_destroy(quell_frame *frame)
{
    ql_frame_destroy(inner(frame));
}

/* ---- Layers from the caller's memory ----------------------------------------------------------------------------- */

/* Bits as they are: a copy must not change a NaN. */
static void copy_view(const ql_view *from, const ql_view *to, uint32_t width, uint32_t height)
{
    const size_t bytes = ql_format_bytes(from->format);
    for (uint32_t c = 0; c < from->num_channels; c++) {
        for (uint32_t y = 0; y < height; y++) {
            const uint8_t *in = from->data + (int64_t)c * from->channel_stride + (int64_t)y * from->row_stride;
            uint8_t *out = to->data + (int64_t)c * to->channel_stride + (int64_t)y * to->row_stride;
            for (uint32_t x = 0; x < width; x++) {
                memcpy(out, in, bytes);
                in += from->pixel_stride;
                out += to->pixel_stride;
            }
        }
    }
}

static quell_status add_layer(const ql_call *call, ql_frame *frame, const char *name, const quell_image *image,
                              int32_t ownership, uint32_t *out_index)
{
    ql_error *err = call->err;
    ql_view view;
    uint32_t width, height;
    if (!frame || !name) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "frame or name is NULL");
    if (frame->source) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "layer '%s': a frame read from a file takes no further layers",
                       name);
    }
    if (ownership != QUELL_LAYER_COPY && ownership != QUELL_LAYER_BORROW) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "layer '%s': no such ownership (%d)", name, ownership);
    }
    QL_TRY(ql_image_read(image, name, &view, &width, &height, err));
    if (width != frame->width || height != frame->height) {
        return ql_fail(err, QUELL_ERR_SIZE_MISMATCH, "layer '%s' has %u x %u pixels, its frame %u x %u", name, width,
                       height, frame->width, frame->height);
    }

    ql_layer *layer;
    QL_TRY(ql_frame_append_layer(frame, name, NULL, &layer, err));
    layer->num_channels = view.num_channels;
    layer->format = view.format;
    const char *letters = ql_role_channels(layer->role, view.num_channels);
    memcpy(layer->channels, letters, strlen(letters) + 1);
    if (!ql_role_fits_channels(layer->role, layer->channels)) {
        const char *role = ql_role_name(layer->role);
        ql_frame_remove_last_layer(frame);
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "layer '%s': %u channels do not fit its role '%s'", name,
                       view.num_channels, role);
    }
    if (ownership == QUELL_LAYER_BORROW) {
        layer->pixels = view;
    } else {
        const quell_status status = ql_layer_alloc_pixels(frame, layer, err);
        if (status != QUELL_OK) {
            ql_frame_remove_last_layer(frame);
            return status;
        }
        copy_view(&view, &layer->pixels, width, height);
    }
    if (out_index) *out_index = frame->num_layers - 1;
    return QUELL_OK;
}

quell_status quell_frame_add_layer(quell_context *ctx, quell_frame *frame, const char *name, const quell_image *image,
                                   int32_t ownership, uint32_t *out_index)
{
    ql_call call;
    QL_TRY(ql_call_begin(ctx, &call));
    return ql_call_end(&call, add_layer(&call, inner(frame), name, image, ownership, out_index));
}

quell_status quell_frame_set_samples(quell_frame *frame, uint32_t samples)
{
    if (!frame) return QUELL_ERR_INVALID_ARGUMENT;
    ql_frame *f = inner(frame);
    for (uint32_t i = 0; i < f->num_layers; i++) f->layers[i].samples = samples;
    return QUELL_OK;
}

/* ---- Looking ----------------------------------------------------------------------------------------------------- */

uint32_t quell_frame_num_layers(const quell_frame *frame)
{
    return frame ? inner_const(frame)->num_layers : 0;
}

quell_status quell_frame_get_layer(const quell_frame *frame, uint32_t index, quell_layer_info *info)
{
    if (!frame || index >= inner_const(frame)->num_layers) return QUELL_ERR_INVALID_ARGUMENT;
    QL_TRY(ql_struct_check_out(info, LAYER_INFO_V1, "quell_layer_info", NULL));
    const ql_frame *f = inner_const(frame);
    const ql_layer *layer = &f->layers[index];
    const quell_layer_info full = {
        .struct_size = sizeof full,
        .role = layer->role,
        .view_layer = layer->view_layer,
        .pass = layer->pass,
        .view = layer->view,
        .full_name = layer->full_name,
        .channels = layer->channels,
        .compression = layer->compression,
        .format = layer->format,
        .num_channels = layer->num_channels,
        .width = f->width,
        .height = f->height,
        .samples = layer->samples,
        .is_denoised = layer->is_denoised,
    };
    ql_struct_write(info, &full, sizeof full);
    return QUELL_OK;
}

int64_t quell_frame_find_layer(const quell_frame *frame, const char *name)
{
    return frame && name ? ql_frame_find_layer(inner_const(frame), name) : -1;
}

static quell_status copy_layer(ql_call *call, ql_frame *frame, uint32_t index, const quell_image *image)
{
    ql_view view;
    uint32_t width, height;
    if (!frame || index >= frame->num_layers) {
        return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "the frame has no layer of index %u", index);
    }
    const ql_layer *layer = &frame->layers[index];
    QL_TRY(ql_image_read(image, layer->full_name, &view, &width, &height, call->err));
    if (width != frame->width || height != frame->height || view.num_channels > layer->num_channels) {
        return ql_fail(call->err, QUELL_ERR_SIZE_MISMATCH,
                       "layer '%s' has %u x %u pixels of %u channels, the image %u x %u of %u", layer->full_name,
                       frame->width, frame->height, layer->num_channels, width, height, view.num_channels);
    }
    if (!layer->pixels.data) QL_TRY(ql_exr_load_layer(&call->env, frame, index, call->err));

    float *row = ql_alloc(call->env.memory, width, sizeof *row);
    if (!row) return ql_fail(call->err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a row of %u pixels", width);
    for (uint32_t c = 0; c < view.num_channels; c++) {
        for (uint32_t y = 0; y < height; y++) {
            ql_layer_read_current_row(layer, width, height, c, y, row);
            ql_view_write_row(&view, width, c, y, row);
        }
    }
    ql_free(call->env.memory, row);
    return QUELL_OK;
}

quell_status quell_frame_copy_layer(quell_context *ctx, const quell_frame *frame, uint32_t index,
                                    const quell_image *image)
{
    ql_call call;
    QL_TRY(ql_call_begin(ctx, &call));
    /* Decoding a layer at last does not change what the caller sees of the frame. */
    return ql_call_end(&call, copy_layer(&call, (ql_frame *)frame, index, image));
}

/* ---- Writing ----------------------------------------------------------------------------------------------------- */

static quell_status write_frame(ql_call *call, ql_frame *frame, const char *path, const quell_write_options *given)
{
    quell_write_options options;
    if (!frame || !path) return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "frame or path_utf8 is NULL");
    QL_TRY(ql_struct_read(&options, sizeof options, WRITE_OPTIONS_V1, given, "quell_write_options", call->err));
    if (options.codec < QUELL_CODEC_KEEP || options.codec > QUELL_CODEC_HTJ2K) {
        return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "quell_write_options.codec: no such codec (%d)",
                       options.codec);
    }
    return ql_exr_write(&call->env, frame, path, options.codec, call->err);
}

quell_status quell_frame_write_exr(quell_context *ctx, quell_frame *frame, const char *path_utf8,
                                   const quell_write_options *options)
{
    ql_call call;
    QL_TRY(ql_call_begin(ctx, &call));
    return ql_call_end(&call, write_frame(&call, inner(frame), path_utf8, options));
}
