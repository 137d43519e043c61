/* SPDX-License-Identifier: Apache-2.0 */
/* POSIX files. An output is written under a temporary name in the target's folder, synced, renamed, and the folder
 * synced, so that a crash leaves either the old file or the new one. Knows nothing of EXR. */
#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif
#ifndef _XOPEN_SOURCE
#define _XOPEN_SOURCE 700 /* realpath */
#endif
#include "exr/file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define MAX_TEMPORARY_NAMES 1000

struct ql_file {
    ql_memory *memory;
    int descriptor;
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
    file->descriptor = -1;
    file->path = ql_strdup(memory, path);
    if (file->path) return file;
    free_file(file);
    return NULL;
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
    *out = NULL;
    /* Not blocking: the open of a pipe would wait for its writer. It means nothing to a regular file. */
    const int descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0) {
        const quell_status status =
            errno == ENOENT || errno == ENOTDIR ? QUELL_ERR_FILE_NOT_FOUND : QUELL_ERR_FILE_READ;
        return ql_fail(err, status, "%s: cannot be opened: %s", path, strerror(errno));
    }
    struct stat facts;
    if (fstat(descriptor, &facts) != 0 || !S_ISREG(facts.st_mode)) {
        close(descriptor);
        return ql_fail(err, QUELL_ERR_FILE_READ, "%s: is %s, not a file", path,
                       S_ISDIR(facts.st_mode) ? "a folder" : "a device or pipe");
    }
    ql_file *file = new_file(memory, path);
    if (!file) {
        close(descriptor);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to open it", path);
    }
    file->descriptor = descriptor;
    file->size_bytes = (uint64_t)facts.st_size;
    *out = file;
    return QUELL_OK;
}

void ql_file_close(ql_file *file)
{
    if (!file) return;
    if (file->descriptor >= 0) close(file->descriptor);
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
        const ssize_t got = pread(file->descriptor, to, num_bytes, (off_t)offset);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) {
            *reason = got < 0 ? strerror(errno) : "the file ends too early";
            return -1;
        }
        to += got;
        num_bytes -= (size_t)got;
        offset += (uint64_t)got;
    }
    return 0;
}

/* ---- Writing ----------------------------------------------------------------------------------------------------- */

static const char *reason_of(int error)
{
    return error == ENOSPC ? "the disk is full" : strerror(error);
}

/* The file that `path` will name: itself, or what a symbolic link leads to, so that the link stays. */
static char *resolve_target(ql_memory *memory, const char *path)
{
    struct stat facts;
    if (lstat(path, &facts) == 0 && S_ISLNK(facts.st_mode)) {
        char *resolved = realpath(path, NULL);
        if (resolved) {
            char *copy = ql_strdup(memory, resolved);
            free(resolved);
            return copy;
        }
    }
    return ql_strdup(memory, path);
}

/* Length of the folder part with its slash, 0 for a bare name. */
static size_t folder_length(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? (size_t)(slash - path) + 1 : 0;
}

static quell_status check_target(const ql_file *file, mode_t *mode, ql_error *err)
{
    struct stat facts;
    *mode = 0;
    if (!file->target[folder_length(file->target)]) {
        return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: is a folder, not a file name", file->path);
    }
    if (stat(file->target, &facts) != 0) return QUELL_OK;
    if (!S_ISREG(facts.st_mode)) {
        return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: is %s and cannot be replaced by a file", file->path,
                       S_ISDIR(facts.st_mode) ? "a folder" : "a device or pipe");
    }
    if (access(file->target, W_OK) != 0) {
        return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: exists and may not be written: %s", file->path, strerror(errno));
    }
    *mode = facts.st_mode & 07777;
    return QUELL_OK;
}

static quell_status open_temporary(ql_file *file, ql_error *err)
{
    const size_t folder = folder_length(file->target);
    const size_t capacity = folder + 64;
    file->temporary = ql_alloc(file->memory, capacity, 1);
    if (!file->temporary) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", file->path);

    for (unsigned i = 0; i < MAX_TEMPORARY_NAMES; i++) {
        memcpy(file->temporary, file->target, folder);
        snprintf(file->temporary + folder, capacity - folder, ".quell-%ld-%u.tmp", (long)getpid(), i);
        file->descriptor = open(file->temporary, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (file->descriptor >= 0) return QUELL_OK;
        if (errno != EEXIST) break;
    }
    if (errno == ENOENT || errno == ENOTDIR) {
        return ql_fail(err, QUELL_ERR_FILE_NOT_FOUND, "%s: the folder to write it into is missing", file->path);
    }
    return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: cannot be written: %s", file->path, reason_of(errno));
}

quell_status ql_file_create(ql_memory *memory, const char *path, ql_file **out, ql_error *err)
{
    mode_t mode = 0;
    *out = NULL;
    ql_file *file = new_file(memory, path);
    if (file) file->target = resolve_target(memory, path);
    if (!file || !file->target) {
        if (file) free_file(file);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", path);
    }
    quell_status status = check_target(file, &mode, err);
    if (status == QUELL_OK) status = open_temporary(file, err);
    if (status != QUELL_OK) {
        free_file(file);
        return status;
    }
    /* A file that is replaced keeps its permissions. Not being allowed to is no reason to fail. */
    if (mode && fchmod(file->descriptor, mode) != 0) errno = 0;
    *out = file;
    return QUELL_OK;
}

quell_status ql_file_write(ql_file *file, const void *data, size_t num_bytes, uint64_t offset, ql_error *err)
{
    const uint8_t *from = data;
    while (num_bytes > 0) {
        const ssize_t put = pwrite(file->descriptor, from, num_bytes, (off_t)offset);
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) {
            return ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: cannot be written: %s", file->path,
                           reason_of(put == 0 ? ENOSPC : errno));
        }
        from += put;
        num_bytes -= (size_t)put;
        offset += (uint64_t)put;
        if (offset > file->size_bytes) file->size_bytes = offset;
    }
    return QUELL_OK;
}

void ql_file_discard(ql_file *file)
{
    if (!file) return;
    if (file->descriptor >= 0) close(file->descriptor);
    if (file->temporary) unlink(file->temporary);
    free_file(file);
}

/* The rename itself must survive a crash. Some file systems cannot sync folders: the file is complete all the same. */
static void sync_folder(const char *target)
{
    char folder[4096];
    const size_t length = folder_length(target);
    if (length >= sizeof folder) return;
    memcpy(folder, target, length);
    folder[length] = '\0';
    const int descriptor = open(length ? folder : ".", O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return;
    fsync(descriptor);
    close(descriptor);
}

quell_status ql_file_commit(ql_file *file, ql_error *err)
{
    int error = fsync(file->descriptor) != 0 ? errno : 0;
    if (close(file->descriptor) != 0 && !error) error = errno; /* quota and network errors show here */
    file->descriptor = -1;
    if (!error && rename(file->temporary, file->target) != 0) error = errno;
    if (error) {
        const quell_status status =
            ql_fail(err, QUELL_ERR_FILE_WRITE, "%s: cannot be written: %s", file->path, reason_of(error));
        ql_file_discard(file);
        return status;
    }
    sync_folder(file->target);
    free_file(file);
    return QUELL_OK;
}
