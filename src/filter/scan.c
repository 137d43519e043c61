/* SPDX-License-Identifier: Apache-2.0 */
/* Scans a layer in bands of eight rows. Each band depends on its own pixels and two rows above and below, and bands are
 * joined in order, so the result is the same for any number of threads. */
#include "filter/scan.h"

#include "frame/roles.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BAND = 8, REACH = 2, MIN_NEIGHBOURS = 8 /* fewer say nothing: tiny images */, MAX_COLORS = 4, LANES = 16 };

typedef struct band {
    ql_fix *fixes;
    uint64_t num_fixes, capacity, num_bad, num_limited;
    double sum;
    uint64_t num_values;
    float lowest, highest;
    int32_t is_zero, is_constant, is_constant_alpha, out_of_memory;
} band;

typedef struct scan_job {
    const ql_layer *layer, *emission;
    uint32_t num_colors, width, height, flags, bins_across;
    float firefly_factor;
    float *scratch; /* per worker: BAND + 2 REACH rows of luminance, MAX_COLORS rows, emission row */
    size_t scratch_floats;
    band *bands;
    float *bins;
    float first[MAX_COLORS];
} scan_job;

static int is_bad(float value)
{
    return !(fabsf(value) <= QL_ABSURD); /* NaN too */
}

static void add_fix(band *b, uint32_t x, uint32_t y, float scale)
{
    if (b->num_fixes == b->capacity) {
        const uint64_t capacity = b->capacity ? 2 * b->capacity : 64;
        ql_fix *const grown = realloc(b->fixes, (size_t)capacity * sizeof *grown);
        if (grown == NULL) {
            b->out_of_memory = 1;
            return;
        }
        b->fixes = grown;
        b->capacity = capacity;
    }
    b->fixes[b->num_fixes++] = (ql_fix){x, y, scale};
}

/* Mean of a pixel's colours; -infinity marks a bad one. Returns whether the row has any. */
static int find_luminance(uint32_t width, uint32_t n, float *const *rows, float *luminance)
{
    int any_bad = 0;
    for (uint32_t x = 0; x < width; ++x) {
        float sum = 0.0f;
        int bad = 0;
        for (uint32_t c = 0; c < n; ++c) {
            bad |= is_bad(rows[c][x]);
            sum += rows[c][x];
        }
        luminance[x] = bad ? -INFINITY : sum / (float)n;
        any_bad |= bad;
    }
    return any_bad;
}

/* Statistics of one channel's row, all of it finite: lanes side by side, for the compiler to put into vectors. */
static void gather_row(const float *row, uint32_t width, float first, band *b)
{
    double sum[LANES] = {0};
    float lowest[LANES], highest[LANES];
    uint32_t nonzero[LANES] = {0}, different[LANES] = {0};
    for (uint32_t i = 0; i < LANES; ++i) lowest[i] = highest[i] = row[0];
    uint32_t x = 0;
    for (; x + LANES <= width; x += LANES)
        for (uint32_t i = 0; i < LANES; ++i) {
            const float value = row[x + i];
            sum[i] += (double)value;
            lowest[i] = value < lowest[i] ? value : lowest[i];
            highest[i] = value > highest[i] ? value : highest[i];
            nonzero[i] |= value != 0.0f;
            different[i] |= value != first;
        }
    for (uint32_t i = 0; x < width; ++x, ++i) {
        const float value = row[x];
        sum[i] += (double)value;
        lowest[i] = value < lowest[i] ? value : lowest[i];
        highest[i] = value > highest[i] ? value : highest[i];
        nonzero[i] |= value != 0.0f;
        different[i] |= value != first;
    }
    for (uint32_t i = 0; i < LANES; ++i) {
        b->sum += sum[i];
        b->lowest = lowest[i] < b->lowest ? lowest[i] : b->lowest;
        b->highest = highest[i] > b->highest ? highest[i] : b->highest;
        if (nonzero[i]) b->is_zero = 0;
        if (different[i]) b->is_constant = 0;
    }
    b->num_values += width;
}

/* The same of a row that has bad pixels, which are left out. */
static void gather_good(const scan_job *job, float *const *rows, const float *luminance, band *b)
{
    for (uint32_t c = 0; c < job->num_colors; ++c)
        for (uint32_t x = 0; x < job->width; ++x) {
            const float value = rows[c][x];
            if (value != 0.0f) b->is_zero = 0;
            if (!(value == job->first[c])) b->is_constant = 0;
            if (luminance[x] == -INFINITY) continue;
            b->sum += (double)value;
            b->lowest = value < b->lowest ? value : b->lowest;
            b->highest = value > b->highest ? value : b->highest;
            ++b->num_values;
        }
}

