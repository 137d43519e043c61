/* SPDX-License-Identifier: Apache-2.0 */
/* Convolutions that change the resolution of a feature map, and instance normalisation over a whole one. */
#ifndef QL_NN_RESAMPLE_H
#define QL_NN_RESAMPLE_H

#include "nn/conv.h"

/* 3x3 convolution with stride 2 and zeros outside: out is half as large as in, whose sides are even. conv: size 3. */
quell_status ql_conv_down_apply(const ql_conv *conv, const ql_kernels *kernels, ql_env *env, const ql_map *in,
                                ql_map *out);

/* Upsampling by nearest neighbour, then a 3x3 convolution. Each output pixel sees only 2x2 pixels of the coarse map, so
 * the 3x3 weights are summed into one 2x2 convolution per output parity: 4/9 of the multiply-adds. */
typedef struct ql_upconv {
    ql_conv phase[2][2]; /* [y parity][x parity] */
} ql_upconv;

/* Reads 'NAME.weight' [3][3][num_in][num_out]; a bias is not read. num_out is a multiple of QL_BLOCK. */
quell_status ql_upconv_load(ql_upconv *up, const ql_weights *weights, const char *name, uint32_t num_in,
                            uint32_t num_out, ql_memory *memory, ql_error *err);
void ql_upconv_free(ql_upconv *up, ql_memory *memory);

/* out = first(a) + second(b): the convolution of the joined channels of two maps of one size. out is twice as large. */
quell_status ql_upconv_apply(const ql_upconv *first, const ql_map *a, const ql_upconv *second, const ql_map *b,
                             const ql_kernels *kernels, ql_env *env, ql_map *out, ql_error *err);

/* map = max(0, (map - mean) / sqrt(variance + 1e-5)) + add, mean and variance of each channel over the whole map, taken
 * in double per row and joined in order: the same bits for any number of threads. add: NULL, or a map of map's shape.
 * map->channels is a multiple of QL_BLOCK. */
quell_status ql_instance_norm_relu(const ql_kernels *kernels, ql_env *env, ql_map *map, const ql_map *add,
                                   ql_error *err);

#endif
