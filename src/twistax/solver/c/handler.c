/* What XLA calls: all members of a batch, by threads of its pool. */
#include "ffi.h"
#include "members.h"
#include <string.h>

/* ---- members by threads --------------------------------------------------------------------------------------- */

/* Whoever comes takes members until none is left. The thread that started waits only for members that others work on,
 * never for tasks that the pool has not begun: these have nothing to do. A job is free again after the last of them. */
typedef struct {
  int64_t holders, next, done, places, count, each;
  const twx_form *form;
  const double *rows;
  double *results, *memory;
  size_t row, result, memory_size;
} twx_job;

static void work(twx_job *job) {
  double *memory = NULL;
  for (;;) {
    const int64_t i = __atomic_fetch_add(&job->next, 1, __ATOMIC_ACQ_REL);
    if (i >= job->count) return;
    if (!memory) memory = job->memory + (size_t)__atomic_fetch_add(&job->places, 1, __ATOMIC_ACQ_REL) * job->memory_size;
    const double *const row = job->rows + (size_t)i * job->row;
    double *const result = job->results + (size_t)i * job->result;
    if (job->each < 0) twx_solve_members(job->form, 1, row, result, memory);
    else twx_linearised_members(job->form, 1, job->each, row, result, memory);
    __atomic_fetch_add(&job->done, 1, __ATOMIC_ACQ_REL);
  }
}

static void release(twx_job *job, int64_t holders) { __atomic_fetch_sub(&job->holders, holders, __ATOMIC_ACQ_REL); }

static void task(void *data) { work(data), release(data, 1); }

/* A job that nobody holds, or NULL. */
static twx_job *claimed(const twx_form *form, int64_t holders) {
  for (int64_t i = 0; i < TWX_JOBS; i++) {
    twx_job *const job = (twx_job *)(void *)(form->jobs + i * TWX_JOB_WORDS);
    int64_t nobody = 0;
    if (__atomic_compare_exchange_n(&job->holders, &nobody, holders, 0, __ATOMIC_ACQ_REL, __ATOMIC_RELAXED)) return job;
  }
  return NULL;
}

static void drop(const twx_ffi_api *api, void *error) {
  twx_ffi_dropped dropped = {sizeof dropped, NULL, error};
  if (error) api->drop(&dropped);
}

typedef char twx_job_fits[sizeof(twx_job) <= sizeof(int64_t) * TWX_JOB_WORDS ? 1 : -1];

extern int sched_yield(void);

static void run(const twx_ffi_frame *frame, const twx_job *of, int64_t places) {
  const twx_ffi_api *const api = frame->api;
  int64_t threads = 1;
  twx_ffi_threads asked = {sizeof asked, NULL, frame->context, &threads};
  void *const unknown = api->threads(&asked);
  if (unknown) drop(api, unknown), threads = 1;
  threads = threads < places ? threads : places, threads = threads < of->count ? threads : of->count;
  twx_job *const job = threads > 1 ? claimed(of->form, threads) : NULL;
  if (!job) {
    twx_job alone = *of;
    work(&alone);
    return;
  }
  memcpy(&job->next, &of->next, sizeof *of - offsetof(twx_job, next));
  int64_t begun = 1;
  twx_ffi_schedule one = {sizeof one, NULL, frame->context, task, job};
  for (; begun < threads; begun++) {
    void *const error = api->schedule(&one);
    if (!error) continue;
    drop(api, error);
    break;
  }
  work(job);
  while (__atomic_load_n(&job->done, __ATOMIC_ACQUIRE) < job->count) sched_yield();
  release(job, threads - begun + 1);
}

/* ---- handlers ------------------------------------------------------------------------------------------------- */

static void *handle(const twx_ffi_frame *frame, int32_t moves) {
  void *error = NULL;
  if (is_about_version(frame, &error)) return error;
  if (frame->arguments.count != 1 + moves || frame->results.count != 2 || frame->attributes.count != 1)
    return failed(frame->api, "twistax: the solver takes other arguments");
  const twx_form *const form = (const twx_form *)(intptr_t)*frame->attributes.values[0]->value;
  twx_ffi_buffer *const rows = frame->arguments.buffers[0], *const results = frame->results.buffers[0];
  twx_ffi_buffer *const memory = frame->results.buffers[1], *const sides = moves ? frame->arguments.buffers[1] : results;
  const int64_t count = rows->shape[0], rank = 2 + moves;
  const size_t row = moves ? row_of_moves(form) : row_of_solve(form);
  const size_t result = moves ? side_of_moves(form) : result_of_solve(form), doubles = twx_form_memory(form);
  if (!has_shape(rows, 2, count, row) || !has_shape(results, rank, count, result) || !has_shape(sides, rank, count, result) ||
      !has_shape(memory, 2, memory->shape[0], doubles) || (moves && sides->shape[1] != results->shape[1]))
    return failed(frame->api, "twistax: arrays of the solver have other shapes");
  const int64_t each = moves ? results->shape[1] : -1;
  const size_t width = moves ? (size_t)each * result : result;
  if (moves) memcpy(results->data, sides->data, sizeof(double) * width * (size_t)count);
  if (count == 0) return NULL;
  const twx_job job = {.count = count, .each = each, .form = form, .rows = rows->data, .results = results->data,
                       .memory = memory->data, .row = row, .result = width, .memory_size = doubles};
  run(frame, &job, memory->shape[0]);
  for (int64_t i = 0; !moves && i < count; i++)
    if (job.results[((size_t)i + 1) * width - 2] == TWX_STOPPED) return failed(frame->api, "twistax: a solve was interrupted");
  return NULL;
}

void *twx_solve_handler(const void *frame) { return handle(frame, 0); }
void *twx_linearised_handler(const void *frame) { return handle(frame, 1); }
