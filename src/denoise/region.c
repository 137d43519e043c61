/* SPDX-License-Identifier: Apache-2.0 */
/* Features of a region, the network, then group by group the filters; Combined comes last, when its parts are there
 * (recombine.c puts it together). */
#include "denoise/region.h"

#include "base/clock.h"
#include "denoise/recombine.h"
#include "filter/pyramid.h"
#include "frame/roles.h"
#include "models/quell_detail.h"
#include "models/quell_stem.h"
#include "models/quell_window.h"

#include <math.h>
#include <string.h>

enum {
    FEATURE_ROWS = 48, /* rows of scratch that one row of features is made from */
    VALUE_ROWS = 12,   /* ... that one row of values is made from */
    DIVISOR_ROW = 4,   /* of these, the first of four for the albedo */
    MAX_BATCH = 8,     /* layers filtered at a time */
    MAX_COLORS = 3
};

/* Added to the albedo that Combined is divided by: what is black has highlights still. training/models/quell.py */
#define ALBEDO_EPSILON 0.02f
/* Weights below it are none: importance is at least e^-12, so only bad pixels and black colours get there.
 * training/models/quell.py: divide */
#define MIN_WEIGHT 1e-20f

/* One layer in a batch: where its planes are. */
typedef struct member {
    int32_t layer; /* whose result is written */
    const ql_layer *source;
    const ql_scan *scan;
    float *result;        /* [channel][y][x] from pixel (x0, y0) on */
    size_t plane, stride; /* of the result, in floats */
    uint32_t x0, y0;
    uint32_t num_channels; /* filtered: 3 colours, and alpha where it varies */
    uint32_t first_plane, weight_plane;
    uint32_t alpha_weight_plane; /* of its own where the albedo weighs the colours */
    int32_t is_divided; /* by the albedo while it is filtered */
    int32_t is_divisor; /* the albedo itself, as a divisor */
} member;

typedef struct batch {
    ql_job *job;
    const ql_region *region;
    const ql_net_window *window;
    const ql_plan_set *set;
    int32_t group, set_index;
    int32_t is_indirect; /* of a group of light: which of its two passes has its turn */
    ql_pyramid_level levels[QL_PYRAMID_LEVELS];
    int32_t color_role; /* of the colour whose size weighs this group's light, or QUELL_ROLE_OTHER */
    member members[MAX_BATCH];
    uint32_t num_members, num_planes;
    float *divisor; /* the filtered albedo plus epsilon, [3][y][x] of the region's own pixels; NULL without one */
    float *scratch; /* per worker */
    size_t scratch_floats;
} batch;

/* What one worker spent; a cache line of its own. */
typedef struct worker_seconds {
    double seconds;
    uint8_t padding[QL_ALIGNMENT - sizeof(double)];
} worker_seconds;

typedef struct feature_job {
    const ql_job *job;
    const ql_plan_set *set;
    const ql_feature_setup *setup;
    const ql_region *region;
    float *scratch; /* per worker: FEATURE_ROWS rows of the image's width */
    size_t scratch_floats;
    worker_seconds *seconds; /* per worker */
} feature_job;

/* ---- Features ----------------------------------------------------------------------------------------------------- */

static void make_finite(float *row, uint32_t width)
{
    for (uint32_t x = 0; x < width; ++x)
        if (!isfinite(row[x])) row[x] = 0.0f;
}

/* Reads up to num channels of a role's row into rows; zeros where the set has no such layer. */
static void read_role(const feature_job *f, int32_t role, uint32_t y, uint32_t num, float *const *rows)
{
    const int32_t index = f->set->role_layer[role];
    const uint32_t width = f->job->frame->width;
    if (index == QL_PLAN_NONE) {
        for (uint32_t c = 0; c < num; ++c) memset(rows[c], 0, width * sizeof *rows[c]);
        return;
    }
    const ql_layer *const layer = &f->job->frame->layers[index];
    ql_read_fixed_row(layer, &f->job->scans[index], width, y, num < layer->num_channels ? num : layer->num_channels,
                      rows, NULL);
    for (uint32_t c = 0; c < num; ++c) make_finite(rows[c], width);
}

/* Adds a role's row to rows. */
static void add_role(const feature_job *f, int32_t role, uint32_t y, float *const *rows, float *const *spare)
{
    if (f->set->role_layer[role] == QL_PLAN_NONE) return;
    read_role(f, role, y, 3, spare);
    for (uint32_t c = 0; c < 3; ++c)
        for (uint32_t x = 0; x < f->job->frame->width; ++x) rows[c][x] += spare[c][x];
}

