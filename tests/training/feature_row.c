/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Features of one row as the library makes them, for test_training_constants.py. stdin: 8 int32 (number of pixels,
 * has_light, has_albedo, has_normal, has_depth, samples, exposure exponent, depth exponent), then float planes of that
 * many pixels: beauty 3, light 4x3, direct light 3x3, emission 3, colour 3x3, albedo 3, normal 3, depth, alpha. stdout:
 * floats, flags and features.
 */
#include "models/features.h"

#include <stdio.h>
#include <stdlib.h>

enum { NUM_PLANES = 44 };

int main(void)
{
    int32_t head[8];
    ql_kernels kernels;
    float flags[QL_NUM_FLAGS];
    if (fread(head, sizeof *head, 8, stdin) != 8) return 1;
    const size_t n = (size_t)head[0];
    float *const planes = malloc(NUM_PLANES * n * sizeof *planes), *const scratch = malloc(n * sizeof *scratch);
    float *const out = malloc(n * QL_NUM_FEATURES * sizeof *out);
    if (!planes || !scratch || !out || fread(planes, sizeof *planes, NUM_PLANES * n, stdin) != NUM_PLANES * n) return 1;
    const ql_feature_setup setup = {.has_light = head[1],
                                    .has_albedo = head[2],
                                    .has_normal = head[3],
                                    .has_depth = head[4],
                                    .samples = (uint32_t)head[5],
                                    .exposure_exponent = head[6],
                                    .depth_exponent = head[7]};
    ql_feature_rows rows;
    const float *next = planes;
    for (int i = 0; i < 3; ++i, next += n) rows.beauty[i] = next;
    for (int i = 0; i < 12; ++i, next += n) rows.light[i / 3][i % 3] = next;
    for (int i = 0; i < 9; ++i, next += n) rows.direct[i / 3][i % 3] = next;
    for (int i = 0; i < 3; ++i, next += n) rows.emission[i] = next;
    for (int i = 0; i < 9; ++i, next += n) rows.color[i / 3][i % 3] = next;
    for (int i = 0; i < 3; ++i, next += n) rows.albedo[i] = next;
    for (int i = 0; i < 3; ++i, next += n) rows.normal[i] = next;
    rows.depth = next;
    rows.alpha = next + n;
    ql_kernels_init(&kernels, 0);
    ql_make_flags(&setup, flags);
    ql_make_feature_row(&kernels, &setup, &rows, (uint32_t)n, scratch, out);
    fwrite(flags, sizeof *flags, QL_NUM_FLAGS, stdout);
    fwrite(out, sizeof *out, n * QL_NUM_FEATURES, stdout);
    free(out);
    free(scratch);
    free(planes);
    return 0;
}
