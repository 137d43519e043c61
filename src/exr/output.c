/* SPDX-License-Identifier: Apache-2.0 */
/* Decides the parts of an output: a part without a denoised channel is copied; the others are encoded again, losslessly
 * unless asked otherwise, with the rest of their channels taken from the source bit by bit. Layers that the source
 * lacks ('Noisy Image', or what the caller added) become channels of a single part, or parts of their own. */
#include "exr/output.h"

#include "frame/roles.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_NAME_BYTES 255 /* of a channel, by the format */
#define SHORT_NAME_BYTES 31
#define NOISY_PASS "Noisy Image"

/* Lines per task at least, so that codecs of one line per chunk do not make a task of each. */
#define MIN_LINES_PER_TASK 16
#define COPIED_CHUNKS_PER_TASK 16

static quell_status out_of_memory(const ql_exr_output *output, ql_error *err)
{
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory to write it", output->path);
}

/* Keeps a copy of a text until the output is closed; NULL when there is no memory. */
static char *keep_name(ql_exr_output *output, const char *text)
{
    if (output->num_names == output->names_capacity) {
        const uint32_t capacity = output->names_capacity ? output->names_capacity * 2 : 64;
        char **names = ql_alloc_zero(output->memory, capacity, sizeof *names);
        if (!names) return NULL;
        if (output->num_names) memcpy(names, output->names, output->num_names * sizeof *names);
        ql_free(output->memory, output->names);
        output->names = names;
        output->names_capacity = capacity;
    }
    char *copy = ql_strdup(output->memory, text);
    if (copy) output->names[output->num_names++] = copy;
    return copy;
}

static void warn(const ql_exr_output *output, const char *text, const char *name)
{
    char line[1400];
    if (!output->env->log) return;
    snprintf(line, sizeof line, "%s: %s '%s'", output->path, text, name);
    output->env->log(output->env->log_user, QUELL_LOG_WARNING, line);
}

/* ---- Layers that the source does not have ------------------------------------------------------------------------ */

typedef struct extra_layer {
    const ql_layer *layer;
    int use_result;
    int is_noisy;
    int32_t part; /* of the source: its channels join that part, or its header serves the new part */
    int is_own_part;
    int32_t before; /* own part: index of the source part that it stands before, num_parts for the end */
} extra_layer;

static int is_same_view(const ql_layer *a, const ql_layer *b)
{
    return strcmp(a->view_layer, b->view_layer) == 0 && strcmp(a->view, b->view) == 0;
}

static int has_noisy_image(const ql_frame *frame, const ql_layer *combined)
{
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        if (layer->role == QUELL_ROLE_NOISY_IMAGE && is_same_view(layer, combined)) return 1;
    }
    return 0;
}

/* Blender puts 'Noisy Image' before the denoising guides, and those before light groups. Without them it goes behind
 * the last part of its view layer. */
static int32_t noisy_place(const ql_frame *frame, const ql_layer *combined)
{
    int32_t last = (int32_t)combined->part + 1, first = INT32_MAX;
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        if (strcmp(layer->view_layer, combined->view_layer) != 0 || layer->channel_index[0] < 0) continue;
        const int32_t part = (int32_t)layer->part;
        const int stands_behind = layer->role == QUELL_ROLE_NOISY_SHADOW_CATCHER ||
                                  layer->role == QUELL_ROLE_LIGHT_GROUP || strncmp(layer->pass, "Denoising ", 10) == 0;
        if (stands_behind && part < first) first = part;
        if (part >= last) last = part + 1;
    }
    return first < last ? first : last;
}

/* Whether all channels of the layer's part are the layer's own. */
static int fills_its_part(const ql_exr_output *output, const ql_layer *layer)
{
    return output->source->parts[layer->part].channels->num_channels == (int32_t)layer->num_channels;
}

/* The part that the file has a layer of the same view layer and view in: its header says what a new part is about. */
static int32_t part_of_view(const ql_frame *frame, const ql_layer *added, int32_t otherwise)
{
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        if (layer->channel_index[0] >= 0 && is_same_view(layer, added)) return (int32_t)layer->part;
    }
    return otherwise;
}

