/* SPDX-License-Identifier: Apache-2.0 */
/* An output is written under a temporary name in the target's folder, synced and renamed, so that a crash leaves either
 * the old file or the new one. Knows nothing of EXR. */
#include "exr/file.h"

#include "base/os.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_TEMPORARY_NAMES 1000

struct ql_file {
    ql_memory *memory;
    ql_os_file handle;
    uint64_t size_bytes;
    char *path;      /* as the caller wrote it, for messages */
    char *target;    /* outputs: where it goes, symbolic links followed */
    char *temporary; /* outputs: the name until then */
};

static void free_file(ql_file *file)
{
    ql_memory *memory = file->memory;
    ql_free(memory, file->path);
    ql_free(memory, file->target);
    ql_free(memory, file->temporary);
    ql_free(memory, file);
}

static ql_file *new_file(ql_memory *memory, const char *path)
{
    ql_file *file = ql_alloc_zero(memory, 1, sizeof *file);
    if (!file) return NULL;
    file->memory = memory;
    file->handle = QL_OS_NO_FILE;
    file->path = ql_strdup(memory, path);
    if (file->path) return file;
    free_file(file);
    return NULL;
}

static const char *name_of_kind(int kind)
{
    return kind == QL_OS_FOLDER ? "a folder" : "a device or pipe";
}

uint64_t ql_file_size(const ql_file *file)
{
    return file->size_bytes;
}

const char *ql_file_path(const ql_file *file)
{
    return file->path;
}

/* ---- Reading ----------------------------------------------------------------------------------------------------- */

quell_status ql_file_open(ql_memory *memory, const char *path, ql_file **out, ql_error *err)
{
    ql_os_file handle;
    ql_os_facts facts = {.kind = QL_OS_DEVICE};
    *out = NULL;
    const int error = ql_os_open(path, &handle);
    if (error) {
        const quell_status status =
            error == ENOENT || error == ENOTDIR ? QUELL_ERR_FILE_NOT_FOUND : QUELL_ERR_FILE_READ;
        return ql_fail(err, status, "%s: cannot be opened: %s", path, ql_os_reason(error));
    }
    if (ql_os_file_facts(handle, &facts) != 0 || facts.kind != QL_OS_REGULAR) {
        ql_os_close(handle);
        return ql_fail(err, QUELL_ERR_FILE_READ, "%s: is %s, not a file", path, name_of_kind(facts.kind));
    }
    ql_file *file = new_file(memory, path);
    if (!file) {
        ql_os_close(handle);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to open it", path);
    }
    file->handle = handle;
    file->size_bytes = facts.size_bytes;
    *out = file;
    return QUELL_OK;
}

void ql_file_close(ql_file *file)
{
    if (!file) return;
    if (file->handle != QL_OS_NO_FILE) ql_os_close(file->handle);
    free_file(file);
}

int ql_file_read(const ql_file *file, void *buffer, size_t num_bytes, uint64_t offset, const char **reason)
{
    uint8_t *to = buffer;
    if (offset > file->size_bytes || num_bytes > file->size_bytes - offset) {
        *reason = "the file ends too early";
        return -1;
    }
    while (num_bytes > 0) {
        size_t got;
        const int error = ql_os_read(file->handle, to, num_bytes, offset, &got);
        if (error || got == 0) {
            *reason = error ? ql_os_reason(error) : "the file ends too early";
            return -1;
        }
        to += got;
        num_bytes -= got;
        offset += got;
    }
    return 0;
}

/* ---- Writing ----------------------------------------------------------------------------------------------------- */

/* The file that `path` will name: itself, or what a symbolic link leads to, so that the link stays. */
static char *resolve_target(ql_memory *memory, const char *path)
{
    char *resolved = ql_os_resolve_link(path);
    char *copy = ql_strdup(memory, resolved ? resolved : path);
    free(resolved);
    return copy;
}

