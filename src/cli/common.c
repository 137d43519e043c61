/* SPDX-License-Identifier: Apache-2.0 */
/* Messages, options and the context that all subcommands share. */
#include "cli/cli.h"
#include "cli/model.h"
#include "cli/platform.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static _Atomic(quell_context *) running_context; /* what a signal cancels */
static atomic_int caught_signal;

/* ---- Messages ---------------------------------------------------------------------------------------------------- */

int cli_exit_code(quell_status status)
{
    switch (status) {
    case QUELL_OK: return CLI_EXIT_OK;
    case QUELL_ERR_INVALID_ARGUMENT: return CLI_EXIT_USAGE;
    case QUELL_ERR_FILE_NOT_FOUND: return CLI_EXIT_NOT_FOUND;
    case QUELL_ERR_FILE_READ:
    case QUELL_ERR_NOT_EXR:
    case QUELL_ERR_UNSUPPORTED: return CLI_EXIT_INPUT;
    case QUELL_ERR_NO_LAYER: return CLI_EXIT_NO_LAYER;
    case QUELL_ERR_FILE_WRITE: return CLI_EXIT_OUTPUT;
    case QUELL_ERR_BAD_MODEL: return CLI_EXIT_MODEL;
    case QUELL_ERR_SIZE_MISMATCH: return CLI_EXIT_SIZE;
    case QUELL_ERR_OUT_OF_MEMORY:
    case QUELL_ERR_LIMIT: return CLI_EXIT_MEMORY;
    case QUELL_ERR_CANCELLED: return cli_interrupt_code();
    default: return CLI_EXIT_FAILED;
    }
}

int cli_exit_merge(int so_far, int code)
{
    if (code == CLI_EXIT_OK || so_far == code) return so_far;
    return so_far == CLI_EXIT_OK ? code : CLI_EXIT_FAILED;
}

static void print_message(const char *file, const char *format, va_list args)
{
    fputs("quell: ", stderr);
    if (file) fprintf(stderr, "%s: ", file);
    vfprintf(stderr, format, args);
    fputc('\n', stderr);
}

void cli_error(const char *file, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    print_message(file, format, args);
    va_end(args);
}

static int begins_with_file(const char *text, const char *file)
{
    const size_t length = strlen(file);
    if (strncmp(text, file, length) == 0 && (text[length] == ':' || text[length] == ',')) return 1;
    const char *colon = strstr(text, ": ");
    if (!colon || colon == text) return 0;
    const size_t subject = (size_t)(colon - text);
    for (size_t i = 0; i < subject; i++) {
        if (cli_is_separator(text[i])) return 1;
    }
    return memchr(text, '.', subject) && !memchr(text, ' ', subject);
}

int cli_error_status(const char *file, const quell_context *ctx, quell_status status)
{
    const char *text = quell_context_last_error(ctx);
    if (!text[0]) text = quell_status_name(status);
    /* A sentence about a file begins with its name already: this one's, the output's or the weight file's. */
    if (file && begins_with_file(text, file)) file = NULL;
    cli_error(file, "%s", text);
    return cli_exit_code(status);
}

int cli_usage_error(const char *command, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    print_message(NULL, format, args);
    va_end(args);
    fprintf(stderr, "Try 'quell%s%s --help'.\n", command ? " " : "", command ? command : "");
    return CLI_EXIT_USAGE;
}

/* ---- Options ----------------------------------------------------------------------------------------------------- */

int cli_parse_uint(const char *text, uint64_t max, uint64_t *out)
{
    if (text[0] < '0' || text[0] > '9') return -1; /* strtoull takes signs and spaces */
    char *end;
    errno = 0;
    const unsigned long long value = strtoull(text, &end, 10);
    if (errno != 0 || *end != '\0' || value > max) return -1;
    *out = value;
    return 0;
}

int cli_parse_double(const char *text, double *out)
{
    char *end;
    const double value = strtod(text, &end);
    if (end == text || *end != '\0' || !isfinite(value)) return -1;
    *out = value;
    return 0;
}

