/* The loop of the interior point. Source: [WB] Algorithm A. */
#include "work.h"

static void record(twx_work *w, const twx_search *search, const twx_measures *m) {
  twx_statistics *t = w->statistics;
  real length = 0;
  if (!t->log || t->iterations >= t->log_rows) return;
  for (size_t i = 0; i < w->variables; i++) length = twx_max(length, fabs(w->step.v[i]));
  t->log[t->iterations] = (twx_record){w->here.cost / w->cost_scale, m->violation, m->stationarity, w->barrier, w->identity,
                                       search->length, search->length_multipliers, length, search->trials, search->kind};
}

/* The barrier parameter falls as long as its problem is solved. Source: [WB] A-3, (7), (8). */
static twx_status update_barrier(twx_work *w, twx_search *search, const twx_measures *m) {
  const twx_options *o = w->options;
  for (int32_t first = 1; !search->watching; first = 0) {
    const int32_t tiny = first && search->tiny > 1;
    if (!tiny && twx_measure_again(w, m, w->barrier).error > o->barrier_error * w->barrier) break;
    const real before = w->barrier, least = w->exactness * o->barrier_least;
    w->barrier = twx_max(least, twx_min(o->barrier_factor * before, pow(before, o->barrier_power)));
    w->fraction = twx_max(o->boundary_fraction, 1 - w->barrier);
    w->filter_rows = search->by_filter = search->shortened = 0;
    if (w->barrier == before) return tiny ? TWX_STALLED : TWX_SOLVED;
  }
  return TWX_SOLVED;
}

static twx_status find_direction(twx_work *w) {
  if (twx_differentiate_twice(w)) return TWX_NON_FINITE;
  twx_right_side(w, w->barrier);
  if (!twx_correct_inertia(w)) return TWX_UNBOUNDED_CURVATURE;
  twx_solve_system(w, &w->right, &w->step, 1);
  twx_step_of_bounds(w, &w->step);
  return TWX_SOLVED;
}

static void reset_filter(twx_work *w, twx_search *search) {
  const twx_options *o = w->options;
  if (search->by_filter < (int32_t)o->filter_reset_trigger || search->resets >= (int32_t)o->filter_resets) return;
  w->filter_rows = search->by_filter = 0, search->resets++, w->statistics->filter_resets++;
}

/* Back to an iterate that was kept. */
static twx_status return_to(twx_work *w, const twx_iterate *kept, const real *z) {
  twx_copy_iterate(w, &w->iterate, kept);
  memcpy(w->here.z, z, sizeof(real) * w->points);
  return twx_evaluate(w, &w->here) || twx_differentiate(w) ? TWX_NON_FINITE : TWX_SOLVED;
}

/* Back to the iterate that the watchdog kept. */
static twx_status go_back(twx_work *w) { return return_to(w, &w->watchdog, w->watchdog_z); }

/* No step length is acceptable. */
static twx_status restore(twx_work *w) {
  const real violation = twx_violation(w, &w->here, 0);
  twx_filter_add(w, violation, twx_barrier(w, &w->here));
  return twx_violation(w, &w->here, 1) < w->options->tolerance ? TWX_STALLED : twx_restore(w);
}

static twx_status take_step(twx_work *w, twx_search *search, const twx_measures *m) {
  const twx_outcome outcome = twx_line_search(w, search);
  record(w, search, m), w->statistics->iterations++;
  if (outcome == TWX_BACK) return go_back(w);
  if (outcome == TWX_NO_STEP) return restore(w);
  twx_accept(w, search->length, search->length_multipliers, w->barrier);
  return twx_differentiate_both(w) ? TWX_NON_FINITE : TWX_SOLVED;
}

static void report(twx_work *w, const twx_measures *m) {
  twx_statistics *t = w->statistics;
  t->cost = w->here.cost / w->cost_scale, t->error = m->error, t->stationarity = m->stationarity;
  t->violation = m->violation, t->complementarity = m->complementarity, t->barrier = w->barrier;
}

