/* SPDX-License-Identifier: Apache-2.0 */
/* The U-Net and its heads. Knows maps and planes, no layers of a frame. */
#include "models/quell_net.h"

#include "models/quell_detail.h"
#include "models/quell_stem.h"
#include "models/quell_window.h"

#include <stdio.h>
#include <string.h>

enum { MAX_LEVEL_PLANES = 192, FINE_FIELDS = QL_NET_DIMS + 4 /* centre, blend, partition, importance */ };

/* Planes of one group at a level of the heads; 0: full resolution. training/models/quell.py: group_planes */
static uint32_t group_planes(uint32_t level)
{
    return level == 0 ? FINE_FIELDS : ql_coarse_planes(level);
}

/* Where the embedding of a level's head begins, after the groups. */
static uint32_t embedding_plane(uint32_t level)
{
    return QL_NET_GROUPS * group_planes(level);
}

/* Which of the file's channels are `num` planes from `first` on. At full resolution the file holds pixel-shuffled
 * channels plane * 4 + dy * 2 + dx; they are ordered [dy][plane][dx], so that a fine row is one slice. */
static uint32_t pick(uint32_t level, uint32_t first, uint32_t num, uint32_t *order)
{
    uint32_t n = 0;
    for (uint32_t dy = 0; dy < (level == 0 ? 2u : 1u); ++dy)
        for (uint32_t k = first; k < first + num; ++k)
            for (uint32_t dx = 0; dx < (level == 0 ? 2u : 1u); ++dx) order[n++] = level == 0 ? k * 4 + dy * 2 + dx : k;
    return n;
}

uint32_t ql_head_planes(uint32_t head)
{
    static const uint32_t planes[] = {2, QL_NET_DIMS + 2};
    return planes[head];
}

uint32_t ql_coarse_planes(uint32_t level)
{
    return QL_NET_DIMS + (level < QL_NET_LEVELS ? 3 : 1);
}

static quell_status load_head(const ql_net *net, const ql_weights *weights, uint32_t level, uint32_t first,
                              uint32_t num, ql_conv *conv, ql_memory *memory, ql_error *err)
{
    uint32_t order[4 * MAX_LEVEL_PLANES];
    char name[QL_RECORD_NAME_BYTES];
    snprintf(name, sizeof name, "head.%u", level);
    const uint32_t file_planes = (embedding_plane(level) + QL_NET_DIMS) * (level == 0 ? 4 : 1);
    const uint32_t num_order = pick(level, first, num, order);
    return ql_conv_load(conv, weights, name, 1, net->widths[level > 0 ? level - 1 : 0], file_planes, order, num_order,
                        memory, err);
}

static quell_status load_heads(ql_net *net, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    const uint32_t down = QL_NET_DIMS + 2;
    for (uint32_t g = 0; g < QL_NET_GROUPS; ++g) {
        QL_TRY(load_head(net, weights, 0, g * FINE_FIELDS, down, &net->head_up[g], memory, err));
        QL_TRY(load_head(net, weights, 0, g * FINE_FIELDS + down, 2, &net->head_down[g], memory, err));
        for (uint32_t l = 1; l <= QL_NET_LEVELS; ++l)
            QL_TRY(load_head(net, weights, l, g * group_planes(l), group_planes(l), &net->head[g][l - 1], memory, err));
    }
    for (uint32_t l = 0; l <= QL_NET_LEVELS; ++l)
        QL_TRY(load_head(net, weights, l, embedding_plane(l), QL_NET_DIMS, &net->embedding[l], memory, err));
    const uint32_t n = net->detail;
    QL_TRY(ql_conv_load(&net->detail_in, weights, "detail_in", 3, QL_NET_DETAIL_INPUTS, n, NULL, 0, memory, err));
    QL_TRY(ql_conv_load(&net->detail_up, weights, "detail_up", 1, net->widths[0], n, NULL, 0, memory, err));
    QL_TRY(ql_conv_load(&net->detail_mid, weights, "detail_mid", 3, n, n, NULL, 0, memory, err));
    QL_TRY(ql_conv_load(&net->detail_out, weights, "detail_out", 3, n, QL_NET_DIMS, NULL, 0, memory, err));
    return ql_conv_load(&net->guides, weights, "guides", 1, QL_NUM_GUIDES, QL_NET_DIMS, NULL, 0, memory, err);
}

