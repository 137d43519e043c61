/* SPDX-License-Identifier: Apache-2.0 */
/* An ordered writer. The worker whose block is next writes it and all that stand ready behind it; others only leave
 * theirs, so nobody waits for a turn. */
#include "exr/stream.h"

/* Finished blocks may pile up behind a slow disk to this size; then their makers wait for the one who writes. */
#define MAX_WAITING_BYTES ((uint64_t)64 << 20)

quell_status ql_exr_stream_open(ql_exr_stream *stream, ql_memory *memory, ql_file *file, uint64_t offset,
                                uint32_t num_blocks, ql_error *err)
{
    *stream = (ql_exr_stream){.memory = memory, .file = file, .offset = offset, .num_blocks = num_blocks};
    stream->blocks = ql_alloc_zero(memory, num_blocks, sizeof *stream->blocks);
    stream->offsets = ql_alloc_zero(memory, num_blocks, sizeof *stream->offsets);
    if (!stream->blocks || !stream->offsets) goto fail;
    if (pthread_mutex_init(&stream->lock, NULL) != 0) goto fail;
    if (pthread_cond_init(&stream->written, NULL) == 0) return QUELL_OK;
    pthread_mutex_destroy(&stream->lock);
fail:
    ql_free(memory, stream->blocks);
    ql_free(memory, stream->offsets);
    stream->memory = NULL;
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", ql_file_path(file));
}

/* Under lock; writes without it. */
static void write_ready_blocks(ql_exr_stream *stream)
{
    stream->is_writing = 1;
    while (stream->next < stream->num_blocks && stream->blocks[stream->next].data) {
        const uint32_t index = stream->next;
        const uint64_t offset = stream->offset;
        uint8_t *data = stream->blocks[index].data;
        const size_t num_bytes = stream->blocks[index].num_bytes;
        ql_error error = {.status = QUELL_OK};
        const int is_broken = stream->error.status != QUELL_OK;
        pthread_mutex_unlock(&stream->lock);
        if (!is_broken) (void)ql_file_write(stream->file, data, num_bytes, offset, &error);
        ql_free(stream->memory, data);
        pthread_mutex_lock(&stream->lock);
        if (error.status != QUELL_OK) stream->error = error;
        stream->blocks[index].data = NULL;
        stream->offsets[index] = offset;
        stream->offset += num_bytes;
        stream->waiting_bytes -= num_bytes;
        stream->next++;
        pthread_cond_broadcast(&stream->written);
    }
    stream->is_writing = 0;
    pthread_cond_broadcast(&stream->written);
}

quell_status ql_exr_stream_put(ql_exr_stream *stream, uint32_t index, ql_exr_bytes *block, ql_error *err)
{
    if (block->has_failed) {
        ql_exr_bytes_free(block);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", ql_file_path(stream->file));
    }
    pthread_mutex_lock(&stream->lock);
    stream->blocks[index].data = block->data;
    stream->blocks[index].num_bytes = block->used;
    stream->waiting_bytes += block->used;
    block->data = NULL;
    block->used = block->capacity = 0;
    if (!stream->is_writing) {
        write_ready_blocks(stream);
    } else {
        while (stream->is_writing && stream->waiting_bytes > MAX_WAITING_BYTES) {
            pthread_cond_wait(&stream->written, &stream->lock);
        }
    }
    const ql_error error = stream->error;
    pthread_mutex_unlock(&stream->lock);
    return error.status == QUELL_OK ? QUELL_OK : ql_fail(err, error.status, "%s", error.text);
}

void ql_exr_stream_close(ql_exr_stream *stream)
{
    if (!stream->memory) return;
    for (uint32_t i = 0; i < stream->num_blocks; i++) ql_free(stream->memory, stream->blocks[i].data);
    ql_free(stream->memory, stream->blocks);
    ql_free(stream->memory, stream->offsets);
    pthread_cond_destroy(&stream->written);
    pthread_mutex_destroy(&stream->lock);
    stream->memory = NULL;
}
