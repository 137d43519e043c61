/* SPDX-License-Identifier: Apache-2.0 */
/* How well the light passes of a frame add up to its Combined. */
#include "denoise/closure.h"

#include <math.h>
#include <string.h>

enum { CLOSURE_ROWS = 10 }; /* Combined, the sum of its parts, a part's three, which pixels count */

/* Mean of |sum of passes - Combined| relative to Combined, for the plan; fixed order of summation, one thread per row
 * band is not worth it: it reads what the scan has just read. */
typedef struct closure_job {
    const ql_frame *frame;
    const ql_scan *scans;
    const ql_plan_set *set;
    float *scratch;
    size_t scratch_floats;
    double *sums; /* [height][3]: without Environment, with it, Combined */
} closure_job;

/* Whether a pixel's parts and Combined are all as they were rendered: sets is_sound[x] for row y. A bad pixel or a firefly
 * in one of them says nothing about the rest of the image. */
static void find_sound(const closure_job *job, uint32_t y, float *is_sound)
{
    const int32_t *const role = job->set->role_layer;
    for (uint32_t x = 0; x < job->frame->width; ++x) is_sound[x] = 1.0f;
    for (int32_t r = QUELL_ROLE_COMBINED; r <= QUELL_ROLE_ENVIRONMENT; ++r) {
        const int32_t index = r == QUELL_ROLE_COMBINED ? job->set->beauty : role[r];
        if (index == QL_PLAN_NONE || job->scans[index].row_start == NULL) continue;
        const ql_scan *const scan = &job->scans[index];
        for (uint64_t i = scan->row_start[y]; i < scan->row_start[y + 1]; ++i) is_sound[scan->fixes[i].x] = 0.0f;
    }
}

static void closure_task(void *user, uint32_t task, uint32_t worker)
{
    const closure_job *const job = user;
    const ql_frame *const frame = job->frame;
    const uint32_t width = frame->width;
    float *const base = job->scratch + worker * job->scratch_floats;
    float *rows[CLOSURE_ROWS];
    for (uint32_t i = 0; i < CLOSURE_ROWS; ++i) rows[i] = base + (size_t)i * width;
    const ql_layer *const combined = &frame->layers[job->set->beauty];
    const int32_t *const role = job->set->role_layer;
    for (uint32_t c = 0; c < 3; ++c) {
        ql_layer_read_row(combined, width, c, task, rows[c]);
        memset(rows[3 + c], 0, width * sizeof *rows[0]);
    }
    for (int32_t r = QUELL_ROLE_DIFFUSE_DIRECT; r <= QUELL_ROLE_TRANSMISSION_DIRECT; r += 3) {
        for (uint32_t c = 0; c < 3; ++c) {
            for (int32_t i = 0; i < 3; ++i) ql_layer_read_row(&frame->layers[role[r + i]], width, c, task, rows[6 + i]);
            for (uint32_t x = 0; x < width; ++x) rows[3 + c][x] += (rows[6][x] + rows[7][x]) * rows[8][x];
        }
    }
    for (int32_t r = QUELL_ROLE_VOLUME_DIRECT; r <= QUELL_ROLE_EMISSION; ++r) {
        if (role[r] == QL_PLAN_NONE) continue;
        for (uint32_t c = 0; c < 3; ++c) {
            ql_layer_read_row(&frame->layers[role[r]], width, c, task, rows[6]);
            for (uint32_t x = 0; x < width; ++x) rows[3 + c][x] += rows[6][x];
        }
    }
    find_sound(job, task, rows[9]);
    double *const sums = job->sums + 3 * (size_t)task;
    sums[0] = sums[1] = sums[2] = 0.0;
    for (uint32_t c = 0; c < 3; ++c) {
        if (role[QUELL_ROLE_ENVIRONMENT] != QL_PLAN_NONE)
            ql_layer_read_row(&frame->layers[role[QUELL_ROLE_ENVIRONMENT]], width, c, task, rows[6]);
        else
            memset(rows[6], 0, width * sizeof *rows[6]);
        for (uint32_t x = 0; x < width; ++x) {
            const float value = rows[c][x], without = fabsf(rows[3 + c][x] - value);
            const float with = fabsf(rows[3 + c][x] + rows[6][x] - value);
            /* Half floats end at 65504, where sums no longer tell. */
            if (rows[9][x] == 0.0f || !isfinite(without) || !isfinite(with) || fabsf(value) > 6e4f) continue;
            sums[0] += (double)without;
            sums[1] += (double)with;
            sums[2] += (double)fabsf(value);
        }
    }
}

quell_status ql_measure_closure(ql_env *env, const ql_frame *frame, const ql_scan *scans, const ql_plan_set *set,
                                double closure[2], ql_error *err)
{
    closure_job job = {
        .frame = frame, .scans = scans, .set = set, .scratch_floats = CLOSURE_ROWS * (size_t)frame->width};
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job.scratch_floats * sizeof(float));
    job.sums = ql_alloc(env->memory, frame->height, 3 * sizeof *job.sums);
    quell_status status = QUELL_OK;
    if (job.scratch == NULL || job.sums == NULL)
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of passes");
    else
        status = ql_env_run(env, frame->height, closure_task, &job);
    double sums[3] = {0.0, 0.0, 0.0};
    for (size_t i = 0; status == QUELL_OK && i < 3 * (size_t)frame->height; ++i) sums[i % 3] += job.sums[i];
    ql_free(env->memory, job.scratch);
    ql_free(env->memory, job.sums);
    for (int i = 0; i < 2; ++i) closure[i] = sums[2] > 0.0 ? sums[i] / sums[2] : sums[i] > 0.0 ? INFINITY : 0.0;
    return status;
}
