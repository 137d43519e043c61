/* SPDX-License-Identifier: Apache-2.0 */
/* From the channels of a file to the layers of a frame. */
#ifndef QL_EXR_LAYERS_H
#define QL_EXR_LAYERS_H

#include "exr/source.h"

/* Sets the frame's size and lists the layers of source's parts in it, without pixels. What cannot be listed - names
 * without a channel letter, tiled or deep parts, parts of another size - stays in the file and is logged. */
quell_status ql_exr_list_layers(ql_env *env, ql_exr_source *source, ql_frame *frame, ql_error *err);

#endif
