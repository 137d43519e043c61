/* SPDX-License-Identifier: Apache-2.0 */
/* Runs an output's tasks: chunks copied from the source or encoded anew, in parallel, into one file in a fixed order. */
#include "exr/exr.h"
#include "exr/output.h"
#include "exr/stream.h"

#include <string.h>

/* A worker's own. */
typedef struct write_worker {
    ql_exr_decoder decoder;
    ql_exr_encoder encoder;
    float *row;
} write_worker;

typedef struct writing {
    ql_exr_output *output;
    ql_exr_stream stream;
    write_worker *workers;
    ql_exr_outcome outcome;
} writing;

static ql_exr_output_part *part_of_task(const ql_exr_output *output, uint32_t task)
{
    uint32_t low = 0, high = output->num_parts;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (output->parts[middle].first_task <= task) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return &output->parts[low];
}

/* ---- Copying ----------------------------------------------------------------------------------------------------- */

static uint32_t read_u32(const uint8_t *from)
{
    return (uint32_t)from[0] | (uint32_t)from[1] << 8 | (uint32_t)from[2] << 16 | (uint32_t)from[3] << 24;
}

static uint64_t read_u64(const uint8_t *from)
{
    return (uint64_t)read_u32(from) | (uint64_t)read_u32(from + 4) << 32;
}

/* Bytes of a chunk's leader by its kind, and of the data behind it as the leader says; -1 when it cannot be. */
static int measure_chunk(const uint8_t *leader, exr_storage_t storage, int is_multi_part, size_t *leader_bytes,
                         uint64_t *data_bytes)
{
    const size_t part = is_multi_part ? 4 : 0;
    const size_t position = storage == EXR_STORAGE_SCANLINE || storage == EXR_STORAGE_DEEP_SCANLINE ? 4 : 16;
    const uint8_t *sizes = leader + part + position;
    if (storage == EXR_STORAGE_SCANLINE || storage == EXR_STORAGE_TILED) {
        *leader_bytes = part + position + 4;
        *data_bytes = read_u32(sizes);
        return *data_bytes <= INT32_MAX ? 0 : -1;
    }
    const uint64_t table = read_u64(sizes), packed = read_u64(sizes + 8);
    *leader_bytes = part + position + 24;
    *data_bytes = table + packed;
    return table <= INT64_MAX / 2 && packed <= INT64_MAX / 2 ? 0 : -1;
}

/* Appends one chunk of a source part as it stands, with the part's new number. */
static quell_status copy_chunk(ql_exr_source *source, const ql_exr_output_part *part, uint32_t new_index,
                               uint64_t offset, ql_exr_bytes *block, ql_error *err)
{
    const uint32_t index = (uint32_t)part->source_part;
    const ql_exr_part *from = &source->parts[index];
    const uint64_t file_bytes = ql_file_size(source->file);
    const char *reason = "a chunk is damaged or missing";
    char where[1200];
    uint8_t leader[64] = {0};
    size_t leader_bytes;
    uint64_t data_bytes;

    if (offset >= file_bytes) goto fail;
    const uint64_t left = file_bytes - offset;
    if (ql_file_read(source->file, leader, left < sizeof leader ? (size_t)left : sizeof leader, offset, &reason) != 0) {
        goto fail;
    }
    if (source->is_multi_part && read_u32(leader) != index) goto fail;
    if (measure_chunk(leader, from->storage, source->is_multi_part, &leader_bytes, &data_bytes) != 0) goto fail;
    if (leader_bytes > left || data_bytes > left - leader_bytes) goto fail;
    const size_t num_bytes = leader_bytes + (size_t)data_bytes;

    ql_exr_bytes_reserve(block, num_bytes);
    if (block->has_failed)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to copy it", ql_file_path(source->file));
    uint8_t *to = block->data + block->used;
    if (ql_file_read(source->file, to, num_bytes, offset, &reason) != 0) goto fail;
    if (source->is_multi_part) {
        for (uint32_t i = 0; i < 4; i++) to[i] = (uint8_t)(new_index >> (8 * i));
    }
    block->used += num_bytes;
    return QUELL_OK;

fail:
    return ql_fail(err, QUELL_ERR_FILE_READ, "%s: %s", ql_exr_source_where(source, index, where, sizeof where), reason);
}

static quell_status copy_task(writing *job, ql_exr_output_part *part, uint32_t first, uint32_t end, ql_exr_bytes *block,
                              ql_error *err)
{
    ql_exr_source *source = job->output->source;
    const uint32_t new_index = (uint32_t)(part - job->output->parts);
    uint64_t *table = NULL;
    int32_t count = 0;
    if (exr_get_chunk_table(source->context, part->source_part, &table, &count) != EXR_ERR_SUCCESS) {
        return ql_fail(err, QUELL_ERR_FILE_READ, "%s: its chunk table is damaged", ql_file_path(source->file));
    }
    for (uint32_t i = first; i < end; i++) {
        const uint32_t chunk = part->order[i];
        part->offsets[chunk] = block->used;
        QL_TRY(copy_chunk(source, part, new_index, table[chunk], block, err));
    }
    return QUELL_OK;
}