/* extras has room for two per layer of the frame. */
static uint32_t find_extras(const ql_exr_output *output, extra_layer *extras)
{
    const ql_frame *frame = output->frame;
    const ql_exr_source *source = output->source;
    uint32_t count = 0;
    int32_t first_listed = 0;
    for (uint32_t p = source->num_parts; p-- > 0;) {
        if (source->parts[p].is_listed) first_listed = (int32_t)p;
    }
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        if (layer->channel_index[0] < 0) { /* added since */
            extras[count++] = (extra_layer){.layer = layer,
                                            .use_result = layer->result != NULL,
                                            .part = part_of_view(frame, layer, first_listed),
                                            .is_own_part = output->is_multi_part,
                                            .before = (int32_t)source->num_parts};
        }
        if (frame->add_noisy_image && layer->role == QUELL_ROLE_COMBINED && layer->result && layer->pixels.data &&
            !has_noisy_image(frame, layer)) {
            const int is_from_file = layer->channel_index[0] >= 0;
            const int is_own_part = output->is_multi_part && (!is_from_file || fills_its_part(output, layer));
            extras[count++] = (extra_layer){
                .layer = layer,
                .is_noisy = 1,
                .part = is_from_file ? (int32_t)layer->part : first_listed,
                .is_own_part = is_own_part,
                .before = is_from_file ? noisy_place(frame, layer) : (int32_t)source->num_parts,
            };
        }
    }
    return count;
}

/* "ViewLayer.Noisy Image" with or without its view; a frame from memory whose layers name no view layer gets Blender's
 * usual. */
static void extra_name(const ql_exr_output *output, const extra_layer *extra, int with_view, char separator, char *out,
                       size_t out_bytes)
{
    const ql_layer *layer = extra->layer;
    const char *view_layer = layer->view_layer;
    if (!view_layer[0] && !output->source) view_layer = "ViewLayer";
    char view[300] = "";
    if (with_view && layer->view[0]) snprintf(view, sizeof view, "%c%s", separator, layer->view);
    snprintf(out, out_bytes, "%s%s%s%s", view_layer, view_layer[0] ? "." : "",
             extra->is_noisy ? NOISY_PASS : layer->pass, view); /* a cut name is still too long for a channel */
}

/* ---- Channels ---------------------------------------------------------------------------------------------------- */

/* A channel while its part is put together. */
typedef struct draft_channel {
    ql_exr_channel channel;
    ql_exr_segment segment;
} draft_channel;

static int by_name(const void *a, const void *b)
{
    const draft_channel *first = a, *second = b;
    return strcmp(first->channel.name, second->channel.name);
}

static exr_pixel_type_t pixel_type(int32_t format)
{
    if (format == QUELL_FORMAT_HALF) return EXR_PIXEL_HALF;
    return format == QUELL_FORMAT_UINT ? EXR_PIXEL_UINT : EXR_PIXEL_FLOAT;
}

static ql_exr_segment layer_segment(const ql_layer *layer, uint32_t channel, int use_result, exr_pixel_type_t type,
                                    uint32_t width)
{
    return (ql_exr_segment){
        .kind = use_result ? QL_EXR_FROM_RESULT : QL_EXR_FROM_PIXELS,
        .num_bytes = width * ql_exr_value_bytes(type),
        .layer = layer,
        .layer_channel = channel,
        .format = ql_exr_format(type),
    };
}

/* The drafts of a source part's own channels, denoised layers included. */
static void draft_source_channels(const ql_exr_output *output, uint32_t index, draft_channel *drafts)
{
    const ql_exr_part *part = &output->source->parts[index];
    size_t offset = 0;
    for (int32_t c = 0; c < part->channels->num_channels; c++) {
        const exr_attr_chlist_entry_t *entry = &part->channels->entries[c];
        const size_t num_bytes = part->width * ql_exr_value_bytes(entry->pixel_type);
        drafts[c].channel =
            (ql_exr_channel){.name = entry->name.str, .type = entry->pixel_type, .is_linear = entry->p_linear};
        drafts[c].segment =
            (ql_exr_segment){.kind = QL_EXR_FROM_SOURCE, .num_bytes = num_bytes, .source_offset = offset};
        offset += num_bytes;
    }
    for (uint32_t i = 0; i < output->frame->num_layers; i++) {
        const ql_layer *layer = &output->frame->layers[i];
        if (!layer->result || layer->part != index || layer->channel_index[0] < 0) continue;
        for (uint32_t c = 0; c < layer->num_channels; c++) {
            draft_channel *draft = &drafts[layer->channel_index[c]];
            draft->segment = layer_segment(layer, c, 1, draft->channel.type, part->width);
        }
    }
}

