/* The line search: the filter, second-order corrections, the watchdog. Source: [WB] Algorithm A; IPOPT for the watchdog. */
#include "work.h"

static twx_reference reference_here(const twx_work *w) {
  return (twx_reference){twx_violation(w, &w->here, 0), twx_barrier(w, &w->here), twx_slope(w, &w->step), 0, 0};
}

/* A step so small that only rounding is left. */
static int32_t is_tiny(const twx_work *w) {
  real most = 0;
  FOR_FREE(w, i) most = twx_max(most, fabs(w->step.v[i]) / (1 + fabs(w->iterate.v[i])));
  for (size_t i = 0; i < w->rows; i++) most = twx_max(most, fabs(w->step.s[i]) / (1 + w->iterate.s[i]));
  return most < 10 * TWX_EPSILON && twx_violation(w, &w->here, 1) < (real)1e-4;
}

static void correct_residuals(const twx_work *w, twx_residual *r, real length) {
  const twx_values *at = &w->trial;
  for (size_t i = 0; i < w->defects; i++) r->c[i] = length * r->c[i] + at->c[i];
  for (size_t i = 0; i < w->rows; i++) r->h[i] = length * r->h[i] + at->h[i] + at->s[i];
  for (size_t i = 0; i < (size_t)w->ne; i++) r->e[i] = length * r->e[i] + at->e[i];
}

/* Second-order corrections of a full step. 1: the trial is accepted; its step is in `corrected`, its length in `from`.
 * Source: [WB]. */
static int32_t correct(twx_work *w, twx_reference *from, real length) {
  const twx_options *o = w->options;
  twx_residual *r = &w->correction;
  real before = from->violation, violation = twx_violation(w, &w->trial, 0), corrected = length;
  if (violation < from->violation) return 0;
  memcpy(r->v, w->right.v, sizeof(real) * w->variables), memcpy(r->s, w->right.s, sizeof(real) * w->rows);
  memcpy(r->c, w->right.c, sizeof(real) * w->defects), memcpy(r->h, w->right.h, sizeof(real) * w->rows);
  memcpy(r->e, w->right.e, sizeof(real) * (size_t)w->ne);
  for (int32_t n = 0; n < (int32_t)o->corrections && (n == 0 || violation <= o->correction_decrease * before); n++) {
    before = violation;
    correct_residuals(w, r, corrected);
    twx_solve_system(w, r, &w->corrected, 1);
    corrected = twx_primal_length(w, &w->corrected);
    w->statistics->corrections++;
    if (twx_move(w, &w->corrected, corrected)) return 0;
    if (twx_accepts(w, from, length)) {
      from->length = corrected;
      return 1;
    }
    violation = twx_violation(w, &w->trial, 0);
  }
  return 0;
}

/* The corrected step takes the place of the step; those of the multipliers of bounds follow from it. */
static void use_corrected(twx_work *w, twx_search *search) {
  twx_copy_step(w, &w->step, &w->corrected);
  twx_step_of_bounds(w, &w->step);
  search->length_multipliers = twx_dual_length(w, &w->step);
}

static void start_watchdog(twx_work *w, twx_search *search, const twx_reference *from, real length) {
  twx_copy_iterate(w, &w->watchdog, &w->iterate);
  memcpy(w->watchdog_z, w->here.z, sizeof(real) * w->points);
  search->watching = 1, search->watch_left = (int32_t)w->options->watchdog_steps, search->shortened = 0;
  search->watched = *from, search->watched.length = length;
}

/* Full steps are taken unseen for a while; the first that the watched point accepts is kept, else the search goes back. */
static twx_outcome watch(twx_work *w, twx_search *search, real length) {
  twx_reference *from = &search->watched;
  const int32_t bad = twx_move(w, &w->step, length) || twx_violation(w, &w->trial, 0) > w->violation_large;
  search->length = length;
  if (!bad && twx_accepts(w, from, from->length)) {
    const real barrier = twx_barrier(w, &w->trial);
    if (!(twx_switches(w, from, from->length) && twx_descends(w, from, from->length, barrier)))
      twx_filter_add(w, from->violation, from->barrier);
    search->watching = 0, search->kind = 'W';
    return TWX_STEP;
  }
  if (bad || search->watch_left-- <= 0) {
    search->watching = 0, search->shortened = 0;
    return TWX_BACK;
  }
  search->kind = 'w';
  return TWX_STEP;
}

