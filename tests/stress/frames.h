/* SPDX-License-Identifier: Apache-2.0 */
/* Frames with Cycles' passes, made from nothing, and what a denoise makes of them. */
#ifndef STRESS_FRAMES_H
#define STRESS_FRAMES_H

#include "quell.h"

enum { MAX_LAYERS = 20 };

/* Which layers a frame has: bit i is layer_name(i). */
enum {
    LAYER_COMBINED = 0,
    LAYER_ALBEDO = 1,
    LAYER_NORMAL = 2,
    LAYER_DEPTH = 3,
    LAYER_FIRST_LIGHT = 4, /* diffuse, glossy, transmission: direct, indirect, colour */
    LAYER_VOLUME_DIRECT = 13,
    LAYER_VOLUME_INDIRECT = 14,
    LAYER_EMISSION = 15,
    LAYER_ENVIRONMENT = 16,
    NUM_LAYERS = 17
};
#define MASK(layer) (1u << (layer))
#define MASK_GUIDES (MASK(LAYER_ALBEDO) | MASK(LAYER_NORMAL) | MASK(LAYER_DEPTH))
#define MASK_LIGHT (0x1ffu << LAYER_FIRST_LIGHT)
#define MASK_ALL (MASK(NUM_LAYERS) - 1u)

const char *layer_name(uint32_t layer);
uint32_t layer_channels(uint32_t layer);
int layer_is_radiance(uint32_t layer); /* scales with exposure */

/* Planes of each layer in the mask: [height][width][channels], owned; NULL for the others. */
typedef struct stress_frame {
    uint32_t width, height, mask, samples;
    int32_t is_half;
    float *layers[NUM_LAYERS];
} stress_frame;

/* A room's worth of noise round edges and a gradient; the light passes sum to Combined. */
stress_frame *frame_create(uint32_t width, uint32_t height, uint32_t mask);
stress_frame *frame_copy(const stress_frame *frame);
void frame_destroy(stress_frame *frame);

/* What was denoised, and how. */
typedef struct stress_run {
    uint32_t num_threads, tile_size, flags;
    uint64_t max_memory_bytes;
} stress_run;

typedef struct stress_report {
    int32_t is_denoised[NUM_LAYERS];
    int32_t is_mixed; /* Combined is made from its parts too */
    uint64_t num_limited, num_bad;
    double mean_before, mean_after; /* Combined's */
    uint32_t halo;                  /* that tiles are computed with; 0 for a single one */
} stress_report;

/* Denoises a copy of the frame; the result has its layers. Returns the status; *out is NULL on failure. */
quell_status frame_denoise(const stress_frame *frame, const stress_run *run, stress_frame **out, stress_report *report);

/* Whether two frames of one size have the same bits. */
int frame_equal(const stress_frame *a, const stress_frame *b);

/* Checks the promises of docs/ARCHITECTURE.md: finite, and within the range of the valid input pixels of the layer's
 * channel. Returns NULL, or a sentence about the first fault; lent until the next call. */
const char *frame_check(const stress_frame *in, const stress_frame *out, const stress_report *report);

#endif