/* The light passes of row y into rows from *next on, which moves behind them. */
static void read_light(const feature_job *f, uint32_t y, float *const **next, float *const *spare, ql_feature_rows *in)
{
    static const int32_t direct[4] = {QUELL_ROLE_DIFFUSE_DIRECT, QUELL_ROLE_GLOSSY_DIRECT,
                                      QUELL_ROLE_TRANSMISSION_DIRECT, QUELL_ROLE_VOLUME_DIRECT};
    static const int32_t color[3] = {QUELL_ROLE_DIFFUSE_COLOR, QUELL_ROLE_GLOSSY_COLOR, QUELL_ROLE_TRANSMISSION_COLOR};
    const uint32_t rx = f->region->rx;
    const size_t row_bytes = f->job->frame->width * sizeof(float);
    for (uint32_t i = 0; i < 4; ++i) {
        float *const *const light = *next;
        read_role(f, direct[i], y, 3, light);
        *next += 3;
        if (i < 3) {
            for (uint32_t c = 0; c < 3; ++c) {
                memcpy((*next)[c], light[c], row_bytes);
                in->direct[i][c] = (*next)[c] + rx;
            }
            *next += 3;
        }
        add_role(f, direct[i] + 1, y, light, spare);
        for (uint32_t c = 0; c < 3; ++c) in->light[i][c] = light[c] + rx;
    }
    for (uint32_t i = 0; i < 3; ++i, *next += 3) {
        read_role(f, color[i], y, 3, *next);
        for (uint32_t c = 0; c < 3; ++c) in->color[i][c] = (*next)[c] + rx;
    }
    read_role(f, QUELL_ROLE_EMISSION, y, 3, *next);
    if (f->set->combined == QL_COMBINED_PASSES_ENVIRONMENT) add_role(f, QUELL_ROLE_ENVIRONMENT, y, *next, spare);
    for (uint32_t c = 0; c < 3; ++c) in->emission[c] = (*next)[c] + rx;
    *next += 3;
}

static void make_row(const feature_job *f, uint32_t region_y, uint32_t worker, float *out)
{
    const ql_frame *const frame = f->job->frame;
    const ql_region *const region = f->region;
    const uint32_t y = region->ry + region_y, width = frame->width;
    if (y >= frame->height) {
        memset(out, 0, (size_t)region->width * QL_NUM_FEATURES * sizeof *out);
        return;
    }
    float *rows[FEATURE_ROWS];
    for (uint32_t i = 0; i < FEATURE_ROWS; ++i) rows[i] = f->scratch + worker * f->scratch_floats + (size_t)i * width;
    float *const *next = rows;
    const uint32_t num = (region->rx + region->width < width ? region->width : width - region->rx);
    ql_feature_rows in = {0};
    const ql_layer *const beauty = &frame->layers[f->set->beauty];
    ql_read_fixed_row(beauty, &f->job->scans[f->set->beauty], width, y, 3, next, NULL);
    for (uint32_t c = 0; c < 3; ++c) in.beauty[c] = next[c] + region->rx;
    next += 3;
    if (beauty->num_channels > 3) {
        ql_layer_read_row(beauty, width, 3, y, next[0]);
        make_finite(next[0], width);
        in.alpha = next[0] + region->rx;
        next += 1;
    }
    if (f->setup->has_light) read_light(f, y, (float *const **)&next, rows + FEATURE_ROWS - 3, &in);
    if (f->setup->has_albedo) {
        read_role(f, QUELL_ROLE_DENOISING_ALBEDO, y, 3, next);
        for (uint32_t c = 0; c < 3; ++c) in.albedo[c] = next[c] + region->rx;
        next += 3;
    }
    if (f->setup->has_normal) {
        read_role(f, QUELL_ROLE_DENOISING_NORMAL, y, 3, next);
        for (uint32_t c = 0; c < 3; ++c) in.normal[c] = next[c] + region->rx;
        next += 3;
    }
    if (f->setup->has_depth) {
        read_role(f, QUELL_ROLE_DENOISING_DEPTH, y, 1, next);
        in.depth = next[0] + region->rx;
    }
    ql_make_feature_row(f->job->kernels, f->setup, &in, num, rows[FEATURE_ROWS - 1], out);
    memset(out + (size_t)num * QL_NUM_FEATURES, 0, (size_t)(region->width - num) * QL_NUM_FEATURES * sizeof *out);
}

static void feature_row(void *user, uint32_t region_y, uint32_t worker, float *out)
{
    const feature_job *const f = user;
    const double start = ql_clock_seconds();
    make_row(f, region_y, worker, out);
    f->seconds[worker].seconds += ql_clock_seconds() - start;
}

static size_t feature_scratch_floats(uint32_t image_width)
{
    return (size_t)FEATURE_ROWS * image_width;
}