/* Luminance of row y, as find_luminance says. Statistics are taken when own is set. */
static void read_luminance(const scan_job *job, uint32_t y, float *const *rows, float *luminance, band *own)
{
    const uint32_t n = job->num_colors;
    for (uint32_t c = 0; c < job->layer->num_channels && c < MAX_COLORS; ++c)
        if (c < n || own) ql_layer_read_row(job->layer, job->width, c, y, rows[c]);
    const int any_bad = find_luminance(job->width, n, rows, luminance);
    if (own == NULL) return;
    if (any_bad)
        gather_good(job, rows, luminance, own);
    else
        for (uint32_t c = 0; c < n; ++c) gather_row(rows[c], job->width, job->first[c], own);
    for (uint32_t c = n; c < job->layer->num_channels && c < MAX_COLORS; ++c)
        for (uint32_t x = 0; x < job->width; ++x)
            if (!(rows[c][x] == job->first[c])) own->is_constant_alpha = 0;
}

static float brightest_neighbour(const float *center, size_t stride, uint32_t x, uint32_t width)
{
    float bound = 0.0f;
    const uint32_t x0 = x < REACH ? 0 : x - REACH, x1 = x + REACH < width ? x + REACH : width - 1;
    for (ptrdiff_t dy = -REACH; dy <= REACH; ++dy) {
        const float *const row = center + dy * (ptrdiff_t)stride;
        for (uint32_t i = x0; i <= x1; ++i)
            if ((dy != 0 || i != x) && row[i] > bound) bound = row[i];
    }
    return bound;
}

float ql_firefly_factor(uint32_t samples)
{
    if (samples == 0) return QL_UNKNOWN_FIREFLY_FACTOR;
    const float factor = QL_FIREFLY_FACTOR * sqrtf((float)samples);
    if (factor < QL_MIN_FIREFLY_FACTOR) return QL_MIN_FIREFLY_FACTOR;
    return factor < QL_MAX_FIREFLY_FACTOR ? factor : QL_MAX_FIREFLY_FACTOR;
}

/* How many pixels of a line of `size` lie within REACH of x, itself included. */
static uint32_t num_within_reach(uint32_t x, uint32_t size)
{
    const uint32_t before = x < REACH ? x : REACH, after = size - 1 - x < REACH ? size - 1 - x : REACH;
    return before + 1 + after;
}

/* Whether one of the four nearest neighbours already shows that a pixel is no firefly: true of nearly all. */
static int has_peer(const float *center, size_t stride, uint32_t x, uint32_t width, float factor)
{
    const float here = center[x];
    return (x > 0 && factor * center[x - 1] >= here) || (x + 1 < width && factor * center[x + 1] >= here) ||
           factor * (center - stride)[x] >= here || factor * (center + stride)[x] >= here;
}

static void find_fixes(const scan_job *job, uint32_t y, const float *luminance, size_t stride, const float *emitted,
                       band *b)
{
    const float factor = job->firefly_factor;
    for (uint32_t x = 0; x < job->width; ++x) {
        const float here = luminance[x];
        if (here == -INFINITY) {
            add_fix(b, x, y, 0.0f);
            ++b->num_bad;
        } else if (factor > 0.0f && here > 0.0f && !has_peer(luminance, stride, x, job->width, factor) &&
                   num_within_reach(x, job->width) * num_within_reach(y, job->height) > MIN_NEIGHBOURS) {
            float bound = factor * brightest_neighbour(luminance, stride, x, job->width);
            if (emitted && 2.0f * emitted[x] > bound) bound = 2.0f * emitted[x];
            if (here > bound && bound > 0.0f) {
                add_fix(b, x, y, bound / here);
                ++b->num_limited;
            }
        }
    }
}

