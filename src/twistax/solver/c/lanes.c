/* Matrices of several intervals side by side: entry (i, j) of all of them, then the next one. What is multiplied is a row of
 * lanes, so that small matrices of any size run at the width of the processor.
 */
#include "phase.h"

#define L TWX_LANES
#ifdef TWX_STATES
#define IS_FULL (TWX_STATES <= 6) /* fewer are multiplied faster than listed */
#else
#define IS_FULL 0
#endif

/* Rows of a block of intervals, so many of `stride` entries, as lanes (width, L); lanes beyond the last interval are zero. */
void twx_pack(const twx_memory *t, size_t block, size_t stride, size_t width, const real *restrict rows, real *restrict lanes) {
  const size_t first = block * L, count = twx_lanes_of(t, block);
  const real *const from = rows + first * stride;
  for (size_t e = 0; e < width && count == L; e++)
    for (size_t l = 0; l < L; l++) lanes[e * L + l] = from[l * stride + e];
  for (size_t e = 0; e < width && count < L; e++)
    for (size_t l = 0; l < L; l++) lanes[e * L + l] = l < count ? from[l * stride + e] : 0;
}

size_t twx_lanes_of(const twx_memory *t, size_t block) { return t->K - block * L < L ? t->K - block * L : L; }

/* List the entries of a row that are not zero in some lane; how many there are. */
TWX_INLINE size_t list_entries(size_t count, const real *row, int32_t *list) {
  size_t used = 0;
  for (size_t i = 0; i < count; i++) {
    twx_bits bits[L], any = 0; /* but for signs: integers are compared faster */
    memcpy(bits, row + i * L, sizeof bits);
    for (size_t l = 0; l < L; l++) any |= bits[l];
    list[used] = (int32_t)i, used += (twx_bits)(any << 1) != 0;
  }
  return used;
}

typedef struct { /* sum of a[i] b[i] over a list of i, or over all where it is NULL; strides in entries */
  size_t count;
  const int32_t *list;
  const real *a, *b;
  size_t a_stride, b_stride;
} products;

TWX_INLINE void add_lanes(real *restrict sums, const real *restrict a, const real *restrict b) {
  for (size_t l = 0; l < L; l++) sums[l] += a[l] * b[l];
}

/* to (columns,) += the products with as many columns of b, at most four. Arrays of a vector each stay in registers. */
TWX_INLINE void add_columns(const products *p, size_t columns, size_t first, real *restrict to) {
  real sums0[L], sums1[L], sums2[L], sums3[L];
  real *const sums[] = {sums0, sums1, sums2, sums3};
  for (size_t c = 0; c < columns; c++) memcpy(sums[c], to + (first + c) * L, sizeof sums0);
  for (size_t q = 0; q < p->count; q++) {
    const size_t i = p->list ? (size_t)p->list[q] : q;
    const real *const a = p->a + i * p->a_stride * L, *const b = p->b + (i * p->b_stride + first) * L;
    for (size_t c = 0; c < columns; c++) add_lanes(sums[c], a, b + c * L);
  }
  for (size_t c = 0; c < columns; c++) memcpy(to + (first + c) * L, sums[c], sizeof sums0);
}

/* The same for columns first <= j < end. */
TWX_INLINE void add_products(const products *p, size_t first, size_t end, real *to) {
  size_t j = first;
  for (; j + 4 <= end; j += 4) add_columns(p, 4, j, to);
  for (; j < end; j++) add_columns(p, 1, j, to);
}

/* As `twx_along`, of a block. */
void twx_lanes_along(const twx_memory *t, size_t rows, const real *M, size_t width, const real *maps, real *out) {
  const size_t n = N_OF(t), size = SIZE_OF(t);
  for (size_t r = 0; r < rows; r++) {
    const real *const row = M + r * width * L;
    real *const to = out + r * size * L;
    const products p = {IS_FULL ? n : list_entries(n, row, t->list), IS_FULL ? NULL : t->list, row, maps, 1, size};
    memset(to, 0, sizeof(real) * size * L);
    if (width > n) memcpy(to + n * L, row + n * L, sizeof(real) * (size - n) * L);
    add_products(&p, 0, size, to);
  }
}

/* The upper triangle of H += G' M G of a block, with M (width, width) and G the sensitivities of eta or of q: maps
 * (n, size), then the unknowns themselves; without maps G is one. Many rows of M are zero: rates are linear in most of
 * their arguments. */
void twx_lanes_bends(const twx_memory *t, const real *M, size_t width, const real *maps, real *H) {
  const size_t n = N_OF(t), size = SIZE_OF(t);
  real *const moved = t->lane_moved;
  int32_t *const rows = t->list + size;
  size_t count = 0;
  for (size_t r = 0; r < size && !maps; r++)
    for (size_t e = (r * size + r) * L; e < (r + 1) * size * L; e++) H[e] += M[e];
  if (!maps) return;
  for (size_t i = 0; i < width; i++) {
    if (!IS_FULL && !list_entries(width, M + i * width * L, t->list)) continue;
    twx_lanes_along(t, 1, M + i * width * L, width, maps, moved + i * size * L);
    rows[count++] = (int32_t)i;
  }
  size_t of_states = 0; /* how many of these rows */
  while (of_states < count && (size_t)rows[of_states] < n) of_states++;
  for (size_t r = 0; r < size && of_states; r++) {
    const products p = {IS_FULL ? n : of_states, IS_FULL ? NULL : rows, maps + r * L, moved, size, size};
    add_products(&p, r, size, H + r * size * L);
  }
  for (size_t q = of_states; q < count; q++)
    for (size_t e = (size_t)rows[q] * (size + 1) * L; e < ((size_t)rows[q] + 1) * size * L; e++) H[e] += moved[e];
}
#undef IS_FULL
#undef L
