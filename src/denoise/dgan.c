/* SPDX-License-Identifier: Apache-2.0 */
/* Layers of a set through generator and kernels. The kernels come from the features alone, so all layers share them; the
 * generator runs on each layer by itself. */
#include "denoise/dgan.h"

#include "base/clock.h"
#include "denoise/dgan_auxiliary.h"
#include "filter/wide.h"
#include "metrics/metrics.h"
#include "models/features.h"

#include <stdio.h>
#include <string.h>

enum { MAX_PLANES = 24, DEFAULT_ITERATIONS = 4, MAX_ITERATIONS = 8, MIN_BAND = 2 * QL_WIDE_STEP };

/* Rows of a band: its halo of 16 then costs an eighth more, and the published width stays below 2 GB at 1080p. */
enum { DEFAULT_BAND = 256 };

/* GMSD between input and result of a round below which another one changes nothing that matters (docs/ablation.md). */
#define STOP_GMSD 0.02

/* A layer's planes among those that are filtered together. */
typedef struct member {
    int32_t layer;
    uint32_t first_plane, num_planes;
    int32_t exponent;
} member;

typedef struct batch {
    ql_dgan_job *job;
    ql_env *env;
    ql_error *err;
    const ql_auxiliary *auxiliary;
    member members[MAX_PLANES];
    uint32_t num_members, num_planes;
    ql_wide_planes image, other;
    ql_kpn_band band;
    double seconds_prepare;
    double from, to; /* progress */
} batch;

/* ---- Options and memory ------------------------------------------------------------------------------------------- */

quell_status ql_dgan_options_read(const quell_dgan_options *given, quell_dgan_options *options, ql_error *err)
{
    memset(options, 0, sizeof *options);
    if (given) *options = *given;
    if (options->parts < QUELL_DGAN_BOTH || options->parts > QUELL_DGAN_KERNELS ||
        options->iterate < QUELL_ITERATE_FILTER || options->iterate > QUELL_ITERATE_NETWORK)
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quell_dgan_options: parts %d, iterate %d are none that exist",
                       options->parts, options->iterate);
    if (options->iterations > MAX_ITERATIONS)
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quell_dgan_options: %u iterations; at most %d are run",
                       options->iterations, MAX_ITERATIONS);
    if (options->reserved0 != 0 || (options->flags & ~(uint32_t)QUELL_DGAN_RUN_ALL))
        return ql_fail(err, QUELL_ERR_UNSUPPORTED,
                       "quell_dgan_options: flags or fields that this version does not know");
    if (options->iterations == 0) options->iterations = DEFAULT_ITERATIONS;
    return QUELL_OK;
}

static uint32_t num_planes_of(const ql_dgan_job *job, uint32_t layer)
{
    const ql_layer *const source = &job->frame->layers[job->plan->layers[layer].source];
    /* An alpha that is the same everywhere needs no filter. */
    return source->num_channels == 4 && job->scans[job->plan->layers[layer].source].is_constant_alpha
               ? 3
               : source->num_channels;
}

static uint32_t ring_iterations(const quell_dgan_options *options)
{
    return options->iterate == QUELL_ITERATE_FILTER ? options->iterations : 1;
}

static int stops_early(const quell_dgan_options *options)
{
    return options->iterate == QUELL_ITERATE_NETWORK && !(options->flags & QUELL_DGAN_RUN_ALL);
}

static uint64_t bytes_needed(const ql_dgan_job *job, ql_env *env, uint32_t band_rows)
{
    const uint32_t width = job->frame->width, height = job->frame->height;
    uint32_t planes = 0;
    for (uint32_t i = 0; i < job->plan->num_layers; ++i)
        if (job->plan->layers[i].action == QUELL_ACTION_DENOISED) planes += num_planes_of(job, i);
    if (planes > MAX_PLANES) planes = MAX_PLANES;
    uint64_t generator = 0, kernels = 0;
    if (job->options.parts != QUELL_DGAN_KERNELS)
        generator = ql_generator_peak_bytes(&job->net->generator, width, height);
    if (job->options.parts != QUELL_DGAN_GENERATOR)
        kernels = ql_kpn_band_bytes(&job->net->kpn, width, band_rows, ql_pool_num_threads(env->pool)) +
                  ql_wide_ring_bytes(width, height, ring_iterations(&job->options));
    uint64_t estimate = 0; /* two luminances, and what GMSD takes of each quarter */
    if (stops_early(&job->options)) estimate = (uint64_t)width * height * (2 * sizeof(float) + 6) + (1 << 16);
    return 2 * ql_wide_planes_bytes(width, height, planes) + estimate + (generator > kernels ? generator : kernels);
}

