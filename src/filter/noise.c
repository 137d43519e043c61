/* SPDX-License-Identifier: Apache-2.0 */
/* Measures block by block, in bands of a block's height. A band depends on its own rows and one above and below, so the
 * result is the same for any number of threads. */
#include "filter/noise.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { BLOCK = QL_NOISE_BLOCK, DIRECTIONS = 4, MAX_COLORS = 3, NUM_EXPONENTS = 512, EXPONENT_BIAS = 256 };
enum {
    ENERGY = DIRECTIONS,
    NUM_SUMS = DIRECTIONS + 1
}; /* what is summed up: h^2 of each direction; the energy itself */

/* Half floats round at 2^-11 of a value: what is below that is none. */
#define LEAST_VARIANCE 1e-7f

typedef struct noise_job {
    const ql_layer *layer;
    const ql_scan *scan;
    const float *result; /* NULL: the layer itself is measured, else result - layer */
    uint32_t num_colors, width, height, across, down;
    uint32_t mx, my; /* pixels at an edge that lack a neighbour: 1, or 0 where the image is too thin for any */
    float floor;
    float *sums[NUM_SUMS], *scale; /* [down][across] each */
    float *scratch;                /* per worker: band_floats */
    size_t band_floats;
} noise_job;

uint32_t ql_noise_blocks(uint32_t pixels)
{
    return (pixels + BLOCK - 1) / BLOCK;
}

/* A half to a quarter of the median block's brightness. A power of two found by counting exponents, so that radiance
 * times 2^n gives exactly 2^n times as much. Blocks with a firefly say nothing: what is left of it is still no part of the picture. */
static float choose_floor(const ql_scan *scan, uint32_t across, uint8_t *has_firefly)
{
    uint32_t counts[NUM_EXPONENTS] = {0};
    uint64_t total = 0, below = 0;
    memset(has_firefly, 0, scan->num_bins);
    for (uint64_t i = 0; i < scan->num_fixes; ++i)
        has_firefly[(size_t)(scan->fixes[i].y / BLOCK) * across + scan->fixes[i].x / BLOCK] = 1;
    for (size_t i = 0; i < scan->num_bins; ++i) {
        int exponent;
        const float value = fabsf(scan->bins[i]);
        if (!(value > 0.0f) || !isfinite(value) || has_firefly[i]) continue;
        frexpf(value, &exponent);
        ++counts[exponent + EXPONENT_BIAS];
        ++total;
    }
    if (total == 0) return FLT_MIN; /* each block by its own brightness alone */
    int median = 0;
    for (int e = 0; e < NUM_EXPONENTS; ++e) {
        below += counts[e];
        if (2 * below < total) continue;
        median = e - EXPONENT_BIAS;
        break;
    }
    const float floor = ldexpf(0.25f, median);
    return floor > FLT_MIN ? floor : FLT_MIN;
}

static void read_luminance(const noise_job *job, uint32_t y, float *const *rows, float *valid, float *out)
{
    ql_read_fixed_row(job->layer, job->scan, job->width, y, job->num_colors, rows, valid);
    const float share = 1.0f / (float)job->num_colors;
    for (uint32_t x = 0; x < job->width; ++x) {
        float sum = rows[0][x];
        for (uint32_t c = 1; c < job->num_colors; ++c) sum += rows[c][x];
        out[x] = sum * share;
    }
    if (job->result) {
        for (uint32_t c = 0; c < job->num_colors; ++c) {
            const float *const row = job->result + ((size_t)c * job->height + y) * job->width;
            for (uint32_t x = 0; x < job->width; ++x) rows[0][x] = c > 0 ? rows[0][x] + row[x] : row[x];
        }
        for (uint32_t x = 0; x < job->width; ++x) out[x] = rows[0][x] * share - out[x];
    }
    /* A bad pixel is no noise: it takes its neighbour's value, and its change is none. That of a firefly is none either:
     * what is left of it is no detail that kernels could lose. */
    for (uint64_t i = job->scan->row_start[y]; i < job->scan->row_start[y + 1]; ++i) {
        const uint32_t x = job->scan->fixes[i].x;
        if (valid[x] == 0.0f || job->result) out[x] = job->result || x == 0 ? 0.0f : out[x - 1];
    }
}

/* Brightness of the band's blocks: scale = 1 / (mean + floor). */
static void measure_scale(const noise_job *job, uint32_t band, const float *luminance, size_t stride, uint32_t num_rows)
{
    for (uint32_t b = 0; b < job->across; ++b) {
        const uint32_t x0 = b * BLOCK, x1 = x0 + BLOCK < job->width ? x0 + BLOCK : job->width;
        double sum = 0.0;
        for (uint32_t r = 0; r < num_rows; ++r)
            for (uint32_t x = x0; x < x1; ++x) sum += (double)fabsf(luminance[r * stride + x]);
        const float mean = (float)(sum / (double)(num_rows * (x1 - x0)));
        job->scale[(size_t)band * job->across + b] = 1.0f / (mean + job->floor);
    }
}