static quell_status load_table(const ql_weights *weights, const char *name, size_t num, float **table,
                               ql_memory *memory, ql_error *err)
{
    *table = ql_alloc(memory, num, sizeof **table);
    if (*table == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory", weights->origin);
    return ql_weights_get_floats(weights, name, *table, num, err);
}

static quell_status load_tables(ql_net *net, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    char name[QL_RECORD_NAME_BYTES];
    for (uint32_t l = 0; l <= QL_NET_LEVELS; ++l) {
        snprintf(name, sizeof name, "filter_table.%u", l);
        QL_TRY(load_table(weights, name, QL_NET_GROUPS * QL_FILTER_TAPS, &net->filter_table[l], memory, err));
        if (l == QL_NET_LEVELS) break;
        snprintf(name, sizeof name, "up_table.%u", l);
        QL_TRY(load_table(weights, name, (size_t)QL_NET_GROUPS * 4 * QL_UP_TAPS, &net->up_table[l], memory, err));
    }
    return QUELL_OK;
}

/* A layer inside the body: its weights in float and in bfloat16. */
static quell_status load_inner(ql_conv *conv, const ql_weights *weights, const char *name, uint32_t size,
                               uint32_t num_in, uint32_t num_out, ql_memory *memory, ql_error *err)
{
    QL_TRY(ql_conv_load(conv, weights, name, size, num_in, num_out, NULL, 0, memory, err));
    return ql_conv_add_bf16(conv, memory, err);
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
            QL_TRY(load_inner(&net->encoder[l][i], weights, name, 3, w[l], w[l], memory, err));
        }
        if (l + 1 == QL_NET_LEVELS) break;
        snprintf(name, sizeof name, "down.%u", l);
        QL_TRY(load_inner(&net->down[l], weights, name, 2, w[l], w[l + 1], memory, err));
        snprintf(name, sizeof name, "up.%u", l);
        QL_TRY(load_inner(&net->up[l], weights, name, 1, w[l + 1], w[l], memory, err));
        for (uint32_t i = 0; i < net->up_convs[l]; ++i) {
            snprintf(name, sizeof name, "decoder.%u.%u", l, i);
            QL_TRY(load_inner(&net->decoder[l][i], weights, name, 3, w[l], w[l], memory, err));
        }
    }
    return QUELL_OK;
}

static quell_status read_shape(ql_net *net, const ql_weights *weights, ql_error *err)
{
    int32_t widths[QL_NET_LEVELS], down[QL_NET_LEVELS], up[QL_NET_LEVELS - 1], detail, inputs[2];
    QL_TRY(ql_weights_get_ints(weights, "config.widths", widths, QL_NET_LEVELS, err));
    QL_TRY(ql_weights_get_ints(weights, "config.down_convs", down, QL_NET_LEVELS, err));
    QL_TRY(ql_weights_get_ints(weights, "config.up_convs", up, QL_NET_LEVELS - 1, err));
    QL_TRY(ql_weights_get_ints(weights, "config.detail", &detail, 1, err));
    QL_TRY(ql_weights_get_ints(weights, "config.inputs", inputs, 2, err));
    if (inputs[0] != QL_NUM_FEATURES || inputs[1] != QL_NUM_FLAGS)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: the network takes %d features, this library makes %d",
                       weights->origin, inputs[0], QL_NUM_FEATURES);
    if (detail < QL_BLOCK || detail > 256 || detail % QL_BLOCK != 0)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: a network of %d channels at full resolution is none that this "
                       "library runs", weights->origin, detail);
    net->detail = (uint32_t)detail;
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
    if (status == QUELL_OK) status = load_tables(net, weights, memory, err);
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
    ql_conv_free(&net->guides, memory);
    ql_conv_free(&net->detail_in, memory);
    ql_conv_free(&net->detail_up, memory);
    ql_conv_free(&net->detail_mid, memory);
    ql_conv_free(&net->detail_out, memory);
    for (uint32_t l = 0; l <= QL_NET_LEVELS; ++l) {
        ql_conv_free(&net->embedding[l], memory);
        ql_free(memory, net->filter_table[l]);
        if (l < QL_NET_LEVELS) ql_free(memory, net->up_table[l]);
    }
    memset(net, 0, sizeof *net);
}

double ql_net_macs_per_pixel(const ql_net *net, uint32_t num_groups)
{
    static const double per[QL_NET_LEVELS] = {1.0 / 4, 1.0 / 16, 1.0 / 64, 1.0 / 256};
    double total = 4.0 * QL_NUM_FEATURES * net->widths[0] * per[0], head = (double)FINE_FIELDS * net->widths[0];
    total += QL_NET_DIMS * (double)(net->widths[0] + QL_NUM_GUIDES) + per[0] * net->widths[0] * net->detail +
             9.0 * net->detail * (QL_NET_DETAIL_INPUTS + net->detail + QL_NET_DIMS);
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        const double w = net->widths[l];
        total += (9.0 * w * w * net->down_convs[l] + QL_NET_DIMS * w) * per[l];
        if (l + 1 < QL_NET_LEVELS)
            total += 5.0 * w * net->widths[l + 1] * per[l + 1] + 9.0 * w * w * net->up_convs[l] * per[l];
        head += w * group_planes(l + 1) * per[l];
    }
    return total + num_groups * head;
}

uint32_t ql_net_reach(const ql_net *net)
{
    /* A 3x3 convolution at 1/2^(l+1) reaches one of its pixels further; a stride or an upsampling adds less than one
     * pixel of the coarser level, once on the way down and once on the way up. */
    uint32_t reach = 2; /* of the two convolutions at full resolution that follow the U-Net */
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        const uint32_t convs = net->down_convs[l] + (l + 1 < QL_NET_LEVELS ? net->up_convs[l] : 0);
        reach += (convs + 1) << (l + 1);
    }
    return (reach + QL_NET_ALIGNMENT - 1) / QL_NET_ALIGNMENT * QL_NET_ALIGNMENT;
}

