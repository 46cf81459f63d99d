"""Formulas of docstrings as the site shows them: what stands between dollars becomes LaTeX, and that is drawn."""

import inspect
import re

import pytest

from test_docs import module_of_site

FORMULAS = module_of_site("formulas")


@pytest.mark.parametrize(
    ("typed", "latex"),
    [
        ("ad*_xi(mu) = -ad_xi^T mu", r"\mathrm{ad}^* _{\xi} ( \mu ) = - \mathrm{ad} _{\xi} ^{T} \mu"),
        ("[w1 x v2; w1 x w2]", r"\begin{bmatrix} w_{1} \times v_{2} \\ w_{1} \times w_{2} \end{bmatrix}"),
        ("[R, [p]R; 0, R]", r"\begin{bmatrix} R & [ p ] R \\ 0 & R \end{bmatrix}"),
        ("[xi, eta]", r"[ \xi , \eta ]"),
        ("M(q) qdd + b(q, qd) = tau", r"M ( q ) \ddot q + b ( q , \dot q ) = \tau"),
        ("V.M V / 2 <= 1.5", r"V \cdot M V / 2 \le 1.5"),
        ("x = sqrt(a*b)^-1", r"x = \sqrt{ a \, b } ^{-1}"),
    ],
)
def test_a_formula_as_latex(typed: str, latex: str) -> None:
    assert FORMULAS.to_latex(typed) == latex


@pytest.mark.parametrize("typed", ["(a", "a)", "[a; b"])
def test_brackets_have_to_match(typed: str) -> None:
    with pytest.raises(ValueError, match="bracket"):
        FORMULAS.to_latex(typed)


def test_every_formula_of_a_docstring_is_drawn() -> None:
    maths = pytest.importorskip("docutils.utils.math.latex2mathml")
    texts = [inspect.getdoc(name.value) or "" for name in module_of_site("names").public_names()]
    formulas = {formula for text in texts for formula in re.findall(r"\$([^$]+)\$", text)}
    assert len(formulas) > 40
    for formula in formulas:
        maths.tex2mathml(FORMULAS.to_latex(formula))
