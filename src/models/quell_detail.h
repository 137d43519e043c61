/* SPDX-License-Identifier: Apache-2.0 */
/* The embedding's share at full resolution: convolutions of the guides that follow edges, and of what the U-Net says lies
 * around. */
#ifndef QL_MODELS_QUELL_DETAIL_H
#define QL_MODELS_QUELL_DETAIL_H

#include "models/quell_net.h"

/* Fills maps->embedding, which has its size; maps->level[0] holds the U-Net's result. source, user: as in ql_net_run. */
quell_status ql_net_detail(const ql_net *net, const ql_kernels *kernels, ql_env *env, ql_feature_source_fn *source,
                           void *user, const ql_net_maps *maps, ql_error *err);
uint64_t ql_net_detail_bytes(const ql_net *net, uint32_t width, uint32_t num_workers);

#endif
