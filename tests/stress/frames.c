/* SPDX-License-Identifier: Apache-2.0 */
#include "frames.h"

#include "base/half.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ABSURD 1e30f /* larger values count as bad: docs/NUMERICS.md */

static const struct {
    const char *name;
    uint32_t channels;
    int is_radiance;
} facts[NUM_LAYERS] = {
    {"ViewLayer.Combined", 4, 1},
    {"ViewLayer.Denoising Albedo", 3, 0},
    {"ViewLayer.Denoising Normal", 3, 0},
    {"ViewLayer.Denoising Depth", 1, 0},
    {"ViewLayer.DiffDir", 3, 1},
    {"ViewLayer.DiffInd", 3, 1},
    {"ViewLayer.DiffCol", 3, 0},
    {"ViewLayer.GlossDir", 3, 1},
    {"ViewLayer.GlossInd", 3, 1},
    {"ViewLayer.GlossCol", 3, 0},
    {"ViewLayer.TransDir", 3, 1},
    {"ViewLayer.TransInd", 3, 1},
    {"ViewLayer.TransCol", 3, 0},
    {"ViewLayer.VolumeDir", 3, 1},
    {"ViewLayer.VolumeInd", 3, 1},
    {"ViewLayer.Emit", 3, 1},
    {"ViewLayer.Env", 3, 1},
};

const char *layer_name(uint32_t layer)
{
    return facts[layer].name;
}

uint32_t layer_channels(uint32_t layer)
{
    return facts[layer].channels;
}

int layer_is_radiance(uint32_t layer)
{
    return facts[layer].is_radiance;
}

static float random_at(uint32_t x, uint32_t y, uint32_t k)
{
    uint32_t s = x * 2654435761u ^ (y + 1) * 2246822519u ^ (k + 1) * 3266489917u;
    s ^= s >> 15;
    s *= 2246822519u;
    s ^= s >> 13;
    return (float)(s >> 8) / 16777216.0f;
}

static float value_of(uint32_t layer, uint32_t x, uint32_t y, uint32_t c)
{
    const float noise = random_at(x, y, layer * 4 + c), color = 0.2f + 0.6f * (float)((x / 7 + y / 5 + c) % 2);
    switch (layer) {
    case LAYER_ALBEDO: return color;
    case LAYER_NORMAL: return c == 2 ? 1.0f : 0.0f;
    case LAYER_DEPTH: return 2.0f + 0.01f * (float)y;
    case LAYER_EMISSION: return x % 23 == 3 && y % 19 == 4 ? 5.0f : 0.0f;
    case LAYER_ENVIRONMENT: return y < 3 ? 0.8f : 0.0f;
    case LAYER_VOLUME_DIRECT:
    case LAYER_VOLUME_INDIRECT: return 0.05f * noise;
    default:
        if (!facts[layer].is_radiance) return layer == LAYER_FIRST_LIGHT + 2 ? color : 0.3f * color;
        return noise < 0.1f ? 6.0f * noise : 0.02f + 0.2f * noise; /* skewed, as light is */
    }
}

static void sum_passes(stress_frame *f)
{
    for (size_t i = 0; i < (size_t)f->width * f->height; ++i)
        for (size_t c = 0; c < 3; ++c) {
            float sum = 0.0f;
            for (size_t t = LAYER_FIRST_LIGHT; t < LAYER_VOLUME_DIRECT; t += 3)
                sum += (f->layers[t][3 * i + c] + f->layers[t + 1][3 * i + c]) * f->layers[t + 2][3 * i + c];
            for (size_t t = LAYER_VOLUME_DIRECT; t < NUM_LAYERS; ++t)
                if (f->layers[t]) sum += f->layers[t][3 * i + c];
            f->layers[0][4 * i + c] = sum;
        }
}

stress_frame *frame_create(uint32_t width, uint32_t height, uint32_t mask)
{
    stress_frame *const f = calloc(1, sizeof *f);
    *f = (stress_frame){.width = width, .height = height, .mask = mask, .samples = 4};
    for (uint32_t l = 0; l < NUM_LAYERS; ++l) {
        if (!(mask & MASK(l))) continue;
        const uint32_t n = facts[l].channels;
        f->layers[l] = malloc((size_t)width * height * n * sizeof(float));
        for (uint32_t y = 0; y < height; ++y)
            for (uint32_t x = 0; x < width; ++x)
                for (uint32_t c = 0; c < n; ++c)
                    f->layers[l][((size_t)y * width + x) * n + c] = c == 3 ? 1.0f : value_of(l, x, y, c);
    }
    if ((mask & MASK_LIGHT) == MASK_LIGHT && f->layers[LAYER_COMBINED]) sum_passes(f);
    return f;
}

