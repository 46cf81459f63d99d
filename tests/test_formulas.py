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
        ("x (+) d = x Exp(d)", r"x \oplus d = x \mathrm{Exp} ( d )"),
        ("h*^T H = e_(n+1), ...", r"{h^*} ^{T} H = e _{ n + 1 } , \ldots"),
        ("[w]x v = w x v", r"[ w ]_{\times} v = w \times v"),
    ],
)
def test_a_formula_as_latex(typed: str, latex: str) -> None:
    assert FORMULAS.to_latex(typed) == latex


@pytest.mark.parametrize("typed", ["(a", "a)", "[a; b"])
def test_brackets_have_to_match(typed: str) -> None:
    with pytest.raises(ValueError, match="bracket"):
        FORMULAS.to_latex(typed)


def docstrings() -> dict[str, str]:
    """Of every public name, and of its methods."""
    found = {}
    for name in module_of_site("names").public_names():
        members = {f"{name.path}.{m}": inspect.getattr_static(name.value, m) for m in name.members()}
        found |= {path: inspect.getdoc(value) or "" for path, value in ({name.path: name.value} | members).items()}
    return found


def test_every_formula_of_a_docstring_is_drawn() -> None:
    maths = pytest.importorskip("docutils.utils.math.latex2mathml")
    formulas = {formula for text in docstrings().values() for formula in re.findall(r"\$([^$]+)\$", text)}
    assert len(formulas) > 200
    for formula in formulas:
        maths.tex2mathml(FORMULAS.to_latex(formula))


def test_no_power_stands_outside_of_a_formula() -> None:
    """What has one is a formula: between dollars it is drawn."""
    own = {path: text for path, text in docstrings().items() if path.startswith("twistax.")}
    bare = {path: re.sub(r"\$[^$]+\$|`[^`]+`", "", text) for path, text in own.items()}
    assert [path for path, text in bare.items() if "^" in text] == []
