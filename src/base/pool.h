/* SPDX-License-Identifier: Apache-2.0 */
/* A small pool of threads owned by a context. Which thread runs which task is not fixed, so a task's result may depend
 * on its index alone, never on its worker. */
#ifndef QL_BASE_POOL_H
#define QL_BASE_POOL_H

#include "base/memory.h"
#include "base/status.h"

#include <stdatomic.h>
#include <stdint.h>

typedef struct ql_pool ql_pool;

/* num_threads includes the calling thread: 1 makes no thread. */
quell_status ql_pool_create(uint32_t num_threads, ql_memory *memory, ql_pool **out, ql_error *err);
void ql_pool_destroy(ql_pool *pool);
uint32_t ql_pool_num_threads(const ql_pool *pool);

/* task: 0 .. num_tasks - 1; worker: 0 .. num_threads - 1, 0 being the calling thread. */
typedef void (*ql_task_fn)(void *user, uint32_t task, uint32_t worker);

/* Runs all tasks, taken in rising order, and returns when the last has ended. Not reentrant: a task must not call it. */
void ql_pool_run(ql_pool *pool, uint32_t num_tasks, ql_task_fn fn, void *user);

/* What a long call needs from its surroundings; lent by the context. */
typedef struct ql_env {
    ql_memory *memory;
    ql_pool *pool;
    atomic_int *cancel; /* non-zero: stop at the next task */
    quell_progress_fn progress;
    void *progress_user;
    double progress_from, progress_to; /* the part of the bar that belongs to the present step */
    double progress_last;              /* the last fraction that the callback saw, of the whole bar */
    double progress_time;              /* when it saw it; 0: not yet */
    quell_log_fn log;
    void *log_user;
} ql_env;

/* Reports fraction (0..1 of the present step) to the caller's callback, from the calling thread only and a few times a
 * second at most, and returns QUELL_ERR_CANCELLED when the job is to stop. */
quell_status ql_env_progress(ql_env *env, double fraction);
int ql_env_is_cancelled(const ql_env *env);

/* Like ql_pool_run, but stops early on cancel and reports progress while it runs (worker 0 does). */
quell_status ql_env_run(ql_env *env, uint32_t num_tasks, ql_task_fn fn, void *user);

#endif
