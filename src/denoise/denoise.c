/* SPDX-License-Identifier: Apache-2.0 */
/* A whole job: look at the layers, plan, run every set tile by tile, report. */
#include "denoise/denoise.h"

#include "base/clock.h"
#include "denoise/closure.h"
#include "denoise/debug_layers.h"
#include "denoise/dgan.h"
#include "denoise/region.h"
#include "denoise/survey.h"
#include "frame/roles.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    TILE_ALIGNMENT = 32,
    MIN_TILE = 64,
    MAX_STRIPS = 4,
    MIN_STRIP = 320, /* as wide as what the filters of its neighbours reach into it, twice */
    /* Working memory that is taken without being asked about: 393 MB at 1080p, 1.19 GB at 4K, where the network's maps
     * alone are 0.93 GB. What a frame needs beyond it is worth strips and tiles. */
    MODEST_BYTES = 128000000,
    MODEST_BYTES_PER_PIXEL = 128
};

typedef struct work {
    ql_env *env;
    ql_frame *frame;
    ql_plan plan;
    ql_scan *scans;
    float **results;
    double *means; /* of the results */
    ql_survey survey;
    uint32_t flags; /* QUELL_DENOISE_* */
    ql_job job;
    const ql_dgan *dgan; /* NULL: a model of the quell family */
    ql_dgan_job dgan_job;
    uint32_t tile_width, tile_height, num_tiles, halo;
    uint64_t planned_bytes;
    double seconds_analyse;
} work;

/* ---- Looking at the layers ---------------------------------------------------------------------------------------- */

static uint32_t num_colors(const ql_layer *layer)
{
    return layer->num_channels < 3 ? layer->num_channels : 3;
}

static int is_radiance(int32_t role)
{
    const int32_t group = ql_role_group(role);
    return group != QL_GROUP_NONE && group != QL_GROUP_COLOR;
}

/* Whether some layer's result is made from this layer's pixels. */
static int is_filtered(const ql_plan *plan, uint32_t index)
{
    for (uint32_t i = 0; i < plan->num_layers; ++i)
        if (plan->layers[i].action == QUELL_ACTION_DENOISED && plan->layers[i].source == (int32_t)index) return 1;
    return 0;
}

static quell_status scan_set(work *w, uint32_t set_index, ql_error *err)
{
    const ql_plan_set *const set = &w->plan.sets[set_index];
    const int32_t emission = set->role_layer[QUELL_ROLE_EMISSION], depth = set->role_layer[QUELL_ROLE_DENOISING_DEPTH];
    for (uint32_t i = 0; i < w->frame->num_layers; ++i) {
        const ql_layer *const layer = &w->frame->layers[i];
        const ql_plan_layer *const plan = &w->plan.layers[i];
        int wanted = plan->set == (int32_t)set_index &&
                     (plan->action == QUELL_ACTION_DENOISED || plan->action == QUELL_ACTION_GUIDE ||
                      ((int32_t)i == set->beauty) || (set->has_light && is_radiance(layer->role)) ||
                      layer->role == QUELL_ROLE_NOISY_SHADOW_CATCHER ||
                      (set->has_light && ql_role_group(layer->role) == QL_GROUP_COLOR));
        if (!wanted || layer->pixels.data == NULL || set->beauty == QL_PLAN_NONE) continue;
        uint32_t flags = 0;
        float factor = 0.0f;
        if (is_radiance(layer->role) || layer->role == QUELL_ROLE_NOISY_IMAGE ||
            layer->role == QUELL_ROLE_NOISY_SHADOW_CATCHER)
            factor = ql_firefly_factor(set->samples);
        /* What the camera sees of emitters and sky is no firefly. */
        if (layer->role == QUELL_ROLE_EMISSION || layer->role == QUELL_ROLE_ENVIRONMENT) factor = 0.0f;
        if ((int32_t)i == set->beauty || is_filtered(&w->plan, i)) flags |= QL_SCAN_BINS;
        if ((int32_t)i == depth) flags |= QL_SCAN_BINS | QL_SCAN_DEPTH;
        /* Fireflies are the generator's business, and each layer has an exposure of its own. */
        if (w->dgan) {
            factor = 0.0f;
            flags |= QL_SCAN_BINS;
        }
        const int by_emission = set->has_light && emission != QL_PLAN_NONE && (int32_t)i == set->beauty;
        QL_TRY(ql_scan_layer(w->env, layer, by_emission ? &w->frame->layers[emission] : NULL, num_colors(layer),
                             w->frame->width, w->frame->height, flags, factor, &w->scans[i], err));
    }
    return QUELL_OK;
}

