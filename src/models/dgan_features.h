/* SPDX-License-Identifier: Apache-2.0 */
/* The 13 auxiliary channels of DGAN-KPN, section 3.2 of the paper; training/dgan/features.py computes the same. */
#ifndef QL_MODELS_DGAN_FEATURES_H
#define QL_MODELS_DGAN_FEATURES_H

#include <stdint.h>

/* Planar rows; the first of a group is NULL where the frame has no such pass, which then reads as zeros. Values that are
 * not finite read as 0. */
typedef struct ql_dgan_rows {
    const float *normal[3], *position[3];
    const float *texture_1[3];    /* albedo */
    const float *texture_2[2][3]; /* glossy and transmission colour, added */
    const float *depth;
} ql_dgan_rows;

/* A frame's scale. */
typedef struct ql_dgan_scale {
    float center[3], position_scale; /* position to -1..1: the box round what the camera hit */
    int32_t depth_exponent;          /* ql_log_exponent of the hits' depth */
} ql_dgan_scale;

/* Whether the camera saw a surface: by depth, or where there is none by a position other than the origin. */
int ql_dgan_is_hit(const ql_dgan_rows *rows, uint32_t x);

/* out[num_pixels][QL_KPN_AUXILIARY] */
void ql_dgan_feature_row(const ql_dgan_scale *scale, const ql_dgan_rows *rows, uint32_t num_pixels, float *out);

#endif