static int parse_cpu(const char *text, int32_t *out)
{
    static const struct {
        const char *name;
        int32_t cpu;
    } names[] = {{"auto", QUELL_CPU_AUTO},
                 {"c", QUELL_CPU_C},
                 {"avx2", QUELL_CPU_AVX2},
                 {"avx512", QUELL_CPU_AVX512},
                 {"avx512bf16", QUELL_CPU_AVX512BF16},
                 {"neon", QUELL_CPU_NEON}};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        if (strcmp(text, names[i].name) != 0) continue;
        *out = names[i].cpu;
        return 0;
    }
    return -1;
}

const char *cli_precision_name(int32_t precision)
{
    switch (precision) {
    case QUELL_PRECISION_FLOAT32: return "float32";
    case QUELL_PRECISION_BFLOAT16: return "bfloat16";
    default: return "auto";
    }
}

static int parse_precision(const char *text, int32_t *out)
{
    for (int32_t precision = QUELL_PRECISION_AUTO; precision <= QUELL_PRECISION_BFLOAT16; precision++) {
        if (strcmp(text, cli_precision_name(precision)) != 0) continue;
        *out = precision;
        return 0;
    }
    return -1;
}

int cli_common_option(cli_common *common, const char *command, int code, const char *argument)
{
    uint64_t value;
    switch (code) {
    case CLI_OPT_THREADS:
        if (cli_parse_uint(argument, 1024, &value) != 0) {
            return cli_usage_error(command, "--threads: '%s' is not a number from 0 to 1024", argument);
        }
        common->num_threads = (uint32_t)value;
        return 0;
    case CLI_OPT_MEMORY:
        if (cli_parse_uint(argument, UINT64_MAX >> 20, &value) != 0 || value == 0) {
            return cli_usage_error(command, "--max-memory: '%s' is not a number of megabytes", argument);
        }
        common->max_memory_bytes = value << 20;
        return 0;
    case CLI_OPT_CPU:
        if (parse_cpu(argument, &common->cpu) != 0) {
            return cli_usage_error(command, "--cpu: '%s' is none of auto, c, avx2, avx512, avx512bf16, neon", argument);
        }
        return 0;
    case CLI_OPT_PRECISION:
        if (parse_precision(argument, &common->precision) != 0) {
            return cli_usage_error(command, "--precision: '%s' is none of auto, float32, bfloat16", argument);
        }
        return 0;
    case CLI_OPT_MODEL: common->model = argument; return 0;
    case CLI_OPT_QUALITY: return cli_quality_option(common, command, argument);
    case CLI_OPT_QUIET: common->is_quiet = 1; return 0;
    default:
        /* getopt has said what is wrong. */
        fprintf(stderr, "Try 'quell %s --help'.\n", command);
        return CLI_EXIT_USAGE;
    }
}

/* ---- Context ----------------------------------------------------------------------------------------------------- */

/* Only atomics here: it runs inside a signal, or on another thread. */
static void on_signal(int number)
{
    atomic_store(&caught_signal, number);
    quell_cancel(atomic_load(&running_context));
}

static void log_line(void *user, int32_t level, const char *message)
{
    (void)level;
    const cli_common *common = user;
    if (!common->is_quiet) cli_error(NULL, "%s", message);
}

int cli_context_create(const cli_common *common, quell_context **out)
{
    quell_context_options options = {.struct_size = sizeof options};
    options.num_threads = common->num_threads;
    options.cpu = common->cpu;
    options.max_memory_bytes = common->max_memory_bytes;
    options.log = log_line;
    options.log_user = (void *)(uintptr_t)common;
    const quell_status status = quell_context_create(&options, out);
    if (status != QUELL_OK) {
        if (common->is_quiet) cli_error(NULL, "cannot start: %s", quell_status_name(status));
        return status == QUELL_ERR_UNSUPPORTED ? CLI_EXIT_USAGE : cli_exit_code(status);
    }
    atomic_store(&running_context, *out);
    cli_catch_interrupts(on_signal);
    return CLI_EXIT_OK;
}

void cli_context_destroy(quell_context *ctx)
{
    atomic_store(&running_context, NULL);
    quell_context_destroy(ctx);
}

int cli_is_interrupted(void)
{
    return atomic_load(&caught_signal) != 0;
}

int cli_interrupt_code(void)
{
    const int number = atomic_load(&caught_signal);
    return number ? 128 + number : CLI_EXIT_CANCELLED;
}
