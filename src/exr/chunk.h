/* SPDX-License-Identifier: Apache-2.0 */
/* One chunk of scanlines: out of a file, or into bytes that a file can hold. Lines are in the file's own order: for each
 * line, for each channel in the order of the channel list, one packed row of the channel's type, little-endian. */
#ifndef QL_EXR_CHUNK_H
#define QL_EXR_CHUNK_H

#include "exr/source.h"

/* A worker's own: a pipeline that keeps its buffers, and the chunk that it decoded last. All zero to begin with. */
typedef struct ql_exr_decoder {
    exr_decode_pipeline_t pipeline;
    int is_open;
    uint32_t part;
    int32_t chunk; /* once open; -1: none */
} ql_exr_decoder;

typedef struct ql_exr_lines {
    const uint8_t *data;   /* lent until the decoder's next call */
    uint32_t first, count; /* lines, counted from the top of the data window */
} ql_exr_lines;

/* Decodes a chunk of a plain part; does nothing when it is the one decoded last. */
quell_status ql_exr_decode(ql_exr_source *source, ql_exr_decoder *decoder, uint32_t part, int32_t chunk,
                           ql_exr_lines *out, ql_error *err);
void ql_exr_decoder_close(ql_exr_source *source, ql_exr_decoder *decoder);

/* How a part of an output is encoded; shared by workers, constant. */
typedef struct ql_exr_codec {
    exr_context_t context; /* a temporary context of OpenEXR with one part, no file */
    ql_exr_messages *messages;
    exr_chunk_info_t first_chunk;
    exr_compression_t compression;
    uint32_t height, lines_per_chunk, num_chunks;
    size_t line_bytes;
} ql_exr_codec;

typedef struct ql_exr_channel {
    const char *name;
    exr_pixel_type_t type;
    uint8_t is_linear; /* OpenEXR's pLinear, as it was in the source */
} ql_exr_channel;

/* channels: sorted by name. messages: receives OpenEXR's errors; lent. dwa_level: below 0 for OpenEXR's own. */
quell_status ql_exr_codec_open(ql_exr_codec *codec, ql_exr_messages *messages, const exr_attr_box2i_t *window,
                               exr_compression_t compression, float dwa_level, const ql_exr_channel *channels,
                               uint32_t num_channels, const char *where, ql_error *err);
void ql_exr_codec_close(ql_exr_codec *codec);

typedef struct ql_exr_encoder {
    exr_encode_pipeline_t pipeline;
    const ql_exr_codec *codec; /* NULL: not open */
} ql_exr_encoder;

/* Fills `count` lines from line `first` on. */
typedef quell_status (*ql_exr_fill_fn)(void *user, uint32_t first, uint32_t count, uint8_t *lines, ql_error *err);

/* Encodes one chunk. *data is lent until the encoder's next call. */
quell_status ql_exr_encode(const ql_exr_codec *codec, ql_exr_encoder *encoder, uint32_t chunk, ql_exr_fill_fn fill,
                           void *user, const char *where, const void **data, size_t *num_bytes, ql_error *err);
void ql_exr_encoder_close(ql_exr_encoder *encoder);

#endif
