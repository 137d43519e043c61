/* SPDX-License-Identifier: Apache-2.0 */
/* Threads that sleep on a condition variable until there is a job, and take its tasks from one atomic counter. A
 * worker that wakes too late finds no job and sleeps on: the caller waits only for workers that have joined, so a busy
 * machine does not delay a small job. */
#include "base/pool.h"

#include "base/clock.h"
#include "base/os.h"

#include <pthread.h>

/* At most this often does the caller's callback run: it may redraw a window. */
#define PROGRESS_INTERVAL_SECONDS 0.1

typedef struct pool_worker {
    struct ql_pool *pool;
    uint32_t index;
    pthread_t thread;
} pool_worker;

struct ql_pool {
    ql_memory *memory;
    uint32_t num_threads;
    uint32_t num_started; /* threads to join, at most num_threads - 1 */
    pool_worker *workers; /* [num_threads - 1] */

    pthread_mutex_t lock;
    pthread_cond_t wake; /* a job has begun, or the pool ends */
    pthread_cond_t idle; /* the last worker has left the job */
    uint64_t generation; /* number of the job; under lock, as all below but next_task */
    uint32_t num_joined; /* workers inside the job */
    int is_open;         /* whether workers may join the job */
    int is_ending;

    ql_task_fn fn;
    void *user;
    uint32_t num_tasks;
    atomic_uint_fast64_t next_task; /* 64 bits: every worker adds once past the end */
};

static void run_tasks(ql_pool *pool, uint32_t worker)
{
    const uint32_t num_tasks = pool->num_tasks;
    const ql_task_fn fn = pool->fn;
    void *user = pool->user;
    for (;;) {
        const uint64_t task = (uint64_t)atomic_fetch_add_explicit(&pool->next_task, 1, memory_order_relaxed);
        if (task >= num_tasks) return;
        fn(user, (uint32_t)task, worker);
    }
}

static void *worker_main(void *argument)
{
    const pool_worker *worker = argument;
    ql_pool *pool = worker->pool;
    uint64_t seen = 0;

    pthread_mutex_lock(&pool->lock);
    for (;;) {
        while (!pool->is_ending && (!pool->is_open || pool->generation == seen)) {
            pthread_cond_wait(&pool->wake, &pool->lock);
        }
        if (pool->is_ending) break;
        seen = pool->generation;
        pool->num_joined++;
        pthread_mutex_unlock(&pool->lock);

        run_tasks(pool, worker->index);

        pthread_mutex_lock(&pool->lock);
        if (--pool->num_joined == 0) pthread_cond_signal(&pool->idle);
    }
    pthread_mutex_unlock(&pool->lock);
    return NULL;
}

static int start_threads(ql_pool *pool)
{
    int failed = 0;
    for (uint32_t i = 0; i + 1 < pool->num_threads && !failed; i++) {
        pool_worker *worker = &pool->workers[i];
        worker->pool = pool;
        worker->index = i + 1;
        failed = ql_os_start_thread(&worker->thread, worker_main, worker);
        if (!failed) pool->num_started++;
    }
    return failed ? -1 : 0;
}

quell_status ql_pool_create(uint32_t num_threads, ql_memory *memory, ql_pool **out, ql_error *err)
{
    *out = NULL;
    if (num_threads == 0) return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "a pool needs at least one thread");

    ql_pool *pool = ql_alloc_zero(memory, 1, sizeof *pool);
    if (!pool) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a pool of threads");
    pool->memory = memory;
    pool->num_threads = num_threads;
    atomic_init(&pool->next_task, 0);
    pool->workers = ql_alloc_zero(memory, num_threads - 1, sizeof *pool->workers);
    if (!pool->workers) goto fail_memory;
    if (pthread_mutex_init(&pool->lock, NULL) != 0) goto fail_workers;
    if (pthread_cond_init(&pool->wake, NULL) != 0) goto fail_lock;
    if (pthread_cond_init(&pool->idle, NULL) != 0) goto fail_wake;

    if (start_threads(pool) != 0) {
        ql_pool_destroy(pool);
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "the system refused to start %u threads", num_threads);
    }
    *out = pool;
    return QUELL_OK;

fail_wake:
    pthread_cond_destroy(&pool->wake);
fail_lock:
    pthread_mutex_destroy(&pool->lock);
fail_workers:
    ql_free(memory, pool->workers);
fail_memory:
    ql_free(memory, pool);
    return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a pool of %u threads", num_threads);
}