static quell_status name_error(const ql_exr_output *output, const char *name, const char *what, ql_error *err)
{
    return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: the layer name '%s' %s for an EXR file", output->path, name,
                   what);
}

/* Appends a layer's channels under `prefix`. A name that is too long or taken is QUELL_ERR_INVALID_ARGUMENT; *count then
 * stays what it was. */
static quell_status draft_layer(ql_exr_output *output, const ql_layer *layer, int use_result, const char *prefix,
                                uint32_t width, draft_channel *drafts, uint32_t *count, ql_error *err)
{
    const char *letters = layer->channels[0] ? layer->channels : ql_role_channels(layer->role, layer->num_channels);
    char name[MAX_NAME_BYTES + 1];
    const uint32_t before = *count;
    for (uint32_t c = 0; c < layer->num_channels; c++) {
        const int length = snprintf(name, sizeof name, "%s.%c", prefix, letters[c]);
        if (length < 1 || (size_t)length >= sizeof name) return name_error(output, prefix, "is too long", err);
        for (uint32_t i = 0; i < before; i++) {
            if (strcmp(drafts[i].channel.name, name) == 0) return name_error(output, prefix, "is there twice", err);
        }
        if (length > SHORT_NAME_BYTES) output->has_long_names = 1;
        const char *kept = keep_name(output, name);
        if (!kept) return out_of_memory(output, err);
        ql_exr_channel channel = {.name = kept, .type = pixel_type(layer->format)};
        if (output->source && layer->channel_index[c] >= 0) {
            const ql_exr_part *part = &output->source->parts[layer->part];
            const exr_attr_chlist_entry_t *entry = &part->channels->entries[layer->channel_index[c]];
            channel.type = entry->pixel_type;
            channel.is_linear = entry->p_linear;
        }
        drafts[before + c].channel = channel;
        drafts[before + c].segment = layer_segment(layer, c, use_result, channel.type, width);
    }
    *count = before + layer->num_channels;
    return QUELL_OK;
}

static int can_join(const ql_exr_segment *a, const ql_exr_segment *b)
{
    return a->kind == QL_EXR_FROM_SOURCE && b->kind == QL_EXR_FROM_SOURCE &&
           a->source_offset + a->num_bytes == b->source_offset;
}

/* Sorts the drafts into the part's channels and joins neighbouring copies. */
static quell_status settle_channels(ql_exr_output *output, ql_exr_output_part *part, draft_channel *drafts,
                                    uint32_t count, ql_error *err)
{
    qsort(drafts, count, sizeof *drafts, by_name);
    part->channels = ql_alloc_zero(output->memory, count, sizeof *part->channels);
    part->segments = ql_alloc_zero(output->memory, count, sizeof *part->segments);
    if (!part->channels || !part->segments) return out_of_memory(output, err);
    part->num_channels = count;
    for (uint32_t c = 0; c < count; c++) {
        part->channels[c] = drafts[c].channel;
        ql_exr_segment *last = part->num_segments ? &part->segments[part->num_segments - 1] : NULL;
        if (last && can_join(last, &drafts[c].segment)) {
            last->num_bytes += drafts[c].segment.num_bytes;
        } else {
            part->segments[part->num_segments++] = drafts[c].segment;
        }
        if (drafts[c].segment.kind == QL_EXR_FROM_SOURCE) part->needs_source = 1;
    }
    return QUELL_OK;
}

/* ---- Codecs and tasks -------------------------------------------------------------------------------------------- */