/* sums[d][x] += h_d^2 of one row, for x from mx to width - mx - 1. */
static void add_row(const noise_job *job, const float *row, ptrdiff_t stride, const float *restrict inverse,
                    float *const *sums)
{
    const ptrdiff_t steps[DIRECTIONS] = {1, stride, stride + 1, stride - 1};
    const int has[DIRECTIONS] = {job->mx > 0, job->my > 0, job->mx && job->my, job->mx && job->my};
    for (uint32_t d = 0; d < DIRECTIONS; ++d) {
        if (!has[d]) continue;
        const float *const before = row - steps[d], *const after = row + steps[d];
        float *restrict const sum = sums[d];
        for (uint32_t x = job->mx; x < job->width - job->mx; ++x) {
            const float h = (before[x] + after[x] - 2.0f * row[x]) * inverse[x];
            sum[x] += h * h * (1.0f / 6.0f);
        }
    }
}

/* sums[x] += value^2 of one row. */
static void add_energy(const noise_job *job, const float *row, const float *restrict inverse, float *restrict sums)
{
    for (uint32_t x = 0; x < job->width; ++x) {
        const float value = row[x] * inverse[x];
        sums[x] += value * value;
    }
}

static void band_task(void *user, uint32_t task, uint32_t worker)
{
    const noise_job *const job = user;
    const size_t stride = job->width;
    float *const luminance = job->scratch + worker * job->band_floats; /* row 0 is y0 - 1 */
    float *const inverse = luminance + (BLOCK + 2) * stride, *const valid = inverse + stride;
    float *const colors = valid + stride;
    float *rows[MAX_COLORS], *sums[NUM_SUMS];
    for (size_t c = 0; c < MAX_COLORS; ++c) rows[c] = colors + c * stride;
    for (size_t i = 0; i < NUM_SUMS; ++i) sums[i] = colors + (MAX_COLORS + i) * stride;
    const uint32_t y0 = task * BLOCK, y1 = y0 + BLOCK < job->height ? y0 + BLOCK : job->height;
    const uint32_t from = y0 > 0 ? y0 - 1 : 0, to = y1 < job->height ? y1 + 1 : y1;
    for (uint32_t y = from; y < to; ++y) read_luminance(job, y, rows, valid, luminance + (y + 1 - y0) * stride);
    if (job->result == NULL) measure_scale(job, task, luminance + stride, stride, y1 - y0);
    for (uint32_t x = 0; x < job->width; ++x) inverse[x] = job->scale[(size_t)task * job->across + x / BLOCK];
    memset(sums[0], 0, NUM_SUMS * stride * sizeof *sums[0]);
    for (uint32_t y = y0; y < y1; ++y) {
        const float *const row = luminance + (y + 1 - y0) * stride;
        if (y >= job->my && y < job->height - job->my) add_row(job, row, (ptrdiff_t)stride, inverse, sums);
        if (job->result) add_energy(job, row, inverse, sums[ENERGY]);
    }
    for (uint32_t b = 0; b < job->across; ++b) {
        const uint32_t x0 = b * BLOCK, x1 = x0 + BLOCK < job->width ? x0 + BLOCK : job->width;
        for (uint32_t i = 0; i < NUM_SUMS; ++i) {
            float sum = 0.0f;
            for (uint32_t x = x0; x < x1; ++x) sum += sums[i][x];
            job->sums[i][(size_t)task * job->across + b] = sum;
        }
    }
}

/* How many of a block's pixels along one edge of the image have both neighbours. */
static uint32_t count_inner(uint32_t block, uint32_t size, uint32_t margin)
{
    const uint32_t from = block * BLOCK > margin ? block * BLOCK : margin;
    const uint32_t to = (block + 1) * BLOCK < size - margin ? (block + 1) * BLOCK : size - margin;
    return to > from ? to - from : 0;
}

/* Sums of single blocks become means over 3x3 blocks with weights 1 2 1; INFINITY where nothing was counted. mx, my:
 * margins whose pixels do not count. */
static void window(const noise_job *job, uint32_t mx, uint32_t my, const float *sums, float *means)
{
    const uint32_t across = job->across, down = job->down;
    for (uint32_t y = 0; y < down; ++y)
        for (uint32_t x = 0; x < across; ++x) {
            float sum = 0.0f, count = 0.0f;
            for (uint32_t i = y > 0 ? y - 1 : 0; i <= y + 1 && i < down; ++i)
                for (uint32_t j = x > 0 ? x - 1 : 0; j <= x + 1 && j < across; ++j) {
                    const float weight = (i == y ? 2.0f : 1.0f) * (j == x ? 2.0f : 1.0f);
                    sum += weight * sums[(size_t)i * across + j];
                    count += weight * (float)(count_inner(j, job->width, mx) * count_inner(i, job->height, my));
                }
            means[(size_t)y * across + x] = count > 0.0f && isfinite(sum) ? sum / count : INFINITY;
        }
}