quell_status ql_dgan_choose_bands(ql_dgan_job *job, ql_env *env, uint32_t tile_size, uint64_t max_bytes,
                                  uint64_t *planned_bytes, ql_error *err)
{
    const uint64_t used = atomic_load(&env->memory->used_bytes);
    const uint32_t height = job->frame->height, most = tile_size > 0 ? tile_size : DEFAULT_BAND;
    const uint32_t wanted = most < height ? most : height;
    uint32_t rows = (wanted + QL_WIDE_STEP - 1) / QL_WIDE_STEP * QL_WIDE_STEP;
    while (rows > MIN_BAND && bytes_needed(job, env, rows) + used > max_bytes)
        rows = (rows / 2 + QL_WIDE_STEP - 1) / QL_WIDE_STEP * QL_WIDE_STEP;
    *planned_bytes = bytes_needed(job, env, rows) + used;
    if (*planned_bytes > max_bytes)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY,
                       "DGAN-KPN needs %llu MB of working memory for this image, %llu MB are allowed; raise the limit",
                       (unsigned long long)(*planned_bytes >> 20) + 1, (unsigned long long)(max_bytes >> 20));
    job->band_rows = rows;
    return QUELL_OK;
}

void ql_dgan_missing_passes(const ql_plan_set *set, char *out, size_t size_bytes)
{
    size_t length = 0;
    out[0] = '\0';
    for (uint32_t i = 0; i < QL_AUXILIARY_PASSES; ++i) {
        if (ql_auxiliary_layer(set, i) != QL_PLAN_NONE || length >= size_bytes) continue;
        length += (size_t)snprintf(out + length, size_bytes - length, "%s%s", length ? ", " : "", ql_auxiliary_name(i));
    }
}

/* ---- Planes ------------------------------------------------------------------------------------------------------- */

/* A bad pixel is replaced by the mean of the valid ones in the smallest window that has any, so that its influence ends
 * near it; is_bad: [height][width]. */
static float mean_of_valid(const ql_dgan_job *job, const uint8_t *is_bad, const float *plane, uint32_t x, uint32_t y)
{
    const int64_t width = job->frame->width, height = job->frame->height;
    for (int64_t radius = 1; radius <= QL_WIDE_RADIUS; ++radius) {
        double sum = 0.0;
        uint32_t count = 0;
        for (int64_t v = y > radius ? y - radius : 0; v <= y + radius && v < height; ++v)
            for (int64_t u = x > radius ? x - radius : 0; u <= x + radius && u < width; ++u) {
                if (is_bad[v * width + u]) continue;
                sum += (double)plane[v * width + u];
                ++count;
            }
        if (count) return (float)(sum / count);
    }
    return 0.0f;
}

