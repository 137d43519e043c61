/* SPDX-License-Identifier: Apache-2.0 */
/* Runs 5x5 kernels of one level. */
#include "filter/narrow.h"

enum { MARGIN = QL_PYRAMID_MARGIN };

typedef struct narrow {
    const ql_kernels *kernels;
    const ql_pyramid_source *source;
    uint32_t num_planes, width, height;
    size_t stride, plane_floats, scratch_floats;
    float *x, *scratch;
} narrow;

static float *plane_row(const narrow *n, uint32_t plane, uint32_t y)
{
    return n->x + plane * n->plane_floats + (y + MARGIN) * n->stride + MARGIN;
}

static void values_task(void *user, uint32_t task, uint32_t worker)
{
    const narrow *const n = user;
    float *rows[QL_PYRAMID_MAX_PLANES];
    for (uint32_t c = 0; c < n->num_planes; ++c) rows[c] = plane_row(n, c, task);
    n->source->values(n->source->user, task, NULL, worker, rows);
}

/* Sharpness and centre. */
static uint32_t num_fields(uint32_t num_dims)
{
    return num_dims + QL_FIELD_CENTRE + 1;
}

static void filter_task(void *user, uint32_t task, uint32_t worker)
{
    const narrow *const n = user;
    const uint32_t num_dims = n->source->num_dims, fields = num_fields(num_dims);
    float *const logits = n->scratch + worker * n->scratch_floats; /* [2][fields][2 SPAN] */
    float *const rows = logits + (size_t)fields * 4 * QL_PYRAMID_SPAN;
    const float *in[QL_PYRAMID_MAX_PLANES];
    float *out[QL_PYRAMID_MAX_PLANES];
    for (uint32_t c = 0; c < n->num_planes; ++c) out[c] = rows + (size_t)c * 2 * QL_PYRAMID_SPAN;
    for (uint32_t x = 0; x < n->width / 2; x += QL_PYRAMID_SPAN) {
        const uint32_t left = n->width / 2 - x, num = left < QL_PYRAMID_SPAN ? left : QL_PYRAMID_SPAN;
        n->source->fine(n->source->user, 0, x, task, num, worker, logits);
        for (uint32_t dy = 0; dy < 2; ++dy) {
            for (uint32_t c = 0; c < n->num_planes; ++c) in[c] = plane_row(n, c, 2 * task + dy) + 2 * x;
            float *const l = logits + (size_t)dy * fields * 2 * num;
            n->kernels->exp_row(l, l, num_dims * 2 * num);
            const ql_filter_row filter = {
                .affinity =
                    ql_pyramid_affinity(&n->source->levels[0], num_dims, 2 * x, 2 * task + dy, l, 2 * (size_t)num),
                .centre = l + (size_t)num_dims * 2 * num,
                .table = n->source->levels[0].table,
                .in = in,
                .in_stride = (ptrdiff_t)n->stride,
                .out = out,
                .num_channels = n->num_planes,
                .num_pixels = 2 * num,
            };
            n->kernels->filter_row(&filter);
            n->source->finish(n->source->user, 2 * task + dy, 2 * x, 2 * num, worker, (const float *const *)out);
        }
    }
}

static void set_sizes(narrow *n, uint32_t num_dims)
{
    n->stride = (size_t)n->width + 2 * MARGIN;
    n->plane_floats = ((size_t)n->height + 2 * MARGIN) * n->stride;
    n->scratch_floats = (4 * (size_t)num_fields(num_dims) + 2 * (size_t)n->num_planes) * QL_PYRAMID_SPAN;
}

quell_status ql_narrow_run(const ql_kernels *kernels, ql_env *env, uint32_t width, uint32_t height, uint32_t num_planes,
                           const ql_pyramid_source *source, ql_error *err)
{
    narrow n = {.kernels = kernels, .source = source, .num_planes = num_planes, .width = width, .height = height};
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    set_sizes(&n, source->num_dims);
    n.x = ql_alloc_zero(env->memory, num_planes, n.plane_floats * sizeof *n.x);
    n.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), n.scratch_floats * sizeof *n.scratch);
    if (n.x == NULL || n.scratch == NULL)
        ql_fail(err, status, "out of memory: %u planes of %ux%u", num_planes, width, height);
    else
        status = ql_env_run(env, height, values_task, &n);
    if (status == QUELL_OK) status = ql_env_run(env, height / 2, filter_task, &n);
    ql_free(env->memory, n.x);
    ql_free(env->memory, n.scratch);
    return status;
}

uint64_t ql_narrow_bytes(uint32_t width, uint32_t height, uint32_t num_planes, uint32_t num_dims, uint32_t num_workers)
{
    narrow n = {.num_planes = num_planes, .width = width, .height = height};
    set_sizes(&n, num_dims);
    return ((uint64_t)num_planes * n.plane_floats + (uint64_t)num_workers * n.scratch_floats) * sizeof(float);
}