/* The smallest direction of each window. scratch: [blocks]. */
static void choose_direction(const noise_job *job, float *scratch, float *variance)
{
    const size_t num = (size_t)job->across * job->down;
    const int has[DIRECTIONS] = {job->mx > 0, job->my > 0, job->mx && job->my, job->mx && job->my};
    for (size_t i = 0; i < num; ++i) variance[i] = INFINITY;
    for (uint32_t d = 0; d < DIRECTIONS; ++d) {
        if (!has[d]) continue;
        window(job, job->mx, job->my, job->sums[d], scratch);
        for (size_t i = 0; i < num; ++i)
            if (scratch[i] < variance[i]) variance[i] = scratch[i];
    }
}

static double level_of(const float *variance, size_t num)
{
    double sum = 0.0;
    size_t known = 0;
    for (size_t i = 0; i < num; ++i) {
        if (!isfinite(variance[i])) continue;
        sum += (double)variance[i];
        ++known;
    }
    return known ? sqrt(sum / (double)known) : 0.0;
}

static noise_job make_job(const ql_layer *layer, const ql_scan *scan, uint32_t num_colors, uint32_t width,
                          uint32_t height)
{
    return (noise_job){
        .layer = layer,
        .scan = scan,
        .num_colors = num_colors < MAX_COLORS ? num_colors : MAX_COLORS,
        .width = width,
        .height = height,
        .across = ql_noise_blocks(width),
        .down = ql_noise_blocks(height),
        .mx = width >= 3,
        .my = height >= 3,
        .band_floats = (BLOCK + 4 + MAX_COLORS + NUM_SUMS) * (size_t)width,
    };
}

/* Runs all bands and fills variance; residual too, where there is a result. */
static quell_status run(noise_job *job, ql_env *env, float *variance, float *residual, ql_error *err)
{
    const size_t num = (size_t)job->across * job->down;
    float *const blocks = ql_alloc(env->memory, num, (NUM_SUMS + 1) * sizeof(float));
    job->scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job->band_floats * sizeof(float));
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    if (blocks == NULL || job->scratch == NULL) {
        ql_fail(err, status, "%s: out of memory: noise estimate", job->layer->full_name);
    } else {
        for (size_t i = 0; i < NUM_SUMS; ++i) job->sums[i] = blocks + i * num;
        status = ql_env_run(env, job->down, band_task, job);
        if (status == QUELL_OK) choose_direction(job, blocks + NUM_SUMS * num, variance);
        if (status == QUELL_OK && residual) window(job, 0, 0, job->sums[ENERGY], residual);
    }
    ql_free(env->memory, blocks);
    ql_free(env->memory, job->scratch);
    return status;
}

quell_status ql_noise_measure(ql_env *env, const ql_layer *layer, const ql_scan *scan, uint32_t num_colors,
                              uint32_t width, uint32_t height, ql_noise *noise, ql_error *err)
{
    noise_job job = make_job(layer, scan, num_colors, width, height);
    const size_t num = (size_t)job.across * job.down;
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    *noise = (ql_noise){.across = job.across, .down = job.down};
    noise->variance = ql_alloc(env->memory, num, sizeof(float));
    noise->scale = job.scale = ql_alloc(env->memory, num, sizeof(float));
    uint8_t *const has_firefly = ql_alloc(env->memory, scan->num_bins, sizeof *has_firefly);
    if (noise->variance == NULL || noise->scale == NULL || has_firefly == NULL) {
        ql_fail(err, status, "%s: out of memory: noise estimate", layer->full_name);
    } else {
        job.floor = choose_floor(scan, job.across, has_firefly);
        status = run(&job, env, noise->variance, NULL, err);
    }
    ql_free(env->memory, has_firefly);
    if (status == QUELL_OK)
        noise->level = level_of(noise->variance, num);
    else
        ql_noise_free(noise, env->memory);
    return status;
}

quell_status ql_noise_measure_change(ql_env *env, const ql_layer *layer, const ql_scan *scan, const ql_noise *noise,
                                     uint32_t num_colors, uint32_t width, uint32_t height, const float *result,
                                     float *variance, float *residual, ql_error *err)
{
    noise_job job = make_job(layer, scan, num_colors, width, height);
    job.result = result;
    job.scale = noise->scale;
    return run(&job, env, variance, residual, err);
}

float ql_noise_quiet(const float *variance, size_t num_blocks)
{
    enum { SHIFT = 21, NUM_BINS = 1 << (31 - SHIFT) }; /* exponent and two bits of mantissa */
    uint32_t counts[NUM_BINS] = {0};
    size_t total = 0, below = 0;
    for (size_t i = 0; i < num_blocks; ++i) {
        uint32_t bits;
        if (!(variance[i] > LEAST_VARIANCE) || !isfinite(variance[i])) continue;
        memcpy(&bits, &variance[i], sizeof bits);
        ++counts[bits >> SHIFT];
        ++total;
    }
    for (uint32_t b = 0; b < NUM_BINS && total > 0; ++b) {
        below += counts[b];
        if (4 * below < total) continue;
        const uint32_t bits = b << SHIFT;
        float value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }
    return 0.0f;
}

void ql_noise_free(ql_noise *noise, ql_memory *memory)
{
    ql_free(memory, noise->variance);
    ql_free(memory, noise->scale);
    memset(noise, 0, sizeof *noise);
}