static quell_status run_network(ql_job *job, ql_env *env, const ql_plan_set *set, const ql_feature_setup *setup,
                                const ql_region *region, ql_net_maps *maps, ql_error *err)
{
    feature_job f = {.job = job, .set = set, .setup = setup, .region = region};
    f.scratch_floats = feature_scratch_floats(job->frame->width);
    const uint32_t num_workers = ql_pool_num_threads(env->pool);
    f.scratch = ql_alloc(env->memory, num_workers, f.scratch_floats * sizeof *f.scratch);
    f.seconds = ql_alloc_zero(env->memory, num_workers, sizeof *f.seconds);
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    if (f.scratch == NULL || f.seconds == NULL) {
        ql_fail(err, status, "out of memory: rows of features");
    } else {
        float flags[QL_NUM_FLAGS];
        ql_make_flags(setup, flags);
        const double start = ql_clock_seconds();
        status = ql_net_run(job->net, job->kernels, env, job->values, region->width, region->height, flags, feature_row,
                            &f, maps, err);
        double features = 0.0;
        for (uint32_t i = 0; i < num_workers; ++i) features += f.seconds[i].seconds / num_workers;
        job->seconds_features += features;
        job->seconds_network += ql_clock_seconds() - start - features;
    }
    ql_free(env->memory, f.seconds);
    ql_free(env->memory, f.scratch);
    return status;
}

/* ---- Filters ------------------------------------------------------------------------------------------------------ */

static int is_light(int32_t group)
{
    return group >= QL_GROUP_DIFFUSE && group <= QL_GROUP_VOLUME;
}

/* Index of the network's group. */
static uint32_t net_group(const batch *b)
{
    if (b->group == QL_GROUP_COLOR) return QL_NET_GROUP_COLOR;
    if (b->group == QL_GROUP_EMISSION) return QL_NET_GROUP_EMISSION;
    return is_light(b->group) ? (uint32_t)(1 + 2 * (b->group - QL_GROUP_DIFFUSE) + b->is_indirect) : 0;
}

/* What the batch's pyramid has of the network's maps and tables. */
static void set_levels(batch *b)
{
    const uint32_t group = net_group(b);
    for (uint32_t l = 0; l < QL_PYRAMID_LEVELS; ++l) {
        const ql_planes *const embedding = &b->window->embedding[l];
        const ql_planes *const pooled = l + 1 < QL_PYRAMID_LEVELS ? &b->window->pooled[l] : embedding;
        b->levels[l] = (ql_pyramid_level){
            .embedding = ql_planes_row(embedding, 0, 0),
            .pooled = ql_planes_row(pooled, 0, 0),
            .stride = embedding->stride,
            .pooled_stride = pooled->stride,
            .plane = embedding->plane,
            .pooled_plane = pooled->plane,
            .table = b->job->net->filter_table[l] + (size_t)group * QL_FILTER_TAPS,
        };
        if (l + 1 < QL_PYRAMID_LEVELS)
            b->levels[l].up_table = b->job->net->up_table[l] + (size_t)group * 4 * QL_UP_TAPS;
    }
}

static float *worker_scratch(const batch *b, uint32_t worker)
{
    return b->scratch + worker * b->scratch_floats;
}

static void give_fine(void *user, uint32_t part, uint32_t x, uint32_t y, uint32_t num, uint32_t worker, float *out)
{
    const batch *const b = user;
    const uint32_t head = part == 0 ? QL_HEAD_DOWN : QL_HEAD_UP;
    ql_net_fine_logits(b->job->net, b->job->kernels, b->window, net_group(b), head, x, y, num,
                       worker_scratch(b, worker), out);
}

static void give_coarse(void *user, uint32_t level, uint32_t y, uint32_t worker, float *out)
{
    const batch *const b = user;
    ql_net_coarse_logits(b->job->net, b->job->kernels, b->window, net_group(b), level, y, worker_scratch(b, worker),
                         out);
}

/* Pixels x0 <= x < x1 of one row of the colour that the group's light was divided by. */
static void read_color(const batch *b, uint32_t x0, uint32_t x1, uint32_t y, float *const *rows)
{
    const int32_t index = b->set->role_layer[b->color_role];
    const ql_layer *const layer = &b->job->frame->layers[index];
    const uint32_t colors = layer->num_channels < MAX_COLORS ? layer->num_channels : MAX_COLORS;
    ql_read_fixed_span(layer, &b->job->scans[index], x0, x1, y, colors, rows, NULL);
    for (uint32_t c = colors; c < MAX_COLORS; ++c) memcpy(rows[c] + x0, rows[0] + x0, (x1 - x0) * sizeof *rows[c]);
}

