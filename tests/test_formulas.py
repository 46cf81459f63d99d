"""Formulas of docstrings as the site shows them: what stands between dollars becomes LaTeX, and that is drawn."""

import importlib.util
import inspect
import re

import pytest
from fontTools.ttLib import TTFont

from test_docs import DOCS, module_of_site

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
        ("x (+) d = x Exp(d)", r"x \oplus d = x \, \mathrm{Exp} ( d )"),
        ("h*^T H = e_(n+1), ...", r"{h^*} ^{T} H = e _{ n + 1 } , \ldots"),
        ("M xi' = T_pc' c''", r"M \dot{\xi} = \dot{T} _{\mathrm{pc}} \ddot{c}"),
        (r"\sum_k y_k \cdot g_k", r"\sum_k y_k \cdot g_k"),
        ("[w]x v = w x v", r"[ w ]_{\times} v = w \times v"),
    ],
)
def test_a_formula_as_latex(typed: str, latex: str) -> None:
    assert FORMULAS.to_latex(typed) == latex


@pytest.mark.parametrize("typed", ["(a", "a)", "[a; b"])
def test_brackets_have_to_match(typed: str) -> None:
    with pytest.raises(ValueError, match="bracket"):
        FORMULAS.to_latex(typed)


def test_a_prime_stands_after_a_name() -> None:
    with pytest.raises(ValueError, match="prime"):
        FORMULAS.to_latex("(a + b)' = 0")


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


def test_pages_typeset_rates_and_transposes() -> None:
    """A dot is a rate and a superscript T a transpose; in plain text a prime would have to be both."""
    pages = [page for page in DOCS.rglob("*.md") if "report" not in page.parts and page.name != "measured.md"]
    primes = {}
    for page in pages:
        text = re.sub(r"^```.*?^```$|`[^`]*`|\$[^$]+\$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
        primes[page.name] = re.findall(r"(?<!\w)(?:[A-Za-z]|xi|eta|mu|qd|tau)''?(?!\w)", text)
    assert {page: found for page, found in primes.items() if found} == {}


@pytest.mark.skipif(importlib.util.find_spec("ziamath") is None, reason="ziamath is not installed")
def test_the_font_of_formulas_ships() -> None:
    """A table of mathematics in it is what browsers need; the style of the site names its file."""
    fonts = module_of_site("fonts")
    font = TTFont(fonts.folder() / fonts.FILE)
    assert "MATH" in font
    assert {ord("\u02d9"), ord("\u22a4"), ord("\U0001d45e")} <= set(font.getBestCmap())
    assert "Open Font License" in font["name"].getDebugName(13)
    assert f'url("{fonts.FILE}")' in (DOCS / "site" / "static" / "site.css").read_text()
