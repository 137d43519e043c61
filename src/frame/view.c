/* SPDX-License-Identifier: Apache-2.0 */
/* Rows of strided images to floats and back. The only place that looks at a view's format and strides; knows neither
 * names nor files. */
#include "base/half.h"
#include "frame/frame.h"

#include <string.h>

static uint8_t *row_of(const ql_view *view, uint32_t channel, uint32_t y)
{
    return view->data + (int64_t)channel * view->channel_stride + (int64_t)y * view->row_stride;
}

size_t ql_format_bytes(int32_t format)
{
    return format == QUELL_FORMAT_HALF ? 2 : 4;
}

/* The same bits as ql_half_to_float, without a branch, so that compilers make vectors of it. No arithmetic on
 * denormal floats: the host program may have them flushed to zero. */
static inline float half_to_float(uint16_t half)
{
    const uint32_t magic_bits = 113u << 23;
    const uint32_t shifted = ((uint32_t)half & 0x7fffu) << 13;
    const uint32_t exponent = shifted & 0x0f800000u;
    const uint32_t special = exponent == 0x0f800000u ? (128u - 16u) << 23 : 0u;
    const uint32_t quiet = shifted > 0x0f800000u ? 0x00400000u : 0u;
    const uint32_t normal = (shifted + ((127u - 15u) << 23) + special) | quiet;
    const uint32_t offset = shifted + magic_bits; /* 2^-14 * (1 + mantissa) for denormals */
    float magic, value;
    memcpy(&magic, &magic_bits, sizeof magic);
    memcpy(&value, &offset, sizeof value);
    value -= magic;
    uint32_t denormal, bits;
    memcpy(&denormal, &value, sizeof denormal);
    bits = (exponent == 0 ? denormal : normal) | (((uint32_t)half & 0x8000u) << 16);
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint32_t uint_from_float(float value)
{
    if (!(value > 0.0f)) return 0; /* NaN too */
    if (value >= 4294967296.0f) return UINT32_MAX;
    return (uint32_t)(value + 0.5f < 4294967296.0f ? value + 0.5f : value);
}

void ql_view_read_row(const ql_view *view, uint32_t width, uint32_t channel, uint32_t y, float *out)
{
    const uint8_t *in = row_of(view, channel, y);
    const int64_t stride = view->pixel_stride;
    const int is_packed = stride == (int64_t)ql_format_bytes(view->format);

    if (view->format == QUELL_FORMAT_HALF) {
        if (is_packed) {
            for (uint32_t x = 0; x < width; x++) {
                uint16_t half;
                memcpy(&half, in + 2 * (size_t)x, sizeof half);
                out[x] = half_to_float(half);
            }
            return;
        }
        for (uint32_t x = 0; x < width; x++, in += stride) {
            uint16_t half;
            memcpy(&half, in, sizeof half);
            out[x] = half_to_float(half);
        }
    } else if (view->format == QUELL_FORMAT_FLOAT) {
        if (is_packed) {
            memcpy(out, in, (size_t)width * sizeof *out);
            return;
        }
        for (uint32_t x = 0; x < width; x++, in += stride) memcpy(&out[x], in, sizeof out[x]);
    } else {
        for (uint32_t x = 0; x < width; x++, in += stride) {
            uint32_t value;
            memcpy(&value, in, sizeof value);
            out[x] = (float)value;
        }
    }
}

void ql_view_write_row(const ql_view *view, uint32_t width, uint32_t channel, uint32_t y, const float *in)
{
    uint8_t *out = row_of(view, channel, y);
    const int64_t stride = view->pixel_stride;

    if (view->format == QUELL_FORMAT_HALF) {
        for (uint32_t x = 0; x < width; x++, out += stride) {
            const uint16_t half = ql_half_from_float(in[x]);
            memcpy(out, &half, sizeof half);
        }
    } else if (view->format == QUELL_FORMAT_FLOAT) {
        if (stride == (int64_t)sizeof *in) {
            memcpy(out, in, (size_t)width * sizeof *in);
            return;
        }
        for (uint32_t x = 0; x < width; x++, out += stride) memcpy(out, &in[x], sizeof in[x]);
    } else {
        for (uint32_t x = 0; x < width; x++, out += stride) {
            const uint32_t value = uint_from_float(in[x]);
            memcpy(out, &value, sizeof value);
        }
    }
}

void ql_layer_read_row(const ql_layer *layer, uint32_t width, uint32_t channel, uint32_t y, float *out)
{
    ql_view_read_row(&layer->pixels, width, channel, y, out);
}

void ql_layer_read_current_row(const ql_layer *layer, uint32_t width, uint32_t height, uint32_t channel, uint32_t y,
                               float *out)
{
    if (layer->result) {
        const size_t row = (size_t)channel * height + y;
        memcpy(out, layer->result + row * width, (size_t)width * sizeof *out);
        return;
    }
    ql_view_read_row(&layer->pixels, width, channel, y, out);
}