static float mean_color(float *const *rows, uint32_t x)
{
    float sum = 0.0f;
    for (uint32_t c = 0; c < MAX_COLORS; ++c) sum += rows[c][x];
    return sum > 0.0f ? sum / (float)MAX_COLORS : 0.0f;
}

/* weight[x] *= the mean colour that the light was divided by, at most 1 so that no product overflows: where the kernels of
 * light and colour agree, the product of both means is the mean of the products, which is what Combined holds. */
static void weigh_by_color(const batch *b, uint32_t y, float *const *rows, float *weight, uint32_t num)
{
    read_color(b, b->region->rx, b->region->rx + num, y, rows);
    for (uint32_t x = 0; x < num; ++x) {
        const float color = mean_color(rows, b->region->rx + x);
        weight[x] *= color < 1.0f ? color : 1.0f;
    }
}

/* Albedo as radiance is divided by it: never zero; where it is no number, radiance stays as it is. */
static void make_divisor(float *const *rows, const float *valid, uint32_t x0, uint32_t x1)
{
    for (uint32_t c = 0; c < MAX_COLORS; ++c)
        for (uint32_t x = x0; x < x1; ++x) {
            const float a = rows[c][x] < 1.0f ? rows[c][x] : 1.0f;
            rows[c][x] = valid[x] > 0.0f ? (a > 0.0f ? a : 0.0f) + ALBEDO_EPSILON : 1.0f;
        }
}

/* Pixels x0 <= x < x1 of the noisy albedo as a divisor. rows: three for it, one for its validity. */
static void read_divisor(const batch *b, uint32_t x0, uint32_t x1, uint32_t y, float *const *rows)
{
    const int32_t index = b->set->role_layer[QUELL_ROLE_DENOISING_ALBEDO];
    ql_read_fixed_span(&b->job->frame->layers[index], &b->job->scans[index], x0, x1, y, MAX_COLORS, rows,
                       rows[MAX_COLORS]);
    make_divisor(rows, rows[MAX_COLORS], x0, x1);
}

static uint32_t weight_plane(const member *m, uint32_t channel)
{
    return channel < MAX_COLORS ? m->weight_plane : m->alpha_weight_plane;
}

static void give_values(void *user, uint32_t region_y, const float *importance, uint32_t worker, float *const *planes)
{
    const batch *const b = user;
    const ql_frame *const frame = b->job->frame;
    const ql_region *const region = b->region;
    const uint32_t y = region->ry + region_y, width = region->width;
    if (y >= frame->height) {
        for (uint32_t p = 0; p < b->num_planes; ++p) memset(planes[p], 0, width * sizeof *planes[p]);
        return;
    }
    const uint32_t num = region->rx + width < frame->width ? width : frame->width - region->rx;
    float *rows[VALUE_ROWS];
    for (uint32_t i = 0; i < VALUE_ROWS; ++i) rows[i] = worker_scratch(b, worker) + (size_t)i * (frame->width + 16);
    float *const valid = rows[VALUE_ROWS - 1], *const weight = rows[VALUE_ROWS - 2];
    for (uint32_t x = 0; x < num; ++x) weight[x] = importance[x];
    if (b->color_role != QUELL_ROLE_OTHER) weigh_by_color(b, y, rows, weight, num);
    for (uint32_t i = 0; i < b->num_members; ++i) {
        const member *const m = &b->members[i];
        const uint32_t first = region->rx, end = region->rx + num;
        if (m->is_divisor) {
            read_divisor(b, first, end, y, rows);
            for (uint32_t x = first; x < end; ++x) valid[x] = 1.0f;
        } else {
            ql_read_fixed_span(m->source, m->scan, first, end, y, m->num_channels, rows, valid);
        }
        float *const *const divisor = rows + DIVISOR_ROW;
        if (m->is_divided) read_divisor(b, first, end, y, divisor);
        float *const own = planes[m->alpha_weight_plane], *const albedo_weight = planes[m->weight_plane];
        for (uint32_t x = 0; x < num; ++x) own[x] = weight[x] * valid[region->rx + x];
        for (uint32_t x = 0; m->is_divided && x < num; ++x)
            albedo_weight[x] = own[x] * mean_color(divisor, region->rx + x);
        for (uint32_t c = 0; c < m->num_channels; ++c) {
            const float *const w = planes[weight_plane(m, c)];
            const float *const row = rows[c] + region->rx;
            float *const out = planes[m->first_plane + c];
            /* A zero weight must not meet the infinity of a bad alpha. */
            for (uint32_t x = 0; x < num; ++x) out[x] = w[x] > 0.0f && isfinite(row[x]) ? w[x] * row[x] : 0.0f;
            if (!m->is_divided || c >= MAX_COLORS) continue;
            const float *const albedo = divisor[c] + region->rx;
            for (uint32_t x = 0; x < num; ++x) out[x] /= albedo[x];
        }
    }
    for (uint32_t p = 0; p < b->num_planes; ++p) memset(planes[p] + num, 0, (width - num) * sizeof *planes[p]);
}

