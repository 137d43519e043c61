/* SPDX-License-Identifier: Apache-2.0 */
/* The U-Net and its heads. Knows maps and logits, no layers of a frame. */
#include "models/quell_net.h"

#include <stdio.h>
#include <string.h>

static const char *const group_names[QL_NET_GROUPS] = {"beauty", "diffuse", "glossy", "transmission", "volume"};

/* The file holds a full-resolution head as pixel-shuffled channels k * 4 + dy * 2 + dx of 37 logits: 25 kernel, 9
 * upsampling, blend, partition, importance. Picks some k, ordered [dy][k][dx], so that a fine row is one slice. */
static uint32_t fine_order(uint32_t first, uint32_t num, uint32_t *order)
{
    uint32_t n = 0;
    for (uint32_t dy = 0; dy < 2; ++dy)
        for (uint32_t k = first; k < first + num; ++k)
            for (uint32_t dx = 0; dx < 2; ++dx) order[n++] = k * 4 + dy * 2 + dx;
    return n;
}

uint32_t ql_head_planes(uint32_t head)
{
    static const uint32_t planes[] = {2, QL_FILTER_TAPS + QL_UP_TAPS + 1, QL_FILTER_TAPS, 1};
    return planes[head];
}

static quell_status load_heads(ql_net *net, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    enum { FINE = QL_FILTER_TAPS + QL_UP_TAPS + 3 };
    const uint32_t *const w = net->widths;
    uint32_t order[4 * FINE], num;
    char name[QL_RECORD_NAME_BYTES];
    for (uint32_t g = 0; g < QL_NET_GROUPS; ++g) {
        snprintf(name, sizeof name, "%s_0", group_names[g]);
        num = fine_order(FINE - 2, 2, order);
        QL_TRY(ql_conv_load(&net->head_down[g], weights, name, 1, w[0], 4 * FINE, order, num, memory, err));
        num = fine_order(0, FINE - 2, order);
        QL_TRY(ql_conv_load(&net->head_up[g], weights, name, 1, w[0], 4 * FINE, order, num, memory, err));
        for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
            const uint32_t planes = l + 1 < QL_NET_LEVELS ? QL_COARSE_PLANES : QL_FILTER_TAPS;
            snprintf(name, sizeof name, "%s_%u", group_names[g], l + 1);
            QL_TRY(ql_conv_load(&net->head[g][l], weights, name, 1, w[l], planes, NULL, 0, memory, err));
        }
    }
    num = fine_order(0, QL_FILTER_TAPS, order);
    QL_TRY(ql_conv_load(&net->head_color, weights, "color_0", 1, w[0], 4 * QL_FILTER_TAPS, order, num, memory, err));
    num = fine_order(0, 1, order);
    return ql_conv_load(&net->head_mix, weights, "mix_0", 1, w[0], 4, order, num, memory, err);
}

static quell_status load_body(ql_net *net, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    const uint32_t *const w = net->widths;
    char name[QL_RECORD_NAME_BYTES];
    QL_TRY(ql_conv_load(&net->stem, weights, "stem", 2, QL_NUM_FEATURES, w[0], NULL, 0, memory, err));
    net->flags = ql_alloc(memory, (size_t)QL_NUM_FLAGS * w[0], sizeof *net->flags);
    if (net->flags == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory", weights->origin);
    QL_TRY(ql_weights_get_floats(weights, "flags.weight", net->flags, (size_t)QL_NUM_FLAGS * w[0], err));
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        for (uint32_t i = 0; i < net->down_convs[l]; ++i) {
            snprintf(name, sizeof name, "encoder.%u.%u", l, i);
            QL_TRY(ql_conv_load(&net->encoder[l][i], weights, name, 3, w[l], w[l], NULL, 0, memory, err));
        }
        if (l + 1 == QL_NET_LEVELS) break;
        snprintf(name, sizeof name, "down.%u", l);
        QL_TRY(ql_conv_load(&net->down[l], weights, name, 2, w[l], w[l + 1], NULL, 0, memory, err));
        snprintf(name, sizeof name, "up.%u", l);
        QL_TRY(ql_conv_load(&net->up[l], weights, name, 1, w[l + 1], w[l], NULL, 0, memory, err));
        for (uint32_t i = 0; i < net->up_convs[l]; ++i) {
            snprintf(name, sizeof name, "decoder.%u.%u", l, i);
            QL_TRY(ql_conv_load(&net->decoder[l][i], weights, name, 3, w[l], w[l], NULL, 0, memory, err));
        }
    }
    return QUELL_OK;
}

