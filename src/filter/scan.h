/* SPDX-License-Identifier: Apache-2.0 */
/* One look at a layer before anything is decided: which pixels are bad, which are fireflies, what there is to do. */
#ifndef QL_FILTER_SCAN_H
#define QL_FILTER_SCAN_H

#include "base/pool.h"
#include "frame/frame.h"

/* How many times brighter than its brightest neighbour a single pixel may be, by samples per pixel (0: unknown).
 * training/features.py: firefly_factor, and why */
#define QL_FIREFLY_FACTOR 0.8125f
#define QL_MIN_FIREFLY_FACTOR 1.625f
#define QL_MAX_FIREFLY_FACTOR 16.0f
#define QL_UNKNOWN_FIREFLY_FACTOR 4.0f
float ql_firefly_factor(uint32_t samples);

#define QL_ABSURD 1e30f /* larger values are bad pixels: their squares overflow */

typedef struct ql_fix {
    uint32_t x, y;
    float scale; /* 0: bad pixel, reads as black and has no weight; else the firefly's factor, below 1 */
} ql_fix;

typedef struct ql_scan {
    ql_fix *fixes; /* by row, then column; owned */
    uint64_t num_fixes, num_bad, num_limited;
    double mean;         /* of valid pixels' colour channels, before fixes */
    float lowest, highest; /* of the same; infinite where there are none */
    int32_t is_zero;     /* every value is 0 */
    int32_t is_constant; /* every pixel is the same */
    int32_t is_constant_alpha;
    float *bins; /* means of 8x8 pixels' luminance after fixes, for ql_log_exponent; owned; NULL unless asked */
    size_t num_bins;
    uint64_t *row_start; /* [height + 1] into fixes; owned */
} ql_scan;

enum {
    QL_SCAN_BINS = 1, /* fill bins */
    QL_SCAN_DEPTH = 2 /* the layer is a depth: background counts as 0 in the bins */
};

/* emission: NULL, or a layer whose radiance is known to be emitted towards the camera and so is no firefly. num_colors:
 * how many channels are colour (alpha is none). firefly_factor: of ql_firefly_factor, 0 where none is looked for. Pixels of
 * the layer must be decoded. */
quell_status ql_scan_layer(ql_env *env, const ql_layer *layer, const ql_layer *emission, uint32_t num_colors,
                           uint32_t width, uint32_t height, uint32_t flags, float firefly_factor, ql_scan *scan,
                           ql_error *err);
void ql_scan_free(ql_scan *scan, ql_memory *memory);

/* Reads one row of the colour channels with the fixes applied; valid, if not NULL, receives 0 or 1 per pixel. */
void ql_read_fixed_row(const ql_layer *layer, const ql_scan *scan, uint32_t width, uint32_t y, uint32_t num_colors,
                       float *const *rows, float *valid);
/* Of that row the pixels x0 <= x < x1 alone, which go to the same places in rows and valid. */
void ql_read_fixed_span(const ql_layer *layer, const ql_scan *scan, uint32_t x0, uint32_t x1, uint32_t y,
                        uint32_t num_colors, float *const *rows, float *valid);

#endif
