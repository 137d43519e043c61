/* SPDX-License-Identifier: Apache-2.0 */
/* OpenEXRCore's pipelines, used from compressed bytes to lines and back: they unpack nothing, because a copy between
 * two files needs no unpacking, and a frame's planes are filled by plain copies of rows. */
#include "exr/chunk.h"

#include <string.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "EXR lines are little-endian, and this code copies them as they are"
#endif

/* ---- Decoding ---------------------------------------------------------------------------------------------------- */

void ql_exr_decoder_close(ql_exr_source *source, ql_exr_decoder *decoder)
{
    if (decoder->is_open) exr_decoding_destroy(source->context, &decoder->pipeline);
    decoder->is_open = 0;
    decoder->chunk = -1;
}

/* Buffers of the pipeline that outlive a change of part: they are the worker's largest memory. */
typedef struct kept_buffers {
    void *packed, *unpacked, *scratch_1, *scratch_2;
    size_t packed_bytes, unpacked_bytes, scratch_1_bytes, scratch_2_bytes;
} kept_buffers;

static kept_buffers take_buffers(exr_decode_pipeline_t *pipeline)
{
    if (pipeline->unpacked_alloc_size == 0) pipeline->unpacked_buffer = NULL; /* an alias of the packed one */
    const kept_buffers kept = {
        .packed = pipeline->packed_buffer,
        .unpacked = pipeline->unpacked_buffer,
        .scratch_1 = pipeline->scratch_buffer_1,
        .scratch_2 = pipeline->scratch_buffer_2,
        .packed_bytes = pipeline->packed_alloc_size,
        .unpacked_bytes = pipeline->unpacked_alloc_size,
        .scratch_1_bytes = pipeline->scratch_alloc_size_1,
        .scratch_2_bytes = pipeline->scratch_alloc_size_2,
    };
    pipeline->packed_buffer = pipeline->unpacked_buffer = NULL;
    pipeline->scratch_buffer_1 = pipeline->scratch_buffer_2 = NULL;
    return kept;
}

static void give_buffers(exr_decode_pipeline_t *pipeline, const kept_buffers *kept)
{
    pipeline->packed_buffer = kept->packed;
    pipeline->unpacked_buffer = kept->unpacked;
    pipeline->scratch_buffer_1 = kept->scratch_1;
    pipeline->scratch_buffer_2 = kept->scratch_2;
    pipeline->packed_alloc_size = kept->packed_bytes;
    pipeline->unpacked_alloc_size = kept->unpacked_bytes;
    pipeline->scratch_alloc_size_1 = kept->scratch_1_bytes;
    pipeline->scratch_alloc_size_2 = kept->scratch_2_bytes;
}

static exr_result_t point_at(ql_exr_source *source, ql_exr_decoder *decoder, uint32_t part,
                             const exr_chunk_info_t *chunk)
{
    exr_decode_pipeline_t *pipeline = &decoder->pipeline;
    if (decoder->is_open && decoder->part == part) {
        return exr_decoding_update(source->context, (int)part, chunk, pipeline);
    }
    kept_buffers kept = {0};
    if (decoder->is_open) {
        kept = take_buffers(pipeline);
        exr_decoding_destroy(source->context, pipeline);
    }
    memset(pipeline, 0, sizeof *pipeline);
    pipeline->pipe_size = sizeof *pipeline;
    exr_result_t code = exr_decoding_initialize(source->context, (int)part, chunk, pipeline);
    if (code == EXR_ERR_SUCCESS) {
        /* No channel has a place to go to, which chooses plain reading and decompressing, and an unpacker to drop. */
        code = exr_decoding_choose_default_routines(source->context, (int)part, pipeline);
        pipeline->unpack_and_convert_fn = NULL;
    } else {
        pipeline->context = source->context; /* destroy frees through it */
        pipeline->part_index = (int)part;
    }
    give_buffers(pipeline, &kept);
    decoder->is_open = 1;
    decoder->part = part;
    return code;
}

