/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Kernel application with its gradients, for training on a CPU. Called from training/native/__init__.py through ctypes;
 * training/models/pyramid.py holds the plain PyTorch form of the same operations, which the tests compare with.
 *
 * All tensors are float, contiguous, planar. The taps of a pixel are softmaxed here, so that the weights of a whole
 * image are never stored. Outside the image everything is zero (values and validity alike, see pyramid.py).
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>


/* Where the taps of fine pixel (x, y) lie in the padded source: for a filter the pixel itself plus an offset, for an
 * upsampling its parent (x / 2, y / 2) plus an offset. */
typedef struct geometry {
    long width, height;             /* of the logits and of the output */
    long source_width, source_height;
    long radius;                    /* 2 for 5x5, 1 for 3x3 */
    long shift;                     /* 0: filter, 1: upsampling by 2 */
} geometry;

static long padded_width(const geometry *g)
{
    return g->source_width + 2 * g->radius;
}

static long padded_size(const geometry *g)
{
    return padded_width(g) * (g->source_height + 2 * g->radius);
}

static void pad(const geometry *g, const float *source, float *padded)
{
    memset(padded, 0, (size_t)padded_size(g) * sizeof *padded);
    for (long y = 0; y < g->source_height; ++y)
        memcpy(padded + (y + g->radius) * padded_width(g) + g->radius, source + y * g->source_width,
               (size_t)g->source_width * sizeof *source);
}

static void unpad_add(const geometry *g, const float *padded, float *target)
{
    for (long y = 0; y < g->source_height; ++y)
        memcpy(target + y * g->source_width, padded + (y + g->radius) * padded_width(g) + g->radius,
               (size_t)g->source_width * sizeof *target);
}

/* weights[k][x] = softmax over k of logits[k][y][x] */
static void softmax_row(const geometry *g, const float *logits, long y, long taps, float *weights)
{
    const long w = g->width, plane = g->width * g->height;
    float *const sum = weights + taps * w, *const top = sum + w;
    const float *const row = logits + y * w;
    for (long x = 0; x < w; ++x) top[x] = row[x];
    for (long k = 1; k < taps; ++k)
        for (long x = 0; x < w; ++x) top[x] = fmaxf(top[x], row[k * plane + x]);
    memset(sum, 0, (size_t)w * sizeof *sum);
    for (long k = 0; k < taps; ++k)
        for (long x = 0; x < w; ++x) {
            const float e = expf(row[k * plane + x] - top[x]);
            weights[k * w + x] = e;
            sum[x] += e;
        }
    for (long x = 0; x < w; ++x) sum[x] = 1.0f / sum[x];
    for (long k = 0; k < taps; ++k)
        for (long x = 0; x < w; ++x) weights[k * w + x] *= sum[x];
}

/* The source row of tap k at every x of an output row: contiguous for a filter, each value twice for an upsampling. */
static const float *tap_row(const geometry *g, const float *padded, long y, long k, float *buffer)
{
    const long side = 2 * g->radius + 1, dy = k / side, dx = k % side;
    const float *const row = padded + ((y >> g->shift) + dy) * padded_width(g) + dx;
    if (g->shift == 0) return row;
    for (long x = 0; x < g->width; ++x) buffer[x] = row[x >> 1];
    return buffer;
}

static void forward_one(const geometry *g, long channels, const float *source, const float *logits, float *out)
{
    const long side = 2 * g->radius + 1, taps = side * side, w = g->width, size = padded_size(g);
    float *const padded = malloc((size_t)(channels * size) * sizeof *padded);
    float *const weights = malloc((size_t)((taps + 3) * w) * sizeof *weights);
    float *const buffer = weights + (taps + 2) * w;
    for (long c = 0; c < channels; ++c) pad(g, source + c * g->source_width * g->source_height, padded + c * size);
    for (long y = 0; y < g->height; ++y) {
        softmax_row(g, logits, y, taps, weights);
        for (long c = 0; c < channels; ++c) {
            float *const o = out + (c * g->height + y) * w;
            memset(o, 0, (size_t)w * sizeof *o);
            for (long k = 0; k < taps; ++k) {
                const float *const s = tap_row(g, padded + c * size, y, k, buffer);
                const float *const wk = weights + k * w;
                for (long x = 0; x < w; ++x) o[x] += wk[x] * s[x];
            }
        }
    }
    free(weights);
    free(padded);
}

