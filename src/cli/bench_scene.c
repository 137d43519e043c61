/* SPDX-License-Identifier: Apache-2.0 */
/* Spheres and boards before a sky, each with a material; light is a smooth function of place and normal. A pass's noise
 * is that of Monte Carlo: each sample finds the light with some probability and then counts the more. */
#include "cli/bench_scene.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { NUM_SHAPES = 40, NUM_COLORS = 3, NUM_GROUPS = 3, SKY = 0xff };

/* Passes in Blender's order; what follows them are light groups. */
enum {
    COMBINED,
    FIRST_LIGHT, /* diffuse, glossy, transmission: direct, indirect, colour */
    VOLUME_DIRECT = FIRST_LIGHT + 3 * NUM_GROUPS,
    VOLUME_INDIRECT,
    EMISSION,
    ENVIRONMENT,
    AMBIENT_OCCLUSION,
    FIRST_LIGHT_GROUP
};

static const char *const pass_names[FIRST_LIGHT_GROUP] = {"Combined",  "DiffDir",   "DiffInd",  "DiffCol",  "GlossDir",
                                                          "GlossInd",  "GlossCol",  "TransDir", "TransInd", "TransCol",
                                                          "VolumeDir", "VolumeInd", "Emit",     "Env",      "AO"};
static const char *const guide_names[CLI_BENCH_NUM_GUIDES] = {"Denoising Albedo", "Denoising Normal",
                                                              "Denoising Depth"};

typedef struct material {
    float color[NUM_GROUPS][NUM_COLORS]; /* diffuse, glossy, transmission; black: the group has nothing here */
    float emission;
    float stripes; /* of the texture across the picture's height; 0: plain */
} material;

/* What the camera sees in a pixel. */
typedef struct surface {
    float normal[NUM_COLORS];
    float depth;
    uint8_t shape; /* SKY: none */
} surface;

typedef struct shape {
    float x, y, radius, depth; /* in picture heights */
    int is_sphere;
    material material;
} shape;

struct cli_bench_scene {
    uint32_t width, height;
    int has_layer[FIRST_LIGHT_GROUP]; /* what Combined is the sum of */
    shape shapes[NUM_SHAPES];
    surface *surfaces; /* [height][width] */
};

/* ---- Numbers ----------------------------------------------------------------------------------------------------- */

static uint32_t hash(uint32_t value)
{
    value ^= value >> 16;
    value *= 0x7feb352du;
    value ^= value >> 15;
    value *= 0x846ca68bu;
    return value ^ value >> 16;
}

/* In [0, 1), by two counters. */
static float uniform(uint32_t a, uint32_t b)
{
    return (float)(hash(a * 0x9e3779b9u + hash(b)) >> 8) * 0x1p-24f;
}

/* Mean 1: of CLI_BENCH_SAMPLES samples, each finds the light with that chance. */
static float noise(uint32_t pixel, uint32_t stream, float chance)
{
    float sum = 0.0f;
    for (uint32_t s = 0; s < CLI_BENCH_SAMPLES; s++) {
        const float u = uniform(pixel, stream * CLI_BENCH_SAMPLES + s);
        if (u < chance) sum += (0.5f + u / chance) / chance;
    }
    return sum / CLI_BENCH_SAMPLES;
}

/* ---- Making the scene -------------------------------------------------------------------------------------------- */

static void make_shape(shape *out, uint32_t index, float aspect)
{
    const uint32_t seed = 1000 * index;
    out->x = aspect * uniform(seed, 1);
    out->y = uniform(seed, 2);
    out->radius = 0.03f + 0.22f * uniform(seed, 3) * uniform(seed, 4);
    out->depth = 2.0f + 10.0f * uniform(seed, 5);
    out->is_sphere = uniform(seed, 6) < 0.6f;
    material *const m = &out->material;
    const float kind = uniform(seed, 7); /* mostly diffuse under a clear coat, some metal, some glass, a few lamps */
    for (uint32_t c = 0; c < NUM_COLORS; c++) {
        const float tint = 0.1f + 0.8f * uniform(seed, 10 + c);
        m->color[0][c] = kind < 0.7f ? tint : 0.0f;
        m->color[1][c] = kind < 0.7f ? 0.04f : kind < 0.85f ? tint : 0.1f;
        m->color[2][c] = kind >= 0.85f && kind < 0.95f ? 0.8f + 0.2f * tint : 0.0f;
    }
    m->emission = kind >= 0.95f ? 6.0f : 0.0f;
    m->stripes = uniform(seed, 8) < 0.5f ? 20.0f + 60.0f * uniform(seed, 9) : 0.0f;
}