static quell_status choose_combined(work *w, uint32_t set_index, ql_error *err)
{
    const ql_plan_set *const set = &w->plan.sets[set_index];
    double closure[2] = {INFINITY, INFINITY};
    if (set->has_light) QL_TRY(ql_measure_closure(w->env, w->frame, w->scans, set, closure, err));
    ql_plan_choose_combined(&w->plan, set_index, closure);
    return QUELL_OK;
}

static quell_status look(work *w, ql_error *err)
{
    w->scans = ql_alloc_zero(w->env->memory, w->frame->num_layers, sizeof *w->scans);
    ql_layer_facts *const facts = ql_alloc_zero(w->env->memory, w->frame->num_layers, sizeof *facts);
    quell_status status = QUELL_OK;
    if (w->scans == NULL || facts == NULL) status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: layer facts");
    for (uint32_t s = 0; s < w->plan.num_sets && status == QUELL_OK; ++s) status = scan_set(w, s, err);
    if (status == QUELL_OK) {
        for (uint32_t i = 0; i < w->frame->num_layers; ++i)
            /* What a generator paints is its own affair, of a constant image too. */
            facts[i] = (ql_layer_facts){w->scans[i].is_zero,
                                        w->dgan == NULL && w->scans[i].is_constant && w->scans[i].is_constant_alpha};
        if (!(w->flags & QUELL_DENOISE_NO_SKIP)) ql_plan_skip(&w->plan, w->frame, facts);
    }
    if (w->dgan == NULL) { /* which filters Combined as one image, and promises nothing about its noise */
        const uint32_t all_cells = w->flags & QUELL_DENOISE_NO_SKIP ? QL_SURVEY_ALL_CELLS : 0;
        const uint32_t no_blend = w->flags & QUELL_DENOISE_NO_BLEND ? QL_SURVEY_NO_BLEND : 0;
        if (status == QUELL_OK)
            status = ql_survey_frame(w->env, w->frame, w->scans, all_cells | no_blend, &w->plan, &w->survey, err);
        for (uint32_t s = 0; s < w->plan.num_sets && status == QUELL_OK; ++s) status = choose_combined(w, s, err);
    }
    ql_free(w->env->memory, facts);
    return status;
}

/* ---- Tiles -------------------------------------------------------------------------------------------------------- */

static uint32_t align_up(uint32_t value, uint32_t alignment)
{
    return (value + alignment - 1) / alignment * alignment;
}

static uint32_t region_edge(uint32_t tile, uint32_t halo, uint32_t image)
{
    const uint64_t with_halo = (uint64_t)tile + 2 * (uint64_t)halo, whole = align_up(image, QL_NET_ALIGNMENT);
    return (uint32_t)(with_halo < whole ? with_halo : whole);
}

static uint64_t tile_bytes(const work *w, uint32_t tile_width, uint32_t tile_height, uint32_t strip_width)
{
    return ql_region_peak_bytes(&w->job, region_edge(tile_width, w->halo, w->frame->width),
                                region_edge(tile_height, w->halo, w->frame->height), strip_width,
                                ql_pool_num_threads(w->env->pool));
}

