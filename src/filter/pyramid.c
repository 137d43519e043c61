/* SPDX-License-Identifier: Apache-2.0 */
/* Runs the kernel pyramid level by level, rows in parallel. */
#include "filter/pyramid.h"

#include <string.h>

enum { MARGIN = QL_PYRAMID_MARGIN /* zeros round a plane: the reach of a 5x5 kernel */, TABLE_TAPS = 9 };

typedef struct level {
    uint32_t width, height;
    size_t stride; /* floats between rows, margins included */
    float *x, *y;  /* [planes][height + 2 MARGIN][stride]; y from level 1 on */
    float *logits; /* [height][num_logit_planes][width], from level 1 on; sharpness is no logarithm any more */
} level;

typedef struct pyramid {
    const ql_kernels *kernels;
    const ql_pyramid_source *source;
    uint32_t num_planes, current;
    level levels[QL_PYRAMID_LEVELS];
    float *scratch; /* [workers][scratch_floats] */
    size_t scratch_floats;
} pyramid;

static size_t plane_floats(const level *l)
{
    return ((size_t)l->height + 2 * MARGIN) * l->stride;
}

static float *plane_row(const level *l, float *planes, uint32_t plane, uint32_t y)
{
    return planes + plane * plane_floats(l) + (y + MARGIN) * l->stride + MARGIN;
}

static uint32_t num_logit_planes(uint32_t index, uint32_t num_dims)
{
    return num_dims + (index + 1 < QL_PYRAMID_LEVELS ? QL_FIELD_PARTITION : QL_FIELD_CENTRE) + 1;
}

/* Sharpness of row y; its other fields follow plane by plane. */
static float *logits_row(const pyramid *p, uint32_t index, uint32_t y)
{
    const level *const l = &p->levels[index];
    return l->logits + (size_t)y * num_logit_planes(index, p->source->num_dims) * l->width;
}

static const float *field_row(const pyramid *p, uint32_t index, uint32_t y, uint32_t field)
{
    return logits_row(p, index, y) + (size_t)(p->source->num_dims + field) * p->levels[index].width;
}

ql_affinity ql_pyramid_affinity(const ql_pyramid_level *guide, uint32_t num_dims, uint32_t x, uint32_t y,
                                const float *sharpness, size_t sharpness_plane)
{
    const float *const here = guide->embedding + (ptrdiff_t)y * guide->stride + x;
    return (ql_affinity){here, guide->plane, here, guide->plane, guide->stride, sharpness, sharpness_plane, num_dims};
}

ql_affinity ql_pyramid_parent_affinity(const ql_pyramid_level *guide, uint32_t num_dims, uint32_t x, uint32_t y,
                                       const float *sharpness, size_t sharpness_plane)
{
    ql_affinity affinity = ql_pyramid_affinity(guide, num_dims, x, y, sharpness, sharpness_plane);
    affinity.other = guide->pooled + (ptrdiff_t)(y / 2) * guide->pooled_stride + x / 2;
    affinity.other_plane = guide->pooled_plane;
    affinity.other_stride = guide->pooled_stride;
    return affinity;
}

static const float *up_table(const ql_pyramid_level *guide, uint32_t y, uint32_t x)
{
    return guide->up_table + (size_t)(y % 2 * 2 + x % 2) * TABLE_TAPS;
}

