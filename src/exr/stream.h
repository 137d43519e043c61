/* SPDX-License-Identifier: Apache-2.0 */
/* Blocks that workers finish in any order, written to a file in the order of their tasks: so the same input gives the
 * same bytes for any number of threads. */
#ifndef QL_EXR_STREAM_H
#define QL_EXR_STREAM_H

#include "exr/header.h"

typedef struct ql_exr_stream {
    pthread_mutex_t lock;
    pthread_cond_t written;
    ql_memory *memory;
    ql_file *file;
    struct {
        uint8_t *data; /* NULL: not there yet */
        size_t num_bytes;
    } * blocks;
    uint64_t *offsets; /* where each block stands in the file, once written */
    uint64_t offset;   /* of the next block */
    uint64_t waiting_bytes;
    uint32_t num_blocks, next;
    int is_writing; /* a worker is at the file */
    ql_error error; /* of the file; what comes after it is dropped */
} ql_exr_stream;

/* The first block goes to `offset`. */
quell_status ql_exr_stream_open(ql_exr_stream *stream, ql_memory *memory, ql_file *file, uint64_t offset,
                                uint32_t num_blocks, ql_error *err);

/* Takes the block's memory. May write it, or others, or wait for the file when far too much is waiting for it. */
quell_status ql_exr_stream_put(ql_exr_stream *stream, uint32_t index, ql_exr_bytes *block, ql_error *err);

void ql_exr_stream_close(ql_exr_stream *stream);

#endif