static void backward_one(const geometry *g, long channels, const float *source, const float *logits, const float *grad,
                         float *grad_source, float *grad_logits)
{
    const long side = 2 * g->radius + 1, taps = side * side, w = g->width, size = padded_size(g);
    const long plane = g->width * g->height;
    float *const padded = malloc((size_t)(channels * size) * sizeof *padded);
    float *const padded_grad = calloc((size_t)(channels * size), sizeof *padded_grad);
    float *const weights = malloc((size_t)((2 * taps + 4) * w) * sizeof *weights);
    float *const d = weights + (taps + 2) * w, *const mean = d + taps * w, *const buffer = mean + w;
    for (long c = 0; c < channels; ++c) pad(g, source + c * g->source_width * g->source_height, padded + c * size);
    for (long y = 0; y < g->height; ++y) {
        softmax_row(g, logits, y, taps, weights);
        memset(mean, 0, (size_t)w * sizeof *mean);
        for (long k = 0; k < taps; ++k) {
            const float *const wk = weights + k * w;
            float *const dk = d + k * w;
            memset(dk, 0, (size_t)w * sizeof *dk);
            for (long c = 0; c < channels; ++c) {
                const float *const s = tap_row(g, padded + c * size, y, k, buffer);
                const float *const gy = grad + (c * g->height + y) * w;
                for (long x = 0; x < w; ++x) dk[x] += gy[x] * s[x];
            }
            for (long x = 0; x < w; ++x) mean[x] += wk[x] * dk[x];
            for (long c = 0; c < channels; ++c) {
                const float *const gy = grad + (c * g->height + y) * w;
                float *const t = padded_grad + c * size + ((y >> g->shift) + k / side) * padded_width(g) + k % side;
                if (g->shift == 0)
                    for (long x = 0; x < w; ++x) t[x] += wk[x] * gy[x];
                else
                    for (long x = 0; x < w / 2; ++x)
                        t[x] += wk[2 * x] * gy[2 * x] + wk[2 * x + 1] * gy[2 * x + 1];
            }
        }
        for (long k = 0; k < taps; ++k) {
            float *const o = grad_logits + k * plane + y * w;
            for (long x = 0; x < w; ++x) o[x] = weights[k * w + x] * (d[k * w + x] - mean[x]);
        }
    }
    for (long c = 0; c < channels; ++c)
        unpad_add(g, padded_grad + c * size, grad_source + c * g->source_width * g->source_height);
    free(weights);
    free(padded_grad);
    free(padded);
}

/* source [n][channels][source_height][source_width], logits [n][(2 radius + 1)^2][height][width], out [n][channels]
 * [height][width]. shift 1: height and width are twice the source's. */
void kernel_forward(long n, long channels, long height, long width, long radius, long shift, const float *source,
                    const float *logits, float *out)
{
    const geometry g = {width, height, width >> shift, height >> shift, radius, shift};
    const long taps = (2 * radius + 1) * (2 * radius + 1);
#pragma omp parallel for schedule(dynamic)
    for (long i = 0; i < n; ++i)
        forward_one(&g, channels, source + i * channels * g.source_width * g.source_height,
                    logits + i * taps * width * height, out + i * channels * width * height);
}

void kernel_backward(long n, long channels, long height, long width, long radius, long shift, const float *source,
                     const float *logits, const float *grad, float *grad_source, float *grad_logits)
{
    const geometry g = {width, height, width >> shift, height >> shift, radius, shift};
    const long taps = (2 * radius + 1) * (2 * radius + 1);
#pragma omp parallel for schedule(dynamic)
    for (long i = 0; i < n; ++i)
        backward_one(&g, channels, source + i * channels * g.source_width * g.source_height,
                     logits + i * taps * width * height, grad + i * channels * width * height,
                     grad_source + i * channels * g.source_width * g.source_height,
                     grad_logits + i * taps * width * height);
}
