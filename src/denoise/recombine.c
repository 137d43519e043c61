/* SPDX-License-Identifier: Apache-2.0 */
/* A task is two rows of the image: they share one row of the network's mixing head. */
#include "denoise/recombine.h"

#include <string.h>

enum {
    NUM_COLORS = 3,
    NUM_PARTS = 3,               /* of a triple: direct, indirect, colour */
    SPARE_ROWS = NUM_PARTS + 1,  /* parts that no filter touched, and the sum */
    FINE_SPAN = 2 * QL_HEAD_SPAN /* pixels that one call of the head answers for */
};

typedef struct recombine_job {
    const ql_job *job;
    const ql_plan_set *set;
    const ql_net_maps *maps;
    const ql_region *region;
    float *scratch; /* per worker: QL_HEAD_BUFFER, SPARE_ROWS rows of the image's width, two rows of weights */
    size_t scratch_floats;
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

/* The network's weights of the parts for rows y (even in the region) and y + 1, pixels x0 .. x1, where out[0] is x0. */
static void read_weights(const recombine_job *r, uint32_t y, float *buffer, float *out, size_t out_stride)
{
    const ql_region *const region = r->region;
    const uint32_t half_row = (y - region->ry) / 2;
    float logits[2 * FINE_SPAN];
    for (uint32_t x = region->x0; x < region->x1; x += FINE_SPAN) {
        const uint32_t left = region->x1 - x, num = left < FINE_SPAN ? left : FINE_SPAN, num_half = (num + 1) / 2;
        ql_net_fine_logits(r->job->net, r->job->kernels, r->maps, 0, QL_HEAD_MIX, (x - region->rx) / 2, half_row,
                           num_half, buffer, logits);
        for (size_t dy = 0; dy < 2; ++dy)
            r->job->kernels->sigmoid_row(logits + dy * 2 * num_half, out + dy * out_stride + (x - region->x0), num);
    }
}

static void recombine_row(const recombine_job *r, uint32_t y, const float *weight, float *spare)
{
    static const int32_t added[4] = {QUELL_ROLE_VOLUME_DIRECT, QUELL_ROLE_VOLUME_INDIRECT, QUELL_ROLE_EMISSION,
                                     QUELL_ROLE_ENVIRONMENT};
    const ql_frame *const frame = r->job->frame;
    const size_t x0 = r->region->x0, x1 = r->region->x1;
    float *const sum = spare + (size_t)NUM_PARTS * frame->width;
    float *const combined = r->job->results[r->set->role_layer[QUELL_ROLE_COMBINED]];
    const uint32_t num_added = r->set->combined == QL_COMBINED_PASSES_ENVIRONMENT ? 4 : 3;
    for (uint32_t c = 0; c < NUM_COLORS; ++c) {
        memset(sum + x0, 0, (x1 - x0) * sizeof *sum);
        add_light(r, QUELL_ROLE_DIFFUSE_DIRECT, c, y, spare, sum);
        add_light(r, QUELL_ROLE_GLOSSY_DIRECT, c, y, spare, sum);
        add_light(r, QUELL_ROLE_TRANSMISSION_DIRECT, c, y, spare, sum);
        for (uint32_t i = 0; i < num_added; ++i) {
            const float *const part = part_row(r, added[i], c, y, spare);
            for (size_t x = x0; part && x < x1; ++x) sum[x] += part[x];
        }
        float *const out = combined + ((size_t)c * frame->height + y) * frame->width;
        for (size_t x = x0; x < x1; ++x) out[x] = weight[x - x0] * sum[x] + (1.0f - weight[x - x0]) * out[x];
    }
}

static void recombine_task(void *user, uint32_t task, uint32_t worker)
{
    const recombine_job *const r = user;
    const size_t width = r->job->frame->width;
    float *const buffer = r->scratch + worker * r->scratch_floats, *const spare = buffer + QL_HEAD_BUFFER;
    float *const weights = spare + SPARE_ROWS * width;
    const uint32_t y = r->region->y0 + 2 * task;
    read_weights(r, y, buffer, weights, width);
    for (uint32_t dy = 0; dy < 2 && y + dy < r->region->y1; ++dy) recombine_row(r, y + dy, weights + dy * width, spare);
}

quell_status ql_recombine(const ql_job *job, ql_env *env, const ql_plan_set *set, const ql_net_maps *maps,
                          const ql_region *region, ql_error *err)
{
    recombine_job r = {.job = job, .set = set, .maps = maps, .region = region};
    r.scratch_floats =
        QL_HEAD_BUFFER + ((SPARE_ROWS + 2) * (size_t)job->frame->width + QL_BLOCK - 1) / QL_BLOCK * QL_BLOCK;
    r.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), r.scratch_floats * sizeof *r.scratch);
    if (r.scratch == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of Combined's parts");
    const quell_status status = ql_env_run(env, (region->y1 - region->y0 + 1) / 2, recombine_task, &r);
    ql_free(env->memory, r.scratch);
    return status;
}
