/* SPDX-License-Identifier: Apache-2.0 */
/* Names of outputs; see paths.h for the rule. */
#include "cli/paths.h"

#include "cli/platform.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct text {
    char *data;
    size_t length, capacity;
    int failed;
} text;

static void append(text *t, const char *data, size_t length)
{
    if (t->failed) return;
    if (t->length + length + 1 > t->capacity) {
        const size_t capacity = 2 * (t->length + length + 1);
        char *grown = realloc(t->data, capacity);
        if (!grown) {
            t->failed = 1;
            return;
        }
        t->data = grown;
        t->capacity = capacity;
    }
    if (length) memcpy(t->data + t->length, data, length);
    t->length += length;
    t->data[t->length] = '\0';
}

static char *finish(text *t)
{
    if (!t->failed) return t->data;
    free(t->data);
    return NULL;
}

static int is_digit(char c)
{
    return c >= '0' && c <= '9';
}

const char *cli_base_name(const char *path)
{
    const char *name = path;
    for (const char *c = path; *c; c++) {
        if (cli_is_separator(*c)) name = c + 1;
    }
    return name;
}

static size_t stem_length(const char *name)
{
    const char *dot = strrchr(name, '.');
    return dot && dot != name ? (size_t)(dot - name) : strlen(name);
}

int cli_out_kind(const char *out)
{
    const size_t length = strlen(out);
    if ((length > 0 && cli_is_separator(out[length - 1])) || cli_is_folder(out)) return CLI_OUT_FOLDER;
    if (strstr(out, "{name}") || strchr(cli_base_name(out), '#')) return CLI_OUT_PATTERN;
    return CLI_OUT_FILE;
}

static char *folder_path(const char *out, const char *input)
{
    text t = {0};
    const size_t length = strlen(out);
    append(&t, out, length);
    if (length > 0 && !cli_is_separator(out[length - 1])) append(&t, "/", 1);
    const char *name = cli_base_name(input);
    append(&t, name, strlen(name));
    return finish(&t);
}

/* The last run of digits in the first `length` characters of name. */
static size_t last_number(const char *name, size_t length, size_t *begin)
{
    size_t end = length;
    while (end > 0 && !is_digit(name[end - 1])) end--;
    *begin = end;
    while (*begin > 0 && is_digit(name[*begin - 1])) (*begin)--;
    return end - *begin;
}

static char *pattern_path(const char *out, const char *input, const char **why)
{
    text t = {0};
    const char *name = cli_base_name(input);
    const size_t stem = stem_length(name);
    size_t begin;
    const size_t digits = last_number(name, stem, &begin);
    const char *base = cli_base_name(out);

    for (const char *p = out; *p;) {
        if (strncmp(p, "{name}", 6) == 0) {
            append(&t, name, stem);
            p += 6;
        } else if (*p == '#' && p >= base) {
            size_t run = strspn(p, "#");
            p += run;
            if (digits == 0) {
                *why = "its name has no frame number for the '#' of the output";
                free(t.data);
                return NULL;
            }
            for (; run > digits; run--) append(&t, "0", 1);
            append(&t, name + begin, digits);
        } else {
            append(&t, p, 1);
            p++;
        }
    }
    return finish(&t);
}

char *cli_out_path(const char *out, const char *input, const char **why)
{
    *why = NULL;
    switch (cli_out_kind(out)) {
    case CLI_OUT_FOLDER: return folder_path(out, input);
    case CLI_OUT_PATTERN: return pattern_path(out, input, why);
    default: {
        text t = {0};
        append(&t, out, strlen(out));
        return finish(&t);
    }
    }
}
