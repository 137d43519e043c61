/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Wide softmax kernels applied to an image, with their gradients, for training on a CPU: eq. 1 and 2 of DGAN-KPN. Called
 * from training/dgan/native.py through ctypes; reconstruct.py has the plain PyTorch form, which the tests compare with.
 *
 * All tensors are float, contiguous, planar. The taps of a pixel are softmaxed here, so that the weights of a whole image
 * are never stored. Outside the image everything is zero.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct shape {
    long channels, width, height, radius;
} shape;

static long num_taps(const shape *s) { return (2 * s->radius + 1) * (2 * s->radius + 1); }
static long padded_width(const shape *s) { return s->width + 2 * s->radius; }
static long padded_size(const shape *s) { return padded_width(s) * (s->height + 2 * s->radius); }

/* Where tap k of output row y begins in a padded plane. */
static long tap_offset(const shape *s, long y, long k)
{
    const long side = 2 * s->radius + 1;
    return (y + k / side) * padded_width(s) + k % side;
}

static float *pad(const shape *s, const float *source)
{
    float *const padded = calloc((size_t)(s->channels * padded_size(s)), sizeof *padded);
    for (long c = 0; c < s->channels; ++c)
        for (long y = 0; y < s->height; ++y)
            memcpy(padded + c * padded_size(s) + (y + s->radius) * padded_width(s) + s->radius,
                   source + (c * s->height + y) * s->width, (size_t)s->width * sizeof *source);
    return padded;
}

/* weights[k][x] = softmax over k of logits[k][y][x]; two rows behind the weights are scratch. */
static void softmax_row(const shape *s, const float *logits, long y, float *weights)
{
    const long w = s->width, plane = s->width * s->height, taps = num_taps(s);
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

static void forward_one(const shape *s, const float *source, const float *logits, float *out)
{
    const long taps = num_taps(s), w = s->width;
    float *const padded = pad(s, source);
    float *const weights = malloc((size_t)((taps + 2) * w) * sizeof *weights);
    for (long y = 0; y < s->height; ++y) {
        softmax_row(s, logits, y, weights);
        for (long c = 0; c < s->channels; ++c) {
            float *const o = out + (c * s->height + y) * w;
            memset(o, 0, (size_t)w * sizeof *o);
            for (long k = 0; k < taps; ++k) {
                const float *const in = padded + c * padded_size(s) + tap_offset(s, y, k);
                for (long x = 0; x < w; ++x) o[x] += weights[k * w + x] * in[x];
            }
        }
    }
    free(weights);
    free(padded);
}

static void backward_one(const shape *s, const float *source, const float *logits, const float *grad,
                         float *grad_source, float *grad_logits)
{
    const long taps = num_taps(s), w = s->width, plane = s->width * s->height, size = padded_size(s);
    float *const padded = pad(s, source);
    float *const padded_grad = calloc((size_t)(s->channels * size), sizeof *padded_grad);
    float *const weights = malloc((size_t)((2 * taps + 3) * w) * sizeof *weights);
    float *const d = weights + (taps + 2) * w, *const mean = d + taps * w;
    for (long y = 0; y < s->height; ++y) {
        softmax_row(s, logits, y, weights);
        memset(mean, 0, (size_t)w * sizeof *mean);
        for (long k = 0; k < taps; ++k) {
            const float *const wk = weights + k * w;
            float *const dk = d + k * w;
            memset(dk, 0, (size_t)w * sizeof *dk);
            for (long c = 0; c < s->channels; ++c) {
                const float *const in = padded + c * size + tap_offset(s, y, k);
                const float *const g = grad + (c * s->height + y) * w;
                float *const t = padded_grad + c * size + tap_offset(s, y, k);
                for (long x = 0; x < w; ++x) {
                    dk[x] += g[x] * in[x];
                    t[x] += wk[x] * g[x];
                }
            }
            for (long x = 0; x < w; ++x) mean[x] += wk[x] * dk[x];
        }
        for (long k = 0; k < taps; ++k)
            for (long x = 0; x < w; ++x)
                grad_logits[k * plane + y * w + x] = weights[k * w + x] * (d[k * w + x] - mean[x]);
    }
    for (long c = 0; c < s->channels; ++c)
        for (long y = 0; y < s->height; ++y)
            memcpy(grad_source + (c * s->height + y) * w,
                   padded_grad + c * size + (y + s->radius) * padded_width(s) + s->radius, (size_t)w * sizeof *grad);
    free(weights);
    free(padded_grad);
    free(padded);
}

/* source, out [n][channels][height][width], logits [n][(2 radius + 1)^2][height][width]. */
void wide_forward(long n, long channels, long height, long width, long radius, const float *source,
                  const float *logits, float *out)
{
    const shape s = {channels, width, height, radius};
    const long image = channels * height * width, maps = num_taps(&s) * height * width;
#pragma omp parallel for schedule(dynamic)
    for (long i = 0; i < n; ++i) forward_one(&s, source + i * image, logits + i * maps, out + i * image);
}

void wide_backward(long n, long channels, long height, long width, long radius, const float *source,
                   const float *logits, const float *grad, float *grad_source, float *grad_logits)
{
    const shape s = {channels, width, height, radius};
    const long image = channels * height * width, maps = num_taps(&s) * height * width;
#pragma omp parallel for schedule(dynamic)
    for (long i = 0; i < n; ++i)
        backward_one(&s, source + i * image, logits + i * maps, grad + i * image, grad_source + i * image,
                     grad_logits + i * maps);
}