static quell_status read_shape(ql_net *net, const ql_weights *weights, ql_error *err)
{
    int32_t widths[QL_NET_LEVELS], down[QL_NET_LEVELS], up[QL_NET_LEVELS - 1], inputs[2];
    QL_TRY(ql_weights_get_ints(weights, "config.widths", widths, QL_NET_LEVELS, err));
    QL_TRY(ql_weights_get_ints(weights, "config.down_convs", down, QL_NET_LEVELS, err));
    QL_TRY(ql_weights_get_ints(weights, "config.up_convs", up, QL_NET_LEVELS - 1, err));
    QL_TRY(ql_weights_get_ints(weights, "config.inputs", inputs, 2, err));
    if (inputs[0] != QL_NUM_FEATURES || inputs[1] != QL_NUM_FLAGS)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the network takes %d features, this library makes %d",
                       weights->origin, inputs[0], QL_NUM_FEATURES);
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        const int32_t convs = l + 1 < QL_NET_LEVELS ? up[l] : 1;
        if (widths[l] < QL_BLOCK || widths[l] > 1024 || widths[l] % QL_BLOCK != 0 || down[l] < 1 ||
            down[l] > QL_NET_MAX_CONVS || convs < 1 || convs > QL_NET_MAX_CONVS)
            return ql_fail(err, QUELL_ERR_BAD_MODEL,
                           "%s: a network of %d channels and %d + %d convolutions at level "
                           "%u is none that this library runs",
                           weights->origin, widths[l], down[l], convs, l);
        net->widths[l] = (uint32_t)widths[l];
        net->down_convs[l] = (uint32_t)down[l];
        if (l + 1 < QL_NET_LEVELS) net->up_convs[l] = (uint32_t)up[l];
    }
    return QUELL_OK;
}

quell_status ql_net_load(ql_net *net, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    memset(net, 0, sizeof *net);
    for (uint32_t i = 0; i < weights->num_records; ++i)
        if (weights->records[i].type == QL_RECORD_FLOAT || weights->records[i].type == QL_RECORD_HALF)
            net->num_parameters += weights->records[i].num_values;
    quell_status status = read_shape(net, weights, err);
    if (status == QUELL_OK) status = load_body(net, weights, memory, err);
    if (status == QUELL_OK) status = load_heads(net, weights, memory, err);
    if (status != QUELL_OK) ql_net_free(net, memory);
    return status;
}

void ql_net_free(ql_net *net, ql_memory *memory)
{
    ql_conv_free(&net->stem, memory);
    ql_free(memory, net->flags);
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        for (uint32_t i = 0; i < QL_NET_MAX_CONVS; ++i) ql_conv_free(&net->encoder[l][i], memory);
        if (l + 1 == QL_NET_LEVELS) break;
        ql_conv_free(&net->down[l], memory);
        ql_conv_free(&net->up[l], memory);
        for (uint32_t i = 0; i < QL_NET_MAX_CONVS; ++i) ql_conv_free(&net->decoder[l][i], memory);
    }
    for (uint32_t g = 0; g < QL_NET_GROUPS; ++g) {
        ql_conv_free(&net->head_down[g], memory);
        ql_conv_free(&net->head_up[g], memory);
        for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) ql_conv_free(&net->head[g][l], memory);
    }
    ql_conv_free(&net->head_color, memory);
    ql_conv_free(&net->head_mix, memory);
    memset(net, 0, sizeof *net);
}

