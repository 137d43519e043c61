/* SPDX-License-Identifier: Apache-2.0 */
/* A made-up picture with Cycles' passes for `quell bench`: smooth shapes under the noise of a few samples, the same on
 * every machine. It is about time and memory: kinds of passes, textures, edges, empty regions and noise are a render's,
 * the light is not. */
#ifndef CLI_BENCH_SCENE_H
#define CLI_BENCH_SCENE_H

#include <stdint.h>

enum {
    CLI_BENCH_SAMPLES = 4, /* per pixel, what the noise is like */
    CLI_BENCH_MAX_LAYERS = 64,
    CLI_BENCH_NUM_GUIDES = 3
};

typedef struct cli_bench_scene cli_bench_scene;

/* A scene that will be seen in the first num_layers layers; with all light passes among them, Combined is their sum.
 * NULL without memory. All are at least 1. */
cli_bench_scene *cli_bench_scene_create(uint32_t width, uint32_t height, uint32_t num_layers);
void cli_bench_scene_destroy(cli_bench_scene *scene);

/* Name of layer `index` in Blender's order: Combined, the light passes with their colours, Volume, Emission,
 * Environment, Ambient Occlusion, then light groups. The text is valid until the next call. */
const char *cli_bench_layer_name(uint32_t index);
uint32_t cli_bench_layer_channels(uint32_t index);

/* The noisy pixels of a layer: pixels[height][width][channels]. */
void cli_bench_fill_layer(const cli_bench_scene *scene, uint32_t index, float *pixels);

/* Guides: Denoising Albedo, Normal, Depth. */
const char *cli_bench_guide_name(uint32_t index);
uint32_t cli_bench_guide_channels(uint32_t index);
void cli_bench_fill_guide(const cli_bench_scene *scene, uint32_t index, float *pixels);

#endif