/* Weighted values of two fine rows and the cells below them. */
static void fine_down_task(void *user, uint32_t task, uint32_t worker)
{
    pyramid *const p = user;
    const level *const fine = &p->levels[0], *const coarse = &p->levels[1];
    const uint32_t width = fine->width;
    float *const logits = p->scratch + worker * p->scratch_floats; /* [2][2][2 SPAN] */
    float *const partition = logits + 8 * QL_PYRAMID_SPAN;         /* [2][width] */
    float *const importance = partition + 2 * (size_t)width;       /* [2][width] */
    for (uint32_t x = 0; x < width / 2; x += QL_PYRAMID_SPAN) {
        const uint32_t num = width / 2 - x < QL_PYRAMID_SPAN ? width / 2 - x : QL_PYRAMID_SPAN;
        p->source->fine(p->source->user, 0, x, task, num, worker, logits);
        for (size_t dy = 0; dy < 2; ++dy) {
            const float *const from = logits + dy * 4 * num;
            memcpy(partition + dy * width + 2 * x, from, 2 * num * sizeof *from);
            p->kernels->sigmoid_row(from + 2 * num, importance + dy * width + 2 * x, 2 * num);
        }
    }
    float *rows[QL_PYRAMID_MAX_PLANES];
    for (uint32_t dy = 0; dy < 2; ++dy) {
        for (uint32_t c = 0; c < p->num_planes; ++c) rows[c] = plane_row(fine, fine->x, c, 2 * task + dy);
        p->source->values(p->source->user, 2 * task + dy, importance + dy * width, worker, rows);
    }
    const float *in[QL_PYRAMID_MAX_PLANES];
    for (uint32_t c = 0; c < p->num_planes; ++c) {
        in[c] = plane_row(fine, fine->x, c, 2 * task);
        rows[c] = plane_row(coarse, coarse->x, c, task);
    }
    const ql_partition_row down = {
        .logits = {partition, partition + width},
        .in = in,
        .in_stride = (ptrdiff_t)fine->stride,
        .out = rows,
        .num_channels = p->num_planes,
        .num_cells = coarse->width,
    };
    p->kernels->partition_row(&down);
}

static void logits_task(void *user, uint32_t task, uint32_t worker)
{
    pyramid *const p = user;
    float *const row = logits_row(p, p->current, task);
    p->source->coarse(p->source->user, p->current, task, worker, row);
    p->kernels->exp_row(row, row, p->source->num_dims * p->levels[p->current].width);
}

static void coarse_down_task(void *user, uint32_t task, uint32_t worker)
{
    pyramid *const p = user;
    const uint32_t index = p->current;
    const level *const fine = &p->levels[index], *const coarse = &p->levels[index + 1];
    const float *in[QL_PYRAMID_MAX_PLANES];
    float *out[QL_PYRAMID_MAX_PLANES];
    (void)worker;
    for (uint32_t c = 0; c < p->num_planes; ++c) {
        in[c] = plane_row(fine, fine->x, c, 2 * task);
        out[c] = plane_row(coarse, coarse->x, c, task);
    }
    const ql_partition_row down = {
        .logits = {field_row(p, index, 2 * task, QL_FIELD_PARTITION),
                   field_row(p, index, 2 * task + 1, QL_FIELD_PARTITION)},
        .in = in,
        .in_stride = (ptrdiff_t)fine->stride,
        .out = out,
        .num_channels = p->num_planes,
        .num_cells = coarse->width,
    };
    p->kernels->partition_row(&down);
}

static void coarse_up_task(void *user, uint32_t task, uint32_t worker)
{
    pyramid *const p = user;
    const uint32_t index = p->current;
    const level *const here = &p->levels[index];
    const ql_pyramid_level *const guide = &p->source->levels[index];
    const uint32_t num_dims = p->source->num_dims;
    const float *const sharpness = logits_row(p, index, task);
    const float *in[QL_PYRAMID_MAX_PLANES];
    float *out[QL_PYRAMID_MAX_PLANES];
    (void)worker;
    for (uint32_t c = 0; c < p->num_planes; ++c) {
        in[c] = plane_row(here, here->x, c, task);
        out[c] = plane_row(here, here->y, c, task);
    }
    const ql_filter_row filter = {
        .affinity = ql_pyramid_affinity(guide, num_dims, 0, task, sharpness, here->width),
        .centre = field_row(p, index, task, QL_FIELD_CENTRE),
        .table = guide->table,
        .in = in,
        .in_stride = (ptrdiff_t)here->stride,
        .out = out,
        .num_channels = p->num_planes,
        .num_pixels = here->width,
    };
    p->kernels->filter_row(&filter);
    if (index + 1 == QL_PYRAMID_LEVELS) return;
    const level *const coarse = &p->levels[index + 1];
    for (uint32_t c = 0; c < p->num_planes; ++c) in[c] = plane_row(coarse, coarse->y, c, task / 2);
    const ql_upsample_row up = {
        .affinity = ql_pyramid_parent_affinity(guide, num_dims, 0, task, sharpness, here->width),
        .blend = field_row(p, index, task, QL_FIELD_BLEND),
        .table = {up_table(guide, task, 0), up_table(guide, task, 1)},
        .in = in,
        .in_stride = (ptrdiff_t)coarse->stride,
        .out = out,
        .num_channels = p->num_planes,
        .num_pixels = here->width,
    };
    p->kernels->upsample_row(&up);
}

