/* SPDX-License-Identifier: Apache-2.0 */
/* The open EXR file behind a frame. Shared by the files of src/exr only. */
#ifndef QL_EXR_SOURCE_H
#define QL_EXR_SOURCE_H

#include "base/pool.h"
#include "exr/file.h"
#include "frame/frame.h"

#include <OpenEXR/openexr.h>

#include <pthread.h>

/* What OpenEXR says about a failure comes through a callback, on the thread that failed. Each thread's first message is
 * kept until that thread takes it. */
#define QL_EXR_MESSAGE_BYTES 256
#define QL_EXR_MAX_MESSAGES 32

typedef struct ql_exr_messages {
    pthread_mutex_t lock;
    struct {
        int is_used;
        pthread_t thread;
        char text[QL_EXR_MESSAGE_BYTES];
    } slots[QL_EXR_MAX_MESSAGES];
} ql_exr_messages;

quell_status ql_exr_messages_init(ql_exr_messages *messages, ql_error *err);
void ql_exr_messages_destroy(ql_exr_messages *messages);

/* Forgets what this thread has said so far. */
void ql_exr_messages_clear(ql_exr_messages *messages);

/* ql_fail with "WHERE: what OpenEXR said". code tells memory shortage from damage, which becomes `status`. */
quell_status ql_exr_fail(ql_exr_messages *messages, exr_result_t code, quell_status status, const char *where,
                         ql_error *err);

/* Fills an initializer so that errors go to `messages`; user_data must be the ql_exr_messages or start with one. */
void ql_exr_error_handler(exr_const_context_t context, exr_result_t code, const char *text);

typedef struct ql_exr_part {
    exr_storage_t storage;
    exr_compression_t compression;
    exr_lineorder_t line_order;
    exr_attr_box2i_t window;             /* data window */
    uint32_t width, height;              /* of the data window */
    const exr_attr_chlist_t *channels;   /* lent by OpenEXR */
    const char *name, *view;             /* lent by OpenEXR, "" where absent */
    int32_t num_chunks, lines_per_chunk; /* lines: 0 unless scanlines */
    size_t line_bytes;                   /* all channels, uncompressed; 0 unless is_plain */
    int is_plain;                        /* scanlines, no subsampling: chunks can be decoded here */
    int is_listed;                       /* is_plain, and of the frame's size and place */
} ql_exr_part;

struct ql_exr_source {
    ql_exr_messages messages; /* first: OpenEXR's user data */
    ql_memory *memory;
    ql_file *file;
    exr_context_t context;
    ql_exr_part *parts;
    uint32_t num_parts;
    int is_multi_part; /* the flag in the file: a file of one part may have it */
};

typedef struct ql_exr_source ql_exr_source;

quell_status ql_exr_source_open(ql_memory *memory, const char *path, uint64_t max_image_pixels, ql_exr_source **out,
                                ql_error *err);
void ql_exr_source_destroy(ql_exr_source *source);

/* "PATH", or "PATH, part 3 'ViewLayer.Depth'" in files of several parts. Returns buffer. */
const char *ql_exr_source_where(const ql_exr_source *source, uint32_t part, char *buffer, size_t buffer_bytes);

/* Bytes of one value of a channel, and its QUELL_FORMAT_*. */
size_t ql_exr_value_bytes(exr_pixel_type_t type);
int32_t ql_exr_format(exr_pixel_type_t type);

/* The failure of the lowest task: so the message does not depend on timing. Tasks above it need not run. */
typedef struct ql_exr_outcome {
    pthread_mutex_t lock;
    atomic_uint_fast32_t first_failed; /* UINT32_MAX: none */
    ql_error error;
} ql_exr_outcome;

quell_status ql_exr_outcome_init(ql_exr_outcome *outcome, ql_error *err);
void ql_exr_outcome_fail(ql_exr_outcome *outcome, uint32_t task, const ql_error *error);
int ql_exr_outcome_is_over(const ql_exr_outcome *outcome, uint32_t task);

/* Destroys the outcome; run_status is what ql_env_run said, `what` names the job for a cancelled one. */
quell_status ql_exr_outcome_end(ql_exr_outcome *outcome, quell_status run_status, const char *what, const char *path,
                                ql_error *err);

#endif
