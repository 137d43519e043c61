/* SPDX-License-Identifier: Apache-2.0 */
/* Pixels from a file into a frame's layers: one task per chunk, each worker with a decoder of its own over the shared
 * file. Rows go straight into the layers' planes in the file's own type. */
#include "base/clock.h"
#include "exr/chunk.h"
#include "exr/exr.h"
#include "exr/layers.h"

#include <string.h>

/* Where a channel's rows go; plane is NULL for channels that nobody wants. */
typedef struct target {
    uint8_t *plane;
    int32_t from, to; /* QUELL_FORMAT_*; they differ only in layers of mixed types */
} target;

typedef struct wanted_part {
    uint32_t part;
    uint32_t first_task, num_tasks; /* a task per chunk */
    target *targets;                /* one per channel */
} wanted_part;

typedef struct reading {
    ql_exr_source *source;
    wanted_part *parts;
    uint32_t num_parts;
    target *targets;          /* all parts' */
    ql_exr_decoder *decoders; /* one per worker */
    ql_exr_outcome outcome;
} reading;

static const wanted_part *part_of_task(const reading *job, uint32_t task)
{
    uint32_t low = 0, high = job->num_parts;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (job->parts[middle].first_task <= task) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return &job->parts[low];
}

static void store_row(const target *to, uint32_t width, uint32_t y, const uint8_t *row)
{
    const size_t to_bytes = width * ql_format_bytes(to->to);
    uint8_t *out = to->plane + y * to_bytes;
    if (to->from == to->to) {
        memcpy(out, row, to_bytes);
        return;
    }
    const ql_view view = {
        .data = (uint8_t *)(uintptr_t)row, /* only read */
        .format = to->from,
        .num_channels = 1,
        .pixel_stride = (int64_t)ql_format_bytes(to->from),
    };
    ql_view_read_row(&view, width, 0, 0, (float *)(void *)out);
}

static void read_chunk(void *user, uint32_t task, uint32_t worker)
{
    reading *job = user;
    if (ql_exr_outcome_is_over(&job->outcome, task)) return;
    const wanted_part *wanted = part_of_task(job, task);
    const ql_exr_part *part = &job->source->parts[wanted->part];
    ql_error error = {.status = QUELL_OK};
    ql_exr_lines lines;
    const int32_t chunk = (int32_t)(task - wanted->first_task);
    if (ql_exr_decode(job->source, &job->decoders[worker], wanted->part, chunk, &lines, &error) != QUELL_OK) {
        ql_exr_outcome_fail(&job->outcome, task, &error);
        return;
    }
    const uint8_t *row = lines.data;
    for (uint32_t y = lines.first; y < lines.first + lines.count; y++) {
        for (int32_t c = 0; c < part->channels->num_channels; c++) {
            if (wanted->targets[c].plane) store_row(&wanted->targets[c], part->width, y, row);
            row += part->width * ql_exr_value_bytes(part->channels->entries[c].pixel_type);
        }
    }
}

/* Lists the parts that hold wanted layers, and gives those layers their memory. */
static quell_status prepare(reading *job, ql_memory *memory, ql_frame *frame, const uint8_t *wants, ql_error *err)
{
    ql_exr_source *source = job->source;
    const char *path = ql_file_path(source->file);
    size_t num_targets = 0;
    uint64_t num_tasks = 0;
    for (uint32_t p = 0; p < source->num_parts; p++) num_targets += (size_t)source->parts[p].channels->num_channels;

    job->parts = ql_alloc_zero(memory, source->num_parts, sizeof *job->parts);
    job->targets = ql_alloc_zero(memory, num_targets, sizeof *job->targets);
    if (!job->parts || !job->targets) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to read it", path);

    target *targets = job->targets;
    for (uint32_t p = 0; p < source->num_parts; p++) {
        wanted_part wanted = {.part = p, .first_task = (uint32_t)num_tasks, .targets = targets};
        int is_wanted = 0;
        for (uint32_t i = 0; i < frame->num_layers; i++) {
            ql_layer *layer = &frame->layers[i];
            if (layer->part != p || !wants[i] || layer->pixels.data) continue;
            QL_TRY(ql_layer_alloc_pixels(frame, layer, err));
            is_wanted = 1;
            for (uint32_t c = 0; c < layer->num_channels; c++) {
                const int32_t channel = layer->channel_index[c];
                targets[channel] = (target){
                    .plane = layer->pixels.data + (int64_t)c * layer->pixels.channel_stride,
                    .from = ql_exr_format(source->parts[p].channels->entries[channel].pixel_type),
                    .to = layer->format,
                };
            }
        }
        targets += source->parts[p].channels->num_channels;
        if (!is_wanted) continue;
        wanted.num_tasks = (source->parts[p].height - 1) / (uint32_t)source->parts[p].lines_per_chunk + 1;
        num_tasks += wanted.num_tasks;
        if (num_tasks > INT32_MAX) return ql_fail(err, QUELL_ERR_LIMIT, "%s: has too many chunks", path);
        job->parts[job->num_parts++] = wanted;
    }
    return QUELL_OK;
}

