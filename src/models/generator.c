/* SPDX-License-Identifier: Apache-2.0 */
/* Encoder of stride-2 convolutions, residual blocks, decoder with skips. Knows planes of an image, no layers of a frame. */
#include "models/generator.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* training/dgan/generator.py: EXPOSURE_STOPS. log(1 + s x) with s = 2^(1 - exponent) is 2 * tone_row(s / 8 * x). */
enum { EXPOSURE_STOPS = 1, TONE_STOPS = 3 };

/* ---- Weights ------------------------------------------------------------------------------------------------------ */

static quell_status read_shape(ql_generator *g, const ql_weights *weights, ql_error *err)
{
    int32_t widths[QL_GENERATOR_LEVELS], decoder[QL_GENERATOR_LEVELS], blocks;
    QL_TRY(ql_weights_get_ints(weights, "config.generator.widths", widths, QL_GENERATOR_LEVELS, err));
    QL_TRY(ql_weights_get_ints(weights, "config.generator.decoder", decoder, QL_GENERATOR_LEVELS, err));
    QL_TRY(ql_weights_get_ints(weights, "config.generator.blocks", &blocks, 1, err));
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) {
        const int32_t w = widths[i], d = decoder[i];
        if (w < QL_BLOCK || w > 1024 || w % QL_BLOCK || d < QL_BLOCK || d > 1024 || d % QL_BLOCK)
            return ql_fail(err, QUELL_ERR_BAD_MODEL,
                           "%s: a generator of %d and %d channels at level %u is none that this library runs",
                           weights->origin, w, d, i);
        g->widths[i] = (uint32_t)w;
        g->decoder[i] = (uint32_t)d;
    }
    if (blocks < 0 || blocks > QL_GENERATOR_MAX_BLOCKS)
        return ql_fail(err, QUELL_ERR_BAD_MODEL, "%s: a generator of %d residual blocks; at most %d are run",
                       weights->origin, blocks, QL_GENERATOR_MAX_BLOCKS);
    g->num_blocks = (uint32_t)blocks;
    return QUELL_OK;
}

/* Channels of the map that decoder level i upsamples, and of the encoder's map joined to it. */
static uint32_t decoder_input(const ql_generator *g, uint32_t i)
{
    return i == 0 ? g->widths[QL_GENERATOR_LEVELS - 1] : g->decoder[i - 1];
}

static uint32_t skip_input(const ql_generator *g, uint32_t i)
{
    return g->widths[QL_GENERATOR_LEVELS - 1 - i];
}

static quell_status load_layers(ql_generator *g, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    char name[QL_RECORD_NAME_BYTES];
    const uint32_t *const w = g->widths, *const d = g->decoder, top = w[QL_GENERATOR_LEVELS - 1];
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) {
        snprintf(name, sizeof name, "encoder.%u", i);
        QL_TRY(ql_conv_load(&g->encoder[i], weights, name, 3, i ? w[i - 1] : 3, w[i], NULL, 0, memory, err));
        snprintf(name, sizeof name, "decoder.%u", i);
        QL_TRY(ql_upconv_load(&g->up[i], weights, name, decoder_input(g, i), d[i], memory, err));
        snprintf(name, sizeof name, "decoder.%u.skip", i);
        QL_TRY(ql_upconv_load(&g->up_skip[i], weights, name, skip_input(g, i), d[i], memory, err));
    }
    for (uint32_t i = 0; i < g->num_blocks; ++i)
        for (uint32_t j = 0; j < 2; ++j) {
            snprintf(name, sizeof name, "block.%u.%u", i, j);
            QL_TRY(ql_conv_load(&g->blocks[i][j], weights, name, 3, top, top, NULL, 0, memory, err));
        }
    QL_TRY(ql_conv_load(&g->last, weights, "last", 3, d[QL_GENERATOR_LEVELS - 1], 3, NULL, 0, memory, err));
    return ql_conv_load(&g->last_skip, weights, "last.skip", 3, 3, 3, NULL, 0, memory, err);
}

quell_status ql_generator_load(ql_generator *generator, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    memset(generator, 0, sizeof *generator);
    quell_status status = read_shape(generator, weights, err);
    if (status == QUELL_OK) status = load_layers(generator, weights, memory, err);
    if (status != QUELL_OK) ql_generator_free(generator, memory);
    return status;
}

void ql_generator_free(ql_generator *generator, ql_memory *memory)
{
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) {
        ql_conv_free(&generator->encoder[i], memory);
        ql_upconv_free(&generator->up[i], memory);
        ql_upconv_free(&generator->up_skip[i], memory);
    }
    for (uint32_t i = 0; i < QL_GENERATOR_MAX_BLOCKS; ++i)
        for (uint32_t j = 0; j < 2; ++j) ql_conv_free(&generator->blocks[i][j], memory);
    ql_conv_free(&generator->last, memory);
    ql_conv_free(&generator->last_skip, memory);
}

