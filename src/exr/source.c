/* SPDX-License-Identifier: Apache-2.0 */
/* Opening an EXR file: header, parts, limits, and OpenEXR's error messages. Decodes nothing. */
#include "exr/source.h"

#include <stdio.h>
#include <string.h>

/* ---- Messages and failures --------------------------------------------------------------------------------------- */

quell_status ql_exr_messages_init(ql_exr_messages *messages, ql_error *err)
{
    memset(messages->slots, 0, sizeof messages->slots);
    if (pthread_mutex_init(&messages->lock, NULL) == 0) return QUELL_OK;
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a lock");
}

void ql_exr_messages_destroy(ql_exr_messages *messages)
{
    pthread_mutex_destroy(&messages->lock);
}

/* Under lock. The calling thread's slot; a free one if it has none and `make` is set; else NULL. */
static char *find_slot(ql_exr_messages *messages, int make)
{
    const pthread_t self = pthread_self();
    size_t free_slot = QL_EXR_MAX_MESSAGES;
    for (size_t i = 0; i < QL_EXR_MAX_MESSAGES; i++) {
        if (!messages->slots[i].is_used) {
            if (free_slot == QL_EXR_MAX_MESSAGES) free_slot = i;
        } else if (pthread_equal(messages->slots[i].thread, self)) {
            return messages->slots[i].text;
        }
    }
    if (!make || free_slot == QL_EXR_MAX_MESSAGES) return NULL;
    messages->slots[free_slot].is_used = 1;
    messages->slots[free_slot].thread = self;
    messages->slots[free_slot].text[0] = '\0';
    return messages->slots[free_slot].text;
}

/* Under lock. */
static void release_slot(ql_exr_messages *messages, char *text)
{
    for (size_t i = 0; i < QL_EXR_MAX_MESSAGES; i++) {
        if (messages->slots[i].text == text) messages->slots[i].is_used = 0;
    }
}

void ql_exr_error_handler(exr_const_context_t context, exr_result_t code, const char *text)
{
    void *user = NULL;
    (void)code;
    if (!context || exr_get_user_data(context, &user) != EXR_ERR_SUCCESS || !user) return;
    ql_exr_messages *messages = user;
    pthread_mutex_lock(&messages->lock);
    char *slot = find_slot(messages, 1);
    if (slot && !slot[0]) {
        snprintf(slot, QL_EXR_MESSAGE_BYTES, "%s", text ? text : "");
        for (char *c = slot; *c; c++) {
            if ((unsigned char)*c < ' ') *c = ' '; /* names in damaged files */
        }
    }
    pthread_mutex_unlock(&messages->lock);
}

void ql_exr_messages_clear(ql_exr_messages *messages)
{
    pthread_mutex_lock(&messages->lock);
    char *slot = find_slot(messages, 0);
    if (slot) release_slot(messages, slot);
    pthread_mutex_unlock(&messages->lock);
}

quell_status ql_exr_fail(ql_exr_messages *messages, exr_result_t code, quell_status status, const char *where,
                         ql_error *err)
{
    char text[QL_EXR_MESSAGE_BYTES] = "";
    pthread_mutex_lock(&messages->lock);
    char *slot = find_slot(messages, 0);
    if (slot) {
        snprintf(text, sizeof text, "%s", slot);
        release_slot(messages, slot);
    }
    pthread_mutex_unlock(&messages->lock);
    if (!text[0]) snprintf(text, sizeof text, "%s", exr_get_default_error_message(code));

    if (code == EXR_ERR_OUT_OF_MEMORY) status = QUELL_ERR_OUT_OF_MEMORY;
    if (code == EXR_ERR_FEATURE_NOT_IMPLEMENTED) status = QUELL_ERR_UNSUPPORTED;
    return ql_fail(err, status, "%s: %s", where, text);
}

quell_status ql_exr_outcome_init(ql_exr_outcome *outcome, ql_error *err)
{
    outcome->error = (ql_error){.status = QUELL_OK};
    atomic_init(&outcome->first_failed, UINT32_MAX);
    if (pthread_mutex_init(&outcome->lock, NULL) == 0) return QUELL_OK;
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a lock");
}

void ql_exr_outcome_fail(ql_exr_outcome *outcome, uint32_t task, const ql_error *error)
{
    pthread_mutex_lock(&outcome->lock);
    if (task < atomic_load(&outcome->first_failed)) {
        outcome->error = *error;
        atomic_store(&outcome->first_failed, task);
    }
    pthread_mutex_unlock(&outcome->lock);
}

int ql_exr_outcome_is_over(const ql_exr_outcome *outcome, uint32_t task)
{
    return task > atomic_load(&outcome->first_failed);
}

quell_status ql_exr_outcome_end(ql_exr_outcome *outcome, quell_status run_status, const char *what, const char *path,
                                ql_error *err)
{
    pthread_mutex_destroy(&outcome->lock);
    if (outcome->error.status != QUELL_OK) return ql_fail(err, outcome->error.status, "%s", outcome->error.text);
    if (run_status != QUELL_OK) return ql_fail(err, run_status, "%s: %s was cancelled", path, what);
    return QUELL_OK;
}