/* Where pixel x of the image is element x - m->x0. */
static float *result_row(const member *m, uint32_t channel, uint32_t y)
{
    return m->result + channel * m->plane + (y - m->y0) * m->stride;
}

/* Row y of the filtered albedo, where element 0 is the region's x0. */
static const float *divisor_row(const batch *b, uint32_t channel, uint32_t y)
{
    const size_t width = b->region->x1 - b->region->x0, height = b->region->y1 - b->region->y0;
    return b->divisor + (channel * height + (y - b->region->y0)) * width;
}

/* What was divided by one albedo and multiplied by another stays within what the layer's pixels span. */
static float within(float value, const ql_scan *scan)
{
    return value < scan->lowest ? scan->lowest : value > scan->highest ? scan->highest : value;
}

static void take_result(void *user, uint32_t region_y, uint32_t region_x, uint32_t num, uint32_t worker,
                        const float *const *planes)
{
    const batch *const b = user;
    const ql_region *const region = b->region;
    (void)worker;
    const uint32_t y = region->ry + region_y;
    const uint32_t from = region->rx + region_x, to = from + num;
    const uint32_t x0 = from > region->x0 ? from : region->x0, x1 = to < region->x1 ? to : region->x1;
    if (y < region->y0 || y >= region->y1 || x0 >= x1) return;
    for (uint32_t i = 0; i < b->num_members; ++i) {
        const member *const m = &b->members[i];
        for (uint32_t c = 0; c < m->num_channels; ++c) {
            const float *const weight = planes[weight_plane(m, c)];
            const float *const value = planes[m->first_plane + c];
            float *const out = result_row(m, c, y);
            const float *const factor = m->is_divided && c < MAX_COLORS ? divisor_row(b, c, y) : NULL;
            /* Where nothing valid is in reach the pixel stays (results start as a cleaned copy of the input). */
            for (uint32_t x = x0; x < x1; ++x) {
                if (weight[x - from] <= MIN_WEIGHT) continue;
                const float mean = value[x - from] / weight[x - from];
                out[x - m->x0] = factor ? within(mean * factor[x - region->x0], m->scan) : mean;
            }
        }
    }
}

/* What is empty stays empty. Light without a colour is "no data", not darkness to be filled from beside; a pixel of a
 * transparent film that nothing covers must not catch the haze of what is next to it. */
static void restore_task(void *user, uint32_t task, uint32_t worker)
{
    const batch *const b = user;
    const ql_region *const region = b->region;
    const uint32_t y = region->y0 + task, width = b->job->frame->width;
    const int has_color = b->color_role != QUELL_ROLE_OTHER;
    float *rows[MAX_COLORS + 4];
    for (uint32_t i = 0; i < MAX_COLORS + 4; ++i) rows[i] = worker_scratch(b, worker) + (size_t)i * width;
    float *const *const color = rows, *const *const value = rows + MAX_COLORS;
    if (has_color) read_color(b, region->x0, region->x1, y, color);
    for (uint32_t i = 0; i < b->num_members; ++i) {
        const member *const m = &b->members[i];
        if (!has_color && m->num_channels < 4) continue;
        ql_read_fixed_span(m->source, m->scan, region->x0, region->x1, y, m->num_channels, (float *const *)value, NULL);
        float *const *const empty = has_color ? color : (float *const *)value;
        for (uint32_t c = 0; c < m->num_channels; ++c) {
            float *const out = result_row(m, c, y); /* of the whole image */
            for (uint32_t x = region->x0; x < region->x1; ++x) {
                const int is_empty = empty[0][x] == 0.0f && empty[1][x] == 0.0f && empty[2][x] == 0.0f &&
                                     (has_color || value[3][x] == 0.0f);
                if (is_empty && isfinite(value[c][x])) out[x] = value[c][x];
            }
        }
    }
}

static uint32_t num_filtered_channels(const ql_layer *layer, const ql_scan *scan, int32_t group)
{
    const uint32_t colors = layer->num_channels < MAX_COLORS ? layer->num_channels : MAX_COLORS;
    const int has_alpha = layer->num_channels == 4 && group == QL_GROUP_BEAUTY && !scan->is_constant_alpha;
    return colors + (has_alpha ? 1 : 0);
}

/* Whether a layer is light that came from the surfaces whose albedo is known: about albedo times irradiance. */
static int is_lit_albedo(int32_t role)
{
    return role == QUELL_ROLE_COMBINED || role == QUELL_ROLE_LIGHT_GROUP;
}

