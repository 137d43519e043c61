/* SPDX-License-Identifier: Apache-2.0 */
/* Windows 7 and later, by the wide-character API, so that every file name works whatever the code page. */
#include "base/os.h"

#include <errno.h>
#include <malloc.h>
#include <stdlib.h>
#include <string.h>
#include <wchar.h>
#include <windows.h>

/* A single transfer's length is a DWORD. */
#define MAX_TRANSFER ((size_t)1 << 30)

/* Names from here on need the prefix that lifts Windows' limit (MAX_PATH less room for a suffix). */
#define MAX_PLAIN_NAME 248

static int errno_of(DWORD error)
{
    switch (error) {
    case ERROR_FILE_NOT_FOUND:
    case ERROR_PATH_NOT_FOUND:
    case ERROR_INVALID_NAME:
    case ERROR_INVALID_DRIVE:
    case ERROR_BAD_NETPATH:
    case ERROR_BAD_NET_NAME: return ENOENT;
    case ERROR_DIRECTORY: return ENOTDIR;
    case ERROR_ACCESS_DENIED:
    case ERROR_WRITE_PROTECT: return EACCES;
    case ERROR_SHARING_VIOLATION:
    case ERROR_LOCK_VIOLATION:
    case ERROR_USER_MAPPED_FILE: return EBUSY;
    case ERROR_FILE_EXISTS:
    case ERROR_ALREADY_EXISTS: return EEXIST;
    case ERROR_DISK_FULL:
    case ERROR_HANDLE_DISK_FULL: return ENOSPC;
    case ERROR_TOO_MANY_OPEN_FILES: return EMFILE;
    case ERROR_FILENAME_EXCED_RANGE: return ENAMETOOLONG;
    case ERROR_NOT_ENOUGH_MEMORY:
    case ERROR_OUTOFMEMORY: return ENOMEM;
    default: return EIO;
    }
}

static int last_errno(void)
{
    return errno_of(GetLastError());
}

/* ---- Names ------------------------------------------------------------------------------------------------------- */

/* All below free with free(), and return NULL with errno set. */

static wchar_t *wide_of(const char *text)
{
    const int length = MultiByteToWideChar(CP_UTF8, MB_ERR_INVALID_CHARS, text, -1, NULL, 0);
    if (length <= 0) {
        errno = EILSEQ;
        return NULL;
    }
    wchar_t *wide = malloc((size_t)length * sizeof *wide);
    if (wide) MultiByteToWideChar(CP_UTF8, MB_ERR_INVALID_CHARS, text, -1, wide, length);
    return wide;
}

static char *utf8_of(const wchar_t *wide)
{
    const int length = WideCharToMultiByte(CP_UTF8, 0, wide, -1, NULL, 0, NULL, NULL);
    char *text = length > 0 ? malloc((size_t)length) : NULL;
    if (text) WideCharToMultiByte(CP_UTF8, 0, wide, -1, text, length, NULL, NULL);
    return text;
}

/* With the prefix a name must be absolute and have backslashes, which GetFullPathNameW sees to. */
static wchar_t *long_name(const wchar_t *wide)
{
    static const wchar_t local[] = L"\\\\?\\", network[] = L"\\\\?\\UNC";
    const size_t room = sizeof network / sizeof *network;
    const DWORD capacity = GetFullPathNameW(wide, 0, NULL, NULL);
    wchar_t *full = malloc((capacity + room) * sizeof *full);
    if (!full) return NULL;
    const DWORD length = GetFullPathNameW(wide, capacity, full, NULL);
    if (length == 0 || length >= capacity) {
        free(full);
        errno = ENOENT;
        return NULL;
    }
    if (wcsncmp(full, L"\\\\?\\", 4) == 0 || wcsncmp(full, L"\\\\.\\", 4) == 0) return full;
    const int is_network = full[0] == L'\\' && full[1] == L'\\'; /* \\server\share becomes \\?\UNC\server\share */
    const wchar_t *prefix = is_network ? network : local;
    const size_t prefix_length = wcslen(prefix), skipped = is_network ? 1 : 0;
    memmove(full + prefix_length, full + skipped, (length + 1 - skipped) * sizeof *full);
    memcpy(full, prefix, prefix_length * sizeof *full);
    return full;
}

static wchar_t *name_of(const char *path)
{
    wchar_t *wide = wide_of(path);
    if (!wide || wcslen(wide) < MAX_PLAIN_NAME) return wide;
    wchar_t *longer = long_name(wide);
    free(wide);
    return longer;
}