double ql_generator_macs_per_pixel(const ql_generator *g)
{
    const double top = g->widths[QL_GENERATOR_LEVELS - 1];
    double macs = g->num_blocks * 2.0 * 9.0 * top * top / 256.0;
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) {
        const double coarse = 1.0 / (double)(4u << (2 * i)); /* pixels of encoder level i */
        macs += 9.0 * (i ? g->widths[i - 1] : 3) * g->widths[i] * coarse;
        const double fine = 1.0 / (double)(1u << (2 * (QL_GENERATOR_LEVELS - 1 - i)));
        macs += 4.0 * (decoder_input(g, i) + skip_input(g, i)) * g->decoder[i] * fine;
    }
    return macs + 9.0 * QL_BLOCK * (g->decoder[QL_GENERATOR_LEVELS - 1] + 3);
}

/* ---- Running ------------------------------------------------------------------------------------------------------ */

static uint32_t align_up(uint32_t value)
{
    return (value + QL_GENERATOR_ALIGNMENT - 1) / QL_GENERATOR_ALIGNMENT * QL_GENERATOR_ALIGNMENT;
}

/* Continues 0 .. size - 1 by reflection about the last pixel, as often as needed. */
static uint32_t mirror(uint32_t i, uint32_t size)
{
    if (size == 1) return 0;
    const uint32_t period = 2 * (size - 1), at = i % period;
    return at < size ? at : period - at;
}

typedef struct image_job {
    const ql_generator *generator;
    const ql_kernels *kernels;
    uint32_t width, height;
    int32_t exponent;
    float *const *rgb;
    size_t stride;
    ql_map *input;
    const ql_map *features;
    float *scratch; /* [workers][padded width][QL_BLOCK] */
    float *row_top; /* [padded height] */
    float top;
} image_job;

static float *worker_scratch(const image_job *job, uint32_t worker)
{
    return job->scratch + (size_t)worker * job->input->width * QL_BLOCK;
}

static void input_task(void *user, uint32_t task, uint32_t worker)
{
    const image_job *const job = user;
    const uint32_t y = mirror(task, job->height);
    float *const row = worker_scratch(job, worker), *const out = ql_map_row(job->input, task);
    const float scale = ldexpf(1.0f, EXPOSURE_STOPS - TONE_STOPS - job->exponent);
    float top = 0.0f;
    for (uint32_t c = 0; c < 3; ++c) {
        job->kernels->tone_row(job->rgb[c] + y * job->stride, scale, row, job->width);
        for (uint32_t x = 0; x < job->input->width; ++x) {
            const float value = 2.0f * row[mirror(x, job->width)];
            out[(size_t)x * 3 + c] = value;
            top = value > top ? value : top;
        }
    }
    job->row_top[task] = top;
}

static void output_task(void *user, uint32_t task, uint32_t worker)
{
    const image_job *const job = user;
    const float scale = ldexpf(1.0f, job->exponent - EXPOSURE_STOPS);
    float *const out = worker_scratch(job, worker);
    const ql_conv *const convs[2] = {&job->generator->last, &job->generator->last_skip};
    const ql_map *const maps[2] = {job->features, job->input};
    for (uint32_t i = 0; i < 2; ++i) {
        const uint32_t channels = maps[i]->channels;
        ql_conv_row row = {
            .weights = convs[i]->weights,
            .bias = convs[i]->bias,
            .add = i ? out : NULL,
            .out = out,
            .num_rows = 3,
            .num_k = 3 * channels,
            .stride = channels,
            .num_pixels = job->width,
            .num_out = QL_BLOCK,
        };
        for (uint32_t r = 0; r < 3; ++r) row.rows[r] = ql_map_row(maps[i], (int64_t)task + r - 1) - channels;
        job->kernels->conv_row(&row);
    }
    for (uint32_t c = 0; c < 3; ++c) {
        float *const to = job->rgb[c] + task * job->stride;
        for (size_t x = 0; x < job->width; ++x) to[x] = out[x * QL_BLOCK + c];
        job->kernels->expm1_row(to, job->top, scale, to, job->width);
    }
}

typedef struct maps {
    ql_map input, encoder[QL_GENERATOR_LEVELS], x, hidden;
} maps;

static quell_status encode(const ql_generator *g, const ql_kernels *kernels, ql_env *env, maps *m, ql_error *err)
{
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) {
        const ql_map *const in = i ? &m->encoder[i - 1] : &m->input;
        QL_TRY(ql_map_create(&m->encoder[i], in->width / 2, in->height / 2, g->widths[i], env->memory, err));
        QL_TRY(ql_conv_down_apply(&g->encoder[i], kernels, env, in, &m->encoder[i]));
        QL_TRY(ql_instance_norm_relu(kernels, env, &m->encoder[i], NULL, err));
    }
    return QUELL_OK;
}