static void forget_pixels(ql_frame *frame, const uint8_t *wants)
{
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        if (!wants[i]) continue;
        ql_free(frame->memory, frame->layers[i].owned);
        frame->layers[i].owned = NULL;
        frame->layers[i].pixels = (ql_view){.data = NULL};
    }
}

/* Decodes the layers whose flag in `wants` is set and that have no pixels. On failure they have none afterwards. */
static quell_status read_layers(ql_env *env, ql_frame *frame, const uint8_t *wants, ql_error *err)
{
    reading job = {.source = frame->source};
    const char *path = ql_file_path(frame->source->file);
    const uint32_t num_workers = ql_pool_num_threads(env->pool);
    quell_status status;
    uint32_t num_tasks = 0;

    QL_TRY_GOTO(prepare(&job, env->memory, frame, wants, err));
    job.decoders = ql_alloc_zero(env->memory, num_workers, sizeof *job.decoders);
    if (!job.decoders) {
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to read it", path);
        goto fail;
    }
    QL_TRY_GOTO(ql_exr_outcome_init(&job.outcome, err));
    for (uint32_t p = 0; p < job.num_parts; p++) num_tasks += job.parts[p].num_tasks;
    status = num_tasks ? ql_env_run(env, num_tasks, read_chunk, &job) : QUELL_OK;
    status = ql_exr_outcome_end(&job.outcome, status, "reading", path, err);
    for (uint32_t w = 0; w < num_workers; w++) ql_exr_decoder_close(frame->source, &job.decoders[w]);

fail:
    if (status != QUELL_OK) forget_pixels(frame, wants);
    ql_free(env->memory, job.decoders);
    ql_free(env->memory, job.targets);
    ql_free(env->memory, job.parts);
    return status;
}

quell_status ql_exr_read(ql_env *env, const char *path, uint64_t max_image_pixels, ql_frame **out, ql_error *err)
{
    const double start = ql_clock_seconds();
    ql_frame *frame = NULL;
    uint8_t *wants = NULL;
    quell_status status;
    *out = NULL;

    QL_TRY(ql_frame_create(1, 1, &frame, err)); /* its size comes with the header */
    frame->source_destroy = ql_exr_source_destroy;
    QL_TRY_GOTO(ql_exr_source_open(frame->memory, path, max_image_pixels ? max_image_pixels : (uint64_t)1 << 30,
                                   &frame->source, err));
    QL_TRY_GOTO(ql_exr_list_layers(env, frame->source, frame, err));

    wants = ql_alloc_zero(env->memory, frame->num_layers, sizeof *wants);
    if (!wants) {
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to read it", path);
        goto fail;
    }
    for (uint32_t i = 0; i < frame->num_layers; i++) wants[i] = frame->layers[i].role != QUELL_ROLE_OTHER;
    QL_TRY_GOTO(read_layers(env, frame, wants, err));
    ql_free(env->memory, wants);
    frame->seconds_decode = ql_clock_seconds() - start;
    *out = frame;
    return QUELL_OK;

fail:
    ql_free(env->memory, wants);
    ql_frame_destroy(frame);
    return status;
}

quell_status ql_exr_load_layer(ql_env *env, ql_frame *frame, uint32_t index, ql_error *err)
{
    if (index >= frame->num_layers) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "there is no layer %u", index);
    const ql_layer *layer = &frame->layers[index];
    if (layer->pixels.data) return QUELL_OK;
    if (!frame->source) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "the layer '%s' has no pixels", layer->full_name);
    }
    uint8_t *wants = ql_alloc_zero(env->memory, frame->num_layers, sizeof *wants);
    if (!wants) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory to read the layer '%s'", layer->full_name);
    wants[index] = 1;
    const quell_status status = read_layers(env, frame, wants, err);
    ql_free(env->memory, wants);
    return status;
}