size_t ql_os_folder_length(const char *path)
{
    size_t length = 0;
    for (size_t i = 0; path[i]; i++) {
        if (path[i] == '/' || path[i] == '\\' || (path[i] == ':' && i == 1)) length = i + 1;
    }
    return length;
}

/* ---- Files ------------------------------------------------------------------------------------------------------- */

static HANDLE handle_of(ql_os_file file)
{
    return (HANDLE)file;
}

/* Backup semantics are what opens a folder. */
static int open_by_name(const char *path, DWORD access, DWORD disposition, HANDLE *out)
{
    *out = INVALID_HANDLE_VALUE;
    wchar_t *name = name_of(path);
    if (!name) return errno;
    const DWORD share = FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE;
    *out = CreateFileW(name, access, share, NULL, disposition, FILE_FLAG_BACKUP_SEMANTICS, NULL);
    const int error = *out == INVALID_HANDLE_VALUE ? last_errno() : 0;
    free(name);
    return error;
}

int ql_os_open(const char *path, ql_os_file *out)
{
    HANDLE handle;
    const int error = open_by_name(path, GENERIC_READ, OPEN_EXISTING, &handle);
    *out = (ql_os_file)handle;
    return error;
}

int ql_os_create(const char *path, ql_os_file *out)
{
    HANDLE handle;
    const int error = open_by_name(path, GENERIC_READ | GENERIC_WRITE, CREATE_NEW, &handle);
    *out = (ql_os_file)handle;
    return error;
}

static OVERLAPPED position(uint64_t offset)
{
    OVERLAPPED at = {0};
    at.Offset = (DWORD)(offset & UINT32_MAX);
    at.OffsetHigh = (DWORD)(offset >> 32);
    return at;
}

int ql_os_read(ql_os_file file, void *buffer, size_t num_bytes, uint64_t offset, size_t *num_read)
{
    OVERLAPPED at = position(offset);
    DWORD got = 0;
    const DWORD wanted = (DWORD)(num_bytes < MAX_TRANSFER ? num_bytes : MAX_TRANSFER);
    const BOOL is_good = ReadFile(handle_of(file), buffer, wanted, &got, &at);
    *num_read = is_good ? got : 0;
    return is_good || GetLastError() == ERROR_HANDLE_EOF ? 0 : last_errno();
}

int ql_os_write(ql_os_file file, const void *data, size_t num_bytes, uint64_t offset, size_t *num_written)
{
    OVERLAPPED at = position(offset);
    DWORD put = 0;
    const DWORD wanted = (DWORD)(num_bytes < MAX_TRANSFER ? num_bytes : MAX_TRANSFER);
    const BOOL is_good = WriteFile(handle_of(file), data, wanted, &put, &at);
    *num_written = is_good ? put : 0;
    return is_good ? 0 : last_errno();
}

int ql_os_sync(ql_os_file file)
{
    return FlushFileBuffers(handle_of(file)) ? 0 : last_errno();
}

int ql_os_close(ql_os_file file)
{
    return CloseHandle(handle_of(file)) ? 0 : last_errno();
}

int ql_os_file_facts(ql_os_file file, ql_os_facts *facts)
{
    *facts = (ql_os_facts){.kind = QL_OS_DEVICE};
    if (GetFileType(handle_of(file)) != FILE_TYPE_DISK) return 0;
    BY_HANDLE_FILE_INFORMATION found;
    if (!GetFileInformationByHandle(handle_of(file), &found)) return last_errno();
    facts->kind = found.dwFileAttributes & FILE_ATTRIBUTE_DIRECTORY ? QL_OS_FOLDER : QL_OS_REGULAR;
    facts->size_bytes = (uint64_t)found.nFileSizeHigh << 32 | found.nFileSizeLow;
    return 0;
}

int ql_os_path_facts(const char *path, ql_os_facts *facts)
{
    HANDLE handle;
    int error = open_by_name(path, FILE_READ_ATTRIBUTES, OPEN_EXISTING, &handle);
    if (error) return error;
    error = ql_os_file_facts((ql_os_file)handle, facts);
    CloseHandle(handle);
    return error;
}

/* Access control lists are left to the replacing itself: they cannot be asked in short. */
int ql_os_check_writable(const char *path)
{
    wchar_t *name = name_of(path);
    if (!name) return errno;
    const DWORD attributes = GetFileAttributesW(name);
    free(name);
    if (attributes == INVALID_FILE_ATTRIBUTES) return last_errno();
    return attributes & FILE_ATTRIBUTE_READONLY ? EACCES : 0;
}

void ql_os_set_permissions(ql_os_file file, uint32_t permissions)
{
    (void)file;
    (void)permissions;
}