quell_status ql_exr_decode(ql_exr_source *source, ql_exr_decoder *decoder, uint32_t part_index, int32_t chunk,
                           ql_exr_lines *out, ql_error *err)
{
    const ql_exr_part *part = &source->parts[part_index];
    const uint32_t first = (uint32_t)chunk * (uint32_t)part->lines_per_chunk;
    const uint32_t left = part->height - first;
    out->first = first;
    out->count = left < (uint32_t)part->lines_per_chunk ? left : (uint32_t)part->lines_per_chunk;
    if (decoder->is_open && decoder->part == part_index && decoder->chunk == chunk) {
        out->data = decoder->pipeline.unpacked_buffer;
        return QUELL_OK;
    }

    char where[1200];
    const int p = (int)part_index;
    exr_chunk_info_t info = {0};
    decoder->chunk = -1;
    ql_exr_messages_clear(&source->messages);
    const int y = (int)((int64_t)part->window.min.y + first);
    exr_result_t code = exr_read_scanline_chunk_info(source->context, p, y, &info);
    /* OpenEXR takes an empty chunk as done and leaves its lines undefined. */
    if (code == EXR_ERR_SUCCESS && (info.packed_size == 0 || info.unpacked_size != part->line_bytes * out->count ||
                                    (uint32_t)info.height != out->count)) {
        code = EXR_ERR_BAD_CHUNK_LEADER;
    }
    if (code == EXR_ERR_SUCCESS && part->compression == EXR_COMPRESSION_NONE &&
        info.packed_size != info.unpacked_size) {
        code = EXR_ERR_BAD_CHUNK_LEADER;
    }
    if (code == EXR_ERR_SUCCESS) code = point_at(source, decoder, part_index, &info);
    if (code == EXR_ERR_SUCCESS) code = exr_decoding_run(source->context, p, &decoder->pipeline);
    if (code != EXR_ERR_SUCCESS) {
        ql_exr_source_where(source, part_index, where, sizeof where);
        return ql_exr_fail(&source->messages, code, QUELL_ERR_FILE_READ, where, err);
    }
    decoder->chunk = chunk;
    out->data = decoder->pipeline.unpacked_buffer;
    return QUELL_OK;
}

/* ---- Encoding ---------------------------------------------------------------------------------------------------- */

void ql_exr_codec_close(ql_exr_codec *codec)
{
    if (codec->context) exr_finish(&codec->context);
}

quell_status ql_exr_codec_open(ql_exr_codec *codec, ql_exr_messages *messages, const exr_attr_box2i_t *window,
                               exr_compression_t compression, float dwa_level, const ql_exr_channel *channels,
                               uint32_t num_channels, const char *where, ql_error *err)
{
    const exr_attr_v2f_t center = {.x = 0.0f, .y = 0.0f};
    const int lines = exr_compression_lines_per_chunk(compression);
    const uint32_t width = (uint32_t)((int64_t)window->max.x - window->min.x + 1);
    exr_context_initializer_t start = EXR_DEFAULT_CONTEXT_INITIALIZER;
    start.error_handler_fn = ql_exr_error_handler;
    start.user_data = messages;

    *codec = (ql_exr_codec){.messages = messages, .compression = compression};
    if (lines < 1) return ql_fail(err, QUELL_ERR_UNSUPPORTED, "%s: unknown compression", where);
    codec->height = (uint32_t)((int64_t)window->max.y - window->min.y + 1);
    codec->lines_per_chunk = (uint32_t)lines;
    codec->num_chunks = (codec->height - 1) / codec->lines_per_chunk + 1;

    exr_result_t code = exr_start_temporary_context(&codec->context, where, &start);
    if (code == EXR_ERR_SUCCESS) code = exr_set_longname_support(codec->context, 1);
    if (code == EXR_ERR_SUCCESS) {
        code = exr_initialize_required_attr(codec->context, 0, window, window, 1.0f, &center, 1.0f,
                                            EXR_LINEORDER_INCREASING_Y, compression);
    }
    for (uint32_t c = 0; c < num_channels && code == EXR_ERR_SUCCESS; c++) {
        const exr_perceptual_treatment_t treatment =
            channels[c].is_linear ? EXR_PERCEPTUALLY_LINEAR : EXR_PERCEPTUALLY_LOGARITHMIC;
        code = exr_add_channel(codec->context, 0, channels[c].name, channels[c].type, treatment, 1, 1);
        codec->line_bytes += (size_t)width * ql_exr_value_bytes(channels[c].type);
    }
    if (code == EXR_ERR_SUCCESS && dwa_level >= 0.0f) {
        code = exr_set_dwa_compression_level(codec->context, 0, dwa_level);
    }
    if (code == EXR_ERR_SUCCESS) {
        code = exr_chunk_default_initialize(codec->context, 0, window, 0, 0, &codec->first_chunk);
    }
    if (code == EXR_ERR_SUCCESS) return QUELL_OK;
    ql_exr_codec_close(codec);
    return ql_exr_fail(messages, code, QUELL_ERR_FILE_WRITE, where, err);
}

