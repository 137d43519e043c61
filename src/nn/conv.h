/* SPDX-License-Identifier: Apache-2.0 */
/* Layers of a network on feature maps in memory: which rows meet which weights. The arithmetic is in kernels/. */
#ifndef QL_NN_CONV_H
#define QL_NN_CONV_H

#include "base/pool.h"
#include "kernels/kernels.h"
#include "nn/weights.h"

/* What a feature map's values are. */
typedef enum ql_values { QL_VALUES_FLOAT = 0, QL_VALUES_BF16 = 1 } ql_values;

/* A feature map [height][width][channels] with one pixel of zeros on every side. */
typedef struct ql_map {
    void *data; /* pixel (-1, -1) */
    uint32_t width, height, channels;
    ql_values values;
} ql_map;

/* Of floats, or of values. */
quell_status ql_map_create(ql_map *map, uint32_t width, uint32_t height, uint32_t channels, ql_memory *memory,
                           ql_error *err);
quell_status ql_map_create_of(ql_map *map, ql_values values, uint32_t width, uint32_t height, uint32_t channels,
                              ql_memory *memory, ql_error *err);
void ql_map_destroy(ql_map *map, ql_memory *memory);
/* Pixel (0, y), y from -1 to height, of a map of floats; of one of bfloat16. */
float *ql_map_row(const ql_map *map, int64_t y);
uint16_t *ql_map_bf16_row(const ql_map *map, int64_t y);
size_t ql_map_bytes(ql_values values, uint32_t width, uint32_t height, uint32_t channels);

typedef struct ql_conv {
    uint32_t size;            /* 5: 5x5, 3: 3x3, 1: 1x1, all stride 1; 2: 2x2, stride 2 */
    uint32_t num_in, num_out; /* num_out is padded to QL_BLOCK */
    float *weights, *bias;    /* packed for ql_conv_row */
    uint16_t *bf16_weights;   /* packed for ql_bf16_conv_row, or NULL: then the layer is computed in float on any map */
} ql_conv;

/* Reads 'NAME.weight' [size][size][num_in][num_out] and 'NAME.bias' [num_out], which is 0 where the file has none. order, if not NULL, picks num_order of
 * the file's output channels, in that order. */
quell_status ql_conv_load(ql_conv *conv, const ql_weights *weights, const char *name, uint32_t size, uint32_t num_in,
                          uint32_t num_out, const uint32_t *order, uint32_t num_order, ql_memory *memory,
                          ql_error *err);
void ql_conv_free(ql_conv *conv, ql_memory *memory);

/* Makes the weights in bfloat16 too, for maps of that. */
quell_status ql_conv_add_bf16(ql_conv *conv, ql_memory *memory, ql_error *err);

/* Fills conv->weights from [k][file_out] in the file's order to [out / 16][k][16], with zeros for the padding. order, if
 * not NULL, picks num of the output channels. */
void ql_conv_pack(ql_conv *conv, const float *file, uint32_t file_out, const uint32_t *order, uint32_t num);

/* One row of a 3x3 or 1x1 convolution at row y, pixels x .. x + num - 1, into out [num][num_out]. On a map of bfloat16 it is
 * 1x1, in bfloat16 with float sums if conv has such weights. */
void ql_conv_apply_row(const ql_conv *conv, const ql_kernels *kernels, const ql_map *in, uint32_t x, uint32_t y,
                       uint32_t num, int32_t relu, float *out);

/* Whole maps of the same values, rows in parallel. out has the right size and num_out channels. */
quell_status ql_conv_apply(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, const ql_map *in, ql_map *out,
                           int32_t relu);

/* map = max(0, conv(map)) for a 3x3 convolution of as many channels out as in, without a second map. */
quell_status ql_conv_relu_in_place(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, ql_map *map,
                                   ql_error *err);
/* What that needs beside the map. */
uint64_t ql_conv_in_place_bytes(ql_values values, uint32_t width, uint32_t height, uint32_t channels,
                                uint32_t num_workers);

/* map = max(0, map + conv(coarse)), conv: 1x1, coarse of twice the pixel size and the same values. */
quell_status ql_conv_upsample_add_relu(const ql_conv *conv, const ql_kernels *kernels, ql_env *env,
                                       const ql_map *coarse, ql_map *map, ql_error *err);

#endif