/* A file that somebody reads, maybe this very process, cannot be moved onto. But it may be moved away, and go when the
 * last reader closes it. Between the two moves the name is free for a moment: Windows has nothing better before 10. */
static int exchange(const wchar_t *from, const wchar_t *to)
{
    static const wchar_t suffix[] = L".quell-old";
    const size_t length = wcslen(to);
    wchar_t *old = malloc((length + sizeof suffix / sizeof *suffix) * sizeof *old);
    if (!old) return ENOMEM;
    memcpy(old, to, length * sizeof *old);
    memcpy(old + length, suffix, sizeof suffix);

    int error = MoveFileExW(to, old, MOVEFILE_REPLACE_EXISTING) ? 0 : last_errno();
    if (!error) {
        if (!MoveFileExW(from, to, MOVEFILE_WRITE_THROUGH)) error = last_errno();
        if (error) {
            MoveFileExW(old, to, 0);
        } else {
            DeleteFileW(old);
        }
    }
    free(old);
    return error;
}

int ql_os_replace(const char *from, const char *to)
{
    wchar_t *old_name = name_of(from);
    wchar_t *new_name = old_name ? name_of(to) : NULL;
    int error = new_name ? 0 : errno;
    if (!error && !MoveFileExW(old_name, new_name, MOVEFILE_REPLACE_EXISTING | MOVEFILE_WRITE_THROUGH)) {
        error = last_errno();
        if (error == EACCES || error == EBUSY) error = exchange(old_name, new_name);
    }
    free(old_name);
    free(new_name);
    return error;
}

void ql_os_remove(const char *path)
{
    wchar_t *name = name_of(path);
    if (name) DeleteFileW(name);
    free(name);
}

char *ql_os_resolve_link(const char *path)
{
    wchar_t *name = name_of(path);
    const DWORD attributes = name ? GetFileAttributesW(name) : INVALID_FILE_ATTRIBUTES;
    free(name);
    if (attributes == INVALID_FILE_ATTRIBUTES || !(attributes & FILE_ATTRIBUTE_REPARSE_POINT)) return NULL;

    HANDLE handle;
    if (open_by_name(path, FILE_READ_ATTRIBUTES, OPEN_EXISTING, &handle) != 0) return NULL;
    char *resolved = NULL;
    const DWORD capacity = GetFinalPathNameByHandleW(handle, NULL, 0, FILE_NAME_NORMALIZED);
    wchar_t *wide = malloc((capacity + 1) * sizeof *wide);
    const DWORD length = wide ? GetFinalPathNameByHandleW(handle, wide, capacity + 1, FILE_NAME_NORMALIZED) : 0;
    if (length > 0 && length <= capacity) resolved = utf8_of(wide);
    free(wide);
    CloseHandle(handle);
    return resolved;
}

FILE *ql_os_fopen(const char *path, const char *mode)
{
    wchar_t *name = name_of(path), *wide_mode = wide_of(mode);
    FILE *file = name && wide_mode ? _wfopen(name, wide_mode) : NULL;
    const int error = errno;
    free(name);
    free(wide_mode);
    errno = error;
    return file;
}

const char *ql_os_reason(int error)
{
    switch (error) {
    case ENOSPC: return "the disk is full";
    case EBUSY: return "another program is using it";
    default: return strerror(error);
    }
}

/* ---- The rest ---------------------------------------------------------------------------------------------------- */

unsigned long ql_os_process_id(void)
{
    return GetCurrentProcessId();
}

uint32_t ql_os_num_cores(void)
{
    DWORD_PTR mine = 0, all = 0;
    if (!GetProcessAffinityMask(GetCurrentProcess(), &mine, &all)) mine = 0;
    uint32_t num = 0;
    for (; mine; mine &= mine - 1) num++;
    return num > 0 ? num : 1;
}

void *ql_os_alloc_aligned(size_t alignment, size_t num_bytes)
{
    return _aligned_malloc(num_bytes, alignment);
}

void ql_os_free_aligned(void *pointer)
{
    _aligned_free(pointer);
}

int ql_os_start_thread(pthread_t *thread, void *(*run)(void *), void *argument)
{
    return pthread_create(thread, NULL, run, argument);
}

void ql_os_set_default_fp_mode(fenv_t *before)
{
    const unsigned int power_up = 0x1f80; /* Intel SDM volume 1, 10.2.3 */
    fegetenv(before);
    fesetenv(FE_DFL_ENV); /* mingw-w64's leaves the vector unit's mode alone */
    __builtin_ia32_ldmxcsr(power_up);
}
