/* A solve: a warm start by its active bounds, then the interior point. */
#include "qp_work.h"

#define OPTION(name, value, source) #name,
static const char *const qp_names[] = {
#include "qp.def"
};
#undef OPTION
#define OPTION(name, value, source) source,
static const char *const qp_sources[] = {
#include "qp.def"
};
#undef OPTION

#define QP_COUNT ((int32_t)(sizeof qp_names / sizeof *qp_names))

int32_t twx_qp_options_count(void) { return QP_COUNT; }

const char *twx_qp_option_name(int32_t i) { return i >= 0 && i < QP_COUNT ? qp_names[i] : NULL; }

const char *twx_qp_option_source(int32_t i) { return i >= 0 && i < QP_COUNT ? qp_sources[i] : NULL; }

void twx_qp_defaults(twx_qp_options *options) {
#define OPTION(name, value, source) options->name = value;
#include "qp.def"
#undef OPTION
}

static int32_t qp_is_convex(twx_qp_work *w) {
  double largest = 0;
  for (int32_t j = 0; j < w->n; j++) largest = twx_max(largest, fabs(w->H[j + (size_t)j * (size_t)w->n]));
  memset(w->weights, 0, sizeof(double) * (size_t)w->k);
  return w->options->convexity == 0 || twx_qp_factorize(w, w->options->convexity * (largest > 0 ? largest : 1));
}

static int32_t qp_warm(twx_qp_work *w) {
  if (!(w->options->warm_start > 0)) return 0;
  twx_qp_measure(w, &w->trial);
  if (!isfinite(w->trial.error)) return 0;
  twx_qp_guess(w, &w->trial, w->trial.t, w->active);
  return twx_qp_active_set(w, (int32_t)w->options->warm_changes);
}

static twx_qp_status qp_solve(twx_qp_work *w) {
  memset(w->point.x, 0, sizeof(double) * (size_t)w->n), memset(w->point.z, 0, sizeof(double) * (size_t)w->k);
  twx_qp_copy(w, &w->best, &w->point);
  if (!qp_is_convex(w)) {
    twx_qp_measure(w, &w->point);
    return TWX_QP_NOT_CONVEX;
  }
  if (qp_warm(w)) return TWX_QP_SOLVED;
  const twx_qp_status status = twx_qp_interior(w);
  return status == TWX_QP_SOLVED || status == TWX_QP_NOT_CONVEX ? status : twx_qp_prove(w, status);
}

int32_t twx_qp_solve(const twx_qp *problem, const twx_qp_options *options, twx_qp_solution *solution,
                     double *workspace, twx_qp_statistics *statistics) {
  twx_qp_work work, *const w = &work;
  *statistics = (twx_qp_statistics){NAN, NAN, NAN, NAN, NAN, INFINITY, TWX_QP_BAD_PROBLEM, 0, 0, 0};
  if (!twx_qp_workspace_size(problem)) return TWX_QP_BAD_PROBLEM;
  twx_qp_carve(w, problem, workspace);
  w->problem = problem, w->options = options, w->statistics = statistics, w->proving = 0;
  w->softness = options->softness, w->first_gradient = 0;
  if (!twx_qp_load(w, solution)) return TWX_QP_BAD_PROBLEM;
  statistics->status = (int32_t)qp_solve(w);
  twx_qp_unload(w, solution);
  return statistics->status;
}