void ql_pool_destroy(ql_pool *pool)
{
    if (!pool) return;
    pthread_mutex_lock(&pool->lock);
    pool->is_ending = 1;
    pthread_cond_broadcast(&pool->wake);
    pthread_mutex_unlock(&pool->lock);
    for (uint32_t i = 0; i < pool->num_started; i++) pthread_join(pool->workers[i].thread, NULL);

    pthread_cond_destroy(&pool->idle);
    pthread_cond_destroy(&pool->wake);
    pthread_mutex_destroy(&pool->lock);
    ql_memory *memory = pool->memory;
    ql_free(memory, pool->workers);
    ql_free(memory, pool);
}

uint32_t ql_pool_num_threads(const ql_pool *pool)
{
    return pool->num_threads;
}

void ql_pool_run(ql_pool *pool, uint32_t num_tasks, ql_task_fn fn, void *user)
{
    if (num_tasks == 0) return;
    if (num_tasks == 1 || pool->num_started == 0) {
        for (uint32_t task = 0; task < num_tasks; task++) fn(user, task, 0);
        return;
    }

    pthread_mutex_lock(&pool->lock);
    pool->fn = fn;
    pool->user = user;
    pool->num_tasks = num_tasks;
    atomic_store_explicit(&pool->next_task, 0, memory_order_relaxed);
    pool->generation++;
    pool->is_open = 1;
    pthread_cond_broadcast(&pool->wake);
    pthread_mutex_unlock(&pool->lock);

    run_tasks(pool, 0);

    pthread_mutex_lock(&pool->lock);
    pool->is_open = 0;
    while (pool->num_joined > 0) pthread_cond_wait(&pool->idle, &pool->lock);
    pthread_mutex_unlock(&pool->lock);
}

/* ---- Progress and cancel ----------------------------------------------------------------------------------------- */

typedef struct env_job {
    ql_env *env;
    ql_task_fn fn;
    void *user;
    uint32_t num_tasks;
    atomic_uint_fast32_t num_done;
    atomic_int stop;
} env_job;

static void env_task(void *user, uint32_t task, uint32_t worker)
{
    env_job *job = user;
    if (atomic_load_explicit(&job->stop, memory_order_relaxed) || ql_env_is_cancelled(job->env)) return;

    job->fn(job->user, task, worker);
    const uint32_t done = (uint32_t)atomic_fetch_add(&job->num_done, 1) + 1;
    if (worker != 0) return;

    const double fraction = (double)done / (double)job->num_tasks;
    if (ql_env_progress(job->env, fraction) != QUELL_OK) atomic_store(&job->stop, 1);
}

int ql_env_is_cancelled(const ql_env *env)
{
    return env->cancel && atomic_load_explicit(env->cancel, memory_order_relaxed) != 0;
}

quell_status ql_env_progress(ql_env *env, double fraction)
{
    if (ql_env_is_cancelled(env)) return QUELL_ERR_CANCELLED;
    if (!env->progress) return QUELL_OK;

    if (!(fraction > 0.0)) fraction = 0.0;
    if (fraction > 1.0) fraction = 1.0;
    double whole = env->progress_from + (env->progress_to - env->progress_from) * fraction;
    if (!(whole > env->progress_last)) whole = env->progress_last;

    const double now = ql_clock_seconds();
    const int is_last = whole >= 1.0 && env->progress_last < 1.0;
    const int is_first = !(env->progress_time > 0.0);
    if (!is_first && !is_last && now - env->progress_time < PROGRESS_INTERVAL_SECONDS) return QUELL_OK;

    env->progress_time = now;
    env->progress_last = whole;
    const int wants_stop = env->progress(env->progress_user, whole) != 0;
    if (wants_stop && env->cancel) atomic_store(env->cancel, 1); /* so that no callback follows */
    return wants_stop || ql_env_is_cancelled(env) ? QUELL_ERR_CANCELLED : QUELL_OK;
}

quell_status ql_env_run(ql_env *env, uint32_t num_tasks, ql_task_fn fn, void *user)
{
    env_job job = {.env = env, .fn = fn, .user = user, .num_tasks = num_tasks};
    atomic_init(&job.num_done, 0);
    atomic_init(&job.stop, 0);
    if (ql_env_is_cancelled(env)) return QUELL_ERR_CANCELLED;

    ql_pool_run(env->pool, num_tasks, env_task, &job);
    if (atomic_load(&job.stop)) return QUELL_ERR_CANCELLED;
    return ql_env_progress(env, 1.0);
}