/* m->x = the encoder's last map through the residual blocks. */
static quell_status run_blocks(const ql_generator *g, const ql_kernels *kernels, ql_env *env, maps *m, ql_error *err)
{
    const ql_map *const top = &m->encoder[QL_GENERATOR_LEVELS - 1];
    const size_t bytes = ql_map_bytes(QL_VALUES_FLOAT, top->width, top->height, top->channels);
    QL_TRY(ql_map_create(&m->x, top->width, top->height, top->channels, env->memory, err));
    memcpy(m->x.data, top->data, bytes);
    for (uint32_t i = 0; i < g->num_blocks; ++i) {
        ql_map out = {0};
        QL_TRY(ql_map_create(&m->hidden, top->width, top->height, top->channels, env->memory, err));
        QL_TRY(ql_conv_apply(&g->blocks[i][0], kernels, env, &m->x, &m->hidden, 0));
        QL_TRY(ql_instance_norm_relu(kernels, env, &m->hidden, NULL, err));
        QL_TRY(ql_map_create(&out, top->width, top->height, top->channels, env->memory, err));
        quell_status status = ql_conv_apply(&g->blocks[i][1], kernels, env, &m->hidden, &out, 0);
        if (status == QUELL_OK) status = ql_instance_norm_relu(kernels, env, &out, &m->x, err);
        ql_map_destroy(&m->hidden, env->memory);
        ql_map_destroy(&m->x, env->memory);
        m->x = out;
        QL_TRY(status);
    }
    return QUELL_OK;
}

static quell_status decode(const ql_generator *g, const ql_kernels *kernels, ql_env *env, maps *m, ql_error *err)
{
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) {
        ql_map *const skip = &m->encoder[QL_GENERATOR_LEVELS - 1 - i];
        QL_TRY(ql_map_create(&m->hidden, 2 * m->x.width, 2 * m->x.height, g->decoder[i], env->memory, err));
        QL_TRY(ql_upconv_apply(&g->up[i], &m->x, &g->up_skip[i], skip, kernels, env, &m->hidden, err));
        ql_map_destroy(&m->x, env->memory);
        ql_map_destroy(skip, env->memory);
        m->x = m->hidden;
        m->hidden.data = NULL;
        QL_TRY(ql_instance_norm_relu(kernels, env, &m->x, NULL, err));
    }
    return QUELL_OK;
}

static quell_status run_image(image_job *job, ql_env *env, maps *m, ql_error *err)
{
    QL_TRY(ql_map_create(&m->input, align_up(job->width), align_up(job->height), 3, env->memory, err));
    job->input = &m->input;
    job->scratch =
        ql_alloc(env->memory, (size_t)ql_pool_num_threads(env->pool) * m->input.width, QL_BLOCK * sizeof *job->scratch);
    job->row_top = ql_alloc(env->memory, m->input.height, sizeof *job->row_top);
    if (job->scratch == NULL || job->row_top == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: rows of the generator");
    QL_TRY(ql_env_run(env, m->input.height, input_task, job));
    for (uint32_t y = 0; y < m->input.height; ++y) job->top = job->row_top[y] > job->top ? job->row_top[y] : job->top;
    QL_TRY(encode(job->generator, job->kernels, env, m, err));
    QL_TRY(run_blocks(job->generator, job->kernels, env, m, err));
    QL_TRY(decode(job->generator, job->kernels, env, m, err));
    job->features = &m->x;
    return ql_env_run(env, job->height, output_task, job);
}

quell_status ql_generator_run(const ql_generator *generator, const ql_kernels *kernels, ql_env *env, uint32_t width,
                              uint32_t height, int32_t exponent, float *const rgb[3], size_t stride, ql_error *err)
{
    image_job job = {.generator = generator, .kernels = kernels, .width = width, .height = height};
    maps m = {0};
    job.exponent = exponent;
    job.rgb = rgb;
    job.stride = stride;
    const quell_status status = run_image(&job, env, &m, err);
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i) ql_map_destroy(&m.encoder[i], env->memory);
    ql_map_destroy(&m.input, env->memory);
    ql_map_destroy(&m.hidden, env->memory);
    ql_map_destroy(&m.x, env->memory);
    ql_free(env->memory, job.scratch);
    ql_free(env->memory, job.row_top);
    return status;
}

uint64_t ql_generator_peak_bytes(const ql_generator *g, uint32_t width, uint32_t height)
{
    /* Input and all encoder maps, and the two finest of the decoder. */
    const uint32_t w = align_up(width), h = align_up(height);
    uint64_t bytes = ql_map_bytes(QL_VALUES_FLOAT, w, h, 3);
    for (uint32_t i = 0; i < QL_GENERATOR_LEVELS; ++i)
        bytes += ql_map_bytes(QL_VALUES_FLOAT, w >> (i + 1), h >> (i + 1), g->widths[i]);
    bytes += 3 * ql_map_bytes(QL_VALUES_FLOAT, w / 16, h / 16, g->widths[QL_GENERATOR_LEVELS - 1]);
    bytes += ql_map_bytes(QL_VALUES_FLOAT, w, h, g->decoder[QL_GENERATOR_LEVELS - 1]);
    return bytes + ql_map_bytes(QL_VALUES_FLOAT, w / 2, h / 2, g->decoder[QL_GENERATOR_LEVELS - 2]);
}