/* Sharpness, centre and blend. */
static uint32_t num_fine_fields(uint32_t num_dims)
{
    return num_dims + QL_FIELD_BLEND + 1;
}

static void fine_up_task(void *user, uint32_t task, uint32_t worker)
{
    pyramid *const p = user;
    const level *const fine = &p->levels[0], *const coarse = &p->levels[1];
    const ql_pyramid_level *const guide = &p->source->levels[0];
    const uint32_t num_dims = p->source->num_dims, fields = num_fine_fields(num_dims);
    float *const logits = p->scratch + worker * p->scratch_floats; /* [2][fields][2 SPAN] */
    float *const rows = logits + (size_t)fields * 4 * QL_PYRAMID_SPAN;
    const float *in[QL_PYRAMID_MAX_PLANES], *parents[QL_PYRAMID_MAX_PLANES];
    float *out[QL_PYRAMID_MAX_PLANES];
    for (uint32_t c = 0; c < p->num_planes; ++c) out[c] = rows + (size_t)c * 2 * QL_PYRAMID_SPAN;
    for (uint32_t x = 0; x < fine->width / 2; x += QL_PYRAMID_SPAN) {
        const uint32_t left = fine->width / 2 - x, num = left < QL_PYRAMID_SPAN ? left : QL_PYRAMID_SPAN;
        p->source->fine(p->source->user, 1, x, task, num, worker, logits);
        for (uint32_t dy = 0; dy < 2; ++dy) {
            const uint32_t y = 2 * task + dy;
            float *const l = logits + (size_t)dy * fields * 2 * num;
            p->kernels->exp_row(l, l, num_dims * 2 * num);
            for (uint32_t c = 0; c < p->num_planes; ++c) {
                in[c] = plane_row(fine, fine->x, c, y) + 2 * x;
                parents[c] = plane_row(coarse, coarse->y, c, task) + x;
            }
            const ql_filter_row filter = {
                .affinity = ql_pyramid_affinity(guide, num_dims, 2 * x, y, l, 2 * num),
                .centre = l + (size_t)(num_dims + QL_FIELD_CENTRE) * 2 * num,
                .table = guide->table,
                .in = in,
                .in_stride = (ptrdiff_t)fine->stride,
                .out = out,
                .num_channels = p->num_planes,
                .num_pixels = 2 * num,
            };
            p->kernels->filter_row(&filter);
            const ql_upsample_row up = {
                .affinity = ql_pyramid_parent_affinity(guide, num_dims, 2 * x, y, l, 2 * num),
                .blend = l + (size_t)(num_dims + QL_FIELD_BLEND) * 2 * num,
                .table = {up_table(guide, y, 0), up_table(guide, y, 1)},
                .in = parents,
                .in_stride = (ptrdiff_t)coarse->stride,
                .out = out,
                .num_channels = p->num_planes,
                .num_pixels = 2 * num,
            };
            p->kernels->upsample_row(&up);
            p->source->finish(p->source->user, y, 2 * x, 2 * num, worker, (const float *const *)out);
        }
    }
}