static quell_status check_target(const ql_file *file, uint32_t *permissions, ql_error *err)
{
    ql_os_facts facts;
    *permissions = 0;
    if (!file->target[ql_os_folder_length(file->target)]) {
        return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: is a folder, not a file name", file->path);
    }
    if (ql_os_path_facts(file->target, &facts) != 0) return QUELL_OK;
    if (facts.kind != QL_OS_REGULAR) {
        return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: is %s and cannot be replaced by a file", file->path,
                       name_of_kind(facts.kind));
    }
    const int error = ql_os_check_writable(file->target);
    if (error) {
        return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: exists and may not be written: %s", file->path,
                       ql_os_reason(error));
    }
    *permissions = facts.permissions;
    return QUELL_OK;
}

static quell_status open_temporary(ql_file *file, ql_error *err)
{
    const size_t folder = ql_os_folder_length(file->target);
    int error = EEXIST;
    const size_t capacity = folder + 64;
    file->temporary = ql_alloc(file->memory, capacity, 1);
    if (!file->temporary) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", file->path);

    for (unsigned i = 0; i < MAX_TEMPORARY_NAMES && error == EEXIST; i++) {
        memcpy(file->temporary, file->target, folder);
        snprintf(file->temporary + folder, capacity - folder, ".quell-%lu-%u.tmp", ql_os_process_id(), i);
        error = ql_os_create(file->temporary, &file->handle);
    }
    if (!error) return QUELL_OK;
    if (error == ENOENT || error == ENOTDIR) {
        return ql_fail(err, QUELL_ERR_FILE_NOT_FOUND, "%s: the folder to write it into is missing", file->path);
    }
    return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: cannot be written: %s", file->path, ql_os_reason(error));
}

quell_status ql_file_create(ql_memory *memory, const char *path, ql_file **out, ql_error *err)
{
    uint32_t permissions = 0;
    *out = NULL;
    ql_file *file = new_file(memory, path);
    if (file) file->target = resolve_target(memory, path);
    if (!file || !file->target) {
        if (file) free_file(file);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", path);
    }
    quell_status status = check_target(file, &permissions, err);
    if (status == QUELL_OK) status = open_temporary(file, err);
    if (status != QUELL_OK) {
        free_file(file);
        return status;
    }
    /* A file that is replaced keeps its permissions. Not being allowed to is no reason to fail. */
    if (permissions) ql_os_set_permissions(file->handle, permissions);
    *out = file;
    return QUELL_OK;
}

quell_status ql_file_write(ql_file *file, const void *data, size_t num_bytes, uint64_t offset, ql_error *err)
{
    const uint8_t *from = data;
    while (num_bytes > 0) {
        size_t put;
        const int error = ql_os_write(file->handle, from, num_bytes, offset, &put);
        if (error || put == 0) {
            return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: cannot be written: %s", file->path,
                           ql_os_reason(error ? error : ENOSPC));
        }
        from += put;
        num_bytes -= put;
        offset += put;
        if (offset > file->size_bytes) file->size_bytes = offset;
    }
    return QUELL_OK;
}

void ql_file_discard(ql_file *file)
{
    if (!file) return;
    if (file->handle != QL_OS_NO_FILE) ql_os_close(file->handle);
    if (file->temporary) ql_os_remove(file->temporary);
    free_file(file);
}

quell_status ql_file_commit(ql_file *file, ql_error *err)
{
    int error = ql_os_sync(file->handle);
    const int close_error = ql_os_close(file->handle); /* quota and network errors show here */
    if (!error) error = close_error;
    file->handle = QL_OS_NO_FILE;
    if (!error) error = ql_os_replace(file->temporary, file->target);
    if (error) {
        const quell_status status =
            ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: cannot be written: %s", file->path, ql_os_reason(error));
        ql_file_discard(file);
        return status;
    }
    free_file(file);
    return QUELL_OK;
}