static quell_status fill_bad(const batch *b, const member *m)
{
    const ql_dgan_job *const job = b->job;
    const ql_scan *const scan = &job->scans[job->plan->layers[m->layer].source];
    const size_t width = job->frame->width, height = job->frame->height;
    if (scan->num_bad == 0) return QUELL_OK;
    uint8_t *const is_bad = ql_alloc_zero(b->env->memory, height, width);
    if (is_bad == NULL) return ql_fail(b->err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: map of bad pixels");
    for (uint64_t i = 0; i < scan->num_fixes; ++i)
        if (scan->fixes[i].scale <= 0.0f) is_bad[scan->fixes[i].y * width + scan->fixes[i].x] = 1;
    for (uint64_t i = 0; i < scan->num_fixes; ++i) {
        const ql_fix *const fix = &scan->fixes[i];
        if (fix->scale > 0.0f) continue;
        for (uint32_t p = 0; p < m->num_planes; ++p)
            ql_wide_row(&b->image, m->first_plane + p, fix->y)[fix->x] =
                mean_of_valid(job, is_bad, job->results[m->layer] + p * width * height, fix->x, fix->y);
    }
    ql_free(b->env->memory, is_bad);
    return QUELL_OK;
}

static quell_status read_planes(batch *b)
{
    const size_t width = b->job->frame->width, height = b->job->frame->height;
    for (uint32_t i = 0; i < b->num_members; ++i) {
        const member *const m = &b->members[i];
        for (uint32_t p = 0; p < m->num_planes; ++p)
            for (uint32_t y = 0; y < height; ++y)
                memcpy(ql_wide_row(&b->image, m->first_plane + p, y),
                       b->job->results[m->layer] + (p * height + y) * width, width * sizeof(float));
        QL_TRY(fill_bad(b, m));
    }
    return QUELL_OK;
}

/* Whether a transparent film's pixel is empty: what nothing covers must not catch the haze of what is next to it. */
static int is_empty(const float *result, size_t plane, size_t at)
{
    return result[at] == 0.0f && result[plane + at] == 0.0f && result[2 * plane + at] == 0.0f &&
           result[3 * plane + at] == 0.0f;
}

static void write_planes(const batch *b)
{
    const size_t width = b->job->frame->width, height = b->job->frame->height, plane = width * height;
    for (uint32_t i = 0; i < b->num_members; ++i) {
        const member *const m = &b->members[i];
        float *const result = b->job->results[m->layer];
        for (uint32_t y = 0; y < height; ++y) {
            const float *rows[4] = {NULL};
            for (uint32_t p = 0; p < m->num_planes; ++p) rows[p] = ql_wide_row(&b->image, m->first_plane + p, y);
            for (size_t x = 0; x < width; ++x) {
                const size_t at = y * width + x;
                if (m->num_planes == 4 && is_empty(result, plane, at)) continue;
                for (uint32_t p = 0; p < m->num_planes; ++p) result[p * plane + at] = rows[p][x];
            }
        }
    }
}

/* ---- One pass through the networks -------------------------------------------------------------------------------- */

static quell_status prepare(void *user, uint32_t y0, uint32_t y1)
{
    batch *const b = user;
    const uint32_t height = b->job->frame->height;
    if (y0 > 0 && y1 <= b->band.y1) return QUELL_OK;
    const double start = ql_clock_seconds();
    const uint32_t end = height - y0 > b->job->band_rows ? y0 + b->job->band_rows : height;
    const quell_status status = ql_kpn_run(&b->job->net->kpn, b->job->kernels, b->env, &b->band, y0, end,
                                           ql_auxiliary_row, (void *)b->auxiliary);
    b->seconds_prepare += ql_clock_seconds() - start;
    return status;
}

static void give_logits(void *user, uint32_t y, uint32_t worker, float *out)
{
    const batch *const b = user;
    ql_kpn_logits_row(&b->job->net->kpn, b->job->kernels, &b->band, y, worker, out);
}

static void share_of_progress(batch *b, double from, double to)
{
    b->env->progress_from = b->from + (b->to - b->from) * from;
    b->env->progress_to = b->from + (b->to - b->from) * to;
}

static quell_status run_generator(batch *b)
{
    const double start = ql_clock_seconds();
    for (uint32_t i = 0; i < b->num_members; ++i) {
        const member *const m = &b->members[i];
        if (m->num_planes < 3) continue; /* a painter of colours */
        float *rgb[3];
        for (uint32_t p = 0; p < 3; ++p) rgb[p] = ql_wide_row(&b->image, m->first_plane + p, 0);
        QL_TRY(ql_generator_run(&b->job->net->generator, b->job->kernels, b->env, b->image.width, b->image.height,
                                m->exponent, rgb, ql_wide_stride(b->image.width), b->err));
    }
    b->job->seconds_network += ql_clock_seconds() - start;
    return QUELL_OK;
}

static quell_status run_kernels(batch *b)
{
    const ql_wide_source source = {b, prepare, give_logits};
    const double start = ql_clock_seconds();
    b->seconds_prepare = 0.0;
    /* Only now: the generator's maps are gone. */
    QL_TRY(ql_kpn_band_create(&b->band, &b->job->net->kpn, b->env, b->image.width, b->image.height, b->job->band_rows,
                              b->err));
    const quell_status status =
        ql_wide_run(b->job->kernels, b->env, &source, ring_iterations(&b->job->options), &b->image, &b->other, b->err);
    ql_kpn_band_destroy(&b->band, b->env->memory);
    b->job->seconds_network += b->seconds_prepare;
    b->job->seconds_filter += ql_clock_seconds() - start - b->seconds_prepare;
    return status;
}

static quell_status run_round(batch *b, uint32_t round, uint32_t num_rounds)
{
    const int32_t parts = b->job->options.parts;
    const double from = (double)round / num_rounds, to = (round + 1.0) / num_rounds;
    const double middle = parts == QUELL_DGAN_BOTH ? from + 0.3 * (to - from) : parts == QUELL_DGAN_KERNELS ? from : to;
    share_of_progress(b, from, middle);
    if (parts != QUELL_DGAN_KERNELS) QL_TRY(run_generator(b));
    share_of_progress(b, middle, to);
    return parts != QUELL_DGAN_GENERATOR ? run_kernels(b) : QUELL_OK;
}

/* ---- Rounds, and when to stop ------------------------------------------------------------------------------------- */

/* Luminance of the first member after z / (1 + z), [height][width]. */
static void luminance(const batch *b, float *out)
{
    const uint32_t num = b->members[0].num_planes < 3 ? b->members[0].num_planes : 3;
    const size_t width = b->image.width;
    for (uint32_t y = 0; y < b->image.height; ++y)
        for (size_t x = 0; x < width; ++x) {
            float sum = 0.0f;
            for (uint32_t p = 0; p < num; ++p) {
                const float z = ql_wide_row(&b->image, b->members[0].first_plane + p, y)[x];
                sum += z > 0.0f ? z / (1.0f + z) : 0.0f;
            }
            out[y * width + x] = sum / (float)num;
        }
}

/* Runs up to num_rounds rounds; *num_run: how many. stops: compare each round's input and result by GMSD. */
static quell_status run_rounds(batch *b, uint32_t num_rounds, int stops, uint32_t *num_run)
{
    const size_t num_pixels = (size_t)b->image.width * b->image.height;
    float *const planes = stops ? ql_alloc(b->env->memory, 2 * num_pixels, sizeof *planes) : NULL;
    if (stops && planes == NULL) return ql_fail(b->err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: estimate of noise");
    float *before = planes, *after = planes ? planes + num_pixels : NULL;
    quell_status status = QUELL_OK;
    double change = 1.0;
    if (stops) luminance(b, before);
    for (*num_run = 0; *num_run < num_rounds && change >= STOP_GMSD && status == QUELL_OK; ++*num_run) {
        status = run_round(b, *num_run, num_rounds);
        if (status != QUELL_OK || !stops) continue;
        luminance(b, after);
        status = ql_metrics_gmsd(b->env, b->image.width, b->image.height, after, before, &change, b->err);
        float *const swap = before;
        before = after;
        after = swap;
    }
    ql_free(b->env->memory, planes);
    return status;
}

/* Takes layers of the set from *next on, as many as fit. */
static void fill_batch(batch *b, int32_t set, uint32_t *next)
{
    const ql_plan *const plan = b->job->plan;
    b->num_members = b->num_planes = 0;
    for (; *next < plan->num_layers; ++*next) {
        const ql_plan_layer *const layer = &plan->layers[*next];
        if (layer->action != QUELL_ACTION_DENOISED || layer->set != set) continue;
        const uint32_t num = num_planes_of(b->job, *next);
        if (b->num_planes + num > MAX_PLANES) return;
        const ql_scan *const scan = &b->job->scans[layer->source];
        b->members[b->num_members++] =
            (member){(int32_t)*next, b->num_planes, num, ql_log_exponent(scan->bins, scan->num_bins)};
        b->num_planes += num;
    }
}

static quell_status run_batch(batch *b, uint32_t num_rounds, int stops, uint32_t *num_run)
{
    const uint32_t width = b->job->frame->width, height = b->job->frame->height;
    ql_memory *const memory = b->env->memory;
    QL_TRY(ql_wide_planes_create(&b->image, width, height, b->num_planes, memory, b->err));
    quell_status status = read_planes(b);
    if (status == QUELL_OK && b->job->options.parts != QUELL_DGAN_GENERATOR)
        status = ql_wide_planes_create(&b->other, width, height, b->num_planes, memory, b->err);
    if (status == QUELL_OK) status = run_rounds(b, num_rounds, stops, num_run);
    if (status == QUELL_OK) write_planes(b);
    ql_wide_planes_destroy(&b->image, memory);
    ql_wide_planes_destroy(&b->other, memory);
    return status;
}

quell_status ql_dgan_run_set(ql_dgan_job *job, ql_env *env, uint32_t set, ql_error *err)
{
    const quell_dgan_options *const options = &job->options;
    const int by_network = options->iterate == QUELL_ITERATE_NETWORK;
    int stops = stops_early(options);
    uint32_t num_rounds = by_network ? options->iterations : 1, num_run = 0;
    const double from = env->progress_from, to = env->progress_to;
    ql_auxiliary auxiliary;
    quell_status status = ql_auxiliary_create(&auxiliary, env, job->frame, &job->plan->sets[set], err);
    for (uint32_t next = 0; status == QUELL_OK;) {
        batch b = {.job = job, .env = env, .err = err, .auxiliary = &auxiliary};
        b.from = from + (to - from) * next / job->plan->num_layers;
        fill_batch(&b, (int32_t)set, &next);
        b.to = from + (to - from) * next / job->plan->num_layers;
        if (b.num_members == 0) break;
        status = run_batch(&b, num_rounds, stops, &num_run);
        /* The first layers, Combined among them, decide for all. */
        num_rounds = num_run;
        stops = 0;
    }
    const uint32_t iterations = by_network ? num_run : options->parts == QUELL_DGAN_GENERATOR ? 1 : options->iterations;
    if (iterations > job->iterations_run) job->iterations_run = iterations;
    env->progress_from = from;
    env->progress_to = to;
    ql_auxiliary_destroy(&auxiliary, env->memory);
    return status;
}
