/* SPDX-License-Identifier: Apache-2.0 */
/* EXR headers as bytes: what an output does not change is copied as it stood, known to OpenEXR or not. */
#ifndef QL_EXR_HEADER_H
#define QL_EXR_HEADER_H

#include "exr/chunk.h"

/* A growing run of bytes. After a failed append, and only then, has_failed is set. */
typedef struct ql_exr_bytes {
    ql_memory *memory;
    uint8_t *data;
    size_t used, capacity;
    int has_failed;
} ql_exr_bytes;

void ql_exr_bytes_reserve(ql_exr_bytes *bytes, size_t more);
void ql_exr_bytes_append(ql_exr_bytes *bytes, const void *data, size_t num_bytes);
void ql_exr_bytes_append_u32(ql_exr_bytes *bytes, uint32_t value);
void ql_exr_bytes_append_u64(ql_exr_bytes *bytes, uint64_t value);
void ql_exr_bytes_free(ql_exr_bytes *bytes);

typedef struct ql_exr_attribute {
    const char *name, *type;
    const uint8_t *value;
    uint32_t num_bytes;
} ql_exr_attribute;

typedef struct ql_exr_part_header {
    ql_exr_attribute *attributes;
    uint32_t num_attributes;
} ql_exr_part_header;

typedef struct ql_exr_header {
    ql_memory *memory;
    uint32_t version;             /* the second word of the file: version and flags */
    uint8_t *raw;                 /* everything between that word and the chunk tables */
    ql_exr_attribute *attributes; /* of all parts, one after the other */
    ql_exr_part_header *parts;    /* as many as the source has */
} ql_exr_header;

#define QL_EXR_FLAG_LONG_NAMES 0x400u

quell_status ql_exr_header_read(ql_exr_source *source, ql_memory *memory, ql_exr_header *out, ql_error *err);
void ql_exr_header_free(ql_exr_header *header);

const ql_exr_attribute *ql_exr_find_attribute(const ql_exr_part_header *part, const char *name);

void ql_exr_append_attribute(ql_exr_bytes *out, const ql_exr_attribute *attribute);

/* The value of a `channels` attribute. */
void ql_exr_append_channel_list(ql_exr_bytes *out, const ql_exr_channel *channels, uint32_t num_channels);

#endif
