/* Members of a batch, one after the other. */
#include "members.h"
#include "work.h"
#include <time.h>

typedef struct { /* what functions of a problem get: the phases of this thread first */
  twx_transcription transcription;
  twx_form *form;
} twx_user;

static size_t doubles_for(size_t bytes) { return (bytes + sizeof(double) - 1) / sizeof(double); }

/* Doubles of the phases in `memory`, which is filled unless it is NULL. */
static size_t copy_phases(const twx_form *form, const double *data, double *memory) {
  const twx_transcription *from = &form->transcription;
  size_t used = doubles_for(sizeof(twx_user)) + doubles_for(sizeof(twx_phase) * (size_t)from->phases);
  twx_user *const user = (twx_user *)(void *)memory;
  if (user) {
    user->form = (twx_form *)(intptr_t)form, user->transcription.phases = from->phases;
    user->transcription.phase = (twx_phase *)(void *)(memory + doubles_for(sizeof(twx_user)));
  }
  for (int32_t i = 0; i < from->phases; i++) {
    if (user) {
      twx_phase *const own = user->transcription.phase + i;
      *own = from->phase[i], own->work = memory + used, own->work[0] = 0, own->scratch = own->work + twx_phase_work(own);
      if (form->data) own->of_phase = data + (own->of_phase - own->data), own->data = data;
    }
    used += twx_phase_work(from->phase + i) + twx_phase_scratch(from->phase + i);
  }
  return used;
}

size_t twx_form_memory(const twx_form *form) { return copy_phases(form, NULL, NULL) + twx_workspace_size(&form->problem, sizeof(real)); }

static int32_t is_ended(const twx_form *form) { return __atomic_load_n(&form->stop, __ATOMIC_RELAXED) != 0; }

static int32_t is_stopped(void *user, int32_t iteration, const double *z) {
  twx_form *const form = ((twx_user *)user)->form;
  (void)iteration, (void)z;
  if (is_ended(form)) return 1;
  if (!form->signals) return 0;
  const int64_t now = (int64_t)time(NULL);
  if (__atomic_exchange_n(&form->second, now, __ATOMIC_RELAXED) == now) return 0;
  const int32_t locked = form->lock(), raised = form->signals() != 0;
  if (raised) form->clear(), form->interrupt();
  form->unlock(locked);
  return raised;
}

typedef struct {
  size_t variables, points, defects, rows, equalities;
} twx_sizes;

static twx_sizes sizes_of(const twx_form *form) {
  twx_counts n;
  if (twx_count(&form->problem, &n) != TWX_SOLVED) memset(&n, 0, sizeof n);
  return (twx_sizes){n.variables, n.points, n.defects, n.inequalities, n.equalities};
}

static size_t row_of_solve(const twx_form *form) {
  const twx_sizes n = sizes_of(form);
  return (size_t)form->data + n.points + 3 * n.variables;
}

static size_t result_of_solve(const twx_form *form) {
  const twx_sizes n = sizes_of(form);
  return n.points + 3 * n.variables + 2 * n.rows + n.defects + n.equalities + TWX_MEASURES;
}

static size_t row_of_moves(const twx_form *form) {
  const twx_sizes n = sizes_of(form);
  return n.points + n.defects + n.equalities + n.variables + 2 * n.rows + 1;
}

static size_t side_of_moves(const twx_form *form) {
  const twx_sizes n = sizes_of(form);
  return n.variables + n.defects + n.rows + n.equalities + 1;
}

static void solve_member(const twx_form *form, const double *row, double *result, double *memory) {
  const twx_sizes n = sizes_of(form);
  if (is_ended(form)) {
    const size_t count = result_of_solve(form);
    for (size_t i = 0; i < count; i++) result[i] = i == count - 2 ? TWX_STOPPED : NAN;
    return;
  }
  const size_t used = copy_phases(form, row, memory);
  const double *const start = row + form->data, *const v = start + n.points;
  double *const z = result, *const s = z + n.points + n.variables, *const lambda = s + n.rows, *const y = lambda + n.defects;
  double *const ye = y + n.rows, *const zl = ye + n.equalities, *const zu = zl + n.variables, *const measures = zu + n.variables;
  twx_solution solution = {z + n.points, s, lambda, y, ye, zl, zu};
  twx_statistics t = {0};
  twx_problem problem = form->problem;
  memcpy(z, start, sizeof(double) * n.points), memcpy(solution.v, v, sizeof(double) * n.variables);
  problem.lower = v + n.variables, problem.upper = problem.lower + n.variables;
  problem.user = memory, problem.stop = is_stopped;
  twx_solve(&problem, &form->options, z, &solution, memory + used, &t);
  const double numbers[TWX_MEASURES] = {t.cost, t.error, t.violation, t.stationarity, t.complementarity, t.minimum,
                                        t.excess, t.worth, t.status, t.iterations};
  memcpy(measures, numbers, sizeof numbers);
}

static int32_t move_member(const twx_form *form, int64_t each, const double *row, double *sides, double *memory) {
  const twx_sizes n = sizes_of(form);
  const size_t used = copy_phases(form, NULL, memory);
  const double *const lambda = row + n.points, *const y = lambda + n.defects, *const ye = y + n.rows;
  const double *const of_bounds = ye + n.equalities, *const of_rows = of_bounds + n.variables;
  const twx_point at = {row, lambda, y, ye, of_bounds, of_rows};
  twx_problem problem = form->problem;
  problem.user = memory;
  const int32_t status = of_rows[n.rows] == 0 ? TWX_STALLED
    : twx_linearised(&problem, &form->options, &at, form->transposed, (int32_t)each, sides, memory + used);
  if (status != TWX_SOLVED) for (size_t i = 0; i < (size_t)each * side_of_moves(form); i++) sides[i] = NAN;
  return status;
}

void twx_solve_members(const twx_form *form, int64_t count, const double *rows, double *results, double *memory) {
  const size_t row = row_of_solve(form), result = result_of_solve(form);
  for (size_t i = 0; i < (size_t)count; i++) solve_member(form, rows + i * row, results + i * result, memory);
}

int32_t twx_linearised_members(const twx_form *form, int64_t count, int64_t each, const double *rows, double *sides, double *memory) {
  const size_t row = row_of_moves(form), side = (size_t)each * side_of_moves(form);
  int32_t status = TWX_SOLVED;
  for (size_t i = 0; i < (size_t)count; i++) {
    const int32_t own = move_member(form, each, rows + i * row, sides + i * side, memory);
    if (own != TWX_SOLVED) status = own;
  }
  return status;
}