/* Sets tile and strips when they fit into so many bytes: strips of the filters first, which cost less than tiles. */
static int try_tile(work *w, uint32_t tile_width, uint32_t tile_height, uint64_t bytes)
{
    for (uint32_t n = 1; n <= MAX_STRIPS; ++n) {
        const uint32_t strip_width = align_up((tile_width + n - 1) / n, TILE_ALIGNMENT);
        if (n > 1 && strip_width < MIN_STRIP) break;
        w->planned_bytes = tile_bytes(w, tile_width, tile_height, strip_width);
        if (w->planned_bytes > bytes) continue;
        w->tile_width = tile_width;
        w->tile_height = tile_height;
        w->job.strip_width = strip_width;
        return 1;
    }
    return 0;
}

/* The largest tile that fits: the whole image, then halves of the longer edge. */
static int try_tiles(work *w, uint32_t tile_width, uint32_t tile_height, uint64_t bytes)
{
    for (;;) {
        if (try_tile(w, tile_width, tile_height, bytes)) return 1;
        if (tile_width <= MIN_TILE && tile_height <= MIN_TILE) return 0;
        uint32_t *const edge = tile_width >= tile_height ? &tile_width : &tile_height;
        const uint32_t half = align_up(*edge / 2, TILE_ALIGNMENT);
        *edge = half < MIN_TILE ? MIN_TILE : half;
    }
}

static quell_status choose_tiles(work *w, uint32_t tile_size, uint64_t max_memory_bytes, ql_error *err)
{
    const uint64_t used = atomic_load(&w->env->memory->used_bytes);
    const uint64_t modest = MODEST_BYTES + MODEST_BYTES_PER_PIXEL * (uint64_t)w->frame->width * w->frame->height;
    const uint64_t left = max_memory_bytes > used ? max_memory_bytes - used : 0;
    w->halo = ql_region_halo(w->job.net);
    uint32_t tw = align_up(w->frame->width, TILE_ALIGNMENT), th = align_up(w->frame->height, TILE_ALIGNMENT);
    if (tile_size > 0) {
        const uint32_t tile = align_up(tile_size < MIN_TILE ? MIN_TILE : tile_size, TILE_ALIGNMENT);
        tw = tile < tw ? tile : tw;
        th = tile < th ? tile : th;
    }
    /* A larger network is not cut to tiles for being larger: its filters may have an eighth more than itself. */
    const uint64_t network =
        ql_region_network_bytes(&w->job, region_edge(tw, w->halo, w->frame->width),
                                region_edge(th, w->halo, w->frame->height), ql_pool_num_threads(w->env->pool));
    uint64_t wanted = modest > used ? modest - used : 0;
    if (wanted < network + network / 8) wanted = network + network / 8;
    const int fits = try_tiles(w, tw, th, wanted < left ? wanted : left);
    w->planned_bytes += used;
    if (!fits)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY,
                       "the smallest tile needs %llu MB of working memory, %llu MB are "
                       "allowed; raise the limit",
                       (unsigned long long)(w->planned_bytes >> 20) + 1, (unsigned long long)(max_memory_bytes >> 20));
    return QUELL_OK;
}

/* What the network's maps hold, by quell_options.precision. */
static quell_status choose_values(const ql_kernels *kernels, const quell_options *options, int is_dgan,
                                  ql_values *values, ql_error *err)
{
    *values = QL_VALUES_FLOAT;
    switch (options->precision) {
    case QUELL_PRECISION_AUTO:
        if (kernels->bf16 == QL_BF16_FAST && !is_dgan) *values = QL_VALUES_BF16;
        return QUELL_OK;
    case QUELL_PRECISION_FLOAT32: return QUELL_OK;
    case QUELL_PRECISION_BFLOAT16: break;
    default:
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quell_options.precision: no such precision (%d)",
                       options->precision);
    }
    if (is_dgan)
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT,
                       "models of the kind DGAN-KPN are computed in float32 alone; choose another model, or leave the "
                       "precision to the library");
    if (kernels->bf16 == QL_BF16_NONE)
        return ql_fail(
            err, QUELL_ERR_UNSUPPORTED,
            "bfloat16 needs the kernels 'avx512bf16', and these are '%s'; leave the precision to the library",
            kernels->name);
    *values = QL_VALUES_BF16;
    return QUELL_OK;
}