int ql_region_divides(const ql_frame *frame, const ql_plan *plan, uint32_t set_index)
{
    const ql_plan_set *const set = &plan->sets[set_index];
    const int32_t albedo = set->role_layer[QUELL_ROLE_DENOISING_ALBEDO];
    if (albedo == QL_PLAN_NONE || frame->layers[albedo].num_channels < MAX_COLORS) return 0;
    for (uint32_t i = 0; i < plan->num_layers; ++i) {
        const int32_t role = frame->layers[i].role;
        const int is_sum = role == QUELL_ROLE_COMBINED && set->combined != QL_COMBINED_DIRECT;
        if (plan->layers[i].action == QUELL_ACTION_DENOISED && plan->layers[i].set == (int32_t)set_index &&
            is_lit_albedo(role) && !is_sum)
            return 1;
    }
    return 0;
}

/* Fills the batch with layers of its group from *next on, as many as fit. */
static void fill_batch(batch *b, uint32_t *next, int combined_only)
{
    const ql_plan *const plan = b->job->plan;
    const int32_t combined = b->set->role_layer[QUELL_ROLE_COMBINED];
    int has_shared[2] = {0}; /* weights, by whether the albedo is part of them */
    uint32_t shared[2] = {0};
    b->num_members = b->num_planes = 0;
    for (; *next < plan->num_layers && b->num_members < MAX_BATCH; ++*next) {
        const ql_plan_layer *const layer = &plan->layers[*next];
        if (layer->action != QUELL_ACTION_DENOISED || layer->set != b->set_index || layer->group != b->group) continue;
        if (is_light(b->group) && ql_role_is_indirect(b->job->frame->layers[*next].role) != b->is_indirect) continue;
        if (combined_only != ((int32_t)*next == combined)) continue;
        member m = {.layer = (int32_t)*next};
        m.source = &b->job->frame->layers[layer->source];
        m.scan = &b->job->scans[layer->source];
        m.result = b->job->results ? b->job->results[*next] : NULL; /* none yet where it is only planned */
        m.stride = b->job->frame->width;
        m.plane = m.stride * b->job->frame->height;
        m.is_divided = b->divisor != NULL && is_lit_albedo(b->job->frame->layers[*next].role);
        m.num_channels = num_filtered_channels(m.source, m.scan, b->group);
        const int own_weight = m.scan->num_bad > 0 || !has_shared[m.is_divided];
        const int own_alpha_weight = m.is_divided && m.num_channels > MAX_COLORS;
        const uint32_t num_planes = m.num_channels + (own_weight ? 1 : 0) + (own_alpha_weight ? 1 : 0);
        if (b->num_planes + num_planes > QL_PYRAMID_MAX_PLANES) return;
        m.first_plane = b->num_planes;
        b->num_planes += m.num_channels;
        m.weight_plane = own_weight ? b->num_planes++ : shared[m.is_divided];
        m.alpha_weight_plane = own_alpha_weight ? b->num_planes++ : m.weight_plane;
        if (m.scan->num_bad == 0 && !has_shared[m.is_divided]) {
            has_shared[m.is_divided] = 1;
            shared[m.is_divided] = m.weight_plane;
        }
        b->members[b->num_members++] = m;
    }
}

static size_t batch_scratch_floats(uint32_t image_width)
{
    const size_t values = (size_t)VALUE_ROWS * (image_width + 16);
    return values > QL_HEAD_BUFFER ? values : QL_HEAD_BUFFER;
}

static quell_status filter_batch(batch *b, ql_env *env, const ql_pyramid_source *source, ql_error *err)
{
    return ql_pyramid_run(b->job->kernels, env, b->region->width, b->region->height, b->num_planes, source, err);
}

/* Combined, if it is the sum of its parts, needs kernels for its alpha alone. */
static quell_status run_group(batch *b, ql_env *env, int combined_only, ql_error *err)
{
    const ql_pyramid_source source = {b, QL_NET_DIMS, b->levels, give_fine, give_coarse, give_values, take_result};
    set_levels(b);
    for (uint32_t next = 0; next < b->job->plan->num_layers;) {
        fill_batch(b, &next, combined_only);
        if (b->num_members == 0) continue;
        const int sums = combined_only && b->set->combined != QL_COMBINED_DIRECT;
        if (!sums || b->members[0].num_channels > MAX_COLORS) QL_TRY(filter_batch(b, env, &source, err));
        if (sums) {
            const double start = ql_clock_seconds();
            QL_TRY(ql_recombine(b->job, env, b->set, b->region, err));
            b->job->seconds_recombine += ql_clock_seconds() - start;
        }
        int restores = b->color_role != QUELL_ROLE_OTHER;
        for (uint32_t i = 0; i < b->num_members; ++i) restores |= b->members[i].num_channels == 4;
        if (restores) QL_TRY(ql_env_run(env, b->region->y1 - b->region->y0, restore_task, b));
    }
    return QUELL_OK;
}

