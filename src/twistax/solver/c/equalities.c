/* Which equalities the controls of their stage decide: these are eliminated with them, others stand in the border. */
#include "work.h"

#define DECIDED ((real)1e-2) /* of a row: how much of it must be controls that no other row moves */

/* The part of a row's controls that is orthogonal to those of rows that came before, in `rest` (nu,): its norm over that
 * of the whole row. */
static real decided_part(const twx_work *w, const twx_stage *s, int32_t r, const real *before, int32_t count, real *rest) {
  real whole = 0, left = 0;
  for (int32_t j = 0; j < s->n; j++) {
    const real entry = w->Je[s->Je + (size_t)r + (size_t)j * (size_t)s->ne];
    const int32_t control = j - s->nx;
    whole += entry * entry;
    if (control >= 0 && control < s->nu) rest[control] = w->free[s->v + (size_t)j] == 0 ? 0 : entry;
  }
  for (int32_t other = 0; other < count; other++) {
    real along = 0;
    for (int32_t j = 0; j < s->nu; j++) along += before[(size_t)other * (size_t)s->nu + (size_t)j] * rest[j];
    for (int32_t j = 0; j < s->nu; j++) rest[j] -= along * before[(size_t)other * (size_t)s->nu + (size_t)j];
  }
  for (int32_t j = 0; j < s->nu; j++) left += rest[j] * rest[j];
  for (int32_t j = 0; j < s->nu && left > 0; j++) rest[j] /= sqrt(left);
  return whole > 0 ? sqrt(left / whole) : 0;
}

/* By the derivatives at the start. Where they vanish later, rows are softened. */
void twx_place_equalities(twx_work *w) {
  w->nbe = 0;
  FOR_STAGES(w, k, s) {
    real *const before = w->t1; /* an orthonormal basis of the rows' controls */
    int32_t count = 0;
    for (int32_t r = 0; r < s->ne; r++) {
      const int32_t decided = count < s->nu && decided_part(w, s, r, before, count, before + (size_t)count * (size_t)s->nu) >= DECIDED;
      w->place[s->e + (size_t)r] = decided ? -1 - count++ : w->nbe++;
    }
    w->stages[k].nl = count;
  }
  w->nb = w->np + w->nbe;
}