static void fill_bins(const scan_job *job, uint32_t task, const float *luminance, size_t stride, uint32_t num_rows)
{
    for (uint32_t i = 0; i < job->bins_across; ++i) {
        const uint32_t x0 = i * BAND, x1 = x0 + BAND < job->width ? x0 + BAND : job->width;
        double sum = 0.0;
        uint32_t count = 0;
        for (uint32_t r = 0; r < num_rows; ++r)
            for (uint32_t x = x0; x < x1; ++x) {
                float value = luminance[r * stride + x];
                if (job->flags & QL_SCAN_DEPTH) value = value > 0.0f && value < QL_BACKGROUND_DEPTH ? value : 0.0f;
                if (value == -INFINITY) continue;
                sum += (double)value;
                ++count;
            }
        job->bins[(size_t)task * job->bins_across + i] = count ? (float)(sum / count) : 0.0f;
    }
}

static void scan_task(void *user, uint32_t task, uint32_t worker)
{
    const scan_job *const job = user;
    const size_t stride = job->width;
    float *const luminance = job->scratch + worker * job->scratch_floats; /* row 0 is y0 - REACH */
    float *const emitted = luminance + (BAND + 2 * REACH) * stride;
    float *const colors = emitted + stride;
    float *const rows[MAX_COLORS] = {colors, colors + stride, colors + 2 * stride, colors + 3 * stride};
    const uint32_t y0 = task * BAND, y1 = y0 + BAND < job->height ? y0 + BAND : job->height;
    band *const b = &job->bands[task];
    b->is_zero = b->is_constant = b->is_constant_alpha = 1;
    b->lowest = INFINITY;
    b->highest = -INFINITY;
    const int around = job->firefly_factor > 0.0f;
    for (int64_t y = (int64_t)y0 - REACH; y < (int64_t)y1 + REACH; ++y) {
        float *const row = luminance + (size_t)(y - ((int64_t)y0 - REACH)) * stride;
        const int own = y >= y0 && y < y1;
        if (y < 0 || y >= job->height || (!own && !around))
            memset(row, 0, stride * sizeof *row);
        else
            read_luminance(job, (uint32_t)y, rows, row, own ? b : NULL);
    }
    for (uint32_t y = y0; y < y1; ++y) {
        if (job->emission) {
            memset(emitted, 0, stride * sizeof *emitted);
            for (uint32_t c = 0; c < 3; ++c) {
                ql_layer_read_row(job->emission, job->width, c, y, colors);
                for (size_t x = 0; x < stride; ++x)
                    if (!is_bad(colors[x])) emitted[x] += colors[x] / 3.0f;
            }
        }
        find_fixes(job, y, luminance + (y - y0 + REACH) * stride, stride, job->emission ? emitted : NULL, b);
    }
    /* Bins are of what will be filtered: one firefly must not move the exposure of the whole image. */
    for (uint64_t i = 0; i < b->num_fixes; ++i)
        if (b->fixes[i].scale > 0.0f)
            luminance[(b->fixes[i].y - y0 + REACH) * stride + b->fixes[i].x] *= b->fixes[i].scale;
    if (job->bins) fill_bins(job, task, luminance + REACH * stride, stride, y1 - y0);
}