/* ---- Encoding ---------------------------------------------------------------------------------------------------- */

typedef struct filling {
    writing *job;
    write_worker *worker;
    const ql_exr_output_part *part;
    uint32_t width;
} filling;

static void fill_from_layer(const filling *fill, const ql_exr_segment *segment, uint32_t y, uint8_t *out)
{
    const ql_layer *layer = segment->layer;
    const uint32_t channel = segment->layer_channel;
    const ql_view *pixels = &layer->pixels;
    const ql_view to = {
        .data = out,
        .format = segment->format,
        .num_channels = 1,
        .pixel_stride = (int64_t)ql_format_bytes(segment->format),
    };
    if (segment->kind == QL_EXR_FROM_RESULT) {
        const size_t row = (size_t)channel * fill->job->output->frame->height + y;
        ql_view_write_row(&to, fill->width, 0, 0, layer->result + row * fill->width);
    } else if (pixels->format == segment->format && pixels->pixel_stride == to.pixel_stride) {
        const uint8_t *row = pixels->data + (int64_t)channel * pixels->channel_stride + (int64_t)y * pixels->row_stride;
        memcpy(out, row, segment->num_bytes);
    } else {
        ql_view_read_row(pixels, fill->width, channel, y, fill->worker->row);
        ql_view_write_row(&to, fill->width, 0, 0, fill->worker->row);
    }
}

static quell_status fill_lines(void *user, uint32_t first, uint32_t count, uint8_t *out, ql_error *err)
{
    const filling *fill = user;
    const ql_exr_output_part *part = fill->part;
    ql_exr_source *source = fill->job->output->source;
    ql_exr_lines lines = {.count = 0};
    for (uint32_t y = first; y < first + count; y++) {
        const uint8_t *line = NULL;
        if (part->needs_source) {
            const ql_exr_part *from = &source->parts[part->source_part];
            if (y >= lines.first + lines.count || lines.count == 0) {
                const int32_t chunk = (int32_t)(y / (uint32_t)from->lines_per_chunk);
                QL_TRY(ql_exr_decode(source, &fill->worker->decoder, (uint32_t)part->source_part, chunk, &lines, err));
            }
            line = lines.data + (size_t)(y - lines.first) * from->line_bytes;
        }
        for (uint32_t s = 0; s < part->num_segments; s++) {
            const ql_exr_segment *segment = &part->segments[s];
            if (segment->kind == QL_EXR_FROM_SOURCE) {
                memcpy(out, line + segment->source_offset, segment->num_bytes);
            } else {
                fill_from_layer(fill, segment, y, out);
            }
            out += segment->num_bytes;
        }
    }
    return QUELL_OK;
}

static quell_status encode_chunk(filling *fill, ql_exr_output_part *part, uint32_t chunk, ql_exr_bytes *block,
                                 ql_error *err)
{
    const ql_exr_output *output = fill->job->output;
    const void *data = NULL;
    size_t num_bytes = 0;
    QL_TRY(ql_exr_encode(&part->codec, &fill->worker->encoder, chunk, fill_lines, fill, output->path, &data, &num_bytes,
                         err));
    if (num_bytes > INT32_MAX) {
        return ql_fail(err, QUELL_ERR_LIMIT, "%s: a chunk of %zu bytes is too long for an EXR file", output->path,
                       num_bytes);
    }
    const int64_t y = (int64_t)part->window.min.y + (int64_t)chunk * part->codec.lines_per_chunk;
    part->offsets[chunk] = block->used;
    if (output->is_multi_part) ql_exr_bytes_append_u32(block, (uint32_t)(part - output->parts));
    ql_exr_bytes_append_u32(block, (uint32_t)(int32_t)y);
    ql_exr_bytes_append_u32(block, (uint32_t)num_bytes);
    ql_exr_bytes_append(block, data, num_bytes);
    return QUELL_OK;
}

/* Chunks of a part whose lines go downwards in the file are stored last first, as its line order promises. */
static uint32_t chunk_at(const ql_exr_output_part *part, uint32_t position)
{
    return part->line_order == EXR_LINEORDER_DECREASING_Y ? part->num_chunks - 1 - position : position;
}

static quell_status encode_task(writing *job, ql_exr_output_part *part, write_worker *worker, uint32_t first,
                                uint32_t end, ql_exr_bytes *block, ql_error *err)
{
    const int64_t width = (int64_t)part->window.max.x - part->window.min.x + 1;
    filling fill = {.job = job, .worker = worker, .part = part, .width = (uint32_t)width};
    for (uint32_t i = first; i < end; i++) QL_TRY(encode_chunk(&fill, part, chunk_at(part, i), block, err));
    return QUELL_OK;
}

/* ---- The file ---------------------------------------------------------------------------------------------------- */

