/* SPDX-License-Identifier: Apache-2.0 */
/* Gradient magnitude similarity deviation; see metrics.h for the definition. */
#include "metrics/metrics.h"

#include <math.h>

typedef struct gmsd_job {
    uint32_t width, height;           /* of the planes */
    uint32_t half_width, half_height; /* of the halved ones */
    const float *image, *reference;
    double *half_image, *half_reference; /* [half_height][half_width] */
    double *similarity;                  /* the same shape */
} gmsd_job;

/* Pixel (2x, 2y) of the 2x2 mean: with its right and lower neighbours, 0 beyond the edge. */
static double mean_2x2(const float *plane, uint32_t width, uint32_t height, uint32_t x, uint32_t y)
{
    double sum = 0.0;
    for (uint32_t j = 2 * y; j < height && j < 2 * y + 2; j++) {
        for (uint32_t i = 2 * x; i < width && i < 2 * x + 2; i++) sum += (double)plane[(size_t)j * width + i];
    }
    return 0.25 * sum;
}

static void halve_row(void *user, uint32_t y, uint32_t worker)
{
    (void)worker;
    gmsd_job *job = user;
    const size_t row = (size_t)y * job->half_width;
    for (uint32_t x = 0; x < job->half_width; x++) {
        job->half_image[row + x] = mean_2x2(job->image, job->width, job->height, x, y);
        job->half_reference[row + x] = mean_2x2(job->reference, job->width, job->height, x, y);
    }
}

static double at(const gmsd_job *job, const double *plane, int64_t x, int64_t y)
{
    if (x < 0 || y < 0 || x >= (int64_t)job->half_width || y >= (int64_t)job->half_height) return 0.0;
    return plane[y * (int64_t)job->half_width + x];
}

static double gradient_squared(const gmsd_job *job, const double *plane, int64_t x, int64_t y)
{
    double dx = 0.0, dy = 0.0;
    for (int64_t k = -1; k <= 1; k++) {
        dx += at(job, plane, x + 1, y + k) - at(job, plane, x - 1, y + k);
        dy += at(job, plane, x + k, y + 1) - at(job, plane, x + k, y - 1);
    }
    return (dx * dx + dy * dy) / 9.0;
}

static void similarity_row(void *user, uint32_t y, uint32_t worker)
{
    (void)worker;
    const double c = 170.0 / (255.0 * 255.0);
    gmsd_job *job = user;
    for (uint32_t x = 0; x < job->half_width; x++) {
        const double a = gradient_squared(job, job->half_image, x, y);
        const double b = gradient_squared(job, job->half_reference, x, y);
        job->similarity[(size_t)y * job->half_width + x] = (2.0 * sqrt(a * b) + c) / (a + b + c);
    }
}

static double deviation(const double *values, size_t num)
{
    if (num < 2) return 0.0;
    double sum = 0.0, squares = 0.0;
    for (size_t i = 0; i < num; i++) sum += values[i];
    const double mean = sum / (double)num;
    for (size_t i = 0; i < num; i++) squares += (values[i] - mean) * (values[i] - mean);
    return sqrt(squares / (double)(num - 1));
}

quell_status ql_metrics_gmsd(ql_env *env, uint32_t width, uint32_t height, const float *image, const float *reference,
                             double *out, ql_error *err)
{
    gmsd_job job = {.width = width, .height = height, .image = image, .reference = reference};
    job.half_width = width / 2 + width % 2;
    job.half_height = height / 2 + height % 2;
    const size_t num = (size_t)job.half_width * job.half_height;
    job.half_image = ql_alloc(env->memory, num, sizeof *job.half_image);
    job.half_reference = ql_alloc(env->memory, num, sizeof *job.half_reference);
    job.similarity = ql_alloc(env->memory, num, sizeof *job.similarity);

    quell_status status = QUELL_OK;
    if (!job.half_image || !job.half_reference || !job.similarity) {
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for the GMSD of %u x %u pixels", width, height);
    }
    if (status == QUELL_OK) status = ql_env_run(env, job.half_height, halve_row, &job);
    if (status == QUELL_OK) status = ql_env_run(env, job.half_height, similarity_row, &job);
    if (status == QUELL_OK) *out = deviation(job.similarity, num);

    ql_free(env->memory, job.similarity);
    ql_free(env->memory, job.half_reference);
    ql_free(env->memory, job.half_image);
    return status;
}
