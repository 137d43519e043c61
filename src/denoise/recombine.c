/* SPDX-License-Identifier: Apache-2.0 */
/* A task is one row of the image. */
#include "denoise/recombine.h"

#include <math.h>
#include <string.h>

enum {
    NUM_COLORS = 3,
    NUM_PARTS = 3 /* of a triple: direct, indirect, colour */
};

typedef struct recombine_job {
    const ql_job *job;
    const ql_plan_set *set;
    const ql_region *region;
    float *scratch; /* per worker: NUM_PARTS rows of the image's width, for parts that no filter touched */
} recombine_job;

/* Row y of a part of Combined: its result, or its pixels (read into spare) where it needed no filter; NULL where it is
 * black. */
static const float *part_row(const recombine_job *r, int32_t role, uint32_t channel, uint32_t y, float *spare)
{
    const ql_frame *const frame = r->job->frame;
    const int32_t index = r->set->role_layer[role];
    if (index == QL_PLAN_NONE || r->job->scans[index].is_zero) return NULL;
    const float *const result = r->job->results[index];
    if (result) return result + ((size_t)channel * frame->height + y) * frame->width;
    ql_layer_read_row(&frame->layers[index], frame->width, channel, y, spare);
    return spare;
}

/* Adds (direct + indirect) * colour of a group of light to sum[x0 .. x1). */
static void add_light(const recombine_job *r, int32_t direct_role, uint32_t channel, uint32_t y, float *spare,
                      float *sum)
{
    const size_t width = r->job->frame->width, x0 = r->region->x0, x1 = r->region->x1;
    const float *const direct = part_row(r, direct_role, channel, y, spare);
    const float *const indirect = part_row(r, direct_role + 1, channel, y, spare + width);
    const float *const color = part_row(r, direct_role + 2, channel, y, spare + 2 * width);
    if (color == NULL || (direct == NULL && indirect == NULL)) return;
    if (direct && indirect)
        for (size_t x = x0; x < x1; ++x) sum[x] += (direct[x] + indirect[x]) * color[x];
    else {
        const float *const light = direct ? direct : indirect;
        for (size_t x = x0; x < x1; ++x) sum[x] += light[x] * color[x];
    }
}

static void recombine_task(void *user, uint32_t task, uint32_t worker)
{
    static const int32_t added[4] = {QUELL_ROLE_VOLUME_DIRECT, QUELL_ROLE_VOLUME_INDIRECT, QUELL_ROLE_EMISSION,
                                     QUELL_ROLE_ENVIRONMENT};
    const recombine_job *const r = user;
    const ql_frame *const frame = r->job->frame;
    const size_t x0 = r->region->x0, x1 = r->region->x1;
    const uint32_t y = r->region->y0 + task;
    float *const spare = r->scratch + (size_t)worker * NUM_PARTS * frame->width;
    float *const combined = r->job->results[r->set->role_layer[QUELL_ROLE_COMBINED]];
    const uint32_t num_added = r->set->combined == QL_COMBINED_PASSES_ENVIRONMENT ? 4 : 3;
    for (uint32_t c = 0; c < NUM_COLORS; ++c) {
        float *const sum = combined + ((size_t)c * frame->height + y) * frame->width;
        memset(sum + x0, 0, (x1 - x0) * sizeof *sum);
        add_light(r, QUELL_ROLE_DIFFUSE_DIRECT, c, y, spare, sum);
        add_light(r, QUELL_ROLE_GLOSSY_DIRECT, c, y, spare, sum);
        add_light(r, QUELL_ROLE_TRANSMISSION_DIRECT, c, y, spare, sum);
        for (uint32_t i = 0; i < num_added; ++i) {
            const float *const part = part_row(r, added[i], c, y, spare);
            for (size_t x = x0; part && x < x1; ++x) sum[x] += part[x];
        }
        /* Light times colour may be more than a float holds, though each is valid. */
        for (size_t x = x0; x < x1; ++x) sum[x] = fminf(fmaxf(sum[x], -QL_ABSURD), QL_ABSURD);
    }
}

quell_status ql_recombine(const ql_job *job, ql_env *env, const ql_plan_set *set, const ql_region *region,
                          ql_error *err)
{
    recombine_job r = {.job = job, .set = set, .region = region};
    r.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool),
                         (size_t)NUM_PARTS * job->frame->width * sizeof *r.scratch);
    if (r.scratch == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of Combined's parts");
    const quell_status status = ql_env_run(env, region->y1 - region->y0, recombine_task, &r);
    ql_free(env->memory, r.scratch);
    return status;
}
