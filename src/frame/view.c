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

#define HALF_BLOCK 32 /* values per step of the converters: enough for any vector */

/* The common case of ql_half_from_float, without a branch: zero and what rounds to it, and normal halves. Everything
 * else (subnormal, clamped, infinite, NaN) makes *is_special non-zero. */
static inline uint16_t common_half(uint32_t bits, uint32_t *is_special)
{
    const uint32_t sign = (bits >> 16) & 0x8000u;
    const uint32_t magnitude = bits & 0x7fffffffu;
    const uint32_t is_zero = magnitude < 0x33000000u ? 1u : 0u;
    const uint32_t is_normal = magnitude - 0x38800000u < 0x477ff000u - 0x38800000u ? 1u : 0u;
    const uint32_t rounded = (magnitude - (112u << 23) + 0xfffu + ((magnitude >> 13) & 1u)) >> 13;
    *is_special |= (is_zero | is_normal) ^ 1u;
    return (uint16_t)(sign | (is_zero ? 0u : rounded));
}

static void write_halves(uint8_t *out, const float *in, uint32_t count)
{
    while (count > 0) {
        const uint32_t block = count < HALF_BLOCK ? count : HALF_BLOCK;
        uint16_t halves[HALF_BLOCK];
        uint32_t is_special = 0;
        if (block == HALF_BLOCK) {
            uint32_t bits[HALF_BLOCK];
            memcpy(bits, in, sizeof bits);
            for (uint32_t i = 0; i < HALF_BLOCK; i++) halves[i] = common_half(bits[i], &is_special);
        }
        if (block < HALF_BLOCK || is_special) {
            for (uint32_t i = 0; i < block; i++) halves[i] = ql_half_from_float(in[i]);
        }
        memcpy(out, halves, block * sizeof *halves);
        in += block;
        out += block * sizeof *halves;
        count -= block;
    }
}

/* The same bits as ql_half_to_float, in loops that compilers make vectors of. No arithmetic on subnormal floats, which
 * the host program may have flushed to zero. */
static void widen_block(const uint16_t *halves, float *out)
{
    const uint32_t magic_bits = 113u << 23; /* 2^-14 */
    uint32_t bits[HALF_BLOCK], subnormal[HALF_BLOCK];
    float offset[HALF_BLOCK], magic;
    memcpy(&magic, &magic_bits, sizeof magic);
    for (uint32_t i = 0; i < HALF_BLOCK; i++) subnormal[i] = (((uint32_t)halves[i] & 0x3ffu) << 13) + magic_bits;
    memcpy(offset, subnormal, sizeof offset);
    for (uint32_t i = 0; i < HALF_BLOCK; i++) offset[i] -= magic; /* 2^-14 (1 + m) - 2^-14: exact */
    memcpy(subnormal, offset, sizeof offset);
    for (uint32_t i = 0; i < HALF_BLOCK; i++) {
        const uint32_t magnitude = ((uint32_t)halves[i] & 0x7fffu) << 13;
        const uint32_t sign = ((uint32_t)halves[i] & 0x8000u) << 16;
        const uint32_t rebias = magnitude >= 0x0f800000u ? 224u << 23 : 112u << 23; /* infinite, NaN: to 255 */
        const uint32_t quiet = magnitude > 0x0f800000u ? 0x00400000u : 0u;
        const uint32_t normal = (magnitude + rebias) | quiet;
        bits[i] = sign | (magnitude < 0x00800000u ? subnormal[i] : normal);
    }
    memcpy(out, bits, sizeof bits);
}

static void read_halves(const uint8_t *in, float *out, uint32_t count)
{
    for (; count >= HALF_BLOCK; count -= HALF_BLOCK) {
        uint16_t halves[HALF_BLOCK];
        memcpy(halves, in, sizeof halves);
        widen_block(halves, out);
        in += sizeof halves;
        out += HALF_BLOCK;
    }
    for (; count > 0; count--) {
        uint16_t half;
        memcpy(&half, in, sizeof half);
        *out++ = ql_half_to_float(half);
        in += sizeof half;
    }
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
            read_halves(in, out, width);
            return;
        }
        for (uint32_t x = 0; x < width; x++, in += stride) {
            uint16_t half;
            memcpy(&half, in, sizeof half);
            out[x] = ql_half_to_float(half);
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
        if (stride == 2) {
            write_halves(out, in, width);
            return;
        }
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
