/* SPDX-License-Identifier: Apache-2.0 */
/* Reads and writes header bytes by the format's own description (OpenEXR, "File Layout"): per part a list of
 * name\0 type\0 size value, ended by \0; files of several parts have one more \0 behind the last. OpenEXR itself has
 * accepted the header before this file sees it, but nothing here relies on that. */
#include "exr/header.h"

#include <string.h>

/* ---- Bytes ------------------------------------------------------------------------------------------------------- */

void ql_exr_bytes_reserve(ql_exr_bytes *bytes, size_t more)
{
    size_t needed;
    if (bytes->has_failed || ql_add_size(bytes->used, more, &needed) != 0) {
        bytes->has_failed = 1;
        return;
    }
    if (needed <= bytes->capacity) return;
    size_t capacity = bytes->capacity ? bytes->capacity : 4096;
    while (capacity < needed) capacity = capacity > SIZE_MAX / 2 ? needed : capacity * 2;
    uint8_t *data = ql_alloc(bytes->memory, capacity, 1);
    if (!data) {
        bytes->has_failed = 1;
        return;
    }
    if (bytes->used) memcpy(data, bytes->data, bytes->used);
    ql_free(bytes->memory, bytes->data);
    bytes->data = data;
    bytes->capacity = capacity;
}

void ql_exr_bytes_append(ql_exr_bytes *bytes, const void *data, size_t num_bytes)
{
    ql_exr_bytes_reserve(bytes, num_bytes);
    if (bytes->has_failed || num_bytes == 0) return;
    memcpy(bytes->data + bytes->used, data, num_bytes);
    bytes->used += num_bytes;
}

