/* The filter, and the tests of a trial point. Source: [WB] 2.3; numbers of equations are theirs. */
#include "work.h"

/* a <= b but for rounding of numbers as large as `base`. */
int32_t twx_at_most(real a, real b, real base) { return a - b <= 10 * TWX_EPSILON * fabs(base); }

int32_t twx_filter_accepts(const twx_work *w, real violation, real barrier) {
  for (int32_t i = 0; i < w->filter_rows; i++) {
    const real *row = w->filter + 2 * i;
    if (!twx_at_most(violation, row[0], row[0]) && !twx_at_most(barrier, row[1], row[1])) return 0;
  }
  return 1;
}

/* (22); rows that the new one covers are dropped. */
void twx_filter_add(twx_work *w, real violation, real barrier) {
  const real most = (1 - w->options->filter_violation) * violation, least = barrier - w->options->filter_barrier * violation;
  int32_t kept = 0;
  for (int32_t i = 0; i < w->filter_rows; i++) {
    const real *row = w->filter + 2 * i;
    if (row[0] >= most && row[1] >= least) continue;
    w->filter[2 * kept] = row[0], w->filter[2 * kept + 1] = row[1], kept++;
  }
  if (kept == w->filter_size) kept--;
  w->filter[2 * kept] = most, w->filter[2 * kept + 1] = least, w->filter_rows = kept + 1;
}

/* The switching condition (19), where the violation is small. */
int32_t twx_switches(const twx_work *w, const twx_reference *from, real length) {
  const twx_options *o = w->options;
  return from->violation <= w->violation_small && from->slope < 0 &&
         length * pow(-from->slope, o->switch_slope) > o->switch_factor * pow(from->violation, o->switch_violation);
}

/* The Armijo condition (20). */
int32_t twx_descends(const twx_work *w, const twx_reference *from, real length, real barrier) {
  return twx_at_most(barrier - from->barrier, w->options->armijo * length * from->slope, from->barrier);
}

/* Whether the barrier function grows by more decades than IPOPT allows. */
static int32_t explodes(const twx_work *w, const twx_reference *from, real barrier) {
  const real growth = barrier - from->barrier;
  if (!(growth > 0)) return 0;
  return log10(growth) > w->options->barrier_growth + twx_max(1, log10(twx_max(fabs(from->barrier), TWX_LEAST)));
}

/* Whether the trial is acceptable for a step of this length: (18), (20) and the filter. */
int32_t twx_accepts(const twx_work *w, twx_reference *from, real length) {
  const twx_options *o = w->options;
  const real violation = twx_violation(w, &w->trial, 0), barrier = twx_barrier(w, &w->trial);
  from->by_filter = 0;
  if (!isfinite(violation) || !isfinite(barrier) || violation > w->violation_large) return 0;
  if (length > 0 && twx_switches(w, from, length)) {
    if (!twx_descends(w, from, length, barrier)) return 0;
  } else {
    if (explodes(w, from, barrier)) return 0;
    if (!twx_at_most(violation, (1 - o->filter_violation) * from->violation, from->violation) &&
        !twx_at_most(barrier, from->barrier - o->filter_barrier * from->violation, from->barrier))
      return 0;
  }
  from->by_filter = !twx_filter_accepts(w, violation, barrier);
  return !from->by_filter;
}

/* The length below which restoration begins (23). */
real twx_smallest_length(const twx_work *w, const twx_reference *from) {
  const twx_options *o = w->options;
  real length = o->filter_violation;
  if (from->slope < 0) {
    length = twx_min(length, o->filter_barrier * from->violation / -from->slope);
    if (from->violation <= w->violation_small)
      length = twx_min(length, o->switch_factor * pow(from->violation, o->switch_violation) / pow(-from->slope, o->switch_slope));
  }
  return o->step_smallest * length;
}
