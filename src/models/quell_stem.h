/* SPDX-License-Identifier: Apache-2.0 */
/* Where features enter the U-Net: a convolution to half resolution. */
#ifndef QL_MODELS_QUELL_STEM_H
#define QL_MODELS_QUELL_STEM_H

#include "models/quell_net.h"

/* Fills out, which has its size, half the region's, and its kind of values. flags, source, user: as in ql_net_run. */
quell_status ql_net_stem(const ql_net *net, const ql_kernels *kernels, ql_env *env, const float *flags,
                         ql_feature_source_fn *source, void *user, const ql_map *out, ql_error *err);
uint64_t ql_net_stem_bytes(const ql_net *net, uint32_t width, uint32_t num_workers);

#endif
