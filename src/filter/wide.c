/* SPDX-License-Identifier: Apache-2.0 */
/* Rows of wide kernels in a ring, and the iterations that follow one another through it. */
#include "filter/wide.h"

#include <string.h>

enum { SIDE = 2 * QL_WIDE_RADIUS + 1, MAX_PLANES = 64 };

/* So far below any logit that its exponential is nothing, and finite, so that differences stay numbers. */
#define NO_TAP -1e30f

size_t ql_wide_stride(uint32_t width)
{
    return (size_t)width + 2 * QL_WIDE_RADIUS;
}

static size_t plane_floats(uint32_t width, uint32_t height)
{
    return ql_wide_stride(width) * ((size_t)height + 2 * QL_WIDE_RADIUS);
}

uint64_t ql_wide_planes_bytes(uint32_t width, uint32_t height, uint32_t num)
{
    return (uint64_t)plane_floats(width, height) * num * sizeof(float);
}

quell_status ql_wide_planes_create(ql_wide_planes *planes, uint32_t width, uint32_t height, uint32_t num,
                                   ql_memory *memory, ql_error *err)
{
    *planes =
        (ql_wide_planes){ql_alloc_zero(memory, plane_floats(width, height), num * sizeof(float)), width, height, num};
    if (planes->data == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: %u planes of %ux%u", num, width, height);
    return QUELL_OK;
}

void ql_wide_planes_destroy(ql_wide_planes *planes, ql_memory *memory)
{
    ql_free(memory, planes->data);
    planes->data = NULL;
}

float *ql_wide_row(const ql_wide_planes *planes, uint32_t plane, uint32_t y)
{
    return planes->data + plane * plane_floats(planes->width, planes->height) +
           ((size_t)y + QL_WIDE_RADIUS) * ql_wide_stride(planes->width) + QL_WIDE_RADIUS;
}

static uint32_t ring_rows(uint32_t height, uint32_t iterations)
{
    const uint32_t rows = QL_WIDE_STEP + QL_WIDE_RADIUS * (iterations - 1);
    return rows < height ? rows : height;
}

uint64_t ql_wide_ring_bytes(uint32_t width, uint32_t height, uint32_t iterations)
{
    return (uint64_t)ring_rows(height, iterations) * QL_WIDE_TAPS * width * sizeof(float);
}

typedef struct wide_job {
    const ql_kernels *kernels;
    const ql_wide_source *source;
    float *ring; /* [ring rows][taps][width] */
    uint32_t num_ring_rows, width, height;
    uint32_t from; /* row of task 0 */
    const ql_wide_planes *in, *out;
} wide_job;

static float *weights_of(const wide_job *job, uint32_t y)
{
    return job->ring + (size_t)(y % job->num_ring_rows) * QL_WIDE_TAPS * job->width;
}

/* Taps beyond the edge of the image get no weight. */
static void drop_outside(const wide_job *job, uint32_t y, float *logits)
{
    const int64_t width = job->width, height = job->height;
    for (int64_t k = 0; k < QL_WIDE_TAPS; ++k) {
        const int64_t dy = k / SIDE - QL_WIDE_RADIUS, dx = k % SIDE - QL_WIDE_RADIUS;
        float *const row = logits + k * width;
        int64_t from = dx < 0 ? -dx : 0, to = dx > 0 ? width - dx : width; /* inside */
        if (y + dy < 0 || y + dy >= height || from >= to) from = to = width;
        for (int64_t x = 0; x < from; ++x) row[x] = NO_TAP;
        for (int64_t x = to; x < width; ++x) row[x] = NO_TAP;
    }
}

static void weights_task(void *user, uint32_t task, uint32_t worker)
{
    const wide_job *const job = user;
    const uint32_t y = job->from + task;
    float *const weights = weights_of(job, y);
    job->source->logits(job->source->user, y, worker, weights);
    drop_outside(job, y, weights);
    job->kernels->softmax_row(weights, job->width, QL_WIDE_TAPS, job->width);
}

static void filter_task(void *user, uint32_t task, uint32_t worker)
{
    const wide_job *const job = user;
    const uint32_t y = job->from + task;
    const float *in[MAX_PLANES];
    float *out[MAX_PLANES];
    (void)worker;
    for (uint32_t p = 0; p < job->in->num; ++p) {
        in[p] = ql_wide_row(job->in, p, y);
        out[p] = ql_wide_row(job->out, p, y);
    }
    const ql_gather_row gather = {
        .weights = weights_of(job, y),
        .weights_stride = job->width,
        .in = in,
        .in_stride = (ptrdiff_t)ql_wide_stride(job->width),
        .out = out,
        .radius = QL_WIDE_RADIUS,
        .num_channels = job->in->num,
        .num_pixels = job->width,
    };
    job->kernels->gather_row(&gather);
}

/* One step: weights of rows from .. to - 1, then each iteration as far as the one before it allows. Iteration r writes
 * the planes that iteration r - 1 read: it is 9 rows behind, which is as far back as that one still looks. */
static quell_status step(wide_job *job, ql_env *env, uint32_t from, uint32_t to, uint32_t iterations, uint32_t *done,
                         const ql_wide_planes *const planes[2])
{
    QL_TRY(job->source->prepare(job->source->user, from, to));
    job->from = from;
    QL_TRY(ql_env_run(env, to - from, weights_task, job));
    for (uint32_t r = 0; r < iterations; ++r) {
        const uint32_t behind = QL_WIDE_RADIUS * r;
        const uint32_t limit = to == job->height ? to : to > behind ? to - behind : 0;
        if (limit <= done[r]) continue;
        job->in = planes[r % 2];
        job->out = planes[(r + 1) % 2];
        job->from = done[r];
        QL_TRY(ql_env_run(env, limit - done[r], filter_task, job));
        done[r] = limit;
    }
    return QUELL_OK;
}

quell_status ql_wide_run(const ql_kernels *kernels, ql_env *env, const ql_wide_source *source, uint32_t iterations,
                         ql_wide_planes *image, ql_wide_planes *other, ql_error *err)
{
    enum { MAX_ITERATIONS = 8 };
    const uint32_t width = image->width, height = image->height;
    const ql_wide_planes *const planes[2] = {image, other};
    uint32_t done[MAX_ITERATIONS] = {0};
    if (iterations < 1 || iterations > MAX_ITERATIONS || image->num > MAX_PLANES)
        return ql_fail(err, QUELL_ERR_INTERNAL, "%u iterations of %u planes", iterations, image->num);
    wide_job job = {.kernels = kernels, .source = source, .width = width, .height = height};
    job.num_ring_rows = ring_rows(height, iterations);
    job.ring = ql_alloc(env->memory, (size_t)job.num_ring_rows * QL_WIDE_TAPS, width * sizeof *job.ring);
    if (job.ring == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: %u rows of 19x19 kernels", job.num_ring_rows);
    const double begin = env->progress_from, end = env->progress_to;
    quell_status status = QUELL_OK;
    for (uint32_t y = 0; y < height && status == QUELL_OK; y += QL_WIDE_STEP) {
        const uint32_t to = height - y > QL_WIDE_STEP ? y + QL_WIDE_STEP : height;
        env->progress_from = begin + (end - begin) * y / height;
        env->progress_to = begin + (end - begin) * to / height;
        status = step(&job, env, y, to, iterations, done, planes);
    }
    env->progress_from = begin;
    env->progress_to = end;
    ql_free(env->memory, job.ring);
    if (status == QUELL_OK && iterations % 2) {
        const ql_wide_planes result = *other;
        *other = *image;
        *image = result;
    }
    return status;
}
