/* SPDX-License-Identifier: Apache-2.0 */
/* Linux, macOS and other POSIX systems. */
#if !defined(_GNU_SOURCE)
#define _GNU_SOURCE /* sched_getaffinity */
#endif
#define _DARWIN_C_SOURCE /* macOS hides _SC_NPROCESSORS_ONLN from strict POSIX */
#include "base/os.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#if defined(__linux__)
#include <sched.h>
#include <sys/mman.h>
#endif

enum { LARGE_PAGE_BYTES = 1 << 21 };

/* ---- Files ------------------------------------------------------------------------------------------------------- */

int ql_os_open(const char *path, ql_os_file *out)
{
    /* Not blocking: the open of a pipe would wait for its writer. It means nothing to a regular file. */
    const int descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    *out = descriptor;
    return descriptor < 0 ? errno : 0;
}

int ql_os_create(const char *path, ql_os_file *out)
{
    const int descriptor = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    *out = descriptor;
    return descriptor < 0 ? errno : 0;
}

int ql_os_read(ql_os_file file, void *buffer, size_t num_bytes, uint64_t offset, size_t *num_read)
{
    ssize_t got;
    do {
        got = pread((int)file, buffer, num_bytes, (off_t)offset);
    } while (got < 0 && errno == EINTR);
    *num_read = got < 0 ? 0 : (size_t)got;
    return got < 0 ? errno : 0;
}

int ql_os_write(ql_os_file file, const void *data, size_t num_bytes, uint64_t offset, size_t *num_written)
{
    ssize_t put;
    do {
        put = pwrite((int)file, data, num_bytes, (off_t)offset);
    } while (put < 0 && errno == EINTR);
    *num_written = put < 0 ? 0 : (size_t)put;
    return put < 0 ? errno : 0;
}

int ql_os_sync(ql_os_file file)
{
    return fsync((int)file) != 0 ? errno : 0;
}

int ql_os_close(ql_os_file file)
{
    return close((int)file) != 0 ? errno : 0;
}

static void fill_facts(const struct stat *from, ql_os_facts *facts)
{
    facts->kind = S_ISREG(from->st_mode) ? QL_OS_REGULAR : S_ISDIR(from->st_mode) ? QL_OS_FOLDER : QL_OS_DEVICE;
    facts->size_bytes = (uint64_t)from->st_size;
    facts->permissions = from->st_mode & 07777u;
}

int ql_os_file_facts(ql_os_file file, ql_os_facts *facts)
{
    struct stat found;
    if (fstat((int)file, &found) != 0) return errno;
    fill_facts(&found, facts);
    return 0;
}

int ql_os_path_facts(const char *path, ql_os_facts *facts)
{
    struct stat found;
    if (stat(path, &found) != 0) return errno;
    fill_facts(&found, facts);
    return 0;
}

int ql_os_check_writable(const char *path)
{
    return access(path, W_OK) != 0 ? errno : 0;
}

void ql_os_set_permissions(ql_os_file file, uint32_t permissions)
{
    if (fchmod((int)file, (mode_t)permissions) != 0) errno = 0;
}

/* The rename itself must survive a crash. Some file systems cannot sync folders: the file is complete all the same. */
static void sync_folder(const char *path)
{
    char folder[4096];
    const size_t length = ql_os_folder_length(path);
    if (length >= sizeof folder) return;
    memcpy(folder, path, length);
    folder[length] = '\0';
    const int descriptor = open(length ? folder : ".", O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return;
    fsync(descriptor);
    close(descriptor);
}

int ql_os_replace(const char *from, const char *to)
{
    if (rename(from, to) != 0) return errno;
    sync_folder(to);
    return 0;
}

void ql_os_remove(const char *path)
{
    unlink(path);
}

char *ql_os_resolve_link(const char *path)
{
    struct stat found;
    return lstat(path, &found) == 0 && S_ISLNK(found.st_mode) ? realpath(path, NULL) : NULL;
}

size_t ql_os_folder_length(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? (size_t)(slash - path) + 1 : 0;
}

FILE *ql_os_fopen(const char *path, const char *mode)
{
    return fopen(path, mode);
}

const char *ql_os_reason(int error)
{
    return error == ENOSPC ? "the disk is full" : strerror(error);
}

/* ---- The rest ---------------------------------------------------------------------------------------------------- */

unsigned long ql_os_process_id(void)
{
    return (unsigned long)getpid();
}

uint32_t ql_os_num_cores(void)
{
#if defined(__linux__)
    cpu_set_t set;
    CPU_ZERO(&set);
    if (sched_getaffinity(0, sizeof set, &set) == 0) {
        const int num = CPU_COUNT(&set);
        if (num > 0) return (uint32_t)num;
    }
    /* The mask is too small for machines of over 1024 processors. */
#endif
    const long online = sysconf(_SC_NPROCESSORS_ONLN);
    return online > 0 ? (uint32_t)online : 1;
}

/* Asks for large pages under a large block: each fault then clears 2 MiB instead of 4 KiB. A hint, so errors are none. */
static void want_large_pages(void *block, size_t num_bytes)
{
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    const uintptr_t page = LARGE_PAGE_BYTES, begin = ((uintptr_t)block + page - 1) & ~(page - 1);
    const uintptr_t end = ((uintptr_t)block + num_bytes) & ~(page - 1);
    if (begin < end) {
        const int before = errno;
        madvise((void *)begin, end - begin, MADV_HUGEPAGE);
        errno = before;
    }
#else
    (void)block;
    (void)num_bytes;
#endif
}

void *ql_os_alloc_aligned(size_t alignment, size_t num_bytes)
{
    void *const block = aligned_alloc(alignment, num_bytes);
    if (block) want_large_pages(block, num_bytes);
    return block;
}

void ql_os_free_aligned(void *pointer)
{
    free(pointer);
}

int ql_os_start_thread(pthread_t *thread, void *(*run)(void *), void *argument)
{
    sigset_t all, before;
    sigfillset(&all);
    int error = pthread_sigmask(SIG_SETMASK, &all, &before); /* the new thread inherits it */
    if (error) return error;
    error = pthread_create(thread, NULL, run, argument);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return error;
}

void ql_os_set_default_fp_mode(fenv_t *before)
{
    fegetenv(before);
    fesetenv(FE_DFL_ENV);
}
