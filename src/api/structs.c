/* SPDX-License-Identifier: Apache-2.0 */
/* The rules of struct_size; see structs.h. Every sized struct begins with a uint32_t struct_size. */
#include "api/structs.h"

#include <string.h>

#define IMAGE_V1 QL_STRUCT_V1(quell_image, row_stride_bytes)

static uint32_t size_of_given(const void *given)
{
    uint32_t bytes;
    memcpy(&bytes, given, sizeof bytes);
    return bytes;
}

quell_status ql_struct_check_out(const void *given, size_t v1_bytes, const char *name, ql_error *err)
{
    if (!given) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: the pointer is NULL", name);
    const uint32_t bytes = size_of_given(given);
    if (bytes < v1_bytes) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: struct_size is %u; set it to sizeof(%s), at least %zu",
                       name, bytes, name, v1_bytes);
    }
    return QUELL_OK;
}

quell_status ql_struct_read(void *full, size_t full_bytes, size_t v1_bytes, const void *given, const char *name,
                            ql_error *err)
{
    memset(full, 0, full_bytes);
    const uint32_t full_size = (uint32_t)full_bytes;
    if (given) {
        QL_TRY(ql_struct_check_out(given, v1_bytes, name, err));
        const size_t bytes = size_of_given(given);
        for (size_t i = full_bytes; i < bytes; i++) {
            if (((const unsigned char *)given)[i] == 0) continue;
            return ql_fail(err, QUELL_ERR_UNSUPPORTED, "%s: byte %zu is set, which this version (%s) does not know",
                           name, i, quell_version_string());
        }
        memcpy(full, given, bytes < full_bytes ? bytes : full_bytes);
    }
    memcpy(full, &full_size, sizeof full_size);
    return QUELL_OK;
}

void ql_struct_write(void *given, const void *full, size_t full_bytes)
{
    const uint32_t bytes = size_of_given(given);
    memcpy(given, full, bytes < full_bytes ? bytes : full_bytes);
    if (bytes > full_bytes) memset((unsigned char *)given + full_bytes, 0, bytes - full_bytes);
    memcpy(given, &bytes, sizeof bytes);
}

quell_status ql_image_read(const quell_image *image, const char *what, ql_view *view, uint32_t *width, uint32_t *height,
                           ql_error *err)
{
    quell_image full;
    if (!image) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: the pointer is NULL", what);
    QL_TRY(ql_struct_read(&full, sizeof full, IMAGE_V1, image, "quell_image", err));
    if (full.format != QUELL_FORMAT_FLOAT && full.format != QUELL_FORMAT_HALF) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: format %d is neither float nor half", what, full.format);
    }
    if (full.num_channels < 1 || full.num_channels > 4) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: %u channels; 1 to 4 are allowed", what, full.num_channels);
    }
    if (full.width < 1 || full.height < 1) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: %u x %u pixels; both sides must be at least 1", what,
                       full.width, full.height);
    }
    if (full.reserved0 != 0) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: quell_image.reserved0 must be 0", what);
    }
    if (!full.data) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: data is NULL", what);

    const int64_t value = (int64_t)ql_format_bytes(full.format);
    view->data = full.data;
    view->format = full.format;
    view->num_channels = full.num_channels;
    view->channel_stride = full.channel_stride_bytes ? full.channel_stride_bytes : value;
    view->pixel_stride = full.pixel_stride_bytes ? full.pixel_stride_bytes : value * (int64_t)full.num_channels;
    view->row_stride = full.row_stride_bytes ? full.row_stride_bytes : view->pixel_stride * (int64_t)full.width;
    *width = full.width;
    *height = full.height;
    return QUELL_OK;
}
