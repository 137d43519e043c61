/* SPDX-License-Identifier: Apache-2.0 */
/* Structural similarity; see metrics.h for the definition. The window is separable: columns first, then rows. */
#include "metrics/metrics.h"

#include <math.h>

#define RADIUS 5
#define SIGMA 1.5
#define NUM_MOMENTS 5 /* x, y, xx, yy, xy */

typedef struct ssim_job {
    uint32_t width, height;
    const float *image, *reference;
    double weights[2 * RADIUS + 1];
    uint32_t x_begin, x_end, y_begin, y_end; /* pixels that count */
    double *columns;                         /* [worker][NUM_MOMENTS][width] */
    double *bands;                           /* sums of QL_METRICS_BAND rows each */
} ssim_job;

static void counted_range(uint32_t size, uint32_t *begin, uint32_t *end)
{
    const int has_inside = size >= 2 * RADIUS + 1;
    *begin = has_inside ? RADIUS : 0;
    *end = has_inside ? size - RADIUS : size;
}

/* The window about `centre` cut to 0 .. size - 1. Returns the sum of the weights left. */
static double cut_window(const double *weights, uint32_t centre, uint32_t size, uint32_t *begin, uint32_t *end)
{
    *begin = centre > RADIUS ? centre - RADIUS : 0;
    *end = size - centre > RADIUS ? centre + RADIUS + 1 : size;
    double sum = 0.0;
    for (uint32_t i = *begin; i < *end; i++) sum += weights[i + RADIUS - centre];
    return sum;
}

static void filter_columns(const ssim_job *job, uint32_t y, double *columns)
{
    const size_t width = job->width;
    uint32_t begin, end;
    const double scale = 1.0 / cut_window(job->weights, y, job->height, &begin, &end);
    for (size_t i = 0; i < NUM_MOMENTS * width; i++) columns[i] = 0.0;
    for (uint32_t row = begin; row < end; row++) {
        const double weight = scale * job->weights[row + RADIUS - y];
        const float *p = job->image + row * width, *q = job->reference + row * width;
        for (size_t x = 0; x < width; x++) {
            const double a = (double)p[x], b = (double)q[x];
            columns[x] += weight * a;
            columns[width + x] += weight * b;
            columns[2 * width + x] += weight * a * a;
            columns[3 * width + x] += weight * b * b;
            columns[4 * width + x] += weight * a * b;
        }
    }
}

static double pixel_ssim(const ssim_job *job, uint32_t x, const double *columns)
{
    const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
    uint32_t begin, end;
    const double scale = 1.0 / cut_window(job->weights, x, job->width, &begin, &end);
    double m[NUM_MOMENTS] = {0};
    for (uint32_t k = 0; k < NUM_MOMENTS; k++) {
        const double *column = columns + (size_t)k * job->width;
        for (uint32_t i = begin; i < end; i++) m[k] += scale * job->weights[i + RADIUS - x] * column[i];
    }
    const double variance_a = m[2] - m[0] * m[0], variance_b = m[3] - m[1] * m[1], covariance = m[4] - m[0] * m[1];
    return (2.0 * m[0] * m[1] + c1) * (2.0 * covariance + c2) /
           ((m[0] * m[0] + m[1] * m[1] + c1) * (variance_a + variance_b + c2));
}

static void ssim_band(void *user, uint32_t task, uint32_t worker)
{
    ssim_job *job = user;
    double *columns = job->columns + (size_t)worker * NUM_MOMENTS * job->width;
    double sum = 0.0;
    const uint32_t first = job->y_begin + task * QL_METRICS_BAND;
    for (uint32_t y = first; y < job->y_end && y - first < QL_METRICS_BAND; y++) {
        filter_columns(job, y, columns);
        for (uint32_t x = job->x_begin; x < job->x_end; x++) sum += pixel_ssim(job, x, columns);
    }
    job->bands[task] = sum;
}

quell_status ql_metrics_ssim(ql_env *env, uint32_t width, uint32_t height, const float *image, const float *reference,
                             double *out, ql_error *err)
{
    ssim_job job = {.width = width, .height = height, .image = image, .reference = reference};
    double sum = 0.0;
    for (int i = 0; i <= 2 * RADIUS; i++) {
        job.weights[i] = exp(-(double)((i - RADIUS) * (i - RADIUS)) / (2.0 * SIGMA * SIGMA));
        sum += job.weights[i];
    }
    for (int i = 0; i <= 2 * RADIUS; i++) job.weights[i] /= sum;
    counted_range(width, &job.x_begin, &job.x_end);
    counted_range(height, &job.y_begin, &job.y_end);

    const uint32_t num_bands = (job.y_end - job.y_begin + QL_METRICS_BAND - 1) / QL_METRICS_BAND;
    const size_t num_rows = (size_t)ql_pool_num_threads(env->pool) * NUM_MOMENTS;
    job.columns = ql_alloc(env->memory, num_rows, (size_t)width * sizeof *job.columns);
    job.bands = ql_alloc_zero(env->memory, num_bands, sizeof *job.bands);
    quell_status status;
    if (job.columns && job.bands) {
        status = ql_env_run(env, num_bands, ssim_band, &job);
    } else {
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for the SSIM of %u x %u pixels", width, height);
    }
    if (status == QUELL_OK) {
        double total = 0.0;
        for (uint32_t i = 0; i < num_bands; i++) total += job.bands[i];
        *out = total / ((double)(job.x_end - job.x_begin) * (double)(job.y_end - job.y_begin));
    }
    ql_free(env->memory, job.bands);
    ql_free(env->memory, job.columns);
    return status;
}
