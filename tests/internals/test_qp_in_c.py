"""The quadratic program in a controller's C: the joined sources and a main, without Python."""

import shutil
import subprocess
from pathlib import Path

from twistax.solver.sources import amalgamation

MAIN = """
#include <stdio.h>
int main(void) {
  static double workspace[1000];
  const double H[4] = {1, 0, 0, 1}, g[2] = {-2, -2}, C[2] = {1, 3}, low[1] = {-INFINITY}, high[1] = {2};
  const double upper[2] = {1, 1};
  double x[2] = {0}, z[1] = {0}, w[2] = {0}, scales[3] = {0};
  twx_qp problem = {.variables = 2, .inequalities = 1, .H = H, .g = g, .C = C, .row_lower = low, .row_upper = high};
  problem.upper = upper;
  twx_qp_solution solution = {x, NULL, z, w, scales};
  twx_qp_statistics statistics;
  twx_qp_options options;
  twx_qp_defaults(&options);
  if (twx_qp_workspace_size(&problem) > 1000) return 1;
  for (int step = 0; step < 2; step++) {
    twx_qp_solve(&problem, &options, &solution, workspace, &statistics);
    printf("%d %d %.12g %.12g %.12g %.12g\\n", statistics.status, statistics.iterations > 0, x[0], x[1], z[0], w[0]);
    options.warm_start = 1;
  }
  problem.variables = 0;
  return twx_qp_solve(&problem, &options, &solution, workspace, &statistics) != TWX_QP_BAD_PROBLEM;
}
"""


def test_a_controller_in_c(tmp_path: Path) -> None:
    """By hand: x_0 at its bound 1, so x_1 = 1/3, z = 5/9 and w_0 = 4/9."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    assert compiler, "the tests of C code need a C compiler"
    source, program = tmp_path / "controller.c", tmp_path / "controller"
    source.write_text(amalgamation() + MAIN)
    subprocess.run([compiler, "-std=c99", "-O0", str(source), "-o", str(program), "-lm"], check=True)
    lines = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.splitlines()
    values = "1 0.333333333333 0.555555555556 0.444444444444"
    assert lines == [f"0 1 {values}", f"0 0 {values}"]
