/* SPDX-License-Identifier: Apache-2.0 */
/* Test tool: reads an EXR file into a frame and writes it again, with layers marked as denoised on the way.
 *
 *   exr_copy [--threads N] [--codec N] [--mark all|none|NAME,NAME] [--scale F] [--noisy] [--all] [--list] IN [OUT]
 *
 * A marked layer's result is its own pixels times F (1). --all loads the layers that a denoise does not need. --list
 * prints a line per layer. Messages go to stderr; the exit code is the status without its sign. */
#include "base/clock.h"
#include "base/pool.h"
#include "exr/exr.h"
#include "frame/roles.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct options {
    uint32_t threads;
    int32_t codec;
    const char *mark, *in, *out;
    float scale;
    int noisy, all, list, timing;
} options;

static void log_line(void *user, int32_t level, const char *message)
{
    (void)user;
    (void)level;
    fprintf(stderr, "warning: %s\n", message);
}

static int is_marked(const options *opt, const ql_layer *layer)
{
    if (strcmp(opt->mark, "none") == 0) return 0;
    if (strcmp(opt->mark, "all") == 0) return ql_role_group(layer->role) != QL_GROUP_NONE;
    const size_t length = strlen(layer->full_name);
    const char *at = opt->mark;
    while ((at = strstr(at, layer->full_name)) != NULL) {
        if ((at == opt->mark || at[-1] == ',') && (at[length] == '\0' || at[length] == ',')) return 1;
        at++;
    }
    return 0;
}

static quell_status mark(const options *opt, ql_frame *frame, ql_layer *layer, ql_error *err)
{
    const size_t pixels = (size_t)frame->width * frame->height;
    layer->result = ql_alloc(frame->memory, pixels * layer->num_channels, sizeof(float));
    if (!layer->result) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a result");
    for (uint32_t c = 0; c < layer->num_channels; c++) {
        for (uint32_t y = 0; y < frame->height; y++) {
            float *row = layer->result + c * pixels + (size_t)y * frame->width;
            ql_layer_read_row(layer, frame->width, c, y, row);
            for (uint32_t x = 0; x < frame->width; x++) row[x] *= opt->scale;
        }
    }
    return QUELL_OK;
}

static void list(const ql_frame *frame)
{
    static const char *const formats[] = {"float", "half", "uint"};
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        printf("%s|%s|%s|%s|%s|%s|%s|%s|%u|%u|%ux%u\n", layer->full_name, layer->view_layer, layer->pass, layer->view,
               ql_role_name(layer->role), layer->channels, formats[layer->format], layer->compression, layer->part,
               layer->samples, frame->width, frame->height);
    }
}

static quell_status run(const options *opt, ql_env *env, ql_error *err)
{
    ql_frame *frame = NULL;
    double start = ql_clock_seconds();
    QL_TRY(ql_exr_read(env, opt->in, 0, &frame, err));
    if (opt->timing)
        fprintf(stderr, "read %.3f s, %.1f MB\n", ql_clock_seconds() - start, (double)frame->memory->used_bytes / 1e6);
    quell_status status = QUELL_OK;
    if (opt->list) list(frame);
    for (uint32_t i = 0; i < frame->num_layers && status == QUELL_OK; i++) {
        ql_layer *layer = &frame->layers[i];
        const int marked = is_marked(opt, layer);
        if (opt->all || marked) status = ql_exr_load_layer(env, frame, i, err);
        if (marked && status == QUELL_OK) status = mark(opt, frame, layer, err);
    }
    frame->add_noisy_image = opt->noisy;
    start = ql_clock_seconds();
    if (status == QUELL_OK && opt->out) status = ql_exr_write(env, frame, opt->out, opt->codec, err);
    if (opt->timing) fprintf(stderr, "write %.3f s\n", ql_clock_seconds() - start);
    ql_frame_destroy(frame);
    return status;
}

static int parse(int argc, char **argv, options *opt)
{
    for (int i = 1; i < argc; i++) {
        const char *arg = argv[i];
        const char *value = i + 1 < argc ? argv[i + 1] : NULL;
        if (strcmp(arg, "--noisy") == 0) {
            opt->noisy = 1;
        } else if (strcmp(arg, "--all") == 0) {
            opt->all = 1;
        } else if (strcmp(arg, "--list") == 0) {
            opt->list = 1;
        } else if (strcmp(arg, "--time") == 0) {
            opt->timing = 1;
        } else if (strcmp(arg, "--threads") == 0 && value) {
            opt->threads = (uint32_t)strtoul(value, NULL, 10), i++;
        } else if (strcmp(arg, "--codec") == 0 && value) {
            opt->codec = (int32_t)strtol(value, NULL, 10), i++;
        } else if (strcmp(arg, "--mark") == 0 && value) {
            opt->mark = value, i++;
        } else if (strcmp(arg, "--scale") == 0 && value) {
            opt->scale = strtof(value, NULL), i++;
        } else if (!opt->in) {
            opt->in = arg;
        } else if (!opt->out) {
            opt->out = arg;
        } else {
            return -1;
        }
    }
    return opt->in ? 0 : -1;
}

int main(int argc, char **argv)
{
    options opt = {.threads = 2, .mark = "none", .scale = 1.0f};
    ql_error error = {.status = QUELL_OK};
    ql_memory memory;
    ql_pool *pool = NULL;
    atomic_int cancel;
    if (parse(argc, argv, &opt) != 0) {
        fprintf(stderr, "usage: exr_copy [options] IN [OUT]\n");
        return 100;
    }
    atomic_init(&cancel, 0);
    ql_memory_init(&memory, 0);
    quell_status status = ql_pool_create(opt.threads, &memory, &pool, &error);
    if (status == QUELL_OK) {
        ql_env env = {.memory = &memory, .pool = pool, .cancel = &cancel, .progress_to = 1.0, .log = log_line};
        status = run(&opt, &env, &error);
        ql_pool_destroy(pool);
    }
    if (status != QUELL_OK) fprintf(stderr, "error: %s\n", error.text);
    if (memory.used_bytes != 0) {
        fprintf(stderr, "leak: %llu bytes\n", (unsigned long long)memory.used_bytes);
        return 101;
    }
    return -status;
}