static size_t scratch_floats(uint32_t width, uint32_t num_planes, uint32_t num_dims)
{
    const size_t down = 8 * QL_PYRAMID_SPAN + 4 * (size_t)width;
    const size_t up = (4 * (size_t)num_fine_fields(num_dims) + 2 * (size_t)num_planes) * QL_PYRAMID_SPAN;
    return ((down > up ? down : up) + 15) / 16 * 16;
}

static quell_status allocate(pyramid *p, ql_env *env, uint32_t width, uint32_t height, ql_error *err)
{
    for (uint32_t i = 0; i < QL_PYRAMID_LEVELS; ++i) {
        level *const l = &p->levels[i];
        l->width = width >> i;
        l->height = height >> i;
        l->stride = (size_t)l->width + 2 * MARGIN;
        l->x = ql_alloc_zero(env->memory, p->num_planes, plane_floats(l) * sizeof *l->x);
        if (i > 0) {
            l->y = ql_alloc_zero(env->memory, p->num_planes, plane_floats(l) * sizeof *l->y);
            l->logits = ql_alloc(env->memory, (size_t)l->height * num_logit_planes(i, p->source->num_dims),
                                 l->width * sizeof *l->logits);
        }
        if (l->x == NULL || (i > 0 && (l->y == NULL || l->logits == NULL)))
            return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: a kernel pyramid of %ux%u", width, height);
    }
    p->scratch_floats = scratch_floats(width, p->num_planes, p->source->num_dims);
    p->scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), p->scratch_floats * sizeof *p->scratch);
    if (p->scratch == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: scratch of a kernel pyramid");
    return QUELL_OK;
}

static quell_status run(pyramid *p, ql_env *env)
{
    QL_TRY(ql_env_run(env, p->levels[1].height, fine_down_task, p));
    for (p->current = 1; p->current < QL_PYRAMID_LEVELS; ++p->current) {
        QL_TRY(ql_env_run(env, p->levels[p->current].height, logits_task, p));
        if (p->current + 1 < QL_PYRAMID_LEVELS)
            QL_TRY(ql_env_run(env, p->levels[p->current + 1].height, coarse_down_task, p));
    }
    for (p->current = QL_PYRAMID_LEVELS - 1; p->current > 0; --p->current)
        QL_TRY(ql_env_run(env, p->levels[p->current].height, coarse_up_task, p));
    return ql_env_run(env, p->levels[1].height, fine_up_task, p);
}

quell_status ql_pyramid_run(const ql_kernels *kernels, ql_env *env, uint32_t width, uint32_t height,
                            uint32_t num_planes, const ql_pyramid_source *source, ql_error *err)
{
    pyramid p = {.kernels = kernels, .source = source, .num_planes = num_planes};
    quell_status status = allocate(&p, env, width, height, err);
    if (status == QUELL_OK) status = run(&p, env);
    for (uint32_t i = 0; i < QL_PYRAMID_LEVELS; ++i) {
        ql_free(env->memory, p.levels[i].x);
        ql_free(env->memory, p.levels[i].y);
        ql_free(env->memory, p.levels[i].logits);
    }
    ql_free(env->memory, p.scratch);
    return status;
}

uint64_t ql_pyramid_peak_bytes(uint32_t width, uint32_t height, uint32_t num_planes, uint32_t num_dims,
                               uint32_t num_workers)
{
    uint64_t floats = (uint64_t)num_workers * scratch_floats(width, num_planes, num_dims);
    for (uint32_t i = 0; i < QL_PYRAMID_LEVELS; ++i) {
        const level l = {.width = width >> i, .height = height >> i, .stride = (width >> i) + 2 * MARGIN};
        floats += (uint64_t)num_planes * plane_floats(&l) * (i > 0 ? 2 : 1);
        if (i > 0) floats += (uint64_t)l.height * num_logit_planes(i, num_dims) * l.width;
    }
    return floats * sizeof(float);
}