/* ---- The body ----------------------------------------------------------------------------------------------------- */

/* The next coarser map, made by a convolution with stride 2. */
static quell_status go_down(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, const ql_map *from, ql_map *to,
                            ql_error *err)
{
    QL_TRY(ql_map_create_of(to, from->values, from->width / 2, from->height / 2, conv->num_out, env->memory, err));
    return ql_conv_apply(conv, kernels, env, from, to, 1);
}

quell_status ql_net_run(const ql_net *net, const ql_kernels *kernels, ql_env *env, ql_values values, uint32_t width,
                        uint32_t height, const float *flags, ql_feature_source_fn *source, void *user,
                        ql_net_maps *maps, ql_error *err)
{
    memset(maps, 0, sizeof *maps);
    ql_map *const m = maps->level;
    QL_TRY(ql_map_create_of(&m[0], values, width / 2, height / 2, net->widths[0], env->memory, err));
    QL_TRY(ql_net_stem(net, kernels, env, flags, source, user, &m[0], err));
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) {
        for (uint32_t i = 0; i < net->down_convs[l]; ++i)
            QL_TRY(ql_conv_relu_in_place(&net->encoder[l][i], kernels, env, &m[l], err));
        if (l + 1 < QL_NET_LEVELS) QL_TRY(go_down(&net->down[l], kernels, env, &m[l], &m[l + 1], err));
    }
    for (uint32_t l = QL_NET_LEVELS - 1; l-- > 0;) {
        QL_TRY(ql_conv_upsample_add_relu(&net->up[l], kernels, env, &m[l + 1], &m[l], err));
        for (uint32_t i = 0; i < net->up_convs[l]; ++i)
            QL_TRY(ql_conv_relu_in_place(&net->decoder[l][i], kernels, env, &m[l], err));
    }
    QL_TRY(ql_planes_create(&maps->embedding, width, height, QL_NET_DIMS, QL_NET_MARGIN, env->memory, err));
    QL_TRY(ql_net_detail(net, kernels, env, source, user, maps, err));
    return ql_net_embed(net, kernels, env, maps, err);
}

void ql_net_maps_destroy(ql_net_maps *maps, ql_memory *memory)
{
    ql_planes_destroy(&maps->embedding, memory);
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l) ql_map_destroy(&maps->level[l], memory);
}

uint64_t ql_net_maps_bytes(const ql_net *net, ql_values values, uint32_t width, uint32_t height)
{
    uint64_t bytes = ql_planes_bytes(width, height, QL_NET_DIMS, QL_NET_MARGIN);
    for (uint32_t l = 0; l < QL_NET_LEVELS; ++l)
        bytes += ql_map_bytes(values, width >> (l + 1), height >> (l + 1), net->widths[l]);
    return bytes;
}

uint64_t ql_net_peak_bytes(const ql_net *net, ql_values values, uint32_t width, uint32_t height, uint32_t num_workers)
{
    /* Beside what stays: the rows that convolutions in place keep; upsampling needs less. */
    return ql_net_maps_bytes(net, values, width, height) +
           ql_conv_in_place_bytes(values, width / 2, height / 2, net->widths[0], num_workers);
}

/* ---- The heads ---------------------------------------------------------------------------------------------------- */

void ql_net_fine_logits(const ql_net *net, const ql_kernels *kernels, const ql_net_window *window, uint32_t group,
                        uint32_t head, uint32_t x, uint32_t y, uint32_t num, float *buffer, float *out)
{
    const ql_conv *const conv = head == QL_HEAD_DOWN ? &net->head_down[group] : &net->head_up[group];
    const uint32_t planes = ql_head_planes(head);
    ql_conv_apply_row(conv, kernels, &window->maps->level[0], window->x / 2 + x, y, num, 0, buffer);
    for (size_t dy = 0; dy < 2; ++dy)
        kernels->planes_row(buffer + dy * planes * 2, conv->num_out, planes, 2, out + dy * planes * 2 * num, 2 * num,
                            num);
}

void ql_net_coarse_logits(const ql_net *net, const ql_kernels *kernels, const ql_net_window *window, uint32_t group,
                          uint32_t level, uint32_t y, float *buffer, float *out)
{
    const ql_conv *const conv = &net->head[group][level - 1];
    const uint32_t planes = ql_coarse_planes(level), first = window->x >> level, width = window->width >> level;
    for (uint32_t x = 0; x < width; x += QL_HEAD_SPAN) {
        const uint32_t num = width - x < QL_HEAD_SPAN ? width - x : QL_HEAD_SPAN;
        ql_conv_apply_row(conv, kernels, &window->maps->level[level - 1], first + x, y, num, 0, buffer);
        kernels->planes_row(buffer, conv->num_out, planes, 1, out + x, width, num);
    }
}