/* Filters the albedo as a colour: textures pass by the light's kernels and are put on again from it. */
static quell_status filter_albedo(batch *b, ql_env *env, ql_error *err)
{
    const ql_pyramid_source source = {b, QL_NET_DIMS, b->levels, give_fine, give_coarse, give_values, take_result};
    const ql_region *const region = b->region;
    const size_t width = region->x1 - region->x0, height = region->y1 - region->y0;
    b->divisor = ql_alloc(env->memory, MAX_COLORS * height, width * sizeof *b->divisor);
    if (b->divisor == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: filtered albedo");
    b->group = QL_GROUP_COLOR;
    b->color_role = QUELL_ROLE_OTHER;
    b->members[0] = (member){.result = b->divisor,
                             .plane = width * height,
                             .stride = width,
                             .x0 = region->x0,
                             .y0 = region->y0,
                             .num_channels = MAX_COLORS,
                             .weight_plane = MAX_COLORS,
                             .alpha_weight_plane = MAX_COLORS,
                             .is_divisor = 1};
    b->num_members = 1;
    b->num_planes = MAX_COLORS + 1;
    set_levels(b);
    return filter_batch(b, env, &source, err);
}

static quell_status run_filters(ql_job *job, ql_env *env, uint32_t set_index, const ql_region *region,
                                const ql_net_window *window, ql_error *err)
{
    static const int32_t order[QL_NUM_GROUPS] = {QL_GROUP_COLOR,  QL_GROUP_EMISSION,     QL_GROUP_DIFFUSE,
                                                 QL_GROUP_GLOSSY, QL_GROUP_TRANSMISSION, QL_GROUP_VOLUME,
                                                 QL_GROUP_BEAUTY};
    batch b = {.job = job, .region = region, .window = window, .set = &job->plan->sets[set_index]};
    b.set_index = (int32_t)set_index;
    b.scratch_floats = batch_scratch_floats(job->frame->width);
    b.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), b.scratch_floats * sizeof *b.scratch);
    if (b.scratch == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of layers");
    const double from = env->progress_from, to = env->progress_to;
    quell_status status = ql_region_divides(job->frame, job->plan, set_index) ? filter_albedo(&b, env, err) : QUELL_OK;
    for (uint32_t i = 0; i < QL_NUM_GROUPS + 1 && status == QUELL_OK; ++i) {
        b.group = order[i < QL_NUM_GROUPS ? i : QL_NUM_GROUPS - 1];
        b.color_role = QUELL_ROLE_OTHER;
        if (b.group == QL_GROUP_DIFFUSE) b.color_role = QUELL_ROLE_DIFFUSE_COLOR;
        if (b.group == QL_GROUP_GLOSSY) b.color_role = QUELL_ROLE_GLOSSY_COLOR;
        if (b.group == QL_GROUP_TRANSMISSION) b.color_role = QUELL_ROLE_TRANSMISSION_COLOR;
        env->progress_from = from + (to - from) * i / (QL_NUM_GROUPS + 1);
        env->progress_to = from + (to - from) * (i + 1) / (QL_NUM_GROUPS + 1);
        /* The last two rounds are the beauty group: Combined's parts first, then Combined. */
        for (b.is_indirect = 0; b.is_indirect <= is_light(b.group) && status == QUELL_OK; ++b.is_indirect)
            status = run_group(&b, env, i == QL_NUM_GROUPS, err);
    }
    env->progress_from = from;
    env->progress_to = to;
    ql_free(env->memory, b.divisor);
    ql_free(env->memory, b.scratch);
    return status;
}

/* The columns x0 <= x < x1 of a region, with what their filters reach. */
static ql_region strip_of(const ql_region *region, uint32_t x0, uint32_t x1)
{
    const uint32_t right = region->rx + region->width;
    const uint32_t end = (x1 + QL_PYRAMID_REACH + QL_NET_ALIGNMENT - 1) / QL_NET_ALIGNMENT * QL_NET_ALIGNMENT;
    ql_region strip = *region;
    strip.x0 = x0;
    strip.x1 = x1;
    if (x0 > region->rx + QL_PYRAMID_REACH) strip.rx = x0 - QL_PYRAMID_REACH;
    strip.width = (end < right ? end : right) - strip.rx;
    return strip;
}