/* DGAN-KPN: bands as wide as the image for the kernels; the generator needs the whole image. */
static quell_status choose_bands(work *w, const ql_kernels *kernels, const quell_options *options,
                                 uint64_t max_memory_bytes, ql_error *err)
{
    w->dgan_job =
        (ql_dgan_job){.kernels = kernels, .net = w->dgan, .frame = w->frame, .plan = &w->plan, .scans = w->scans};
    QL_TRY(ql_dgan_options_read(options->dgan, &w->dgan_job.options, err));
    QL_TRY(ql_dgan_choose_bands(&w->dgan_job, w->env, options->tile_size, max_memory_bytes, &w->planned_bytes, err));
    w->tile_width = w->frame->width;
    w->tile_height = w->dgan_job.band_rows < w->frame->height ? w->dgan_job.band_rows : w->frame->height;
    w->num_tiles = (w->frame->height + w->tile_height - 1) / w->tile_height;
    w->halo = ql_kpn_reach(&w->dgan->kpn);
    return QUELL_OK;
}

static uint32_t num_tiles(const work *w, const ql_plan_rect *rect)
{
    return ((rect->x1 - rect->x0 + w->tile_width - 1) / w->tile_width) *
           ((rect->y1 - rect->y0 + w->tile_height - 1) / w->tile_height);
}

/* What a set's active cells are computed in; returns how many rectangles. */
static uint32_t cover(work *w, uint32_t set, ql_plan_rect rects[QL_PLAN_MAX_RECTS])
{
    return ql_plan_cells_cover(&w->survey.cells[set], w->halo, rects, QL_PLAN_MAX_RECTS);
}

/* Tiles of all sets together. */
static void count_tiles(work *w)
{
    ql_plan_rect rects[QL_PLAN_MAX_RECTS];
    w->num_tiles = 0;
    for (uint32_t s = 0; s < w->plan.num_sets; ++s)
        for (uint32_t i = 0, num = cover(w, s, rects); i < num; ++i) w->num_tiles += num_tiles(w, &rects[i]);
}

static ql_region region_at(const work *w, const ql_plan_rect *rect, uint32_t index)
{
    const uint32_t across = (rect->x1 - rect->x0 + w->tile_width - 1) / w->tile_width;
    ql_region r = {.x0 = rect->x0 + index % across * w->tile_width, .y0 = rect->y0 + index / across * w->tile_height};
    r.x1 = r.x0 + w->tile_width < rect->x1 ? r.x0 + w->tile_width : rect->x1;
    r.y1 = r.y0 + w->tile_height < rect->y1 ? r.y0 + w->tile_height : rect->y1;
    r.rx = r.x0 > w->halo ? r.x0 - w->halo : 0;
    r.ry = r.y0 > w->halo ? r.y0 - w->halo : 0;
    const uint32_t right = align_up(w->frame->width, QL_NET_ALIGNMENT),
                   bottom = align_up(w->frame->height, QL_NET_ALIGNMENT);
    const uint32_t x_end = align_up(r.x1 + w->halo, QL_NET_ALIGNMENT),
                   y_end = align_up(r.y1 + w->halo, QL_NET_ALIGNMENT);
    r.width = (x_end < right ? x_end : right) - r.rx;
    r.height = (y_end < bottom ? y_end : bottom) - r.ry;
    return r;
}

/* ---- Running ------------------------------------------------------------------------------------------------------ */

typedef struct start_job {
    const ql_layer *layer, *source;
    float *out;
    uint32_t width, height;
} start_job;

static void start_task(void *user, uint32_t task, uint32_t worker)
{
    const start_job *const job = user;
    (void)worker;
    for (uint32_t c = 0; c < job->layer->num_channels; ++c) {
        float *const row = job->out + ((size_t)c * job->height + task) * job->width;
        ql_layer_read_row(c < job->source->num_channels ? job->source : job->layer, job->width, c, task, row);
        for (uint32_t x = 0; x < job->width; ++x)
            if (!isfinite(row[x])) row[x] = 0.0f;
    }
}

