/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The robust relative error of training/loss.py with its gradient, at one scale or three, in one pass over each plane.
 * Called from training/native/__init__.py through ctypes; loss.py holds the plain PyTorch form, which the tests compare
 * with. Planes are float, contiguous, [n][channels][height][width].
 */
#include <math.h>
#include <stdlib.h>

enum { NUM_SCALES = 3 };

typedef struct plane {
    long height, width;
    const float *image, *target, *level;
    float *grad; /* NULL: no gradient wanted */
} plane;

static float *floats(long num)
{
    return malloc((size_t)(num > 0 ? num : 1) * sizeof(float));
}

/* Sum over a plane of turn^2 (sqrt(1 + s / turn^2) - 1), s = (image - target)^2 / (level^2 + epsilon). Gradients are
 * written, of the sum. */
static double relative_plane(const plane *p, float epsilon, float turn)
{
    const float inverse = 1.0f / (turn * turn);
    double total = 0.0;
    for (long y = 0; y < p->height; ++y) {
        const float *const image = p->image + y * p->width, *const target = p->target + y * p->width;
        const float *const level = p->level + y * p->width;
        float *const grad = p->grad ? p->grad + y * p->width : NULL;
        float sum = 0.0f;
        for (long x = 0; x < p->width; ++x) {
            const float error = image[x] - target[x], weight = 1.0f / (level[x] * level[x] + epsilon);
            const float root = sqrtf(1.0f + error * error * weight * inverse);
            sum += error * error * weight / (root + 1.0f); /* as above, without cancellation */
            if (grad) grad[x] = error * weight / root;
        }
        total += sum;
    }
    return total;
}

/* out[y][x]: mean of the size x size cell. */
static void pool(const float *in, long width, long size, long out_height, long out_width, float *out)
{
    const float share = 1.0f / (float)(size * size);
    for (long y = 0; y < out_height; ++y)
        for (long x = 0; x < out_width; ++x) {
            float sum = 0.0f;
            for (long i = 0; i < size; ++i)
                for (long j = 0; j < size; ++j) sum += in[(y * size + i) * width + x * size + j];
            out[y * out_width + x] = sum * share;
        }
}

/* The same error of means over size x size cells, and its gradient added to that of the whole plane. */
static double pooled_plane(const plane *p, long size, float weight, float epsilon, float turn)
{
    const long height = p->height / size, width = p->width / size, num = height * width;
    if (num == 0) return 0.0;
    float *const buffer = floats(4 * num);
    const plane small = {height, width, buffer, buffer + num, buffer + 2 * num, p->grad ? buffer + 3 * num : NULL};
    pool(p->image, p->width, size, height, width, buffer);
    pool(p->target, p->width, size, height, width, buffer + num);
    pool(p->level, p->width, size, height, width, buffer + 2 * num);
    const double total = relative_plane(&small, epsilon, turn) / (double)num;
    const float share = weight / (float)(size * size) / (float)num;
    for (long y = 0; p->grad && y < height * size; ++y)
        for (long x = 0; x < width * size; ++x)
            p->grad[y * p->width + x] += share * small.grad[(y / size) * width + x / size];
    free(buffer);
    return weight * total;
}

/* loss[n]: mean over channels and pixels; with scales 3 that of means over 4x4 and 16x16 besides, at half weight.
 * grad: NULL or as the image, of each image's own loss. */
void relative_error(long n, long channels, long height, long width, long scales, float epsilon, float turn,
                    const float *image, const float *target, const float *level, float *loss, float *grad)
{
    static const long sizes[NUM_SCALES] = {1, 4, 16};
    const long num = height * width;
#pragma omp parallel for schedule(dynamic)
    for (long i = 0; i < n; ++i) {
        double total = 0.0;
        for (long c = 0; c < channels; ++c) {
            const long at = (i * channels + c) * num;
            const plane p = {height, width, image + at, target + at, level + at, grad ? grad + at : NULL};
            total += relative_plane(&p, epsilon, turn) / (double)num;
            for (long k = 0; grad && k < num; ++k) p.grad[k] /= (float)num;
            for (long s = 1; s < scales; ++s) total += pooled_plane(&p, sizes[s], 0.5f, epsilon, turn);
            for (long k = 0; grad && k < num; ++k) p.grad[k] /= (float)channels;
        }
        loss[i] = (float)(total / (double)channels);
    }
}