static real largest_variable(const twx_work *w) {
  real most = 1;
  for (size_t i = 0; i < w->variables; i++) most = twx_max(most, fabs(w->iterate.v[i]));
  return most;
}

static void keep(twx_work *w) {
  twx_copy_iterate(w, &w->best, &w->iterate);
  memcpy(w->best_z, w->here.z, sizeof(real) * w->points);
}

/* Keep the iterate with the smallest error, unless one was acceptable. */
static void keep_best(twx_work *w, const twx_measures *m) {
  if (m->error < w->best_error) w->best_error = m->error, keep(w);
}

/* Keep the iterate that meets the conditions with the smallest excess, if that is acceptable. */
static void keep_acceptable(twx_work *w) {
  const twx_statistics *t = w->statistics;
  if (!(t->excess <= w->options->excess_acceptable * t->worth)) return;
  if (w->acceptable_age > 0 && !(t->excess < w->best_excess)) return;
  w->best_error = -INFINITY, w->best_excess = t->excess;
  if (w->acceptable_age == 0) w->acceptable_age = 1;
  keep(w);
}

/* How a solve ends that came to no end: with the best iterate, if it is better than the last one. */
static void end_at_best(twx_work *w) {
  const twx_measures last = twx_measure(w);
  report(w, &last);
  if (!(w->best_error < last.error) || return_to(w, &w->best, w->best_z)) return;
  const twx_measures best = twx_measure(w);
  report(w, &best);
}

/* The excess of a solve that ended early, where the estimate means something and its time is there: an iterate far from
 * acceptable after a count of iterations, as a controller's, needs none. */
static void measure_rest(twx_work *w, twx_status status) {
  twx_statistics *t = w->statistics;
  t->minimum = 0, t->excess = NAN, t->worth = 0;
  if (!(w->options->excess > 0)) return;
  const int32_t early = status == TWX_STALLED || status == TWX_ACCEPTABLE || status == TWX_UNBOUNDED_CURVATURE;
  if (early || (status == TWX_MAX_ITERATIONS && t->error <= w->options->acceptable)) twx_measure_optimum(w);
}

/* Whether the optimality conditions hold, and the cost is as close to the minimum as asked for. If the units say the
 * first and the estimate does not agree, the search goes on to a smaller barrier. */
static int32_t is_solution(twx_work *w, const twx_measures *m) {
  const twx_options *o = w->options;
  if (!(m->error <= o->tolerance && m->violation <= o->violation)) return 0;
  if (!(m->complementarity <= o->complementarity)) return 0;
  if (!(o->excess > 0) || twx_measure_optimum(w)) return 1;
  if (m->error <= w->exactness * o->tolerance) w->exactness *= o->excess_decrease;
  keep_acceptable(w);
  return 0;
}

static twx_status iterate(twx_work *w) {
  const twx_options *o = w->options;
  const twx_problem *p = w->problem;
  twx_search search = {0};
  int32_t acceptable = 0;
  w->best_error = INFINITY;
  for (twx_status status = TWX_SOLVED; status == TWX_SOLVED;) {
    const twx_measures m = twx_measure(w);
    report(w, &m);
    if (is_solution(w, &m)) return TWX_SOLVED;
    keep_best(w, &m);
    acceptable = m.error <= o->acceptable && m.complementarity <= 10 * w->barrier ? acceptable + 1 : 0;
    if (acceptable > (int32_t)o->acceptable_iterations) return TWX_ACCEPTABLE;
    if (w->acceptable_age > 0 && w->acceptable_age++ > (int32_t)o->acceptable_iterations) return TWX_ACCEPTABLE;
    if (w->here.cost < -o->cost_largest && m.violation <= twx_max(o->tolerance, 10000 * TWX_EPSILON * largest_variable(w))) return TWX_UNBOUNDED;
    if (w->statistics->iterations >= (int32_t)o->iterations) return TWX_MAX_ITERATIONS;
    if (p->stop && p->stop(p->user, w->statistics->iterations, w->here.z)) return TWX_STOPPED;
    status = update_barrier(w, &search, &m);
    if (status == TWX_SOLVED) status = find_direction(w);
    if (status != TWX_SOLVED && search.watching) { /* steps that were taken unseen led nowhere */
      search.watching = search.shortened = 0, status = go_back(w);
      continue;
    }
    reset_filter(w, &search);
    if (status == TWX_SOLVED) status = take_step(w, &search, &m);
    if (status != TWX_SOLVED) return status;
  }
  return TWX_STALLED;
}

