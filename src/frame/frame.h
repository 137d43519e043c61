/* SPDX-License-Identifier: Apache-2.0 */
/* Frames of named layers in memory: pixels as they came, results beside them. Knows no file format and no network. */
#ifndef QL_FRAME_FRAME_H
#define QL_FRAME_FRAME_H

#include "base/memory.h"
#include "base/status.h"

#include <stdint.h>

/* A strided image, in the frame's memory or the caller's. Channel c of (x, y) stands at
 * data + y * row_stride + x * pixel_stride + c * channel_stride (bytes). */
typedef struct ql_view {
    uint8_t *data;
    int32_t format; /* QUELL_FORMAT_* */
    uint32_t num_channels;
    int64_t channel_stride, pixel_stride, row_stride;
} ql_view;

typedef struct ql_layer {
    char *view_layer, *pass, *view, *full_name; /* owned; never NULL, "" where absent */
    char channels[8];                           /* letters in reading order, as in the file: "RGBA", "XYZ", "V" */
    int32_t role;                               /* QUELL_ROLE_* */
    uint32_t num_channels;
    int32_t format;
    uint32_t samples;
    const char *compression; /* static text */
    ql_view pixels;      /* what came in, in reading order of channels; data NULL: not decoded (roles that no denoise
                                reads), see ql_exr_load_layer */
    void *owned;         /* the memory behind pixels, NULL when borrowed */
    float *result;       /* [num_channels][height][width], NULL until denoised; owned */
    int32_t is_denoised; /* filtered by a denoise; a borrowed layer then has its result in the caller's pixels */
    uint32_t part;       /* of the file */
    int32_t channel_index[4]; /* index of each channel in its part's channel list */
} ql_layer;

struct ql_exr_source; /* src/exr: the open file behind a frame, NULL for frames from memory */

typedef struct ql_frame {
    ql_memory *memory; /* counts the frame's pixels, apart from a job's working memory; owned */
    uint32_t width, height;
    ql_layer *layers;
    uint32_t num_layers, capacity;
    struct ql_exr_source *source;
    void (*source_destroy)(struct ql_exr_source *source);
    double seconds_decode;   /* wall clock of reading it from its file; 0 for frames from memory */
    int32_t add_noisy_image; /* QUELL_DENOISE_KEEP_NOISY was asked: writers add 'Noisy Image' */
} ql_frame;

quell_status ql_frame_create(uint32_t width, uint32_t height, ql_frame **out, ql_error *err);
void ql_frame_destroy(ql_frame *frame);

/* Appends a layer named as Blender names it; splits full_name into view layer, pass and view and finds its role. The
 * layer has no pixels yet, no channels and no format. A name that is taken is QUELL_ERR_INVALID_ARGUMENT. multi_view: the view names that may stand before the channel letter, NULL-terminated, or
 * NULL. *out is lent until the next append. */
quell_status ql_frame_append_layer(ql_frame *frame, const char *full_name, const char *const *multi_view,
                                   ql_layer **out, ql_error *err);

/* Takes the last layer off again, for callers whose next step failed. */
void ql_frame_remove_last_layer(ql_frame *frame);

/* Gives the layer packed planes of its own ([num_channels][height][width] in its format), whose content is undefined.
 * num_channels and format must be set. Pixels that it owned before are freed. */
quell_status ql_layer_alloc_pixels(ql_frame *frame, ql_layer *layer, ql_error *err);

/* Index of the layer of that full name, else of the first with that pass name; -1: none. */
int64_t ql_frame_find_layer(const ql_frame *frame, const char *name);

size_t ql_format_bytes(int32_t format); /* of one value: 2 or 4 */

/* One row of one channel of a view, as floats. */
void ql_view_read_row(const ql_view *view, uint32_t width, uint32_t channel, uint32_t y, float *out);

/* One row of one channel as floats, from pixels (not result). */
void ql_layer_read_row(const ql_layer *layer, uint32_t width, uint32_t channel, uint32_t y, float *out);

/* One row of one channel: the result where there is one, else pixels. */
void ql_layer_read_current_row(const ql_layer *layer, uint32_t width, uint32_t height, uint32_t channel, uint32_t y,
                               float *out);

/* Writes one row of one channel into a view, converting to its format (half: clamped to +-65504; uint: rounded and
 * clamped, NaN is 0). */
void ql_view_write_row(const ql_view *view, uint32_t width, uint32_t channel, uint32_t y, const float *in);

#endif
