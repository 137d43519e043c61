/* SPDX-License-Identifier: Apache-2.0 */
/* Feature planes: tone-mapped light, squashed colours, guides. Order as in training/features.py: make_features. */
#include "models/features.h"

#include "base/log2.h"
#include "frame/roles.h"

#include <math.h>

int32_t ql_log_exponent(const float *bins, size_t num)
{
    /* Mantissas and exponents are summed apart: a power of two shifts the integer sum alone, so rounding cannot tip. */
    double mantissas = 0.0;
    int64_t exponents = 0, count = 0;
    for (size_t i = 0; i < num; ++i) {
        if (!(bins[i] > 0.0f) || !isfinite(bins[i])) continue;
        int exponent;
        mantissas += log2(frexp((double)bins[i], &exponent));
        exponents += exponent;
        ++count;
    }
    if (count == 0) return 0;
    int64_t whole = exponents / count, rest = exponents % count;
    if (rest < 0) {
        rest += count;
        --whole;
    }
    return (int32_t)(whole + (int64_t)floor((mantissas + (double)rest) / (double)count + 0.5));
}

void ql_make_flags(const ql_feature_setup *setup, float flags[QL_NUM_FLAGS])
{
    flags[0] = (float)setup->has_light;
    flags[1] = (float)setup->has_albedo;
    flags[2] = (float)setup->has_normal;
    flags[3] = (float)setup->has_depth;
    flags[4] = setup->samples ? ql_log2f((float)setup->samples) / 8.0f : 0.0f;
    flags[5] = setup->samples ? 1.0f : 0.0f;
}

static void put(const float *plane, uint32_t num_pixels, uint32_t feature, float *out)
{
    for (size_t x = 0; x < num_pixels; ++x) out[x * QL_NUM_FEATURES + feature] = plane[x];
}

static void put_value(float value, uint32_t num_pixels, uint32_t feature, float *out)
{
    for (size_t x = 0; x < num_pixels; ++x) out[x * QL_NUM_FEATURES + feature] = value;
}

static float squash(float color)
{
    const float c = color > 0.0f ? color : 0.0f;
    return c > 1e30f ? 2.0f : 2.0f * c / (1.0f + c);
}

static float clamp(float value, float low, float high)
{
    return value < low ? low : value > high ? high : value;
}

void ql_make_feature_row(const ql_kernels *kernels, const ql_feature_setup *setup, const ql_feature_rows *rows,
                         uint32_t num_pixels, float *scratch, float *out)
{
    const float scale = ldexpf(1.0f, -setup->exposure_exponent - QL_KEY_EXPONENT);
    const float depth_scale = ldexpf(1.0f, -setup->depth_exponent);
    uint32_t feature = 0;
    for (uint32_t c = 0; c < 3; ++c) {
        kernels->tone_row(rows->beauty[c], scale, scratch, num_pixels);
        put(scratch, num_pixels, feature++, out);
    }
    for (uint32_t i = 0; i < 12; ++i, ++feature) {
        const float *const light = setup->has_light ? rows->light[i / 3][i % 3] : NULL;
        if (light) {
            kernels->tone_row(light, scale, scratch, num_pixels);
            put(scratch, num_pixels, feature, out);
        } else {
            put_value(0.0f, num_pixels, feature, out);
        }
    }
    for (uint32_t c = 0; c < 3; ++c, ++feature)
        for (size_t x = 0; x < num_pixels; ++x)
            out[x * QL_NUM_FEATURES + feature] = setup->has_albedo ? squash(rows->albedo[c][x]) : 0.0f;
    for (uint32_t c = 0; c < 3; ++c, ++feature)
        for (size_t x = 0; x < num_pixels; ++x)
            out[x * QL_NUM_FEATURES + feature] = setup->has_normal ? clamp(rows->normal[c][x], -1.0f, 1.0f) : 0.0f;
    for (size_t x = 0; x < num_pixels; ++x) {
        const float depth = setup->has_depth ? rows->depth[x] : 0.0f;
        const int valid = depth > 0.0f && depth < QL_BACKGROUND_DEPTH;
        out[x * QL_NUM_FEATURES + feature] = valid ? 1.0f / (1.0f + depth * depth_scale) : 0.0f;
    }
    ++feature;
    for (size_t x = 0; x < num_pixels; ++x)
        out[x * QL_NUM_FEATURES + feature] = rows->alpha ? clamp(rows->alpha[x], 0.0f, 1.0f) : 1.0f;
    ++feature;
    for (size_t x = 0; x < num_pixels; ++x) {
        float *const to = out + x * QL_NUM_FEATURES + feature;
        for (uint32_t c = 0; c < 3; ++c) to[c] = setup->has_light ? squash(rows->color[0][c][x]) : 0.0f;
        for (uint32_t i = 1; i < 3; ++i) {
            const float *const *const color = rows->color[i];
            to[2 + i] = setup->has_light ? squash((color[0][x] + color[1][x] + color[2][x]) / 3.0f) : 0.0f;
        }
    }
    feature += 5;
    for (uint32_t i = 0; i < 4; ++i, ++feature) {
        const float *const *const light = i < 3 ? rows->direct[i] : rows->emission;
        if (setup->has_light) {
            for (size_t x = 0; x < num_pixels; ++x) scratch[x] = (light[0][x] + light[1][x] + light[2][x]) / 3.0f;
            kernels->tone_row(scratch, scale, scratch, num_pixels);
            put(scratch, num_pixels, feature, out);
        } else {
            put_value(0.0f, num_pixels, feature, out);
        }
    }
}