static exr_compression_t choose_compression(exr_compression_t own, int32_t codec)
{
    switch (codec) {
    case QUELL_CODEC_NONE: return EXR_COMPRESSION_NONE;
    case QUELL_CODEC_RLE: return EXR_COMPRESSION_RLE;
    case QUELL_CODEC_ZIPS: return EXR_COMPRESSION_ZIPS;
    case QUELL_CODEC_ZIP: return EXR_COMPRESSION_ZIP;
    case QUELL_CODEC_PIZ: return EXR_COMPRESSION_PIZ;
    case QUELL_CODEC_PXR24: return EXR_COMPRESSION_PXR24;
    case QUELL_CODEC_B44: return EXR_COMPRESSION_B44;
    case QUELL_CODEC_B44A: return EXR_COMPRESSION_B44A;
    case QUELL_CODEC_DWAA: return EXR_COMPRESSION_DWAA;
    case QUELL_CODEC_DWAB: return EXR_COMPRESSION_DWAB;
    case QUELL_CODEC_HTJ2K: /* Blender's block size, but a file's own is as good */
        return own == EXR_COMPRESSION_HTJ2K256 ? own : EXR_COMPRESSION_HTJ2K32;
    default: return exr_compression_is_lossy(own) ? EXR_COMPRESSION_ZIP : own;
    }
}

/* Blender writes no such attribute; other programs do. */
static float dwa_level_of(const ql_exr_output *output, const ql_exr_output_part *part)
{
    float level = -1.0f;
    if (!output->source || part->header_part < 0) return level;
    const ql_exr_attribute *attribute =
        ql_exr_find_attribute(&output->header.parts[part->header_part], "dwaCompressionLevel");
    if (attribute && attribute->num_bytes == sizeof level) memcpy(&level, attribute->value, sizeof level);
    return level >= 0.0f && level <= 1e6f ? level : -1.0f;
}

static quell_status open_codec(ql_exr_output *output, ql_exr_output_part *part, ql_error *err)
{
    QL_TRY(ql_exr_codec_open(&part->codec, &output->messages, &part->window, part->compression,
                             dwa_level_of(output, part), part->channels, part->num_channels, output->path, err));
    part->num_chunks = part->codec.num_chunks;
    uint32_t lines =
        part->codec.lines_per_chunk > MIN_LINES_PER_TASK ? part->codec.lines_per_chunk : MIN_LINES_PER_TASK;
    if (part->needs_source) { /* both kinds of chunks begin with the task: their heights are powers of two */
        const uint32_t source_lines = (uint32_t)output->source->parts[part->source_part].lines_per_chunk;
        if (source_lines > lines) lines = source_lines;
    }
    part->chunks_per_task = lines / part->codec.lines_per_chunk;
    return QUELL_OK;
}

typedef struct place {
    uint64_t offset;
    uint32_t chunk;
} place;

static int by_place(const void *a, const void *b)
{
    const place *first = a, *second = b;
    if (first->offset != second->offset) return first->offset < second->offset ? -1 : 1;
    return first->chunk < second->chunk ? -1 : first->chunk > second->chunk;
}

/* Copied chunks keep the order that they have in the source, whatever the line order. */
static quell_status order_chunks(ql_exr_output *output, ql_exr_output_part *part, ql_error *err)
{
    ql_exr_source *source = output->source;
    uint64_t *table = NULL;
    int32_t count = 0;
    char where[1200];
    ql_exr_source_where(source, (uint32_t)part->source_part, where, sizeof where);
    if (source->parts[part->source_part].storage >= EXR_STORAGE_LAST_TYPE) {
        return ql_fail(err, QUELL_ERR_UNSUPPORTED, "%s: is of a kind that cannot be copied", where);
    }
    const exr_result_t code = exr_get_chunk_table(source->context, part->source_part, &table, &count);
    if (code != EXR_ERR_SUCCESS || count < 1) {
        return ql_exr_fail(&source->messages, code, QUELL_ERR_FILE_READ, where, err);
    }
    place *places = ql_alloc(output->memory, (size_t)count, sizeof *places);
    part->order = ql_alloc(output->memory, (size_t)count, sizeof *part->order);
    if (!places || !part->order) {
        ql_free(output->memory, places);
        return out_of_memory(output, err);
    }
    for (int32_t i = 0; i < count; i++) places[i] = (place){.offset = table[i], .chunk = (uint32_t)i};
    qsort(places, (size_t)count, sizeof *places, by_place);
    for (int32_t i = 0; i < count; i++) part->order[i] = places[i].chunk;
    ql_free(output->memory, places);
    part->num_chunks = (uint32_t)count;
    part->chunks_per_task = COPIED_CHUNKS_PER_TASK;
    return QUELL_OK;
}