static quell_status run_strip(ql_job *job, ql_env *env, uint32_t set, const ql_region *region, const ql_net_maps *maps,
                              const ql_region *strip, ql_error *err)
{
    ql_net_window window;
    quell_status status =
        ql_net_window_open(job->net, job->kernels, env, maps, strip->rx - region->rx, strip->width, &window, err);
    if (status == QUELL_OK) status = run_filters(job, env, set, strip, &window, err);
    ql_net_window_close(&window, env->memory);
    return status;
}

quell_status ql_region_run(ql_job *job, ql_env *env, uint32_t set, const ql_feature_setup *setup,
                           const ql_region *region, ql_error *err)
{
    ql_net_maps maps = {0}; /* so that it can be freed whatever fails */
    const double from = env->progress_from, to = env->progress_to, middle = from + 0.6 * (to - from);
    env->progress_to = middle;
    quell_status status = run_network(job, env, &job->plan->sets[set], setup, region, &maps, err);
    const double start = ql_clock_seconds(), recombined = job->seconds_recombine;
    const uint32_t num_strips = (region->x1 - region->x0 + job->strip_width - 1) / job->strip_width;
    for (uint32_t i = 0; i < num_strips && status == QUELL_OK; ++i) {
        const uint32_t x0 = region->x0 + i * job->strip_width, left = region->x1 - x0;
        const ql_region strip = strip_of(region, x0, x0 + (left < job->strip_width ? left : job->strip_width));
        env->progress_from = middle + (to - middle) * i / num_strips;
        env->progress_to = middle + (to - middle) * (i + 1) / num_strips;
        status = run_strip(job, env, set, region, &maps, &strip, err);
    }
    env->progress_from = from;
    env->progress_to = to;
    ql_net_maps_destroy(&maps, env->memory);
    job->seconds_filter += ql_clock_seconds() - start - (job->seconds_recombine - recombined);
    return status;
}

/* Of the widest batch of any set. */
static uint64_t batch_bytes(const ql_job *job, uint32_t width, uint32_t height, uint32_t num_workers)
{
    uint64_t most = 0;
    ql_job planned = *job;
    planned.results = NULL;
    for (uint32_t s = 0; s < job->plan->num_sets; ++s)
        for (uint32_t i = 0; i < 4 * QL_NUM_GROUPS; ++i) {
            batch b = {.job = &planned, .set = &job->plan->sets[s], .set_index = (int32_t)s, .group = (int32_t)(i / 4)};
            float divisor = 0.0f;
            b.is_indirect = i % 2;
            if (ql_region_divides(job->frame, job->plan, s)) b.divisor = &divisor; /* never read: nothing is filtered */
            for (uint32_t next = 0; next < job->plan->num_layers;) {
                fill_batch(&b, &next, i / 2 % 2);
                if (b.num_members == 0) continue;
                const uint64_t bytes =
                    ql_pyramid_peak_bytes(width, height, b.num_planes, QL_NET_DIMS, num_workers);
                if (bytes > most) most = bytes;
            }
        }
    return most;
}

/* Of the filtered albedo. */
static uint64_t divisor_bytes(const ql_job *job, uint32_t width, uint32_t height)
{
    for (uint32_t s = 0; s < job->plan->num_sets; ++s)
        if (ql_region_divides(job->frame, job->plan, s)) return MAX_COLORS * sizeof(float) * (uint64_t)width * height;
    return 0;
}

uint64_t ql_region_network_bytes(const ql_job *job, uint32_t width, uint32_t height, uint32_t num_workers)
{
    const uint64_t features = num_workers * sizeof(float) * feature_scratch_floats(job->frame->width) +
                              ql_net_stem_bytes(job->net, width, num_workers) +
                              ql_net_detail_bytes(job->net, width, num_workers);
    return ql_net_peak_bytes(job->net, job->values, width, height, num_workers) + features;
}

uint64_t ql_region_peak_bytes(const ql_job *job, uint32_t width, uint32_t height, uint32_t strip_width,
                              uint32_t num_workers)
{
    const uint32_t image_width = job->frame->width;
    const uint64_t network = ql_region_network_bytes(job, width, height, num_workers);
    const uint64_t wide = strip_width + 2 * (uint64_t)QL_PYRAMID_REACH;
    const uint32_t columns = wide < width ? (uint32_t)wide : width;
    /* Maps stay while the filters run. */
    const uint64_t filters = ql_net_maps_bytes(job->net, job->values, width, height) +
                             ql_net_window_bytes(columns, height, num_workers) +
                             batch_bytes(job, columns, height, num_workers) + divisor_bytes(job, columns, height) +
                             num_workers * sizeof(float) * batch_scratch_floats(image_width);
    return network > filters ? network : filters;
}

uint32_t ql_region_halo(const ql_net *net)
{
    return ql_net_reach(net) + QL_PYRAMID_REACH;
}
