/* SPDX-License-Identifier: Apache-2.0 */
/* What the tool asks of the operating system beyond ISO C; platform_posix.c and platform_windows.c answer. Paths are
 * UTF-8 on Windows and plain bytes elsewhere. */
#ifndef CLI_PLATFORM_H
#define CLI_PLATFORM_H

#include <stdio.h>

/* The tool itself; the platform's main calls it, with wildcards expanded where the shell leaves them to programs. */
int cli_main(int argc, char **argv);

FILE *cli_fopen(const char *path, const char *mode);    /* errno as fopen sets it */
int cli_replace_file(const char *from, const char *to); /* renames; 0 or an errno value */
void cli_remove_file(const char *path);
int cli_is_folder(const char *path);
int cli_is_same_file(const char *a, const char *b); /* whether both names lead to one existing file */
int cli_is_separator(char c);                       /* between folders of a path */

/* Whether stderr is a terminal that takes the escape sequences of progress.c. */
int cli_has_terminal(void);

/* Calls handler with SIGINT or SIGTERM, maybe on another thread, the first time that the user wants the tool to end. The
 * second time ends it. */
void cli_catch_interrupts(void (*handler)(int number));

#endif