static quell_status count_tasks(ql_exr_output *output, ql_error *err)
{
    uint64_t num_tasks = 0;
    for (uint32_t p = 0; p < output->num_parts; p++) {
        ql_exr_output_part *part = &output->parts[p];
        part->offsets = ql_alloc_zero(output->memory, part->num_chunks, sizeof *part->offsets);
        if (!part->offsets) return out_of_memory(output, err);
        part->first_task = (uint32_t)num_tasks;
        part->num_tasks = (part->num_chunks - 1) / part->chunks_per_task + 1;
        num_tasks += part->num_tasks;
        if (num_tasks > INT32_MAX) return ql_fail(err, QUELL_ERR_LIMIT, "%s: has too many chunks", output->path);
    }
    output->num_tasks = (uint32_t)num_tasks;
    return QUELL_OK;
}

/* ---- Parts ------------------------------------------------------------------------------------------------------- */

static int is_part_name_taken(const ql_exr_source *source, const char *name)
{
    for (uint32_t p = 0; p < source->num_parts; p++) {
        if (strcmp(source->parts[p].name, name) == 0) return 1;
    }
    return 0;
}

/* 'Noisy Image' is a courtesy: a file that has no room for its name is written without. What the caller added is not. */
static quell_status forgive_noisy(const ql_exr_output *output, const extra_layer *extra, quell_status status)
{
    if (status != QUELL_ERR_INVALID_ARGUMENT || !extra->is_noisy) return status;
    warn(output, "no 'Noisy Image' can be added beside", extra->layer->full_name);
    return QUELL_OK;
}

static quell_status add_extra_part(ql_exr_output *output, const extra_layer *extra, int32_t codec,
                                   draft_channel *drafts, ql_error *err)
{
    const ql_exr_part *base = &output->source->parts[extra->part];
    ql_exr_output_part *part = &output->parts[output->num_parts];
    char prefix[512], name[512];
    uint32_t count = 0;
    extra_name(output, extra, 0, '.', prefix, sizeof prefix);
    extra_name(output, extra, 1, '-', name, sizeof name);
    quell_status status =
        is_part_name_taken(output->source, name) ? name_error(output, name, "is taken", err) : QUELL_OK;
    if (status == QUELL_OK) {
        status = draft_layer(output, extra->layer, extra->use_result, prefix, base->width, drafts, &count, err);
    }
    if (status != QUELL_OK) return forgive_noisy(output, extra, status);

    *part = (ql_exr_output_part){
        .source_part = -1,
        .header_part = extra->part,
        .is_new = 1,
        .has_new_channels = 1,
        .compression = choose_compression(base->compression, codec),
        .line_order = base->line_order,
        .window = base->window,
    };
    output->num_parts++;
    part->name = keep_name(output, name);
    if (!part->name) return out_of_memory(output, err);
    QL_TRY(settle_channels(output, part, drafts, count, err));
    return open_codec(output, part, err);
}

static int has_result(const ql_frame *frame, uint32_t part)
{
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        if (layer->result && layer->part == part && layer->channel_index[0] >= 0) return 1;
    }
    return 0;
}

