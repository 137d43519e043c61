/* SPDX-License-Identifier: Apache-2.0 */
/* Windows: UTF-16 at its interfaces becomes UTF-8 here, so that the rest of the tool is the same everywhere. */
#include "cli/platform.h"

#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <wchar.h>
#include <windows.h>

/* The command prompt leaves wildcards to programs: this tells the C run-time to expand those outside quotes. */
extern int _dowildcard;
int _dowildcard = -1;

static _Atomic(void (*)(int)) interrupt_handler;
static UINT output_code_page; /* of the console before the tool ran */

/* Freed with free(); NULL with errno set. */
static wchar_t *wide_of(const char *text)
{
    const int length = MultiByteToWideChar(CP_UTF8, MB_ERR_INVALID_CHARS, text, -1, NULL, 0);
    wchar_t *wide = length > 0 ? malloc((size_t)length * sizeof *wide) : NULL;
    if (length <= 0) errno = EILSEQ;
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

FILE *cli_fopen(const char *path, const char *mode)
{
    wchar_t *name = wide_of(path), *wide_mode = wide_of(mode);
    FILE *file = name && wide_mode ? _wfopen(name, wide_mode) : NULL;
    const int error = errno;
    free(name);
    free(wide_mode);
    errno = error;
    return file;
}

int cli_replace_file(const char *from, const char *to)
{
    wchar_t *old_name = wide_of(from), *new_name = wide_of(to);
    int error = old_name && new_name ? 0 : EILSEQ;
    if (!error && !MoveFileExW(old_name, new_name, MOVEFILE_REPLACE_EXISTING)) error = EACCES;
    free(old_name);
    free(new_name);
    return error;
}

void cli_remove_file(const char *path)
{
    wchar_t *name = wide_of(path);
    if (name) DeleteFileW(name);
    free(name);
}

/* Folders need backup semantics. */
static int file_facts(const char *path, BY_HANDLE_FILE_INFORMATION *facts)
{
    wchar_t *name = wide_of(path);
    if (!name) return -1;
    const DWORD share = FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE;
    const HANDLE handle =
        CreateFileW(name, FILE_READ_ATTRIBUTES, share, NULL, OPEN_EXISTING, FILE_FLAG_BACKUP_SEMANTICS, NULL);
    free(name);
    if (handle == INVALID_HANDLE_VALUE) return -1;
    const BOOL is_good = GetFileInformationByHandle(handle, facts);
    CloseHandle(handle);
    return is_good ? 0 : -1;
}

int cli_is_folder(const char *path)
{
    BY_HANDLE_FILE_INFORMATION facts;
    return file_facts(path, &facts) == 0 && (facts.dwFileAttributes & FILE_ATTRIBUTE_DIRECTORY) != 0;
}

int cli_is_same_file(const char *a, const char *b)
{
    BY_HANDLE_FILE_INFORMATION x, y;
    return file_facts(a, &x) == 0 && file_facts(b, &y) == 0 && x.dwVolumeSerialNumber == y.dwVolumeSerialNumber &&
           x.nFileIndexHigh == y.nFileIndexHigh && x.nFileIndexLow == y.nFileIndexLow;
}

int cli_is_separator(char c)
{
    return c == '/' || c == '\\';
}

int cli_has_terminal(void)
{
    const HANDLE console = GetStdHandle(STD_ERROR_HANDLE);
    DWORD mode;
    return GetConsoleMode(console, &mode) && SetConsoleMode(console, mode | ENABLE_VIRTUAL_TERMINAL_PROCESSING);
}

/* Runs on a thread of its own. FALSE passes the event on, which ends the program. */
static BOOL WINAPI on_console_event(DWORD event)
{
    void (*handler)(int) = atomic_exchange(&interrupt_handler, NULL);
    if (!handler) return FALSE;
    handler(event == CTRL_C_EVENT ? SIGINT : SIGTERM);
    return TRUE;
}

void cli_catch_interrupts(void (*handler)(int number))
{
    if (atomic_exchange(&interrupt_handler, handler) == NULL) SetConsoleCtrlHandler(on_console_event, TRUE);
}

static void restore_console(void)
{
    SetConsoleOutputCP(output_code_page);
}

int wmain(int argc, wchar_t **wide_argv); /* the C run-time calls it, and no header declares it */

int wmain(int argc, wchar_t **wide_argv)
{
    output_code_page = GetConsoleOutputCP();
    if (output_code_page && SetConsoleOutputCP(CP_UTF8)) atexit(restore_console);

    char **argv = calloc((size_t)argc + 1, sizeof *argv);
    if (!argv) return EXIT_FAILURE;
    for (int i = 0; i < argc; i++) {
        argv[i] = utf8_of(wide_argv[i]);
        if (!argv[i]) return EXIT_FAILURE;
    }
    __argv = argv; /* getopt takes the program's name from there, and a wide main leaves it empty */
    const int code = cli_main(argc, argv);
    fflush(NULL); /* before the console's code page changes back */
    return code;
}