static quell_status join(const scan_job *job, uint32_t num_bands, ql_memory *memory, ql_scan *scan, ql_error *err)
{
    double sum = 0.0;
    uint64_t num_values = 0;
    scan->is_zero = scan->is_constant = scan->is_constant_alpha = 1;
    scan->lowest = INFINITY;
    scan->highest = -INFINITY;
    for (uint32_t i = 0; i < num_bands; ++i) {
        const band *const b = &job->bands[i];
        if (b->out_of_memory) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: list of bad pixels");
        scan->num_fixes += b->num_fixes;
        scan->num_bad += b->num_bad;
        scan->num_limited += b->num_limited;
        scan->is_zero &= b->is_zero;
        scan->is_constant &= b->is_constant;
        scan->is_constant_alpha &= b->is_constant_alpha;
        scan->lowest = b->lowest < scan->lowest ? b->lowest : scan->lowest;
        scan->highest = b->highest > scan->highest ? b->highest : scan->highest;
        sum += b->sum;
        num_values += b->num_values;
    }
    scan->mean = num_values ? sum / (double)num_values : 0.0;
    scan->fixes = ql_alloc(memory, (size_t)scan->num_fixes, sizeof *scan->fixes);
    scan->row_start = ql_alloc_zero(memory, (size_t)job->height + 1, sizeof *scan->row_start);
    if (scan->fixes == NULL || scan->row_start == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: list of bad pixels");
    uint64_t at = 0;
    for (uint32_t i = 0; i < num_bands; ++i) {
        const band *const b = &job->bands[i];
        if (b->num_fixes) memcpy(scan->fixes + at, b->fixes, (size_t)b->num_fixes * sizeof *b->fixes);
        at += b->num_fixes;
    }
    for (uint64_t i = 0; i < scan->num_fixes; ++i) ++scan->row_start[scan->fixes[i].y + 1];
    for (uint32_t y = 0; y < job->height; ++y) scan->row_start[y + 1] += scan->row_start[y];
    return QUELL_OK;
}

quell_status ql_scan_layer(ql_env *env, const ql_layer *layer, const ql_layer *emission, uint32_t num_colors,
                           uint32_t width, uint32_t height, uint32_t flags, float firefly_factor, ql_scan *scan,
                           ql_error *err)
{
    const uint32_t num_bands = (height + BAND - 1) / BAND;
    scan_job job = {
        .layer = layer,
        .emission = emission,
        .num_colors = num_colors < MAX_COLORS ? num_colors : MAX_COLORS,
        .width = width,
        .height = height,
        .flags = flags,
        .firefly_factor = firefly_factor,
        .bins_across = (width + BAND - 1) / BAND,
        .scratch_floats = (BAND + 2 * REACH + 1 + MAX_COLORS) * (size_t)width,
    };
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    memset(scan, 0, sizeof *scan);
    job.scratch = ql_alloc(env->memory, ql_pool_num_threads(env->pool), job.scratch_floats * sizeof *job.scratch);
    job.bands = ql_alloc_zero(env->memory, num_bands, sizeof *job.bands);
    if (flags & QL_SCAN_BINS) {
        scan->num_bins = (size_t)num_bands * job.bins_across;
        scan->bins = job.bins = ql_alloc(env->memory, scan->num_bins, sizeof *job.bins);
    }
    if (job.scratch == NULL || job.bands == NULL || ((flags & QL_SCAN_BINS) && job.bins == NULL)) {
        ql_fail(err, status, "%s: out of memory", layer->full_name);
    } else {
        for (uint32_t c = 0; c < layer->num_channels && c < MAX_COLORS; ++c) {
            ql_layer_read_row(layer, width, c, 0, job.scratch);
            job.first[c] = job.scratch[0];
        }
        status = ql_env_run(env, num_bands, scan_task, &job);
        if (status == QUELL_OK) status = join(&job, num_bands, env->memory, scan, err);
        for (uint32_t i = 0; i < num_bands; ++i) free(job.bands[i].fixes);
    }
    ql_free(env->memory, job.scratch);
    ql_free(env->memory, job.bands);
    if (status != QUELL_OK) ql_scan_free(scan, env->memory);
    return status;
}

void ql_scan_free(ql_scan *scan, ql_memory *memory)
{
    ql_free(memory, scan->fixes);
    ql_free(memory, scan->bins);
    ql_free(memory, scan->row_start);
    memset(scan, 0, sizeof *scan);
}

void ql_read_fixed_span(const ql_layer *layer, const ql_scan *scan, uint32_t x0, uint32_t x1, uint32_t y,
                        uint32_t num_colors, float *const *rows, float *valid)
{
    ql_view view = layer->pixels;
    view.data += (int64_t)x0 * view.pixel_stride;
    for (uint32_t c = 0; c < num_colors; ++c) ql_view_read_row(&view, x1 - x0, c, y, rows[c] + x0);
    if (valid)
        for (uint32_t x = x0; x < x1; ++x) valid[x] = 1.0f;
    if (scan->row_start == NULL) return;
    for (uint64_t i = scan->row_start[y]; i < scan->row_start[y + 1]; ++i) {
        const ql_fix *const fix = &scan->fixes[i];
        if (fix->x < x0 || fix->x >= x1) continue;
        for (uint32_t c = 0; c < num_colors; ++c)
            rows[c][fix->x] = fix->scale > 0.0f ? rows[c][fix->x] * fix->scale : 0.0f;
        if (valid && fix->scale <= 0.0f) valid[fix->x] = 0.0f;
    }
}

void ql_read_fixed_row(const ql_layer *layer, const ql_scan *scan, uint32_t width, uint32_t y, uint32_t num_colors,
                       float *const *rows, float *valid)
{
    ql_read_fixed_span(layer, scan, 0, width, y, num_colors, rows, valid);
}