static quell_status add_source_part(ql_exr_output *output, uint32_t index, const extra_layer *extras,
                                    uint32_t num_extras, int32_t codec, draft_channel *drafts, ql_error *err)
{
    const ql_exr_part *source = &output->source->parts[index];
    ql_exr_output_part *part = &output->parts[output->num_parts++];
    *part = (ql_exr_output_part){
        .source_part = (int32_t)index,
        .header_part = (int32_t)index,
        .compression = source->compression,
        .line_order = source->line_order,
        .window = source->window,
    };
    int is_changed = has_result(output->frame, index);
    for (uint32_t e = 0; e < num_extras; e++) {
        if (!extras[e].is_own_part && extras[e].part == (int32_t)index) is_changed = 1;
    }
    if (!is_changed || !source->is_plain) {
        part->is_copied = 1;
        return order_chunks(output, part, err);
    }

    uint32_t count = (uint32_t)source->channels->num_channels;
    draft_source_channels(output, index, drafts);
    for (uint32_t e = 0; e < num_extras; e++) {
        char prefix[512];
        if (extras[e].is_own_part || extras[e].part != (int32_t)index) continue;
        extra_name(output, &extras[e], 1, '.', prefix, sizeof prefix);
        const quell_status status =
            draft_layer(output, extras[e].layer, extras[e].use_result, prefix, source->width, drafts, &count, err);
        QL_TRY(forgive_noisy(output, &extras[e], status));
        if (status == QUELL_OK) part->has_new_channels = 1;
    }
    part->compression = choose_compression(source->compression, codec);
    QL_TRY(settle_channels(output, part, drafts, count, err));
    return open_codec(output, part, err);
}

static quell_status plan_from_source(ql_exr_output *output, int32_t codec, ql_error *err)
{
    const ql_exr_source *source = output->source;
    const uint32_t num_layers = output->frame->num_layers;
    size_t most_channels = (size_t)num_layers * 8; /* two extras per layer, four channels each */
    extra_layer *extras = ql_alloc_zero(output->memory, (size_t)num_layers * 2, sizeof *extras);
    draft_channel *drafts = NULL;
    quell_status status = QUELL_OK;
    for (uint32_t p = 0; p < source->num_parts; p++) {
        most_channels += (size_t)source->parts[p].channels->num_channels;
    }
    drafts = ql_alloc_zero(output->memory, most_channels, sizeof *drafts);
    output->parts =
        ql_alloc_zero(output->memory, (size_t)source->num_parts + (size_t)num_layers * 2, sizeof *output->parts);
    if (!extras || !drafts || !output->parts) {
        status = out_of_memory(output, err);
        goto fail;
    }
    const uint32_t num_extras = find_extras(output, extras);
    for (uint32_t p = 0; p <= source->num_parts; p++) {
        for (uint32_t e = 0; e < num_extras; e++) {
            if (!extras[e].is_own_part || extras[e].before != (int32_t)p) continue;
            QL_TRY_GOTO(add_extra_part(output, &extras[e], codec, drafts, err));
        }
        if (p == source->num_parts) break;
        QL_TRY_GOTO(add_source_part(output, p, extras, num_extras, codec, drafts, err));
    }
fail:
    ql_free(output->memory, drafts);
    ql_free(output->memory, extras);
    return status;
}

static quell_status plan_from_layers(ql_exr_output *output, int32_t codec, ql_error *err)
{
    const ql_frame *frame = output->frame;
    uint32_t count = 0;
    quell_status status = QUELL_OK;
    if (frame->num_layers == 0) {
        return ql_fail(err, QUELL_ERR_NO_LAYER, "%s: the frame has no layers to write", output->path);
    }
    draft_channel *drafts = ql_alloc_zero(output->memory, (size_t)frame->num_layers * 8, sizeof *drafts);
    output->parts = ql_alloc_zero(output->memory, 1, sizeof *output->parts);
    if (!drafts || !output->parts) {
        status = out_of_memory(output, err);
        goto fail;
    }
    output->num_parts = 1;
    ql_exr_output_part *part = &output->parts[0];
    *part = (ql_exr_output_part){
        .source_part = -1,
        .header_part = -1,
        .has_new_channels = 1,
        .compression = choose_compression(EXR_COMPRESSION_ZIP, codec),
        .line_order = EXR_LINEORDER_INCREASING_Y,
        .window = {.max = {.x = (int32_t)(frame->width - 1), .y = (int32_t)(frame->height - 1)}},
    };
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *layer = &frame->layers[i];
        const int adds_noisy = frame->add_noisy_image && layer->role == QUELL_ROLE_COMBINED && layer->result &&
                               layer->pixels.data && !has_noisy_image(frame, layer);
        for (int noisy = 0; noisy <= adds_noisy; noisy++) {
            const extra_layer extra = {.layer = layer, .use_result = !noisy && layer->result, .is_noisy = noisy};
            char prefix[512];
            if (!extra.use_result && !layer->pixels.data) {
                status = ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%s: the layer '%s' has no pixels", output->path,
                                 layer->full_name);
                goto fail;
            }
            extra_name(output, &extra, 1, '.', prefix, sizeof prefix);
            status = draft_layer(output, layer, extra.use_result, prefix, frame->width, drafts, &count, err);
            QL_TRY_GOTO(forgive_noisy(output, &extra, status));
        }
    }
    /* "cycles.LAYER.samples" */
    if (strlen(frame->layers[0].view_layer) + 15 > SHORT_NAME_BYTES) output->has_long_names = 1;
    QL_TRY_GOTO(settle_channels(output, part, drafts, count, err));
    QL_TRY_GOTO(open_codec(output, part, err));