stress_frame *frame_copy(const stress_frame *frame)
{
    stress_frame *const f = malloc(sizeof *f);
    *f = *frame;
    for (uint32_t l = 0; l < NUM_LAYERS; ++l) {
        if (frame->layers[l] == NULL) continue;
        const size_t bytes = (size_t)f->width * f->height * facts[l].channels * sizeof(float);
        f->layers[l] = malloc(bytes);
        memcpy(f->layers[l], frame->layers[l], bytes);
    }
    return f;
}

void frame_destroy(stress_frame *frame)
{
    for (uint32_t l = 0; frame && l < NUM_LAYERS; ++l) free(frame->layers[l]);
    free(frame);
}

/* ---- Denoise ------------------------------------------------------------------------------------------------------- */

static quell_image image_of(const stress_frame *f, uint32_t layer, void *data, int32_t format)
{
    return (quell_image){.struct_size = sizeof(quell_image),
                         .format = format,
                         .width = f->width,
                         .height = f->height,
                         .num_channels = facts[layer].channels,
                         .data = data};
}

static quell_status add_layer(quell_context *ctx, quell_frame *frame, const stress_frame *f, uint32_t layer)
{
    const size_t num = (size_t)f->width * f->height * facts[layer].channels;
    if (!f->is_half) {
        const quell_image image = image_of(f, layer, f->layers[layer], QUELL_FORMAT_FLOAT);
        return quell_frame_add_layer(ctx, frame, facts[layer].name, &image, QUELL_LAYER_COPY, NULL);
    }
    uint16_t *const halves = malloc(num * sizeof *halves);
    for (size_t i = 0; i < num; ++i) halves[i] = ql_half_from_float(f->layers[layer][i]);
    const quell_image image = image_of(f, layer, halves, QUELL_FORMAT_HALF);
    const quell_status status = quell_frame_add_layer(ctx, frame, facts[layer].name, &image, QUELL_LAYER_COPY, NULL);
    free(halves);
    return status;
}

static void read_report(const quell_report *report, const stress_frame *f, stress_report *out)
{
    quell_report_summary summary = {.struct_size = sizeof summary};
    memset(out, 0, sizeof *out);
    if (quell_report_get_summary(report, &summary) != QUELL_OK) return;
    out->halo = summary.halo;
    out->is_mixed = strcmp(summary.combined, "direct") != 0;
    for (uint32_t l = 0, i = 0; l < NUM_LAYERS; ++l) {
        quell_report_layer layer = {.struct_size = sizeof layer};
        if (f->layers[l] == NULL || quell_report_get_layer(report, i++, &layer) != QUELL_OK) continue;
        out->is_denoised[l] = layer.action == QUELL_ACTION_DENOISED;
        out->num_limited += layer.num_limited_pixels;
        out->num_bad += layer.num_bad_pixels;
        if (l == LAYER_COMBINED) {
            out->mean_before = layer.mean_before;
            out->mean_after = layer.mean_after;
        }
    }
}

static quell_status denoise(quell_context *ctx, const stress_frame *f, const stress_run *run, quell_frame *frame,
                            stress_frame **out, stress_report *report)
{
    quell_model *model = NULL;
    quell_report *made = NULL;
    uint32_t index = 0;
    quell_status status = quell_model_open(ctx, NULL, &model);
    for (uint32_t l = 0; l < NUM_LAYERS && status == QUELL_OK; ++l)
        if (f->layers[l]) status = add_layer(ctx, frame, f, l);
    if (status == QUELL_OK && f->samples) status = quell_frame_set_samples(frame, f->samples);
    const quell_options options = {.struct_size = sizeof options, .flags = run->flags, .tile_size = run->tile_size};
    if (status == QUELL_OK) status = quell_denoise(ctx, model, frame, &options, &made);
    if (status == QUELL_OK) {
        read_report(made, f, report);
        *out = frame_copy(f);
    }
    for (uint32_t l = 0; l < NUM_LAYERS && status == QUELL_OK; ++l) {
        if (f->layers[l] == NULL) continue;
        const quell_image image = image_of(f, l, (*out)->layers[l], QUELL_FORMAT_FLOAT);
        status = quell_frame_copy_layer(ctx, frame, index++, &image);
    }
    quell_report_destroy(made);
    quell_model_destroy(model);
    return status;
}

