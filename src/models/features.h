/* SPDX-License-Identifier: Apache-2.0 */
/* Render passes to network inputs; training/features.py computes the same, and tests/golden compares the two. */
#ifndef QL_MODELS_FEATURES_H
#define QL_MODELS_FEATURES_H

#include "kernels/kernels.h"

#include <stdint.h>

enum { QL_NUM_FEATURES = 32, QL_NUM_FLAGS = 6 };
enum { QL_FIRST_GUIDE = 15, QL_NUM_GUIDES = 13 }; /* albedo, normal, depth, alpha, colours: the embedding starts there */
enum { QL_KEY_EXPONENT = 2 }; /* the log average is brought to 2^-2, near middle grey */

/* Planar rows of num_pixels values each, finite, bad pixels being 0; NULL: the frame has no such pass. */
typedef struct ql_feature_rows {
    const float *beauty[3];
    const float *light[4][3];  /* diffuse, glossy, transmission, volume: direct + indirect; all or none */
    const float *direct[3][3]; /* diffuse, glossy, transmission; with light */
    const float *emission[3];  /* with light: emission, and environment where it is part of Combined */
    const float *color[3][3]; /* diffuse, glossy, transmission; with light */
    const float *albedo[3];
    const float *normal[3];
    const float *depth;
    const float *alpha;
} ql_feature_rows;

/* Which passes the frame has, and its scale. */
typedef struct ql_feature_setup {
    int32_t has_light, has_albedo, has_normal, has_depth;
    uint32_t samples;          /* 0: unknown */
    int32_t exposure_exponent; /* ql_log_exponent of beauty */
    int32_t depth_exponent;    /* ql_log_exponent of the valid depths */
} ql_feature_setup;

/* k such that 2^k is nearest to the log average of num bins, those above zero. Scaling all bins by 2^n adds n exactly.
 * Returns 0 without such bins. */
int32_t ql_log_exponent(const float *bins, size_t num);

/* The constant inputs, training/features.py: flags. */
void ql_make_flags(const ql_feature_setup *setup, float flags[QL_NUM_FLAGS]);

/* One row: out[x][QL_NUM_FEATURES]. scratch: num_pixels floats. Light that the frame lacks is all zero. */
void ql_make_feature_row(const ql_kernels *kernels, const ql_feature_setup *setup, const ql_feature_rows *rows,
                         uint32_t num_pixels, float *scratch, float *out);

#endif