fail:
    ql_free(output->memory, drafts);
    return status;
}

quell_status ql_exr_output_open(ql_exr_output *output, ql_env *env, const ql_frame *frame, int32_t codec,
                                const char *path, ql_error *err)
{
    *output = (ql_exr_output){.memory = env->memory, .env = env, .frame = frame, .source = frame->source, .path = path};
    QL_TRY(ql_exr_messages_init(&output->messages, err));
    quell_status status;
    if (output->source) {
        output->is_multi_part = output->source->is_multi_part;
        QL_TRY_GOTO(ql_exr_header_read(output->source, output->memory, &output->header, err));
        QL_TRY_GOTO(plan_from_source(output, codec, err));
    } else {
        QL_TRY_GOTO(plan_from_layers(output, codec, err));
    }
    QL_TRY_GOTO(count_tasks(output, err));
    return QUELL_OK;

fail:
    ql_exr_output_close(output);
    return status;
}

void ql_exr_output_close(ql_exr_output *output)
{
    for (uint32_t p = 0; p < output->num_parts; p++) {
        ql_exr_output_part *part = &output->parts[p];
        ql_exr_codec_close(&part->codec);
        ql_free(output->memory, part->channels);
        ql_free(output->memory, part->segments);
        ql_free(output->memory, part->order);
        ql_free(output->memory, part->offsets);
    }
    ql_free(output->memory, output->parts);
    for (uint32_t i = 0; i < output->num_names; i++) ql_free(output->memory, output->names[i]);
    ql_free(output->memory, output->names);
    if (output->source) ql_exr_header_free(&output->header);
    ql_exr_messages_destroy(&output->messages);
}

/* ---- Header ------------------------------------------------------------------------------------------------------ */

static void append_attribute(ql_exr_bytes *out, const char *name, const char *type, const void *value, size_t num_bytes)
{
    const ql_exr_attribute attribute = {.name = name, .type = type, .value = value, .num_bytes = (uint32_t)num_bytes};
    ql_exr_append_attribute(out, &attribute);
}

static void append_channels(ql_exr_bytes *out, const ql_exr_output_part *part)
{
    ql_exr_bytes list = {.memory = out->memory};
    ql_exr_append_channel_list(&list, part->channels, part->num_channels);
    append_attribute(out, "channels", "chlist", list.data, list.used);
    if (list.has_failed) out->has_failed = 1;
    ql_exr_bytes_free(&list);
}

static void append_i32(ql_exr_bytes *out, const char *name, int32_t value)
{
    append_attribute(out, name, "int", &value, sizeof value); /* little-endian: checked in chunk.c */
}

/* What a new part shares with the part it is made after; other attributes are that part's own metadata. */
static int is_structural(const char *name)
{
    static const char *const names[] = {
        "channels",      "chunkCount", "chromaticities", "colorInteropID",   "compression",        "dataWindow",
        "displayWindow", "lineOrder",  "name",           "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth",
        "timeCode",      "type",       "view",           "xDensity",
    };
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        if (strcmp(name, names[i]) == 0) return 1;
    }
    return 0;
}

