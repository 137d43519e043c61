/* SPDX-License-Identifier: Apache-2.0 */
/* Linux, macOS and other POSIX systems. */
#include "cli/platform.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

FILE *cli_fopen(const char *path, const char *mode)
{
    return fopen(path, mode);
}

int cli_replace_file(const char *from, const char *to)
{
    return rename(from, to) != 0 ? errno : 0;
}

void cli_remove_file(const char *path)
{
    unlink(path);
}

int cli_is_folder(const char *path)
{
    struct stat facts;
    return stat(path, &facts) == 0 && S_ISDIR(facts.st_mode);
}

int cli_is_same_file(const char *a, const char *b)
{
    struct stat x, y;
    return stat(a, &x) == 0 && stat(b, &y) == 0 && x.st_dev == y.st_dev && x.st_ino == y.st_ino;
}

int cli_is_separator(char c)
{
    return c == '/';
}

int cli_has_terminal(void)
{
    const char *terminal = getenv("TERM");
    return isatty(STDERR_FILENO) && terminal && strcmp(terminal, "dumb") != 0;
}

void cli_catch_interrupts(void (*handler)(int number))
{
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = handler;
    action.sa_flags = (int)SA_RESETHAND; /* a second Ctrl-C finds the default action and ends the program */
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
}

int main(int argc, char **argv)
{
    return cli_main(argc, argv);
}
