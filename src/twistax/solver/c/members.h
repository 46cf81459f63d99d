/* Many problems of one form at once: each member of a batch is a row of numbers.
 *
 * A row of a solve is data | z | v | lower | upper. Its result is
 * z | v | s | lambda | y | ye | zl | zu | cost, error, violation, stationarity, complementarity, minimum, excess, worth,
 * status, iterations.
 * A row of a linearisation is z | lambda | y | ye | bound_weights | row_weights | solved, beside it right sides as
 * `twx_linearised` has them. Its result are the moves; these are NaN where `solved` is 0, or there is no strict minimum.
 */
#ifndef TWX_MEMBERS_H
#define TWX_MEMBERS_H
#include "transcription.h"

#define TWX_MEASURES 10
#define TWX_JOBS 16
#define TWX_JOB_WORDS 16

typedef struct { /* read by all threads */
  twx_problem problem;              /* of a solve without bounds */
  twx_options options;
  twx_transcription transcription;  /* its phases are copied for each thread: their work, and their data in a solve */
  int64_t data;                     /* numbers of a row that kernels read; 0 where these are those of the phases */
  int32_t transposed;
  int64_t stop;                     /* other than 0: every solve ends with TWX_STOPPED at once; another thread sets it */
  int64_t second;                   /* when signals were looked at last */
  /* Functions of Python, or NULL: PyGILState_Ensure, PyGILState_Release, PyErr_CheckSignals, PyErr_Clear and
   * PyErr_SetInterrupt. A solve asks for signals once a second, and ends with TWX_STOPPED where a handler raises: then
   * there is a signal again, for Python to see after the call. Python sees signals in its main thread alone. */
  int32_t (*lock)(void);
  void (*unlock)(int32_t);
  int32_t (*signals)(void);
  void (*clear)(void), (*interrupt)(void);
  int64_t *jobs;                    /* memory of TWX_JOBS calls that run at once, zero at first */
} twx_form;

size_t twx_form_memory(const twx_form *form); /* doubles that a thread needs */
void twx_solve_members(const twx_form *form, int64_t count, const double *rows, double *results, double *memory);
/* The status of a member that has no moves, if there is one. */
int32_t twx_linearised_members(const twx_form *form, int64_t count, int64_t each, const double *rows, double *sides, double *memory);
/* The same as handlers of XLA's foreign-function interface. The attribute is the address of the form. Arguments: rows
 * (count, entries), and for the second sides (count, each, entries). Results: likewise, and memory (threads, doubles). */
void *twx_solve_handler(const void *frame);
void *twx_linearised_handler(const void *frame);
#endif
