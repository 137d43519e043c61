/* SPDX-License-Identifier: Apache-2.0 */
#include "cli/json.h"

#include "cli/cli.h"
#include "cli/platform.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *cli_action_name(int32_t action)
{
    switch (action) {
    case QUELL_ACTION_DENOISED: return "denoise";
    case QUELL_ACTION_SKIPPED: return "skip";
    case QUELL_ACTION_GUIDE: return "guide";
    case QUELL_ACTION_UNTOUCHED: return "keep";
    default: return "unknown";
    }
}

const char *cli_format_name(int32_t format)
{
    switch (format) {
    case QUELL_FORMAT_FLOAT: return "float";
    case QUELL_FORMAT_HALF: return "half";
    case QUELL_FORMAT_UINT: return "uint";
    default: return "unknown";
    }
}

void cli_json_number(cJSON *object, const char *name, double value)
{
    if (isfinite(value)) {
        cJSON_AddNumberToObject(object, name, value);
    } else {
        cJSON_AddNullToObject(object, name);
    }
}

cJSON *cli_json_model(const quell_model_info *info)
{
    const char *const level = quell_quality_name(info->quality);
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cJSON_AddStringToObject(json, "name", info->name);
    cJSON_AddItemToObject(json, "quality", level ? cJSON_CreateString(level) : cJSON_CreateNull());
    cJSON_AddStringToObject(json, "file", info->weight_file);
    cJSON_AddStringToObject(json, "sha256", info->sha256);
    return json;
}

cJSON *cli_json_layer(const quell_layer_info *layer)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cJSON_AddStringToObject(json, "name", layer->full_name);
    cJSON_AddStringToObject(json, "view_layer", layer->view_layer);
    cJSON_AddStringToObject(json, "pass", layer->pass);
    cJSON_AddStringToObject(json, "view", layer->view);
    cJSON_AddStringToObject(json, "role", quell_role_name(layer->role));
    cJSON_AddStringToObject(json, "channels", layer->channels);
    cJSON_AddStringToObject(json, "type", cli_format_name(layer->format));
    cJSON_AddStringToObject(json, "compression", layer->compression);
    cli_json_number(json, "width", layer->width);
    cli_json_number(json, "height", layer->height);
    cli_json_number(json, "samples", layer->samples);
    return json;
}

cJSON *cli_json_report_layer(const quell_report_layer *layer)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cJSON_AddStringToObject(json, "name", layer->full_name);
    cJSON_AddStringToObject(json, "action", cli_action_name(layer->action));
    cJSON_AddStringToObject(json, "reason", layer->reason ? layer->reason : "");
    cli_json_number(json, "bad_pixels", (double)layer->num_bad_pixels);
    cli_json_number(json, "limited_pixels", (double)layer->num_limited_pixels);
    cli_json_number(json, "mean_before", layer->mean_before);
    cli_json_number(json, "mean_after", layer->mean_after);
    cli_json_number(json, "noise", layer->noise);
    cli_json_number(json, "blend", layer->blend);
    cli_json_number(json, "change", layer->change);
    return json;
}

cJSON *cli_json_summary(const quell_report_summary *summary)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cJSON_AddStringToObject(json, "model", summary->model_name ? summary->model_name : "");
    cJSON_AddStringToObject(json, "combined", summary->combined ? summary->combined : "");
    cJSON_AddStringToObject(json, "precision", cli_precision_name(summary->precision));
    if (summary->iterations) cli_json_number(json, "iterations", summary->iterations);
    cli_json_number(json, "tile_width", summary->tile_width);
    cli_json_number(json, "tile_height", summary->tile_height);
    cli_json_number(json, "tiles", summary->num_tiles);
    cli_json_number(json, "halo", summary->halo);
    cli_json_number(json, "cells", summary->num_cells);
    cli_json_number(json, "active_cells", summary->num_active_cells);
    cli_json_number(json, "peak_bytes", (double)summary->peak_bytes);
    cli_json_number(json, "macs_per_pixel", summary->macs_per_pixel);
    return json;
}

cJSON *cli_json_stages(const quell_report_summary *summary)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cli_json_number(json, "decode", summary->seconds_decode);
    cli_json_number(json, "analyse", summary->seconds_analyse);
    cli_json_number(json, "features", summary->seconds_features);
    cli_json_number(json, "network", summary->seconds_network);
    cli_json_number(json, "filter", summary->seconds_filter);
    cli_json_number(json, "recombine", summary->seconds_recombine);
    return json;
}

cJSON *cli_json_metrics(const quell_metrics *metrics)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cli_json_number(json, "mse", metrics->mse);
    cli_json_number(json, "rel_mse", metrics->rel_mse);
    cli_json_number(json, "psnr", metrics->psnr);
    cli_json_number(json, "ssim", metrics->ssim);
    cli_json_number(json, "gmsd", metrics->gmsd);
    cli_json_number(json, "non_finite", (double)metrics->num_non_finite);
    return json;
}

static int write_whole(const char *text, const char *path)
{
    const size_t length = strlen(path);
    char *temporary = malloc(length + 8);
    if (!temporary) {
        cli_error(path, "no memory to write it");
        return CLI_EXIT_MEMORY;
    }
    memcpy(temporary, path, length);
    memcpy(temporary + length, ".part", 6);

    FILE *file = cli_fopen(temporary, "wb");
    const int missing = !file && errno == ENOENT;
    int good = file && fputs(text, file) >= 0 && fputc('\n', file) != EOF;
    int reason = good ? 0 : errno;
    if (file && fclose(file) != 0 && good) {
        good = 0;
        reason = errno;
    }
    if (good) {
        reason = cli_replace_file(temporary, path);
        good = reason == 0;
    }
    if (!good) {
        if (file) cli_remove_file(temporary);
        cli_error(path, "cannot be written: %s", strerror(reason));
    }
    free(temporary);
    return good ? CLI_EXIT_OK : missing ? CLI_EXIT_NOT_FOUND : CLI_EXIT_OUTPUT;
}

int cli_json_write(cJSON *json, const char *path)
{
    char *text = json ? cJSON_Print(json) : NULL;
    cJSON_Delete(json);
    if (!text) {
        cli_error(path, "no memory for the JSON text");
        return CLI_EXIT_MEMORY;
    }
    int code = CLI_EXIT_OK;
    if (strcmp(path, "-") == 0) {
        puts(text);
    } else {
        code = write_whole(text, path);
    }
    cJSON_free(text);
    return code;
}
