/* SPDX-License-Identifier: Apache-2.0 */
/* What operating systems do differently. os_posix.c and os_windows.c are the library's only files that call one beyond
 * ISO C and POSIX threads, which mingw-w64 brings to Windows. Paths are UTF-8 on Windows and plain bytes elsewhere.
 *
 * A function that can fail returns 0 or an errno value. */
#ifndef QL_BASE_OS_H
#define QL_BASE_OS_H

#include <fenv.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* ---- Files ------------------------------------------------------------------------------------------------------- */

typedef intptr_t ql_os_file; /* a descriptor, or a HANDLE */

#define QL_OS_NO_FILE ((ql_os_file)-1)

enum { QL_OS_REGULAR, QL_OS_FOLDER, QL_OS_DEVICE };

typedef struct ql_os_facts {
    int kind; /* QL_OS_DEVICE: pipes and all else too */
    uint64_t size_bytes;
    uint32_t permissions; /* POSIX mode bits; 0 on Windows */
} ql_os_facts;

/* For reading, folders and devices too, without ever waiting for one. While it is open the file may be replaced. */
int ql_os_open(const char *path, ql_os_file *out);

/* Makes a new file to write; EEXIST when there is one. */
int ql_os_create(const char *path, ql_os_file *out);

/* Both may be called from several threads at once, and transfer at least one byte, or 0 at the end or on a full disk. */
int ql_os_read(ql_os_file file, void *buffer, size_t num_bytes, uint64_t offset, size_t *num_read);
int ql_os_write(ql_os_file file, const void *data, size_t num_bytes, uint64_t offset, size_t *num_written);

int ql_os_sync(ql_os_file file); /* returns once the content is on the disk */
int ql_os_close(ql_os_file file);
int ql_os_file_facts(ql_os_file file, ql_os_facts *facts);
int ql_os_path_facts(const char *path, ql_os_facts *facts); /* of what a symbolic link leads to */
int ql_os_check_writable(const char *path);                 /* of an existing file: 0 when it may be changed */

/* May do nothing: where there are no such permissions, or they are not ours to set. */
void ql_os_set_permissions(ql_os_file file, uint32_t permissions);

/* Gives a file a name in the same folder, in place of what may stand there, even while that is open for reading. */
int ql_os_replace(const char *from, const char *to);
void ql_os_remove(const char *path);

/* Where a symbolic link leads, to be freed with free(); NULL when path is none, or leads nowhere. */
char *ql_os_resolve_link(const char *path);

size_t ql_os_folder_length(const char *path); /* the folder part with its separator, 0 for a bare name */
FILE *ql_os_fopen(const char *path, const char *mode);

/* What to tell the user about an errno value. Static text, or strerror's. */
const char *ql_os_reason(int error);

/* ---- The rest ---------------------------------------------------------------------------------------------------- */

unsigned long ql_os_process_id(void);
uint32_t ql_os_num_cores(void); /* those that this process may run on, at least 1 */

/* num_bytes is a multiple of alignment. Freed with ql_os_free_aligned. */
void *ql_os_alloc_aligned(size_t alignment, size_t num_bytes);
void ql_os_free_aligned(void *pointer);

/* pthread_create for a thread that takes no signals: they belong to the host program's own. */
int ql_os_start_thread(pthread_t *thread, void *(*run)(void *), void *argument);

/* Sets this thread's default floating-point mode: to nearest, denormals kept, no traps. *before is for fesetenv. */
void ql_os_set_default_fp_mode(fenv_t *before);

#endif