/* Results start as the source's pixels, bad ones as black: what no kernel reaches stays. */
static quell_status start_results(work *w, ql_error *err)
{
    w->results = ql_alloc_zero(w->env->memory, w->frame->num_layers, sizeof *w->results);
    if (w->results == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: list of results");
    const uint32_t width = w->frame->width, height = w->frame->height;
    for (uint32_t i = 0; i < w->frame->num_layers; ++i) {
        if (w->plan.layers[i].action != QUELL_ACTION_DENOISED) continue;
        start_job job = {.layer = &w->frame->layers[i], .width = width, .height = height};
        job.source = &w->frame->layers[w->plan.layers[i].source];
        job.out = ql_alloc(w->frame->memory, (size_t)job.layer->num_channels * height, width * sizeof *job.out);
        if (job.out == NULL)
            return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: out of memory for its result", job.layer->full_name);
        w->results[i] = job.out;
        QL_TRY(ql_env_run(w->env, height, start_task, &job));
    }
    return QUELL_OK;
}

static ql_feature_setup feature_setup(const work *w, uint32_t set_index)
{
    const ql_plan_set *const set = &w->plan.sets[set_index];
    const int32_t depth = set->role_layer[QUELL_ROLE_DENOISING_DEPTH];
    const ql_scan *const beauty = &w->scans[set->beauty];
    ql_feature_setup setup = {
        .has_light = set->has_light,
        .has_albedo = set->role_layer[QUELL_ROLE_DENOISING_ALBEDO] != QL_PLAN_NONE,
        .has_normal = set->role_layer[QUELL_ROLE_DENOISING_NORMAL] != QL_PLAN_NONE,
        .has_depth = depth != QL_PLAN_NONE,
        .samples = set->samples,
        .exposure_exponent = ql_log_exponent(beauty->bins, beauty->num_bins),
    };
    if (setup.has_depth) setup.depth_exponent = ql_log_exponent(w->scans[depth].bins, w->scans[depth].num_bins);
    return setup;
}

typedef struct mean_job {
    const float *result;
    size_t width;
    double *sums; /* one per row of every colour channel */
} mean_job;

static void mean_task(void *user, uint32_t task, uint32_t worker)
{
    const mean_job *const job = user;
    double sum = 0.0;
    (void)worker;
    for (size_t x = 0; x < job->width; ++x) sum += (double)job->result[task * job->width + x];
    job->sums[task] = sum;
}

/* Rows are summed by themselves and then in order, so the mean does not depend on the threads. */
static quell_status measure_means(work *w, ql_error *err)
{
    const uint32_t height = w->frame->height;
    w->means = ql_alloc_zero(w->env->memory, w->frame->num_layers, sizeof *w->means);
    double *const sums = ql_alloc(w->env->memory, 3 * (size_t)height, sizeof *sums);
    quell_status status = QUELL_OK;
    if (w->means == NULL || sums == NULL) status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: means");
    for (uint32_t i = 0; i < w->frame->num_layers && status == QUELL_OK; ++i) {
        if (w->results[i] == NULL) continue;
        const uint32_t num_rows = num_colors(&w->frame->layers[i]) * height;
        mean_job job = {w->results[i], w->frame->width, sums};
        status = ql_env_run(w->env, num_rows, mean_task, &job);
        double sum = 0.0;
        for (uint32_t r = 0; r < num_rows && status == QUELL_OK; ++r) sum += sums[r];
        w->means[i] = sum / ((double)num_rows * (double)w->frame->width);
    }
    ql_free(w->env->memory, sums);
    return status;
}

/* Filters what is active of every set. */
static quell_status run_sets(work *w, ql_error *err)
{
    ql_plan_rect rects[QL_PLAN_MAX_RECTS];
    const double share = 0.9 / (double)(w->num_tiles ? w->num_tiles : 1);
    for (uint32_t s = 0, done = 0; s < w->plan.num_sets; ++s) {
        const uint32_t num_rects = cover(w, s, rects);
        if (num_rects == 0) continue;
        const ql_feature_setup setup = feature_setup(w, s);
        for (uint32_t i = 0; i < num_rects; ++i)
            for (uint32_t t = 0; t < num_tiles(w, &rects[i]); ++t, ++done) {
                const ql_region region = region_at(w, &rects[i], t);
                w->env->progress_from = 0.05 + share * done;
                w->env->progress_to = 0.05 + share * (done + 1);
                QL_TRY(ql_region_run(&w->job, w->env, s, &setup, &region, err));
            }
    }
    return QUELL_OK;
}

static quell_status blend(work *w, ql_error *err)
{
    if (w->flags & QUELL_DENOISE_NO_BLEND) return QUELL_OK;
    for (uint32_t i = 0, done = 0; i < w->frame->num_layers; ++i) {
        if (w->results[i] == NULL) continue;
        w->env->progress_from = 0.95 + 0.05 * done / w->plan.num_denoised;
        w->env->progress_to = 0.95 + 0.05 * ++done / w->plan.num_denoised;
        QL_TRY(ql_survey_blend(w->env, w->frame, w->scans, &w->plan, i, w->results[i], &w->survey, err));
    }
    return QUELL_OK;
}

static quell_status run(work *w, ql_error *err)
{
    QL_TRY(start_results(w, err));
    w->job.results = w->results;
    QL_TRY(run_sets(w, err));
    const double start = ql_clock_seconds();
    QL_TRY(blend(w, err));
    w->job.seconds_filter += ql_clock_seconds() - start;
    w->env->progress_from = w->env->progress_to = 1.0;
    return measure_means(w, err);
}

static int set_has_work(const work *w, uint32_t set_index)
{
    for (uint32_t i = 0; i < w->plan.num_layers; ++i)
        if (w->plan.layers[i].set == (int32_t)set_index && w->plan.layers[i].action == QUELL_ACTION_DENOISED) return 1;
    return 0;
}

/* What DGAN-KPN lacks is said twice: which passes in the log, and with each layer that they are fewer. */
static void report_missing(work *w, uint32_t set_index)
{
    char missing[128], message[192];
    ql_dgan_missing_passes(&w->plan.sets[set_index], missing, sizeof missing);
    if (missing[0] == '\0') return;
    for (uint32_t i = 0; i < w->plan.num_layers; ++i)
        if (w->plan.layers[i].set == (int32_t)set_index && w->plan.layers[i].action == QUELL_ACTION_DENOISED)
            w->plan.layers[i].reason = "without all auxiliary passes";
    snprintf(message, sizeof message, "auxiliary passes of DGAN-KPN that the frame lacks: %s", missing);
    if (w->env->log) w->env->log(w->env->log_user, QUELL_LOG_INFO, message);
}

static quell_status run_dgan(work *w, ql_error *err)
{
    QL_TRY(start_results(w, err));
    w->dgan_job.results = w->results;
    for (uint32_t s = 0; s < w->plan.num_sets; ++s) {
        if (!set_has_work(w, s)) continue;
        report_missing(w, s);
        w->env->progress_from = 0.05 + 0.95 * s / w->plan.num_sets;
        w->env->progress_to = 0.05 + 0.95 * (s + 1) / w->plan.num_sets;
        QL_TRY(ql_dgan_run_set(&w->dgan_job, w->env, s, err));
    }
    w->env->progress_from = w->env->progress_to = 1.0;
    w->job.seconds_network = w->dgan_job.seconds_network;
    w->job.seconds_filter = w->dgan_job.seconds_filter;
    return measure_means(w, err);
}

/* ---- Report ------------------------------------------------------------------------------------------------------- */

/* Of one layer, each network that runs counted once. */
static double dgan_macs(const work *w)
{
    const int32_t parts = w->dgan_job.options.parts;
    return (parts == QUELL_DGAN_KERNELS ? 0.0 : ql_generator_macs_per_pixel(&w->dgan->generator)) +
           (parts == QUELL_DGAN_GENERATOR ? 0.0 : ql_kpn_macs_per_pixel(&w->dgan->kpn));
}

static uint32_t count_bits(uint32_t bits)
{
    uint32_t num = 0;
    for (; bits; bits &= bits - 1) ++num;
    return num;
}

static quell_status make_report(const work *w, const ql_model *model, double seconds, int dry, ql_report **out,
                                ql_error *err)
{
    quell_model_info info;
    ql_report *const report = calloc(1, sizeof *report);
    if (report == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: report");
    ql_memory_init(&report->memory, 0);
    ql_model_get_info(model, &info);
    const uint32_t num = w->frame->num_layers;
    report->layers = ql_alloc_zero(&report->memory, num, sizeof *report->layers);
    report->names = ql_alloc_zero(&report->memory, num, sizeof *report->names);
    report->model_name = ql_strdup(&report->memory, info.name);
    int failed = report->layers == NULL || report->names == NULL || report->model_name == NULL;
    uint32_t groups = 0;
    int32_t combined = QL_COMBINED_DIRECT;
    if (!failed) report->summary.num_layers = num;
    for (uint32_t i = 0; i < num && !failed; ++i) {
        const ql_plan_layer *const plan = &w->plan.layers[i];
        const ql_scan *const scan = &w->scans[plan->source];
        quell_report_layer *const layer = &report->layers[i];
        report->names[i] = ql_strdup(&report->memory, w->frame->layers[i].full_name);
        failed = report->names[i] == NULL;
        *layer =
            (quell_report_layer){.struct_size = sizeof *layer, .action = plan->action, .full_name = report->names[i]};
        layer->reason = plan->reason;
        layer->mean_before = layer->mean_after = scan->mean;
        if (plan->action != QUELL_ACTION_DENOISED) continue;
        layer->num_bad_pixels = scan->num_bad;
        layer->num_limited_pixels = scan->num_limited;
        if (w->survey.layers) layer->noise = w->survey.layers[i].noise.level;
        if (!dry) {
            layer->mean_after = w->means[i];
            if (w->survey.layers) ql_survey_layer_means(&w->survey.layers[i], &layer->blend, &layer->change);
        }
        const int is_combined = w->frame->layers[i].role == QUELL_ROLE_COMBINED;
        if (!is_combined || w->plan.sets[plan->set].combined == QL_COMBINED_DIRECT || !scan->is_constant_alpha)
            groups |= 1u << (2 * plan->group + ql_role_is_indirect(w->frame->layers[i].role));
    }
    if (failed) {
        ql_report_destroy(report);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: report");
    }
    for (uint32_t s = 0; s < w->plan.num_sets; ++s) {
        if (w->plan.sets[s].combined > combined) combined = w->plan.sets[s].combined;
        if (ql_region_divides(w->frame, &w->plan, s)) groups |= 1u << (2 * QL_GROUP_COLOR);
    }
    quell_report_summary *const summary = &report->summary;
    summary->struct_size = sizeof *summary;
    summary->tile_width = w->tile_width;
    summary->tile_height = w->tile_height;
    summary->num_tiles = w->num_tiles;
    summary->halo = w->num_tiles > 1 ? w->halo : 0;
    summary->peak_bytes = dry ? w->planned_bytes : atomic_load(&w->env->memory->peak_bytes);
    summary->macs_per_pixel =
        w->dgan ? dgan_macs(w) : ql_net_macs_per_pixel(w->job.net, count_bits(groups));
    summary->combined = ql_plan_combined_name(combined);
    summary->model_name = report->model_name;
    for (uint32_t s = 0; s < w->plan.num_sets; ++s) {
        if (w->dgan || w->plan.sets[s].beauty == QL_PLAN_NONE) continue;
        summary->num_cells += w->survey.cells[s].across * w->survey.cells[s].down;
        summary->num_active_cells += w->survey.cells[s].num_active;
    }
    summary->precision = w->job.values == QL_VALUES_BF16 ? QUELL_PRECISION_BFLOAT16 : QUELL_PRECISION_FLOAT32;
    if (!dry) {
        summary->seconds_features = w->job.seconds_features;
        summary->seconds_network = w->job.seconds_network;
        summary->seconds_filter = w->job.seconds_filter;
        summary->seconds_total = seconds;
        summary->seconds_decode = w->frame->seconds_decode;
        summary->seconds_analyse = w->seconds_analyse;
        summary->seconds_recombine = w->job.seconds_recombine;
        summary->iterations = w->dgan_job.iterations_run;
    }
    *out = report;
    return QUELL_OK;
}

quell_status ql_denoise_frame(ql_env *env, const ql_kernels *kernels, const ql_model *model, ql_frame *frame,
                              const quell_options *options, uint64_t max_memory_bytes, int dry, ql_report **report,
                              ql_error *err)
{
    const double start = ql_clock_seconds();
    work w = {.env = env, .frame = frame, .flags = options->flags, .dgan = ql_model_dgan(model)};
    const char *const by_default = w.dgan ? "beauty" : NULL;
    ql_values values;
    *report = NULL;
    QL_TRY(choose_values(kernels, options, w.dgan != NULL, &values, err));
    if (w.dgan == NULL && options->dgan)
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT,
                       "settings of DGAN-KPN are given with a model that is none; choose 'dgan-kpn' or leave them out");
    if (w.dgan && (options->flags & QUELL_DENOISE_DEBUG_LAYERS))
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT,
                       "debug layers show the noise estimate, which models of the kind DGAN-KPN do not use; choose "
                       "another model or leave them out");
    env->progress_from = 0.0;
    env->progress_to = 0.05;
    quell_status status = ql_plan_create(frame, options->layers && options->layers[0] ? options->layers : by_default,
                                         env->memory, &w.plan, err);
    if (status == QUELL_OK && (options->flags & QUELL_DENOISE_DEBUG_LAYERS))
        status = ql_debug_layers_check(frame, &w.plan, err);
    if (status == QUELL_OK) status = look(&w, err);
    w.seconds_analyse = ql_clock_seconds() - start;
    if (status == QUELL_OK && w.dgan) {
        status = choose_bands(&w, kernels, options, max_memory_bytes, err);
        if (status == QUELL_OK && !dry) status = run_dgan(&w, err);
    } else if (status == QUELL_OK) {
        w.job = (ql_job){.kernels = kernels,
                         .net = ql_model_net(model),
                         .values = values,
                         .frame = frame,
                         .plan = &w.plan,
                         .scans = w.scans};
        status = choose_tiles(&w, options->tile_size, max_memory_bytes, err);
        if (status == QUELL_OK) count_tiles(&w);
        if (status == QUELL_OK && !dry) status = run(&w, err);
    }
    if (status == QUELL_OK) status = make_report(&w, model, ql_clock_seconds() - start, dry, report, err);
    if (status == QUELL_OK && !dry && (options->flags & QUELL_DENOISE_DEBUG_LAYERS)) {
        status = ql_debug_layers_add(env, frame, &w.plan, &w.survey, w.halo, err);
        if (status != QUELL_OK) {
            ql_report_destroy(*report);
            *report = NULL;
        }
    }
    for (uint32_t i = 0; i < w.plan.num_layers; ++i) { /* those that the frame came with */
        if (w.scans) ql_scan_free(&w.scans[i], env->memory);
        if (w.results == NULL || w.results[i] == NULL) continue;
        if (status == QUELL_OK) {
            ql_free(frame->memory, frame->layers[i].result);
            frame->layers[i].result = w.results[i];
        } else {
            ql_free(frame->memory, w.results[i]);
        }
    }
    if (status == QUELL_OK && !dry && (options->flags & QUELL_DENOISE_KEEP_NOISY)) frame->add_noisy_image = 1;
    ql_free(env->memory, w.scans);
    ql_free(env->memory, w.results);
    ql_free(env->memory, w.means);
    ql_survey_free(&w.survey, env->memory);
    ql_plan_free(&w.plan, env->memory);
    return status;
}
