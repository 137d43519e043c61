/* SPDX-License-Identifier: Apache-2.0 */
/* The embedding of each level: what the finer one has in the mean, and the body's share. */
#include "models/quell_window.h"

#include <string.h>

typedef struct embed_job {
    const ql_conv *conv;
    const ql_kernels *kernels;
    const ql_map *map;
    uint32_t x;                      /* pixel of the map that the planes begin at */
    const ql_planes *finer, *pooled; /* the level that this one starts from, and its means; NULL at full resolution */
    const ql_planes *out;
    float *scratch; /* [workers][2 QL_HEAD_BUFFER] */
} embed_job;

/* Adds the head's share to row y of the embedding, at full resolution to the two rows of row y of the map. */
static void add_head(const embed_job *job, uint32_t y, float *buffer)
{
    const ql_planes *const out = job->out;
    const uint32_t group = job->finer ? 1 : 2, width = out->width / group;
    float *const planes = buffer + QL_HEAD_BUFFER;
    for (uint32_t x = 0; x < width; x += QL_HEAD_SPAN) {
        const uint32_t num = width - x < QL_HEAD_SPAN ? width - x : QL_HEAD_SPAN;
        ql_conv_apply_row(job->conv, job->kernels, job->map, job->x + x, y, num, 0, buffer);
        for (uint32_t dy = 0; dy < group; ++dy) {
            job->kernels->planes_row(buffer + (size_t)dy * QL_NET_DIMS * group, job->conv->num_out, QL_NET_DIMS, group,
                                     planes, (size_t)num * group, num);
            for (uint32_t e = 0; e < QL_NET_DIMS; ++e) {
                float *const to = ql_planes_row(out, e, y * group + dy) + (size_t)x * group;
                const float *const from = planes + (size_t)e * num * group;
                for (size_t i = 0; i < (size_t)num * group; ++i) to[i] += from[i];
            }
        }
    }
}

/* A row of the finer level's means, and the row of the embedding that starts from it. */
static void pool_row(const embed_job *job, uint32_t y)
{
    for (uint32_t e = 0; e < QL_NET_DIMS; ++e) {
        const float *const upper = ql_planes_row(job->finer, e, 2 * y), *const lower = upper + job->finer->stride;
        float *const mean = ql_planes_row(job->pooled, e, y);
        for (size_t x = 0; x < job->pooled->width; ++x)
            mean[x] = 0.25f * (upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1]);
        memcpy(ql_planes_row(job->out, e, y), mean, job->out->width * sizeof *mean);
    }
}

static void embed_task(void *user, uint32_t task, uint32_t worker)
{
    const embed_job *const job = user;
    if (job->finer) pool_row(job, task);
    add_head(job, task, job->scratch + (size_t)worker * 2 * QL_HEAD_BUFFER);
}

static uint64_t scratch_bytes(uint32_t num_workers)
{
    return (uint64_t)num_workers * 2 * QL_HEAD_BUFFER * sizeof(float);
}

static quell_status alloc_scratch(ql_env *env, float **scratch, ql_error *err)
{
    *scratch = ql_alloc(env->memory, scratch_bytes(ql_pool_num_threads(env->pool)), 1);
    return *scratch ? QUELL_OK : ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of the embedding");
}

quell_status ql_net_embed(const ql_net *net, const ql_kernels *kernels, ql_env *env, ql_net_maps *maps, ql_error *err)
{
    embed_job job = {.conv = &net->embedding[0], .kernels = kernels, .map = &maps->level[0], .out = &maps->embedding};
    quell_status status = alloc_scratch(env, &job.scratch, err);
    if (status == QUELL_OK) status = ql_env_run(env, job.map->height, embed_task, &job);
    ql_free(env->memory, job.scratch);
    return status;
}

quell_status ql_net_window_open(const ql_net *net, const ql_kernels *kernels, ql_env *env, const ql_net_maps *maps,
                                uint32_t x, uint32_t width, ql_net_window *window, ql_error *err)
{
    float *scratch;
    *window = (ql_net_window){.maps = maps, .x = x, .width = width};
    window->embedding[0] = maps->embedding;
    window->embedding[0].data += x;
    window->embedding[0].width = width;
    quell_status status = alloc_scratch(env, &scratch, err);
    for (uint32_t l = 1; l <= QL_NET_LEVELS && status == QUELL_OK; ++l) {
        const ql_map *const map = &maps->level[l - 1];
        ql_planes *const out = &window->embedding[l], *const pooled = &window->pooled[l - 1];
        status = ql_planes_create(out, width >> l, map->height, QL_NET_DIMS, QL_NET_MARGIN, env->memory, err);
        if (status == QUELL_OK)
            status = ql_planes_create(pooled, width >> l, map->height, QL_NET_DIMS, QL_NET_MARGIN, env->memory, err);
        embed_job job = {&net->embedding[l], kernels, map, x >> l, &window->embedding[l - 1], pooled, out, scratch};
        if (status == QUELL_OK) status = ql_env_run(env, map->height, embed_task, &job);
    }
    ql_free(env->memory, scratch);
    return status;
}

void ql_net_window_close(ql_net_window *window, ql_memory *memory)
{
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        ql_planes_destroy(&window->embedding[l + 1], memory);
        ql_planes_destroy(&window->pooled[l], memory);
    }
}

uint64_t ql_net_window_bytes(uint32_t width, uint32_t height, uint32_t num_workers)
{
    uint64_t bytes = scratch_bytes(num_workers);
    for (uint32_t l = 1; l <= QL_NET_LEVELS; ++l)
        bytes += 2 * (uint64_t)ql_planes_bytes(width >> l, height >> l, QL_NET_DIMS, QL_NET_MARGIN);
    return bytes;
}