static surface look(const cli_bench_scene *scene, float x, float y)
{
    surface seen = {.normal = {0.0f, 0.0f, 0.0f}, .depth = 1e10f, .shape = SKY};
    for (uint32_t i = 0; i < NUM_SHAPES; i++) {
        const shape *const s = &scene->shapes[i];
        const float dx = (x - s->x) / s->radius, dy = (y - s->y) / s->radius, square = dx * dx + dy * dy;
        const int is_hit = s->is_sphere ? square < 1.0f : fabsf(dx) < 1.0f && fabsf(dy) < 0.6f;
        if (!is_hit || s->depth >= seen.depth) continue;
        seen.shape = (uint8_t)i;
        seen.depth = s->depth;
        seen.normal[0] = s->is_sphere ? dx : 0.3f;
        seen.normal[1] = s->is_sphere ? -dy : 0.2f;
        seen.normal[2] = s->is_sphere ? sqrtf(1.0f - square) : sqrtf(1.0f - 0.3f * 0.3f - 0.2f * 0.2f);
    }
    return seen;
}

cli_bench_scene *cli_bench_scene_create(uint32_t width, uint32_t height, uint32_t num_layers)
{
    cli_bench_scene *const scene = malloc(sizeof *scene);
    if (!scene) return NULL;
    scene->width = width;
    scene->height = height;
    scene->surfaces = malloc((size_t)width * height * sizeof *scene->surfaces);
    if (!scene->surfaces) {
        free(scene);
        return NULL;
    }
    /* Passes that are not written hold nothing, unless none of the sum can be made anyway. */
    for (uint32_t i = 0; i < FIRST_LIGHT_GROUP; i++) scene->has_layer[i] = i < num_layers || num_layers < VOLUME_DIRECT;
    const float unit = 1.0f / (float)height;
    for (uint32_t i = 0; i < NUM_SHAPES; i++) make_shape(&scene->shapes[i], i, (float)width * unit);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            scene->surfaces[(size_t)y * width + x] = look(scene, ((float)x + 0.5f) * unit, ((float)y + 0.5f) * unit);
    return scene;
}

void cli_bench_scene_destroy(cli_bench_scene *scene)
{
    if (!scene) return;
    free(scene->surfaces);
    free(scene);
}

/* ---- Passes ------------------------------------------------------------------------------------------------------ */

/* One pixel and what of it a pass may need. */
typedef struct pixel {
    const surface *surface;
    const material *material; /* NULL: sky */
    uint32_t index;
    float u, v; /* place, in picture heights */
    float texture;
} pixel;

static pixel pixel_at(const cli_bench_scene *scene, uint32_t x, uint32_t y)
{
    const float unit = 1.0f / (float)scene->height;
    pixel p = {.surface = &scene->surfaces[(size_t)y * scene->width + x], .texture = 1.0f};
    p.index = y * scene->width + x;
    p.u = (float)x * unit;
    p.v = (float)y * unit;
    if (p.surface->shape == SKY) return p;
    p.material = &scene->shapes[p.surface->shape].material;
    const float stripes = p.material->stripes;
    if (stripes > 0.0f && ((int)(p.u * stripes) + (int)(p.v * stripes)) % 2) p.texture = 0.6f;
    return p;
}

static float pass_color(const pixel *p, uint32_t group, uint32_t c)
{
    if (!p->material) return 0.0f;
    return p->material->color[group][c] * (group == 0 ? p->texture : 1.0f);
}

/* Light that falls on the pixel in a group: direct light is found by most samples, indirect light by few. */
static float light(const pixel *p, uint32_t group, int is_indirect, uint32_t c)
{
    static const float tint[NUM_COLORS] = {1.0f, 0.9f, 0.75f};
    if (!p->material || !(p->material->color[group][c] > 0.0f)) return 0.0f;
    const float *const n = p->surface->normal;
    const uint32_t stream = 2 * group + (uint32_t)is_indirect;
    if (is_indirect) return (0.15f + 0.1f * n[1]) * noise(p->index, stream, 0.12f) * (1.3f - tint[c] / 2.0f);
    const float facing = 0.5f * n[0] + 0.6f * n[1] + 0.6f * n[2];
    const float clean = group == 0 ? facing : facing > 0.9f ? 8.0f * (facing - 0.9f) : 0.02f;
    return clean > 0.0f ? 2.0f * clean * tint[c] * noise(p->index, stream, 0.55f) : 0.0f;
}