/* What the packing callback needs besides the pipeline. */
typedef struct packing {
    ql_exr_fill_fn fill;
    void *user;
    uint32_t first;
    size_t num_bytes;
    ql_error error;
} packing;

static exr_result_t pack_lines(struct _exr_encode_pipeline *pipeline)
{
    packing *job = pipeline->encoding_user_data;
    const uint32_t count = (uint32_t)pipeline->chunk.height;
    if (pipeline->packed_alloc_size < job->num_bytes) return EXR_ERR_INVALID_ARGUMENT;
    if (job->fill(job->user, job->first, count, pipeline->packed_buffer, &job->error) != QUELL_OK) {
        return EXR_ERR_UNKNOWN;
    }
    pipeline->packed_bytes = job->num_bytes;
    return EXR_ERR_SUCCESS;
}

void ql_exr_encoder_close(ql_exr_encoder *encoder)
{
    if (encoder->codec) exr_encoding_destroy(encoder->codec->context, &encoder->pipeline);
    encoder->codec = NULL;
}

static exr_result_t aim_at(const ql_exr_codec *codec, ql_exr_encoder *encoder, const exr_chunk_info_t *chunk)
{
    exr_encode_pipeline_t *pipeline = &encoder->pipeline;
    exr_result_t code;
    if (encoder->codec == codec) {
        code = exr_encoding_update(codec->context, 0, chunk, pipeline);
    } else {
        ql_exr_encoder_close(encoder);
        memset(pipeline, 0, sizeof *pipeline);
        pipeline->pipe_size = sizeof *pipeline;
        code = exr_encoding_initialize(codec->context, 0, chunk, pipeline);
        if (code != EXR_ERR_SUCCESS) return code;
        encoder->codec = codec;
        pipeline->convert_and_pack_fn = pack_lines;
        pipeline->compress_fn = codec->compression == EXR_COMPRESSION_NONE ? NULL : exr_compress_chunk;
    }
    for (int16_t c = 0; c < pipeline->channel_count; c++) { /* read by no one, but checked */
        exr_coding_channel_info_t *channel = &pipeline->channels[c];
        channel->encode_from_ptr = (const uint8_t *)codec;
        channel->user_bytes_per_element = channel->bytes_per_element;
        channel->user_data_type = channel->data_type;
    }
    return code;
}

quell_status ql_exr_encode(const ql_exr_codec *codec, ql_exr_encoder *encoder, uint32_t chunk, ql_exr_fill_fn fill,
                           void *user, const char *where, const void **data, size_t *num_bytes, ql_error *err)
{
    const uint32_t first = chunk * codec->lines_per_chunk;
    const uint32_t left = codec->height - first;
    const uint32_t count = left < codec->lines_per_chunk ? left : codec->lines_per_chunk;
    exr_chunk_info_t info = codec->first_chunk;
    info.idx = (int32_t)chunk;
    info.start_y += (int32_t)first;
    info.height = (int32_t)count;
    info.unpacked_size = codec->line_bytes * count;

    packing job = {.fill = fill, .user = user, .first = first, .num_bytes = codec->line_bytes * count};
    ql_exr_messages_clear(codec->messages);
    exr_result_t code = aim_at(codec, encoder, &info);
    encoder->pipeline.encoding_user_data = &job;
    if (code == EXR_ERR_SUCCESS) code = exr_encoding_run(codec->context, 0, &encoder->pipeline);
    encoder->pipeline.encoding_user_data = NULL;
    if (job.error.status != QUELL_OK) return ql_fail(err, job.error.status, "%s", job.error.text);
    if (code != EXR_ERR_SUCCESS) return ql_exr_fail(codec->messages, code, QUELL_ERR_FILE_WRITE, where, err);
    /* A chunk of the full size is read as raw lines, whatever the codec. B44 among others may come out at that size,
     * ordered by channel: such chunks must be stored raw. */
    const int is_smaller = encoder->pipeline.compressed_bytes < job.num_bytes;
    *data = is_smaller ? encoder->pipeline.compressed_buffer : encoder->pipeline.packed_buffer;
    *num_bytes = is_smaller ? encoder->pipeline.compressed_bytes : job.num_bytes;
    return QUELL_OK;
}
