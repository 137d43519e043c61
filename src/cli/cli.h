/* SPDX-License-Identifier: Apache-2.0 */
/* What the subcommands of `quell` share: exit codes, messages, common options, a context that Ctrl-C cancels. The tool
 * uses the library through quell.h alone. */
#ifndef CLI_CLI_H
#define CLI_CLI_H

#include "quell.h"

#include <getopt.h>
#include <stdint.h>

/* docs/cli.md lists them for the user. */
enum {
    CLI_EXIT_OK = 0,
    CLI_EXIT_FAILED = 1, /* several files failed for different reasons, or a reason without a code of its own */
    CLI_EXIT_USAGE = 2,
    CLI_EXIT_NOT_FOUND = 3, /* input missing, folder of the output missing */
    CLI_EXIT_INPUT = 4,     /* damaged, truncated, not an EXR, or of an unsupported kind */
    CLI_EXIT_NO_LAYER = 5,  /* nothing to denoise, or a named layer is not there */
    CLI_EXIT_OUTPUT = 6,    /* disk full, no permission */
    CLI_EXIT_MODEL = 7,
    CLI_EXIT_SIZE = 8,   /* sizes differ */
    CLI_EXIT_MEMORY = 9, /* out of memory, or over a limit */
    CLI_EXIT_CANCELLED = 130
};

int cli_exit_code(quell_status status);

/* Folds the code of one more file into the code so far: equal failures keep their code, mixed ones become 1. */
int cli_exit_merge(int so_far, int code);

/* "quell: FILE: sentence" on stderr; file NULL: "quell: sentence". */
void cli_error(const char *file, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The same with the context's last error, whose sentence may name the file itself. Returns cli_exit_code(status). */
int cli_error_status(const char *file, const quell_context *ctx, quell_status status);

/* "quell: sentence" and a hint at --help; returns CLI_EXIT_USAGE. command NULL: the tool itself. */
int cli_usage_error(const char *command, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* ---- Options ----------------------------------------------------------------------------------------------------- */

typedef struct cli_common {
    uint32_t num_threads;
    uint64_t max_memory_bytes;
    int32_t cpu;
    const char *model;
    int32_t quality;   /* QUELL_QUALITY_*; 0: not asked for */
    int32_t precision; /* QUELL_PRECISION_* */
    int is_quiet;
} cli_common;

/* getopt codes of the options that every subcommand has. Those of a subcommand start at CLI_OPT_OWN. */
enum {
    CLI_OPT_HELP = 'h',
    CLI_OPT_THREADS = 1000,
    CLI_OPT_MEMORY,
    CLI_OPT_CPU,
    CLI_OPT_MODEL,
    CLI_OPT_QUALITY,
    CLI_OPT_PRECISION,
    CLI_OPT_QUIET,
    CLI_OPT_OWN
};

/* clang-format off */
#define CLI_COMMON_OPTIONS                                     \
    {"help", no_argument, NULL, CLI_OPT_HELP},                 \
    {"threads", required_argument, NULL, CLI_OPT_THREADS},     \
    {"max-memory", required_argument, NULL, CLI_OPT_MEMORY},   \
    {"cpu", required_argument, NULL, CLI_OPT_CPU}
/* clang-format on */

/* Takes one of the common options. 0: taken; else an exit code, after a message. */
int cli_common_option(cli_common *common, const char *command, int code, const char *argument);

/* "float32" or "bfloat16", by QUELL_PRECISION_*; "auto". */
const char *cli_precision_name(int32_t precision);

/* Whole numbers of at most `max`, and decimal numbers: 0 on success, -1 when text is anything else. */
int cli_parse_uint(const char *text, uint64_t max, uint64_t *out);
int cli_parse_double(const char *text, double *out);

/* ---- Context ----------------------------------------------------------------------------------------------------- */

/* A context whose running call is cancelled by SIGINT and SIGTERM. Returns an exit code, after a message. */
int cli_context_create(const cli_common *common, quell_context **out);
void cli_context_destroy(quell_context *ctx);
int cli_is_interrupted(void);
int cli_interrupt_code(void); /* 128 + the signal */

/* ---- Subcommands: argv[0] is the subcommand's name --------------------------------------------------------------- */

int cli_denoise(int argc, char **argv);
int cli_inspect(int argc, char **argv);
int cli_compare(int argc, char **argv);
int cli_preview(int argc, char **argv);
int cli_bench(int argc, char **argv);

#endif