/* The result in the problem's units. */
static void unscale(twx_work *w, real *z, twx_solution *solution) {
  const twx_iterate *q = &w->iterate;
  for (size_t i = 0; i < w->variables; i++) {
    solution->v[i] = q->v[i] * w->size[i];
    solution->zl[i] = q->zl[i] / (w->cost_scale * w->size[i]), solution->zu[i] = q->zu[i] / (w->cost_scale * w->size[i]);
  }
  for (int32_t k = 0; k < w->N; k++)
    for (int32_t i = 0; i < w->stages[k].next; i++) {
      const size_t at = w->stages[k].c + (size_t)i;
      solution->lambda[at] = q->lambda[at] / (w->cost_scale * w->size[w->stages[k + 1].v + (size_t)i]);
    }
  for (size_t i = 0; i < w->rows; i++)
    solution->s[i] = q->s[i] / w->row_scale[i], solution->y[i] = q->y[i] * w->row_scale[i] / w->cost_scale;
  for (size_t i = 0; i < (size_t)w->ne; i++) solution->ye[i] = q->ye[i] * w->equality_scale[i] / w->cost_scale;
  memcpy(z, w->here.z, sizeof(real) * w->points);
}

static void load(twx_work *w, const real *z, const twx_solution *solution) {
  twx_iterate *q = &w->iterate;
  memcpy(w->here.z, z, sizeof(real) * w->points);
  memset(q->v, 0, sizeof(real) * w->point_size);
  memcpy(q->v, solution->v, sizeof(real) * w->variables);
  if (!(w->options->warm_start > 0)) return;
  memcpy(q->s, solution->s, sizeof(real) * w->rows), memcpy(q->y, solution->y, sizeof(real) * w->rows);
  memcpy(q->lambda, solution->lambda, sizeof(real) * w->defects), memcpy(q->ye, solution->ye, sizeof(real) * (size_t)w->ne);
  memcpy(q->zl, solution->zl, sizeof(real) * w->variables), memcpy(q->zu, solution->zu, sizeof(real) * w->variables);
}

static int32_t is_lost(twx_status status) {
  return status == TWX_NON_FINITE || status == TWX_UNBOUNDED_CURVATURE || status == TWX_UNBOUNDED;
}

int32_t twx_solve(const twx_problem *problem, const twx_options *options, real *z, twx_solution *solution,
                  real *workspace, twx_statistics *statistics) {
  twx_work work, *const w = &work;
  twx_statistics fresh = {0};
  fresh.log = statistics->log, fresh.log_rows = statistics->log_rows;
  fresh.cost = fresh.error = fresh.stationarity = fresh.violation = fresh.complementarity = fresh.excess = NAN;
  *statistics = fresh;
  if (!twx_workspace_size(problem, sizeof(real))) return statistics->status = TWX_BAD_PROBLEM;
  twx_carve(w, problem, workspace);
  w->problem = problem, w->options = options, w->statistics = statistics;
  load(w, z, solution);
  twx_status status = twx_start(w);
  if (status == TWX_BAD_PROBLEM) return statistics->status = status;
  if (status == TWX_SOLVED) {
    status = iterate(w);
    if (status != TWX_SOLVED && status != TWX_INFEASIBLE && status != TWX_UNBOUNDED) end_at_best(w);
    if (status != TWX_SOLVED) measure_rest(w, status);
  }
  if (!problem->discards || !is_lost(status)) unscale(w, z, solution);
  return statistics->status = status;
}