double ql_net_macs_per_pixel(const ql_net *net, uint32_t num_groups, int32_t has_light)
{
    static const double per[QL_NET_LEVELS] = {1.0 / 4, 1.0 / 16, 1.0 / 64, 1.0 / 256};
    double total = 4.0 * QL_NUM_FEATURES * net->widths[0] * per[0], head = 0.0;
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        const double w = net->widths[l];
        total += 9.0 * w * w * net->down_convs[l] * per[l];
        if (l + 1 < QL_NET_LEVELS) {
            total += 5.0 * w * net->widths[l + 1] * per[l + 1] + 9.0 * w * w * net->up_convs[l] * per[l];
            head += w * QL_COARSE_PLANES * per[l];
        } else {
            head += w * QL_FILTER_TAPS * per[l];
        }
    }
    head += 4.0 * (QL_COARSE_PLANES + 1) * net->widths[0] * per[0];
    if (has_light) total += 4.0 * (QL_FILTER_TAPS + 1) * net->widths[0] * per[0];
    return total + num_groups * head;
}

uint32_t ql_net_reach(const ql_net *net)
{
    /* A 3x3 convolution at 1/2^(l+1) reaches one of its pixels further; a stride or an upsampling adds less than one
     * pixel of the coarser level, once on the way down and once on the way up. */
    uint32_t reach = 0;
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        const uint32_t convs = net->down_convs[l] + (l + 1 < QL_NET_LEVELS ? net->up_convs[l] : 0);
        reach += (convs + 1) << (l + 1);
    }
    return (reach + QL_NET_ALIGNMENT - 1) / QL_NET_ALIGNMENT * QL_NET_ALIGNMENT;
}

/* ---- The body ----------------------------------------------------------------------------------------------------- */

typedef struct stem_job {
    const ql_conv *stem;
    const ql_kernels *kernels;
    const float *bias;
    ql_feature_source_fn *source;
    void *user;
    ql_map *out;
    float *scratch; /* [workers][2 rows][width][features] */
} stem_job;

static void stem_task(void *user, uint32_t task, uint32_t worker)
{
    const stem_job *const job = user;
    const size_t row = (size_t)job->out->width * 2 * QL_NUM_FEATURES;
    float *const rows = job->scratch + worker * 2 * row;
    job->source(job->user, 2 * task, worker, rows);
    job->source(job->user, 2 * task + 1, worker, rows + row);
    const ql_conv_row conv = {
        .rows = {rows, rows + row, NULL},
        .weights = job->stem->weights,
        .bias = job->bias,
        .out = ql_map_row(job->out, task),
        .num_rows = 2,
        .num_k = 2 * QL_NUM_FEATURES,
        .stride = 2 * QL_NUM_FEATURES,
        .num_pixels = job->out->width,
        .num_out = job->stem->num_out,
        .relu = 1,
    };
    job->kernels->conv_row(&conv);
}

static quell_status run_stem(const ql_net *net, const ql_kernels *kernels, ql_env *env, const float *flags,
                             ql_feature_source_fn *source, void *user, ql_map *out, ql_error *err)
{
    const size_t workers = ql_pool_num_threads(env->pool), row = (size_t)out->width * 2 * QL_NUM_FEATURES;
    float *const bias = ql_alloc(env->memory, net->widths[0], sizeof *bias);
    float *const scratch = ql_alloc(env->memory, workers * 2 * row, sizeof *scratch);
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    if (bias == NULL || scratch == NULL) {
        ql_fail(err, status, "out of memory: features of a region %u pixels wide", 2 * out->width);
    } else {
        for (uint32_t c = 0; c < net->widths[0]; ++c) {
            bias[c] = net->stem.bias[c];
            for (uint32_t f = 0; f < QL_NUM_FLAGS; ++f) bias[c] += flags[f] * net->flags[f * net->widths[0] + c];
        }
        stem_job job = {&net->stem, kernels, bias, source, user, out, scratch};
        status = ql_env_run(env, out->height, stem_task, &job);
    }
    ql_free(env->memory, scratch);
    ql_free(env->memory, bias);
    return status;
}

/* Replaces *map by conv(*map), of the given size. */
static quell_status step(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, ql_map *map, uint32_t width,
                         uint32_t height, int keep, ql_map *out, int32_t relu, ql_error *err)
{
    ql_map next;
    QL_TRY(ql_map_create(&next, width, height, conv->num_out, env->memory, err));
    const quell_status status = ql_conv_apply(conv, kernels, env, map, &next, relu);
    if (status != QUELL_OK) {
        ql_map_destroy(&next, env->memory);
        return status;
    }
    if (!keep) ql_map_destroy(map, env->memory);
    *out = next;
    return QUELL_OK;
}

