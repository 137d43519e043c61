/* SPDX-License-Identifier: Apache-2.0 */
/* Multilayer EXR files in and out, by OpenEXRCore. The only folder that includes OpenEXR. */
#ifndef QL_EXR_EXR_H
#define QL_EXR_EXR_H

#include "base/pool.h"
#include "frame/frame.h"

/* Opens and decodes the layers whose role a denoise can use (all but QUELL_ROLE_OTHER), in their own type (half stays
 * half), chunks in parallel. The file stays open in frame->source. */
quell_status ql_exr_read(ql_env *env, const char *path, uint64_t max_image_pixels, ql_frame **out, ql_error *err);

/* Decodes one layer that ql_exr_read left out. Does nothing when it has pixels. */
quell_status ql_exr_load_layer(ql_env *env, ql_frame *frame, uint32_t index, ql_error *err);

/* Writes the frame; see quell_frame_write_exr. */
quell_status ql_exr_write(ql_env *env, ql_frame *frame, const char *path, int32_t codec, ql_error *err);

#endif