/* Backtracking from the longest step inside the bounds. Source: [WB] A-5. */
static twx_outcome backtrack(twx_work *w, twx_search *search, twx_reference *from, real longest) {
  const real smallest = twx_smallest_length(w, from);
  real length = longest;
  int32_t rejected_by_filter = 0; /* whether the last trial that was rejected was so by the filter alone */
  for (int32_t first = 1;; first = 0, length /= 2) {
    if (!first && !(length > smallest)) { /* also where overflow makes it no number */
      search->shortened = 0;
      return TWX_NO_STEP;
    }
    const int32_t bad = twx_move(w, &w->step, length);
    search->trials++;
    if (!bad && twx_accepts(w, from, length)) {
      from->length = length;
      break;
    }
    rejected_by_filter = !bad && from->by_filter;
    if (!bad && first && w->options->corrections > 0 && correct(w, from, length)) {
      use_corrected(w, search);
      search->kind = 'H';
      break;
    }
  }
  search->by_filter = rejected_by_filter ? search->by_filter + 1 : 0;
  search->shortened = search->trials > 1 ? search->shortened + 1 : 0;
  if (twx_switches(w, from, length) && twx_descends(w, from, length, twx_barrier(w, &w->trial)))
    search->kind = search->kind == 'H' ? 'F' : 'f';
  else
    twx_filter_add(w, from->violation, from->barrier);
  search->length = from->length;
  return TWX_STEP;
}

/* Find the trial that becomes the next iterate. TWX_BACK: the iterate that the watchdog kept does. */
twx_outcome twx_line_search(twx_work *w, twx_search *search) {
  const twx_options *o = w->options;
  twx_reference from = reference_here(w);
  const real longest = twx_primal_length(w, &w->step);
  search->length = longest, search->length_multipliers = twx_dual_length(w, &w->step), search->kind = 'h', search->trials = 0;
  const int32_t tiny = is_tiny(w);
  search->tiny = tiny ? search->tiny + 1 : 0;
  if (tiny || o->full_step > 0) {
    search->kind = tiny ? 't' : 'r';
    return twx_move(w, &w->step, longest) ? TWX_NO_STEP : TWX_STEP;
  }
  if (!search->watching && w->watchdog_z && o->watchdog_trigger > 0 && search->shortened >= (int32_t)o->watchdog_trigger)
    start_watchdog(w, search, &from, longest);
  return search->watching ? watch(w, search, longest) : backtrack(w, search, &from, longest);
}

/* The multipliers of the dynamics about the nodes that have moved. */
static void transport(twx_work *w, real length) {
  const twx_problem *p = w->problem;
  if (!p->transport) return;
  for (size_t i = 0; i < w->variables; i++) w->moved[i] = w->size[i] * length * w->step.v[i];
  for (int32_t pass = 0; pass < 2; pass++) { /* to the problem's units and back */
    for (int32_t k = 0; k < w->N; k++)
      for (int32_t i = 0; i < w->stages[k].next; i++) {
        const real size = w->size[w->stages[k + 1].v + (size_t)i];
        w->iterate.lambda[w->stages[k].c + (size_t)i] *= pass ? size : 1 / size;
      }
    if (!pass) p->transport(p->user, w->moved, w->iterate.lambda);
  }
}

/* The iterate becomes the trial; multipliers move by their own lengths, those of bounds stay near barrier over slack.
 * Source: [WB] (14), (16). */
void twx_accept(twx_work *w, real length, real length_multipliers, real barrier) {
  twx_iterate *q = &w->iterate;
  const twx_iterate *d = &w->step;
  const real range = w->options->multiplier_range;
  memcpy(q->v, w->trial.v, sizeof(real) * w->variables);
  for (size_t i = 0; i < w->rows; i++) {
    q->s[i] = twx_max(w->trial.s[i], TWX_LEAST_SLACK), q->y[i] += length * (d->y[i] - q->y[i]);
    const real central = barrier / q->s[i];
    q->zs[i] = twx_max(twx_min(q->zs[i] + length_multipliers * d->zs[i], range * central), central / range);
  }
  for (size_t i = 0; i < w->defects; i++) q->lambda[i] += length * (d->lambda[i] - q->lambda[i]);
  for (size_t i = 0; i < (size_t)w->ne; i++) q->ye[i] += length * (d->ye[i] - q->ye[i]);
  FOR_FREE(w, i) {
    if (twx_has(w->lower[i])) {
      const real central = barrier / twx_below(w, q->v, i);
      q->zl[i] = twx_max(twx_min(q->zl[i] + length_multipliers * d->zl[i], range * central), central / range);
    }
    if (twx_has(w->upper[i])) {
      const real central = barrier / twx_above(w, q->v, i);
      q->zu[i] = twx_max(twx_min(q->zu[i] + length_multipliers * d->zu[i], range * central), central / range);
    }
  }
  twx_take_values(w);
  if (length > 0) transport(w, length);
}
