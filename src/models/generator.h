/* SPDX-License-Identifier: Apache-2.0 */
/* The generator of DGAN-KPN, section 3.1.1 of the paper; training/dgan/generator.py is the same in PyTorch. */
#ifndef QL_MODELS_GENERATOR_H
#define QL_MODELS_GENERATOR_H

#include "nn/resample.h"

enum { QL_GENERATOR_LEVELS = 4, QL_GENERATOR_ALIGNMENT = 16, QL_GENERATOR_MAX_BLOCKS = 8 };

typedef struct ql_generator {
    uint32_t widths[QL_GENERATOR_LEVELS];  /* of the encoder; published: 64, 128, 256, 512 */
    uint32_t decoder[QL_GENERATOR_LEVELS]; /* from the coarsest on; published: 256, 128, 64, 64 */
    uint32_t num_blocks;                   /* residual blocks */
    ql_conv encoder[QL_GENERATOR_LEVELS];
    ql_conv blocks[QL_GENERATOR_MAX_BLOCKS][2];
    ql_upconv up[QL_GENERATOR_LEVELS], up_skip[QL_GENERATOR_LEVELS]; /* of the two maps that each level joins */
    ql_conv last, last_skip;                                         /* to 3 channels, of 16 that are computed */
} ql_generator;

quell_status ql_generator_load(ql_generator *generator, const ql_weights *weights, ql_memory *memory, ql_error *err);
void ql_generator_free(ql_generator *generator, ql_memory *memory);
double ql_generator_macs_per_pixel(const ql_generator *generator);
uint64_t ql_generator_peak_bytes(const ql_generator *generator, uint32_t width, uint32_t height);

/* G(z) of one image: rgb[c] points at pixel (0, 0) of a plane whose rows are stride floats apart, scene-linear and
 * finite; the result takes its place. exponent: ql_log_exponent of the noisy image. Results lie in 0 .. the brightest
 * value of the input. Normalisation looks at the whole image, so the whole image is in memory. */
quell_status ql_generator_run(const ql_generator *generator, const ql_kernels *kernels, ql_env *env, uint32_t width,
                              uint32_t height, int32_t exponent, float *const rgb[3], size_t stride, ql_error *err);

#endif