/* ---- Opening ----------------------------------------------------------------------------------------------------- */

static int64_t read_callback(exr_const_context_t context, void *user, void *buffer, uint64_t num_bytes, uint64_t offset,
                             exr_stream_error_func_ptr_t report)
{
    const ql_exr_source *source = user;
    const uint64_t file_bytes = ql_file_size(source->file);
    const char *reason = "";
    if (offset > file_bytes) offset = file_bytes;
    if (num_bytes > file_bytes - offset) num_bytes = file_bytes - offset; /* a short read: OpenEXR judges */
    if (ql_file_read(source->file, buffer, (size_t)num_bytes, offset, &reason) == 0) return (int64_t)num_bytes;
    (void)report(context, EXR_ERR_READ_IO, "%s", reason);
    return -1;
}

static int64_t size_callback(exr_const_context_t context, void *user)
{
    const ql_exr_source *source = user;
    (void)context;
    return (int64_t)ql_file_size(source->file);
}

size_t ql_exr_value_bytes(exr_pixel_type_t type)
{
    return type == EXR_PIXEL_HALF ? 2 : 4;
}

int32_t ql_exr_format(exr_pixel_type_t type)
{
    if (type == EXR_PIXEL_HALF) return QUELL_FORMAT_HALF;
    return type == EXR_PIXEL_UINT ? QUELL_FORMAT_UINT : QUELL_FORMAT_FLOAT;
}

const char *ql_exr_source_where(const ql_exr_source *source, uint32_t part, char *buffer, size_t buffer_bytes)
{
    const char *path = ql_file_path(source->file);
    if (source->num_parts < 2 || part >= source->num_parts) {
        snprintf(buffer, buffer_bytes, "%s", path);
    } else {
        snprintf(buffer, buffer_bytes, "%s, part %u '%s'", path, part, source->parts[part].name);
    }
    return buffer;
}

static quell_status check_magic(const ql_exr_source *source, ql_error *err)
{
    static const uint8_t magic[4] = {0x76, 0x2f, 0x31, 0x01};
    uint8_t found[4];
    const char *path = ql_file_path(source->file);
    const char *reason = "";
    if (ql_file_size(source->file) == 0) {
        return ql_fail(err, QUELL_ERR_NOT_EXR, "%s: is empty, so it is no OpenEXR file", path);
    }
    if (ql_file_size(source->file) < sizeof found) {
        return ql_fail(err, QUELL_ERR_NOT_EXR, "%s: is no OpenEXR file", path);
    }
    if (ql_file_read(source->file, found, sizeof found, 0, &reason) != 0) {
        return ql_fail(err, QUELL_ERR_FILE_READ, "%s: cannot be read: %s", path, reason);
    }
    if (memcmp(found, magic, sizeof magic) != 0) {
        return ql_fail(err, QUELL_ERR_NOT_EXR, "%s: is no OpenEXR file (other first bytes)", path);
    }
    return QUELL_OK;
}

/* Facts of a part that can be decoded line by line; checks sizes before anything is allocated for pixels. */
static quell_status describe_lines(const ql_exr_source *source, uint32_t index, ql_exr_part *part, ql_error *err)
{
    char where[1200];
    part->is_plain = part->storage == EXR_STORAGE_SCANLINE && part->lines_per_chunk > 0;
    for (int32_t c = 0; c < part->channels->num_channels; c++) {
        const exr_attr_chlist_entry_t *channel = &part->channels->entries[c];
        size_t bytes;
        if (channel->x_sampling != 1 || channel->y_sampling != 1) part->is_plain = 0;
        if (ql_mul_size(part->width, ql_exr_value_bytes(channel->pixel_type), &bytes) != 0 ||
            ql_add_size(part->line_bytes, bytes, &part->line_bytes) != 0) {
            return ql_fail(err, QUELL_ERR_LIMIT, "%s: a line is too long for this machine",
                           ql_exr_source_where(source, index, where, sizeof where));
        }
    }
    if (!part->is_plain) part->line_bytes = 0;
    return QUELL_OK;
}