void ql_exr_bytes_append_u32(ql_exr_bytes *bytes, uint32_t value)
{
    const uint8_t little[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
    ql_exr_bytes_append(bytes, little, sizeof little);
}

void ql_exr_bytes_append_u64(ql_exr_bytes *bytes, uint64_t value)
{
    ql_exr_bytes_append_u32(bytes, (uint32_t)value);
    ql_exr_bytes_append_u32(bytes, (uint32_t)(value >> 32));
}

void ql_exr_bytes_free(ql_exr_bytes *bytes)
{
    ql_free(bytes->memory, bytes->data);
    bytes->data = NULL;
    bytes->used = bytes->capacity = 0;
}

/* ---- Reading ----------------------------------------------------------------------------------------------------- */

typedef struct cursor {
    const uint8_t *at;
    size_t left;
} cursor;

static const char *take_text(cursor *from)
{
    const uint8_t *end = from->left ? memchr(from->at, 0, from->left) : NULL;
    if (!end) return NULL;
    const char *text = (const char *)from->at;
    from->left -= (size_t)(end - from->at) + 1;
    from->at = end + 1;
    return text;
}

static int take_attribute(cursor *from, const char *name, ql_exr_attribute *out)
{
    out->name = name;
    out->type = take_text(from);
    if (!out->type || from->left < 4) return -1;
    const uint8_t *size = from->at;
    out->num_bytes = (uint32_t)size[0] | (uint32_t)size[1] << 8 | (uint32_t)size[2] << 16 | (uint32_t)size[3] << 24;
    from->at += 4;
    from->left -= 4;
    if (from->left < out->num_bytes) return -1;
    out->value = from->at;
    from->at += out->num_bytes;
    from->left -= out->num_bytes;
    return 0;
}

/* Goes through the header; counts attributes, and stores them where `attributes` is not NULL. */
static int walk(cursor from, ql_exr_attribute *attributes, ql_exr_part_header *parts, uint32_t num_parts,
                uint32_t *count)
{
    uint32_t num_attributes = 0;
    for (uint32_t p = 0; p < num_parts; p++) {
        const uint32_t first = num_attributes;
        for (;;) {
            const char *name = take_text(&from);
            ql_exr_attribute attribute;
            if (!name) return -1;
            if (!name[0]) break;
            if (take_attribute(&from, name, &attribute) != 0) return -1;
            if (attributes) attributes[num_attributes] = attribute;
            num_attributes++;
        }
        if (attributes) {
            parts[p].attributes = attributes + first;
            parts[p].num_attributes = num_attributes - first;
        }
    }
    *count = num_attributes;
    return 0;
}

quell_status ql_exr_header_read(ql_exr_source *source, ql_memory *memory, ql_exr_header *out, ql_error *err)
{
    const char *path = ql_file_path(source->file);
    const char *reason = "its header is damaged";
    quell_status status = QUELL_ERR_FILE_READ;
    uint64_t end = 0;
    uint32_t count = 0;
    *out = (ql_exr_header){.memory = memory};

    if (exr_get_chunk_table_offset(source->context, 0, &end) != EXR_ERR_SUCCESS || end < 8) goto fail;
    if (end > ql_file_size(source->file)) goto fail;
    const size_t num_bytes = (size_t)(end - 4);
    out->raw = ql_alloc(memory, num_bytes, 1);
    out->parts = ql_alloc_zero(memory, source->num_parts, sizeof *out->parts);
    if (!out->raw || !out->parts) goto fail_memory;
    if (ql_file_read(source->file, out->raw, num_bytes, 4, &reason) != 0) goto fail;

    const uint8_t *word = out->raw;
    out->version = (uint32_t)word[0] | (uint32_t)word[1] << 8 | (uint32_t)word[2] << 16 | (uint32_t)word[3] << 24;
    const cursor from = {.at = out->raw + 4, .left = num_bytes - 4};
    if (walk(from, NULL, NULL, source->num_parts, &count) != 0) goto fail;
    out->attributes = ql_alloc_zero(memory, count, sizeof *out->attributes);
    if (!out->attributes) goto fail_memory;
    walk(from, out->attributes, out->parts, source->num_parts, &count);
    return QUELL_OK;

fail_memory:
    status = QUELL_ERR_OUT_OF_MEMORY;
    reason = "no memory for its header";
fail:
    ql_exr_header_free(out);
    return ql_fail(err, status, "%s: %s", path, reason);
}

void ql_exr_header_free(ql_exr_header *header)
{
    ql_free(header->memory, header->raw);
    ql_free(header->memory, header->attributes);
    ql_free(header->memory, header->parts);
    header->raw = NULL;
    header->attributes = NULL;
    header->parts = NULL;
}

const ql_exr_attribute *ql_exr_find_attribute(const ql_exr_part_header *part, const char *name)
{
    for (uint32_t i = 0; i < part->num_attributes; i++) {
        if (strcmp(part->attributes[i].name, name) == 0) return &part->attributes[i];
    }
    return NULL;
}

/* ---- Writing ----------------------------------------------------------------------------------------------------- */

void ql_exr_append_attribute(ql_exr_bytes *out, const ql_exr_attribute *attribute)
{
    ql_exr_bytes_append(out, attribute->name, strlen(attribute->name) + 1);
    ql_exr_bytes_append(out, attribute->type, strlen(attribute->type) + 1);
    ql_exr_bytes_append_u32(out, attribute->num_bytes);
    ql_exr_bytes_append(out, attribute->value, attribute->num_bytes);
}

void ql_exr_append_channel_list(ql_exr_bytes *out, const ql_exr_channel *channels, uint32_t num_channels)
{
    for (uint32_t c = 0; c < num_channels; c++) {
        const uint8_t flags[4] = {channels[c].is_linear, 0, 0, 0};
        ql_exr_bytes_append(out, channels[c].name, strlen(channels[c].name) + 1);
        ql_exr_bytes_append_u32(out, (uint32_t)channels[c].type);
        ql_exr_bytes_append(out, flags, sizeof flags);
        ql_exr_bytes_append_u32(out, 1); /* sampling */
        ql_exr_bytes_append_u32(out, 1);
    }
    ql_exr_bytes_append(out, "", 1);
}
