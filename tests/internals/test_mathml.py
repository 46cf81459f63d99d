"""Formulas of notebooks: MathML that says what the LaTeX says."""

from xml.etree import ElementTree

import pytest

import twistax as tx
from twistax.expr.node import all_nodes
from twistax.expr.printing.mathml import mathml

FENCED = '<mrow><mo stretchy="true">(</mo><mrow>{}</mrow><mo stretchy="true">)</mo></mrow>'


@pytest.mark.parametrize(
    ("latex", "expected"),
    [
        ("a", "<mi>a</mi>"),
        ("2.5 x_{1}^{2}", "<mn>2.5</mn><msubsup><mi>x</mi><mrow><mn>1</mn></mrow><mrow><mn>2</mn></mrow></msubsup>"),
        (r"\frac{a}{-b} c", "<mfrac><mrow><mi>a</mi></mrow><mrow><mo>−</mo><mi>b</mi></mrow></mfrac><mi>c</mi>"),
        (r"\left(a\right)^2", f"<msup>{FENCED.format('<mi>a</mi>')}<mn>2</mn></msup>"),
        (r"\mathrm{a\_b} \le \infty", '<mi mathvariant="normal">a_b</mi><mo>≤</mo><mo>∞</mo>'),
        (r"\dot{q}", '<mover accent="true"><mrow><mi>q</mi></mrow><mo>˙</mo></mover>'),
        (r"\unheardOf < \sin", r"<mi>\unheardOf</mi><mo>&lt;</mo><mi>sin</mi>"),
    ],
)
def test_a_formula_as_mathml(latex: str, expected: str) -> None:
    found = mathml(latex)
    assert found.removesuffix("</mrow></math>").partition("<mrow>")[2] == expected


def test_a_matrix_has_its_rows_and_columns() -> None:
    space = "{http://www.w3.org/1998/Math/MathML}"
    page = ElementTree.fromstring(mathml(r"\begin{bmatrix} 1 & \frac{a}{b} \\ c & 4 \end{bmatrix}"))
    table = page.find(f".//{space}mtable")
    assert [["".join(cell.itertext()) for cell in row] for row in table] == [["1", "ab"], ["c", "4"]]


def test_every_node_shows_itself_in_a_notebook() -> None:
    """Nothing of its LaTeX is left, and nothing is lost: names and numbers stand in it in their order."""
    cases = [case.expr for node in all_nodes() for case in node.example()]
    for expr in cases:
        element = ElementTree.fromstring(expr._repr_html_())
        assert "\\" not in "".join(element.itertext()), expr.latex()
    assert len(cases) > 200
    x, k = tx.State("x"), tx.Parameter("spring")
    assert "".join(ElementTree.fromstring((-k * x)._repr_html_()).itertext()) == "(−spring)x"


@pytest.mark.parametrize("latex", [r"\right) x", r"\left(x", r"x \left", "{x < y", r"\frac{1}", "x}"])
def test_what_does_not_close_stands_as_it_is(latex: str) -> None:
    assert "".join(ElementTree.fromstring(mathml(latex)).itertext()) == latex
