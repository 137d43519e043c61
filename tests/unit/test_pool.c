/* SPDX-License-Identifier: Apache-2.0 */
#include "base/clock.h"
#include "base/cpu.h"
#include "base/os.h"
#include "base/pool.h"

#include "cmocka_all.h"

#include <string.h>
#include <time.h>

#define NUM_TASKS 1000

typedef struct counters {
    atomic_int runs[NUM_TASKS];
    atomic_int bad_worker;
    uint32_t num_threads;
    atomic_int *cancel;
} counters;

static void count_task(void *user, uint32_t task, uint32_t worker)
{
    counters *c = user;
    atomic_fetch_add(&c->runs[task], 1);
    if (worker >= c->num_threads) atomic_store(&c->bad_worker, 1);
}

static void every_task_runs_once(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    for (uint32_t threads = 1; threads <= 9; threads += 4) {
        ql_pool *pool;
        ql_error err;
        assert_int_equal(ql_pool_create(threads, &memory, &pool, &err), QUELL_OK);
        assert_int_equal(ql_pool_num_threads(pool), threads);
        counters c;
        memset(&c, 0, sizeof c);
        c.num_threads = threads;
        for (int round = 0; round < 200; round++) ql_pool_run(pool, NUM_TASKS, count_task, &c);
        ql_pool_run(pool, 0, count_task, &c);
        ql_pool_run(pool, 1, count_task, &c);
        for (int i = 0; i < NUM_TASKS; i++) assert_int_equal(c.runs[i], i == 0 ? 201 : 200);
        assert_int_equal(c.bad_worker, 0);
        ql_pool_destroy(pool);
    }
    assert_int_equal(memory.used_bytes, 0);
}

static void pool_of_nothing_is_refused(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    ql_pool *pool = (ql_pool *)&memory;
    ql_error err;
    assert_int_equal(ql_pool_create(0, &memory, &pool, &err), QUELL_ERR_INVALID_ARGUMENT);
    assert_null(pool);
    for (int n = 1; n <= 2; n++) {
        memory.fail_at = n;
        assert_int_equal(ql_pool_create(3, &memory, &pool, &err), QUELL_ERR_OUT_OF_MEMORY);
        assert_null(pool);
    }
    assert_int_equal(memory.used_bytes, 0);
    ql_pool_destroy(NULL);
}

typedef struct progress_log {
    double last;
    int num_calls, num_backwards, cancel_at_call;
} progress_log;

static int32_t log_progress(void *user, double fraction)
{
    progress_log *log = user;
    log->num_calls++;
    if (fraction < log->last) log->num_backwards++;
    log->last = fraction;
    return log->cancel_at_call && log->num_calls >= log->cancel_at_call;
}

static void sleep_task(void *user, uint32_t task, uint32_t worker)
{
    counters *c = user;
    (void)worker;
    atomic_fetch_add(&c->runs[task], 1);
    const struct timespec wait = {0, 1000000};
    nanosleep(&wait, NULL);
    if (c->cancel && task == 20) atomic_store(c->cancel, 1);
}

static void progress_rises_and_is_rare(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    ql_pool *pool;
    assert_int_equal(ql_pool_create(2, &memory, &pool, NULL), QUELL_OK);
    atomic_int cancel = 0;
    progress_log log = {0};
    counters c;
    memset(&c, 0, sizeof c);
    ql_env env = {.memory = &memory, .pool = pool, .cancel = &cancel, .progress = log_progress, .progress_user = &log};
    const double start = ql_clock_seconds();
    env.progress_from = 0.0;
    env.progress_to = 0.5;
    assert_int_equal(ql_env_run(&env, 400, sleep_task, &c), QUELL_OK);
    env.progress_from = 0.4; /* a careless caller: the bar must not go back */
    env.progress_to = 1.0;
    assert_int_equal(ql_env_run(&env, 400, sleep_task, &c), QUELL_OK);
    const double seconds = ql_clock_seconds() - start;
    assert_int_equal(log.num_backwards, 0);
    assert_true(log.last == 1.0);
    assert_true(log.num_calls >= 2 && log.num_calls <= 3 + (int)(seconds * 10.0));
    ql_pool_destroy(pool);
}

static void cancel_stops_soon(void **state)
{
    (void)state;
    ql_memory memory;
    ql_memory_init(&memory, 0);
    ql_pool *pool;
    assert_int_equal(ql_pool_create(2, &memory, &pool, NULL), QUELL_OK);
    atomic_int cancel = 0;
    progress_log log = {.cancel_at_call = 1};
    counters c;
    memset(&c, 0, sizeof c);
    ql_env env = {.memory = &memory, .pool = pool, .cancel = &cancel, .progress = log_progress, .progress_user = &log};
    env.progress_to = 1.0;
    assert_int_equal(ql_env_run(&env, NUM_TASKS, sleep_task, &c), QUELL_ERR_CANCELLED);
    assert_int_equal(log.num_calls, 1); /* none follows */
    assert_int_equal(ql_env_progress(&env, 1.0), QUELL_ERR_CANCELLED);
    assert_int_equal(log.num_calls, 1);
    assert_int_equal(c.runs[NUM_TASKS - 1], 0);

    cancel = 0;
    memset(&c, 0, sizeof c);
    c.cancel = &cancel;
    env.progress = NULL;
    assert_int_equal(ql_env_run(&env, NUM_TASKS, sleep_task, &c), QUELL_ERR_CANCELLED);
    assert_int_equal(c.runs[NUM_TASKS - 1], 0);
    assert_true(ql_env_is_cancelled(&env));
    ql_pool_destroy(pool);
}

static void probe_is_consistent(void **state)
{
    (void)state;
    const uint32_t cpu = ql_cpu_probe();
    if (cpu & QL_CPU_AVX512_BF16) assert_true(cpu & QL_CPU_AVX512);
    if (cpu & QL_CPU_AVX512) assert_true(cpu & QL_CPU_AVX2);
    assert_true(ql_os_num_cores() >= 1);
}

static void errors_are_one_valid_line(void **state)
{
    (void)state;
    ql_error err;
    assert_int_equal(ql_fail(&err, QUELL_ERR_FILE_READ, "%s: part %d", "a\nb.exr", 3), QUELL_ERR_FILE_READ);
    assert_string_equal(err.text, "a?b.exr: part 3");
    assert_int_equal(ql_fail(NULL, QUELL_ERR_INTERNAL, "x"), QUELL_ERR_INTERNAL);
    char name[2001];
    for (int i = 0; i < 2000; i += 2) memcpy(name + i, "\xc3\xa4", 2);
    name[2000] = '\0';
    for (int prefix = 0; prefix < 2; prefix++) {
        (void)ql_fail(&err, QUELL_ERR_FILE_READ, "%.*s%s", prefix, "x", name);
        const size_t length = strlen(err.text);
        assert_int_equal(((int)length - prefix) % 2, 0); /* no half of a character at the end */
        assert_true(length >= QL_ERROR_TEXT_BYTES - 3);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_task_runs_once),       cmocka_unit_test(pool_of_nothing_is_refused),
        cmocka_unit_test(progress_rises_and_is_rare), cmocka_unit_test(cancel_stops_soon),
        cmocka_unit_test(probe_is_consistent),        cmocka_unit_test(errors_are_one_valid_line),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