static float volume(const pixel *p, int is_indirect)
{
    const float clean = 0.06f * expf(-4.0f * (p->v - 0.3f) * (p->v - 0.3f));
    return clean * noise(p->index, 10 + (uint32_t)is_indirect, is_indirect ? 0.08f : 0.3f) *
           (is_indirect ? 0.3f : 1.0f);
}

static float sky(const pixel *p, uint32_t c)
{
    static const float zenith[NUM_COLORS] = {0.25f, 0.4f, 0.9f};
    return p->material ? 0.0f : 0.4f + zenith[c] * (1.0f - p->v);
}

static float emitted(const pixel *p)
{
    return p->material ? p->material->emission : 0.0f;
}

static float combined(const cli_bench_scene *scene, const pixel *p, uint32_t c)
{
    const int *const has = scene->has_layer;
    float sum = 0.0f;
    for (uint32_t g = 0; g < NUM_GROUPS; g++) sum += (light(p, g, 0, c) + light(p, g, 1, c)) * pass_color(p, g, c);
    if (has[VOLUME_DIRECT]) sum += volume(p, 0);
    if (has[VOLUME_INDIRECT]) sum += volume(p, 1);
    if (has[EMISSION]) sum += emitted(p);
    if (has[ENVIRONMENT]) sum += sky(p, c);
    return sum;
}

static float value_of(const cli_bench_scene *scene, const pixel *p, uint32_t layer, uint32_t c)
{
    if (c == NUM_COLORS) return 1.0f; /* an opaque film */
    if (layer >= FIRST_LIGHT && layer < VOLUME_DIRECT) {
        const uint32_t group = (layer - FIRST_LIGHT) / 3, kind = (layer - FIRST_LIGHT) % 3;
        return kind == 2 ? pass_color(p, group, c) : light(p, group, (int)kind, c);
    }
    switch (layer) {
    case COMBINED: return combined(scene, p, c);
    case VOLUME_DIRECT: return volume(p, 0);
    case VOLUME_INDIRECT: return volume(p, 1);
    case EMISSION: return emitted(p);
    case ENVIRONMENT: return sky(p, c);
    case AMBIENT_OCCLUSION: return p->material ? noise(p->index, 20, 0.8f) : 0.0f;
    default: /* a group's lamps stand at another place each */
        return combined(scene, p, c) * (0.2f + 0.8f * uniform(layer, 30)) / (1.0f + p->u * uniform(layer, 31));
    }
}

const char *cli_bench_layer_name(uint32_t index)
{
    static char light_group[32];
    if (index < FIRST_LIGHT_GROUP) return pass_names[index];
    snprintf(light_group, sizeof light_group, "Combined_lamp%02u", index - FIRST_LIGHT_GROUP + 1);
    return light_group;
}

uint32_t cli_bench_layer_channels(uint32_t index)
{
    return index == COMBINED ? NUM_COLORS + 1 : NUM_COLORS;
}

void cli_bench_fill_layer(const cli_bench_scene *scene, uint32_t index, float *pixels)
{
    const uint32_t channels = cli_bench_layer_channels(index);
    for (uint32_t y = 0; y < scene->height; y++)
        for (uint32_t x = 0; x < scene->width; x++) {
            const pixel p = pixel_at(scene, x, y);
            for (uint32_t c = 0; c < channels; c++) *pixels++ = value_of(scene, &p, index, c);
        }
}

const char *cli_bench_guide_name(uint32_t index)
{
    return guide_names[index];
}

uint32_t cli_bench_guide_channels(uint32_t index)
{
    return index == 2 ? 1 : NUM_COLORS;
}

void cli_bench_fill_guide(const cli_bench_scene *scene, uint32_t index, float *pixels)
{
    const uint32_t channels = cli_bench_guide_channels(index);
    for (uint32_t y = 0; y < scene->height; y++)
        for (uint32_t x = 0; x < scene->width; x++) {
            const pixel p = pixel_at(scene, x, y);
            for (uint32_t c = 0; c < channels; c++) {
                float value = p.surface->depth;
                if (index == 0) value = p.material ? pass_color(&p, 0, c) + pass_color(&p, 1, c) : sky(&p, c);
                if (index == 1) value = p.surface->normal[c];
                *pixels++ = value;
            }
        }
}