static quell_status describe_part(ql_exr_source *source, uint32_t index, uint64_t max_image_pixels, ql_error *err)
{
    const int p = (int)index;
    exr_const_context_t context = source->context;
    ql_exr_part *part = &source->parts[index];
    uint64_t *offsets = NULL;
    int32_t length = 0, num_offsets = 0;
    char where[1200];

    part->name = part->view = "";
    if (exr_get_name(context, p, &part->name) != EXR_ERR_SUCCESS || !part->name) part->name = "";
    const exr_attribute_t *view = NULL;
    if (exr_get_attribute_by_name(context, p, "view", &view) == EXR_ERR_SUCCESS && view->type == EXR_ATTR_STRING) {
        if (exr_attr_get_string(context, p, "view", &length, &part->view) != EXR_ERR_SUCCESS) part->view = "";
    }
    ql_exr_messages_clear(&source->messages); /* OpenEXR complains when there is no such attribute */
    ql_exr_source_where(source, index, where, sizeof where);

    exr_result_t code = exr_get_storage(context, p, &part->storage);
    if (code == EXR_ERR_SUCCESS) code = exr_get_compression(context, p, &part->compression);
    if (code == EXR_ERR_SUCCESS) code = exr_get_lineorder(context, p, &part->line_order);
    if (code == EXR_ERR_SUCCESS) code = exr_get_data_window(context, p, &part->window);
    if (code == EXR_ERR_SUCCESS) code = exr_get_channels(context, p, &part->channels);
    if (code == EXR_ERR_SUCCESS) code = exr_get_chunk_count(context, p, &part->num_chunks);
    if (code == EXR_ERR_SUCCESS && part->storage == EXR_STORAGE_SCANLINE) {
        code = exr_get_scanlines_per_chunk(context, p, &part->lines_per_chunk);
    }
    if (code != EXR_ERR_SUCCESS) return ql_exr_fail(&source->messages, code, QUELL_ERR_FILE_READ, where, err);

    const int64_t width = (int64_t)part->window.max.x - part->window.min.x + 1;
    const int64_t height = (int64_t)part->window.max.y - part->window.min.y + 1;
    if (width < 1 || height < 1 || part->channels->num_channels < 1) {
        return ql_fail(err, QUELL_ERR_FILE_READ, "%s: has no pixels", where);
    }
    if (width > INT32_MAX || height > INT32_MAX || (uint64_t)width * (uint64_t)height > max_image_pixels) {
        return ql_fail(err, QUELL_ERR_LIMIT, "%s: %lld x %lld pixels are more than the limit of %llu", where,
                       (long long)width, (long long)height, (unsigned long long)max_image_pixels);
    }
    part->width = (uint32_t)width;
    part->height = (uint32_t)height;
    QL_TRY(describe_lines(source, index, part, err));

    /* Read here, before threads ask for it, so that a file cut in its table fails at once. */
    code = exr_get_chunk_table(context, p, &offsets, &num_offsets);
    if (code != EXR_ERR_SUCCESS) return ql_exr_fail(&source->messages, code, QUELL_ERR_FILE_READ, where, err);
    return QUELL_OK;
}

static quell_status start_reading(ql_exr_source *source, ql_error *err)
{
    exr_context_initializer_t start = EXR_DEFAULT_CONTEXT_INITIALIZER;
    start.error_handler_fn = ql_exr_error_handler;
    start.user_data = source;
    start.read_fn = read_callback;
    start.size_fn = size_callback;
    /* A table of chunks with holes means that the writer died: that is an error to tell, not one to guess around. */
    start.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    const char *path = ql_file_path(source->file);
    uint32_t version = 0;
    int count = 0;

    exr_result_t code = exr_start_read(&source->context, path, &start);
    if (code == EXR_ERR_SUCCESS) code = exr_get_count(source->context, &count);
    if (code == EXR_ERR_SUCCESS) code = exr_get_file_version_and_flags(source->context, &version);
    if (code != EXR_ERR_SUCCESS) return ql_exr_fail(&source->messages, code, QUELL_ERR_FILE_READ, path, err);
    if (count < 1) return ql_fail(err, QUELL_ERR_FILE_READ, "%s: has no parts", path);
    source->is_multi_part = (version & 0x1000u) != 0;

    source->parts = ql_alloc_zero(source->memory, (size_t)count, sizeof *source->parts);
    if (!source->parts) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory for %d parts", path, count);
    source->num_parts = (uint32_t)count;
    return QUELL_OK;
}

quell_status ql_exr_source_open(ql_memory *memory, const char *path, uint64_t max_image_pixels, ql_exr_source **out,
                                ql_error *err)
{
    *out = NULL;
    ql_exr_source *source = ql_alloc_zero(memory, 1, sizeof *source);
    if (!source) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to open it", path);
    source->memory = memory;
    quell_status status = ql_exr_messages_init(&source->messages, err);
    if (status != QUELL_OK) {
        ql_free(memory, source);
        return status;
    }
    QL_TRY_GOTO(ql_file_open(memory, path, &source->file, err));
    QL_TRY_GOTO(check_magic(source, err));
    QL_TRY_GOTO(start_reading(source, err));
    for (uint32_t p = 0; p < source->num_parts; p++) QL_TRY_GOTO(describe_part(source, p, max_image_pixels, err));
    *out = source;
    return QUELL_OK;

fail:
    ql_exr_source_destroy(source);
    return status;
}

void ql_exr_source_destroy(ql_exr_source *source)
{
    if (!source) return;
    if (source->context) exr_finish(&source->context);
    ql_file_close(source->file);
    ql_exr_messages_destroy(&source->messages);
    ql_free(source->memory, source->parts);
    ql_free(source->memory, source);
}
