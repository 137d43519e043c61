/* SPDX-License-Identifier: Apache-2.0 */
/* The quell family's network: a U-Net at half resolution and the heads that turn its features into what guides kernels.
 * training/models/quell.py is the same in PyTorch. */
#ifndef QL_MODELS_QUELL_NET_H
#define QL_MODELS_QUELL_NET_H

#include "models/features.h"
#include "nn/conv.h"
#include "nn/planes.h"

enum {
    QL_NET_LEVELS = 4,     /* of the body: 1/2, 1/4, 1/8, 1/16; heads have one more, full resolution */
    QL_NET_ALIGNMENT = 16, /* widths and heights of a region are multiples */
    QL_NET_MAX_CONVS = 4,  /* 3x3 convolutions of a level, one way */
    QL_NET_DIMS = 10,      /* of the embedding */
    QL_NET_MARGIN = 2,     /* of its planes */
    QL_NET_DETAIL_INPUTS = 16, /* channels that the convolutions at full resolution see */
    QL_FILTER_TAPS = 25,
    QL_UP_TAPS = 9
};

/* Groups with a pyramid of their own, in the order of the file's heads: beauty, then direct and indirect light of
 * diffuse, glossy, transmission, volume, then colours, then emission and environment. */
enum { QL_NET_GROUPS = 11, QL_NET_GROUP_COLOR = 9, QL_NET_GROUP_EMISSION = 10 };

/* What of the full-resolution head is wanted. Planes are [plane][x] for each of the two fine rows of a half row. */
enum {
    QL_HEAD_DOWN = 0,  /* 2 planes: partition, importance */
    QL_HEAD_UP = 1     /* sharpness (QL_NET_DIMS planes), centre, blend */
};

typedef struct ql_net {
    uint32_t widths[QL_NET_LEVELS];
    uint32_t down_convs[QL_NET_LEVELS], up_convs[QL_NET_LEVELS - 1];
    uint32_t detail; /* channels of the convolutions at full resolution */
    ql_conv stem;
    float *flags; /* [QL_NUM_FLAGS][widths[0]] */
    ql_conv down[QL_NET_LEVELS - 1], up[QL_NET_LEVELS - 1];
    ql_conv encoder[QL_NET_LEVELS][QL_NET_MAX_CONVS], decoder[QL_NET_LEVELS - 1][QL_NET_MAX_CONVS];
    ql_conv head_down[QL_NET_GROUPS], head_up[QL_NET_GROUPS];
    ql_conv head[QL_NET_GROUPS][QL_NET_LEVELS]; /* sharpness, centre, blend, partition; at 1/16 the first two */
    ql_conv guides, detail_in, detail_up, detail_mid, detail_out; /* the embedding's share at full resolution */
    ql_conv embedding[QL_NET_LEVELS + 1];       /* the body's share of it */
    float *filter_table[QL_NET_LEVELS + 1];     /* [QL_NET_GROUPS][QL_FILTER_TAPS] */
    float *up_table[QL_NET_LEVELS];             /* [QL_NET_GROUPS][2][2][QL_UP_TAPS] */
    uint64_t num_parameters;
} ql_net;

quell_status ql_net_load(ql_net *net, const ql_weights *weights, ql_memory *memory, ql_error *err);
void ql_net_free(ql_net *net, ql_memory *memory);
double ql_net_macs_per_pixel(const ql_net *net, uint32_t num_groups);

/* Pixels from which one result of the body is computed, in each direction, rounded up to QL_NET_ALIGNMENT. */
uint32_t ql_net_reach(const ql_net *net);

/* Fills out[num_pixels][QL_NUM_FEATURES] for row y of the region, pixels from x = 0; zeros outside the image. */
typedef void ql_feature_source_fn(void *user, uint32_t y, uint32_t worker, float *out);

/* Features of each level, for the heads, and the finest level of the embedding that all kernels share. */
typedef struct ql_net_maps {
    ql_map level[QL_NET_LEVELS];
    ql_planes embedding; /* full resolution */
} ql_net_maps;

/* Columns of the maps, which filters work on one after the other: the coarser levels of the embedding are there for these
 * alone. x and width are multiples of QL_NET_ALIGNMENT. */
typedef struct ql_net_window {
    const ql_net_maps *maps;
    uint32_t x, width;
    ql_planes embedding[QL_NET_LEVELS + 1]; /* full resolution first, which lies in the maps */
    ql_planes pooled[QL_NET_LEVELS];        /* means over 2x2 of embedding[l], at the size of level l + 1 */
} ql_net_window;

/* Runs the body on a region, its maps holding such values. flags: QL_NUM_FLAGS constants. maps is freed by
 * ql_net_maps_destroy in any case. */
quell_status ql_net_run(const ql_net *net, const ql_kernels *kernels, ql_env *env, ql_values values, uint32_t width,
                        uint32_t height, const float *flags, ql_feature_source_fn *source, void *user,
                        ql_net_maps *maps, ql_error *err);
void ql_net_maps_destroy(ql_net_maps *maps, ql_memory *memory);
uint64_t ql_net_maps_bytes(const ql_net *net, ql_values values, uint32_t width, uint32_t height);
uint64_t ql_net_peak_bytes(const ql_net *net, ql_values values, uint32_t width, uint32_t height, uint32_t num_workers);

/* Full-resolution logits of the window's fine rows 2y and 2y + 1, fine pixels 2x .. 2x + 2 num - 1, num at most QL_HEAD_SPAN.
 * out: [2 rows][planes][2 num]. buffer: QL_HEAD_BUFFER floats. */
enum { QL_HEAD_SPAN = 64, QL_HEAD_BUFFER = QL_HEAD_SPAN * 64 };
void ql_net_fine_logits(const ql_net *net, const ql_kernels *kernels, const ql_net_window *window, uint32_t group,
                        uint32_t head, uint32_t x, uint32_t y, uint32_t num, float *buffer, float *out);
uint32_t ql_head_planes(uint32_t head);
uint32_t ql_coarse_planes(uint32_t level);

/* One row of level 1 to 4 (1/2 .. 1/16): out [ql_coarse_planes][window's width at that level]. */
void ql_net_coarse_logits(const ql_net *net, const ql_kernels *kernels, const ql_net_window *window, uint32_t group,
                          uint32_t level, uint32_t y, float *buffer, float *out);

#endif