quell_status ql_net_run(const ql_net *net, const ql_kernels *kernels, ql_env *env, uint32_t width, uint32_t height,
                        const float *flags, ql_feature_source_fn *source, void *user, ql_net_maps *maps, ql_error *err)
{
    memset(maps, 0, sizeof *maps);
    ql_map *const m = maps->level;
    QL_TRY(ql_map_create(&m[0], width / 2, height / 2, net->widths[0], env->memory, err));
    QL_TRY(run_stem(net, kernels, env, flags, source, user, &m[0], err));
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        for (uint32_t i = 0; i < net->down_convs[l]; ++i)
            QL_TRY(step(&net->encoder[l][i], kernels, env, &m[l], m[l].width, m[l].height, 0, &m[l], 1, err));
        if (l + 1 < QL_NET_LEVELS)
            QL_TRY(step(&net->down[l], kernels, env, &m[l], m[l].width / 2, m[l].height / 2, 1, &m[l + 1], 1, err));
    }
    for (uint32_t l = QL_NET_LEVELS - 1; l-- > 0;) {
        ql_map coarse;
        QL_TRY(step(&net->up[l], kernels, env, &m[l + 1], m[l + 1].width, m[l + 1].height, 1, &coarse, 0, err));
        const quell_status status = ql_upsample_add_relu(env, &coarse, &m[l]);
        ql_map_destroy(&coarse, env->memory);
        QL_TRY(status);
        for (uint32_t i = 0; i < net->up_convs[l]; ++i)
            QL_TRY(step(&net->decoder[l][i], kernels, env, &m[l], m[l].width, m[l].height, 0, &m[l], 1, err));
    }
    return QUELL_OK;
}

void ql_net_maps_destroy(ql_net_maps *maps, ql_memory *memory)
{
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) ql_map_destroy(&maps->level[l], memory);
}

uint64_t ql_net_peak_bytes(const ql_net *net, uint32_t width, uint32_t height)
{
    /* Two maps of the finest level, one of each other, and the coarse map of an upsampling. */
    uint64_t bytes = 2 * ql_map_bytes(width / 2, height / 2, net->widths[0]);
    for (uint32_t l = 1; l < QL_NET_LEVELS; ++l)
        bytes += ql_map_bytes(width >> (l + 1), height >> (l + 1), net->widths[l]);
    return bytes + ql_map_bytes(width / 4, height / 4, net->widths[0]);
}

/* ---- The heads ---------------------------------------------------------------------------------------------------- */

void ql_net_fine_logits(const ql_net *net, const ql_kernels *kernels, const ql_net_maps *maps, uint32_t group,
                        uint32_t head, uint32_t x, uint32_t y, uint32_t num, float *buffer, float *out)
{
    const ql_conv *const conv = head == QL_HEAD_DOWN    ? &net->head_down[group]
                                : head == QL_HEAD_UP    ? &net->head_up[group]
                                : head == QL_HEAD_COLOR ? &net->head_color
                                                        : &net->head_mix;
    const uint32_t planes = ql_head_planes(head);
    ql_conv_apply_row(conv, kernels, &maps->level[0], x, y, num, 0, buffer);
    for (size_t dy = 0; dy < 2; ++dy)
        kernels->planes_row(buffer + dy * planes * 2, conv->num_out, planes, 2, out + dy * planes * 2 * num, 2 * num,
                            num);
}

void ql_net_coarse_logits(const ql_net *net, const ql_kernels *kernels, const ql_net_maps *maps, uint32_t group,
                          uint32_t level, uint32_t y, float *buffer, float *out)
{
    const ql_conv *const conv = &net->head[group][level - 1];
    const ql_map *const map = &maps->level[level - 1];
    const uint32_t planes = level < QL_NET_LEVELS ? QL_COARSE_PLANES : QL_FILTER_TAPS;
    for (uint32_t x = 0; x < map->width; x += QL_HEAD_SPAN) {
        const uint32_t num = map->width - x < QL_HEAD_SPAN ? map->width - x : QL_HEAD_SPAN;
        ql_conv_apply_row(conv, kernels, map, x, y, num, 0, buffer);
        kernels->planes_row(buffer, conv->num_out, planes, 1, out + x, map->width, num);
    }
}