static void append_changed_header(const ql_exr_output *output, const ql_exr_output_part *part, ql_exr_bytes *out)
{
    const ql_exr_part_header *header = &output->header.parts[part->header_part];
    const uint8_t compression = (uint8_t)part->compression;
    for (uint32_t i = 0; i < header->num_attributes; i++) {
        const ql_exr_attribute *attribute = &header->attributes[i];
        const char *name = attribute->name;
        if (part->is_new && !is_structural(name)) continue;
        if (strcmp(name, "compression") == 0) {
            append_attribute(out, name, "compression", &compression, 1);
        } else if (strcmp(name, "chunkCount") == 0) {
            append_i32(out, name, (int32_t)part->num_chunks);
        } else if (strcmp(name, "channels") == 0 && part->has_new_channels) {
            append_channels(out, part);
        } else if (strcmp(name, "name") == 0 && part->is_new) {
            append_attribute(out, name, "string", part->name, strlen(part->name));
        } else {
            ql_exr_append_attribute(out, attribute);
        }
    }
}

static void append_new_header(const ql_exr_output *output, const ql_exr_output_part *part, ql_exr_bytes *out)
{
    static const char made_by[] = "Blender V2.55.1 and newer"; /* what Blender looks for in multilayer files */
    const float one = 1.0f, center[2] = {0.0f, 0.0f};
    const uint8_t compression = (uint8_t)part->compression, line_order = (uint8_t)part->line_order;
    const ql_layer *first = &output->frame->layers[0];
    char software[64];
    snprintf(software, sizeof software, "Quell %d.%d.%d", QUELL_VERSION_MAJOR, QUELL_VERSION_MINOR,
             QUELL_VERSION_PATCH);

    append_attribute(out, "BlenderMultiChannel", "string", made_by, strlen(made_by));
    append_attribute(out, "Software", "string", software, strlen(software));
    append_channels(out, part);
    append_attribute(out, "compression", "compression", &compression, 1);
    if (first->samples) {
        char name[600], text[16];
        snprintf(name, sizeof name, "cycles.%.255s.samples", first->view_layer[0] ? first->view_layer : "ViewLayer");
        snprintf(text, sizeof text, "%u", first->samples);
        append_attribute(out, name, "string", text, strlen(text));
    }
    append_attribute(out, "dataWindow", "box2i", &part->window, sizeof part->window);
    append_attribute(out, "displayWindow", "box2i", &part->window, sizeof part->window);
    append_attribute(out, "lineOrder", "lineOrder", &line_order, 1);
    append_attribute(out, "pixelAspectRatio", "float", &one, sizeof one);
    append_attribute(out, "screenWindowCenter", "v2f", center, sizeof center);
    append_attribute(out, "screenWindowWidth", "float", &one, sizeof one);
}

void ql_exr_output_head(const ql_exr_output *output, ql_exr_bytes *out)
{
    static const uint8_t magic[4] = {0x76, 0x2f, 0x31, 0x01};
    uint32_t version = output->source ? output->header.version : 2u;
    if (output->has_long_names) version |= QL_EXR_FLAG_LONG_NAMES;
    ql_exr_bytes_append(out, magic, sizeof magic);
    ql_exr_bytes_append_u32(out, version);
    for (uint32_t p = 0; p < output->num_parts; p++) {
        const ql_exr_output_part *part = &output->parts[p];
        if (part->header_part < 0) {
            append_new_header(output, part, out);
        } else if (part->is_copied) {
            const ql_exr_part_header *header = &output->header.parts[part->header_part];
            for (uint32_t i = 0; i < header->num_attributes; i++) {
                ql_exr_append_attribute(out, &header->attributes[i]);
            }
        } else {
            append_changed_header(output, part, out);
        }
        ql_exr_bytes_append(out, "", 1);
    }
    if (output->is_multi_part) ql_exr_bytes_append(out, "", 1);
    for (uint32_t p = 0; p < output->num_parts; p++) {
        const ql_exr_output_part *part = &output->parts[p];
        for (uint32_t c = 0; c < part->num_chunks; c++) ql_exr_bytes_append_u64(out, part->offsets[c]);
    }
}