static void write_task(void *user, uint32_t task, uint32_t worker)
{
    writing *job = user;
    if (ql_exr_outcome_is_over(&job->outcome, task)) return;
    ql_exr_output_part *part = part_of_task(job->output, task);
    const uint32_t first = (task - part->first_task) * part->chunks_per_task;
    const uint32_t left = part->num_chunks - first;
    const uint32_t end = first + (left < part->chunks_per_task ? left : part->chunks_per_task);
    ql_exr_bytes block = {.memory = job->output->memory};
    ql_error error = {.status = QUELL_OK};

    quell_status status = part->is_copied ? copy_task(job, part, first, end, &block, &error)
                                          : encode_task(job, part, &job->workers[worker], first, end, &block, &error);
    if (status == QUELL_OK) {
        status = ql_exr_stream_put(&job->stream, task, &block, &error);
    } else {
        ql_exr_bytes_free(&block);
    }
    if (status != QUELL_OK) ql_exr_outcome_fail(&job->outcome, task, &error);
}

/* Offsets were counted within their blocks; the stream knows by now where those stand. */
static void settle_offsets(writing *job)
{
    ql_exr_output *output = job->output;
    for (uint32_t p = 0; p < output->num_parts; p++) {
        ql_exr_output_part *part = &output->parts[p];
        for (uint32_t i = 0; i < part->num_chunks; i++) {
            const uint32_t chunk = part->is_copied ? part->order[i] : chunk_at(part, i);
            part->offsets[chunk] += job->stream.offsets[part->first_task + i / part->chunks_per_task];
        }
    }
}

static quell_status open_workers(writing *job, ql_env *env, uint32_t num_workers, ql_error *err)
{
    const ql_exr_output *output = job->output;
    job->workers = ql_alloc_zero(env->memory, num_workers, sizeof *job->workers);
    if (!job->workers) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", output->path);
    for (uint32_t w = 0; w < num_workers; w++) {
        job->workers[w].row = ql_alloc(env->memory, output->frame->width, sizeof(float));
        if (!job->workers[w].row) {
            return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", output->path);
        }
    }
    return QUELL_OK;
}

static void close_workers(writing *job, ql_env *env, uint32_t num_workers)
{
    for (uint32_t w = 0; job->workers && w < num_workers; w++) {
        if (job->output->source) ql_exr_decoder_close(job->output->source, &job->workers[w].decoder);
        ql_exr_encoder_close(&job->workers[w].encoder);
        ql_free(env->memory, job->workers[w].row);
    }
    ql_free(env->memory, job->workers);
}

static quell_status run_tasks(writing *job, ql_env *env, ql_error *err)
{
    QL_TRY(ql_exr_outcome_init(&job->outcome, err));
    const quell_status status = ql_env_run(env, job->output->num_tasks, write_task, job);
    QL_TRY(ql_exr_outcome_end(&job->outcome, status, "writing", job->output->path, err));
    if (job->stream.next == job->output->num_tasks) return QUELL_OK;
    return ql_fail(err, QUELL_ERR_INTERNAL, "%s: only %u of %u blocks were written", job->output->path,
                   job->stream.next, job->output->num_tasks);
}

/* The chunks, then header and chunk tables in front of them. */
static quell_status write_all(writing *job, ql_env *env, ql_file *file, ql_error *err)
{
    ql_exr_output *output = job->output;
    const uint32_t num_workers = ql_pool_num_threads(env->pool);
    ql_exr_bytes head = {.memory = output->memory};
    quell_status status = QUELL_OK;

    ql_exr_output_head(output, &head); /* for its length */
    const size_t head_bytes = head.used;
    if (!head.has_failed) {
        QL_TRY_GOTO(ql_exr_stream_open(&job->stream, env->memory, file, head_bytes, output->num_tasks, err));
        QL_TRY_GOTO(open_workers(job, env, num_workers, err));
        QL_TRY_GOTO(run_tasks(job, env, err));
        settle_offsets(job);
        head.used = 0;
        ql_exr_output_head(output, &head);
    }
    if (head.has_failed || head.used != head_bytes) {
        status = ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory for its header", output->path);
        goto fail;
    }
    QL_TRY_GOTO(ql_file_write(file, head.data, head.used, 0, err));

fail:
    close_workers(job, env, num_workers);
    ql_exr_stream_close(&job->stream);
    ql_exr_bytes_free(&head);
    return status;
}

quell_status ql_exr_write(ql_env *env, ql_frame *frame, const char *path, int32_t codec, ql_error *err)
{
    ql_exr_output output;
    writing job = {.output = &output};
    ql_file *file = NULL;
    if (codec < QUELL_CODEC_KEEP || codec > QUELL_CODEC_HTJ2K) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "there is no codec %d", (int)codec);
    }
    /* The target first: a missing folder is found before any work is done. */
    QL_TRY(ql_file_create(env->memory, path, &file, err));
    quell_status status = ql_exr_output_open(&output, env, frame, codec, path, err);
    if (status == QUELL_OK) {
        status = write_all(&job, env, file, err);
        ql_exr_output_close(&output);
    }
    if (status != QUELL_OK) {
        ql_file_discard(file);
        return status;
    }
    return ql_file_commit(file, err);
}
