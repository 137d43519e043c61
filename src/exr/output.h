/* SPDX-License-Identifier: Apache-2.0 */
/* What an output file will hold: its parts, where each channel's rows come from, and its header. No pixel is touched
 * here. */
#ifndef QL_EXR_OUTPUT_H
#define QL_EXR_OUTPUT_H

#include "exr/header.h"

/* A run of bytes in each line of a part, in the order of the line. */
typedef struct ql_exr_segment {
    enum { QL_EXR_FROM_SOURCE, QL_EXR_FROM_RESULT, QL_EXR_FROM_PIXELS } kind;
    size_t num_bytes;
    size_t source_offset;  /* FROM_SOURCE: in the source part's line */
    const ql_layer *layer; /* FROM_RESULT, FROM_PIXELS: one row of this layer's channel */
    uint32_t layer_channel;
    int32_t format;
} ql_exr_segment;

typedef struct ql_exr_output_part {
    int32_t source_part; /* whose chunks it copies or decodes; -1: made of layers alone */
    int32_t header_part; /* whose attributes it has; -1: made here */
    int is_new;          /* a part that the source lacks: it has only the structural attributes of header_part */
    int is_copied;       /* chunk by chunk, as they stand */
    exr_compression_t compression;
    exr_lineorder_t line_order;
    exr_attr_box2i_t window;
    char *name;               /* is_new: of the part; owned */
    ql_exr_channel *channels; /* not copied; sorted by name; names owned by the output */
    ql_exr_segment *segments;
    uint32_t num_channels, num_segments;
    int needs_source; /* some segment is FROM_SOURCE */
    int has_new_channels;
    ql_exr_codec codec; /* not copied */
    uint32_t num_chunks, chunks_per_task, first_task, num_tasks;
    uint32_t *order;   /* copied: chunks in the order of their place in the source */
    uint64_t *offsets; /* of the chunks: inside their block, then in the file */
} ql_exr_output_part;

typedef struct ql_exr_output {
    ql_memory *memory;
    ql_env *env;
    const ql_frame *frame;
    ql_exr_source *source; /* NULL: a frame from memory */
    const char *path;
    ql_exr_header header; /* of the source */
    ql_exr_messages messages;
    ql_exr_output_part *parts;
    uint32_t num_parts, num_tasks;
    int is_multi_part, has_long_names;
    char **names; /* every string that was made */
    uint32_t num_names, names_capacity;
} ql_exr_output;

quell_status ql_exr_output_open(ql_exr_output *output, ql_env *env, const ql_frame *frame, int32_t codec,
                                const char *path, ql_error *err);
void ql_exr_output_close(ql_exr_output *output);

/* Everything before the chunks: header, and the chunk tables with the offsets that are known by now. */
void ql_exr_output_head(const ql_exr_output *output, ql_exr_bytes *out);

#endif