quell_status frame_denoise(const stress_frame *frame, const stress_run *run, stress_frame **out, stress_report *report)
{
    const quell_context_options options = {
        .struct_size = sizeof options, .num_threads = run->num_threads, .max_memory_bytes = run->max_memory_bytes};
    quell_context *ctx = NULL;
    quell_frame *made = NULL;
    *out = NULL;
    quell_status status = quell_context_create(&options, &ctx);
    if (status == QUELL_OK) status = quell_frame_create(ctx, frame->width, frame->height, &made);
    if (status == QUELL_OK) status = denoise(ctx, frame, run, made, out, report);
    if (status != QUELL_OK && status != QUELL_ERR_NO_LAYER) fprintf(stderr, "%s\n", quell_context_last_error(ctx));
    if (status != QUELL_OK && *out) {
        frame_destroy(*out);
        *out = NULL;
    }
    quell_frame_destroy(made);
    quell_context_destroy(ctx);
    return status;
}

/* ---- Checks -------------------------------------------------------------------------------------------------------- */

int frame_equal(const stress_frame *a, const stress_frame *b)
{
    for (uint32_t l = 0; l < NUM_LAYERS; ++l)
        if (a->layers[l] &&
            memcmp(a->layers[l], b->layers[l], (size_t)a->width * a->height * facts[l].channels * sizeof(float)) != 0)
            return 0;
    return 1;
}

typedef struct range {
    double low, high;
} range;

static int is_bad(float value)
{
    return !(fabsf(value) <= ABSURD);
}

/* Of the pixels of a layer whose colours are all valid, and of black where there are others; alpha for itself. */
static range range_of(const stress_frame *f, uint32_t layer, uint32_t channel)
{
    const uint32_t n = facts[layer].channels, colors = n < 3 ? n : 3;
    range r = {INFINITY, -INFINITY};
    for (size_t i = 0; i < (size_t)f->width * f->height; ++i) {
        int bad = is_bad(f->layers[layer][i * n + channel]);
        for (uint32_t c = 0; c < colors && channel < 3; ++c) bad |= is_bad(f->layers[layer][i * n + c]);
        const double value = bad ? 0.0 : (double)f->layers[layer][i * n + channel];
        if (value < r.low) r.low = value;
        if (value > r.high) r.high = value;
    }
    return r;
}

static range add(range a, range b)
{
    return (range){a.low + b.low, a.high + b.high};
}

static range multiply(range a, range b)
{
    const double p[4] = {a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high};
    range r = {p[0], p[0]};
    for (int i = 1; i < 4; ++i) r = (range){fmin(r.low, p[i]), fmax(r.high, p[i])};
    return r;
}

/* Combined may also be what its parts add up to. */
static range widen_by_parts(const stress_frame *f, uint32_t c, range r)
{
    range sum = {0.0, 0.0};
    for (uint32_t t = LAYER_FIRST_LIGHT; t < LAYER_VOLUME_DIRECT; t += 3)
        sum = add(sum, multiply(add(range_of(f, t, c), range_of(f, t + 1, c)), range_of(f, t + 2, c)));
    for (uint32_t t = LAYER_VOLUME_DIRECT; t < NUM_LAYERS; ++t)
        if (f->layers[t]) sum = add(sum, range_of(f, t, c));
    return (range){fmin(r.low, sum.low), fmax(r.high, sum.high)};
}

const char *frame_check(const stress_frame *in, const stress_frame *out, const stress_report *report)
{
    static char text[256];
    for (uint32_t l = 0; l < NUM_LAYERS; ++l) {
        if (out->layers[l] == NULL || !report->is_denoised[l]) continue;
        const uint32_t n = facts[l].channels;
        for (uint32_t c = 0; c < n; ++c) {
            range r = range_of(in, l, c);
            if (l == LAYER_COMBINED && c < 3 && report->is_mixed) r = widen_by_parts(in, c, r);
            /* Half floats were rounded on their way in. */
            const double rounding = in->is_half ? 0x1p-11 : 1e-5, least = in->is_half ? 0x1p-25 : 0.0;
            const double slack = rounding * fmax(fabs(r.low), fabs(r.high)) + least;
            for (size_t i = 0; i < (size_t)out->width * out->height; ++i) {
                const double value = (double)out->layers[l][i * n + c];
                if (isfinite(value) && value >= r.low - slack && value <= r.high + slack) continue;
                snprintf(text, sizeof text, "%s, channel %u, pixel %zu: %g is not within %g .. %g", facts[l].name, c, i,
                         value, r.low, r.high);
                return text;
            }
        }
    }
    return NULL;
}
