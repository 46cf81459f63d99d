"""Formulas of docstrings, written as one types them, `$ad*_xi(mu) = -ad_xi^T mu$`, as LaTeX.

Names are one letter or a word: Greek ones become their letters, sum and integral their signs, others upright. qd and
qdd, q' and q'' are rates of q, with a dot or two; ^T is the transpose. `x` between two factors is the cross product,
`[w]x` its matrix, `.` the dot product, `[a, b; c, d]` a matrix, `x (+) d` a move along the group; `^` and `_` take the
next name, or what stands in parentheses.
"""

from __future__ import annotations

import re

GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|theta|lambda|mu|nu|xi|eta|rho|sigma|tau|phi|psi|omega|Omega|Delta|pi|sum"
)
DUALS = {"ad": r"\mathrm{ad}^*", "Ad": r"\mathrm{Ad}^*", "h": "{h^*}", "Hbar": r"{\bar H^*}"}
RATES = {"qd": r"\dot q", "qdd": r"\ddot q", "integral": r"\int"}
SIGNS = {"<=": r"\le", ">=": r"\ge", "->": r"\to", ".": r"\cdot", "*": r"\,", "{": r"\{", "}": r"\}"} | {
    "(+)": r"\oplus",
    "...": r"\ldots",
}
COLUMN = r"\end{bmatrix}"
_TOKEN = re.compile(
    r"\s*(?:(\d+(?:\.\d+)?)|(sqrt)\(|([A-Za-z]+\d*)(\*?)|(\^|_)(-?\w+|\()|('+|\(\+\)|\.\.\.|\]x(?!\w)|<=|>=|->|\S))"
)


def to_latex(text: str) -> str:
    """The LaTeX of a formula; one with a backslash is LaTeX. Raises ValueError for brackets that do not match, and for
    a prime after no name.
    """
    if "\\" in text:
        return text.strip()
    written: list[str] = []
    closing: list[str] = []  # what ends the brackets that are open
    at, text = 0, text.strip()
    while at < len(text):
        token = _TOKEN.match(text, at)
        assert token is not None  # there is always a last sign
        at = token.end()
        number, root, word, star, script, scripted, sign = token.groups()
        if number:
            written.append(number)
        elif root:
            written.append(r"\sqrt{")
            closing.append("}")
        elif sign and sign[0] == "'":
            _add_dots(written, len(sign))
        elif word:
            # The star of Ad* is part of the name, that of a * b a product.
            dual = star and word in DUALS
            crossed = word == "x" and _between(text[: token.start(3)], text[at:])
            latex = r"\times" if crossed else DUALS[word] if dual else name(word)
            # An upright name stands apart from the factor before it.
            apart = latex.startswith(r"\mathrm") and re.search(r"[\w)\]'] +$", text[: token.start(3)])
            written += [r"\,", latex] if apart else [latex]
            at -= bool(star) and not dual
        elif script and scripted == "(":
            written.append(f"{script}{{")
            closing.append("}")
        elif script:
            minus = "-" if scripted.startswith("-") else ""
            written.append(f"{script}{{{minus}{name(scripted.lstrip('-'))}}}")
        elif sign in "([":
            column = sign == "[" and ";" in inside(text, at)
            written.append(r"\begin{bmatrix}" if column else sign)
            closing.append(COLUMN if column else {"(": ")", "[": "]"}[sign])
        elif sign in (")", "]", "]x"):
            if not closing:
                raise ValueError(f"the formula {text!r} has a bracket too many")
            written.append(closing.pop() + (r"_{\times}" if sign == "]x" else ""))
        elif sign == ";":
            written.append(r"\\")
        elif sign == "," and closing[-1:] == [COLUMN]:
            written.append("&")
        else:
            written.append(SIGNS.get(sign, sign))
    if closing:
        raise ValueError(f"the formula {text!r} has a bracket that is not closed")
    return " ".join(written)


def _add_dots(written: list[str], count: int) -> None:
    """Put the dots of a rate over the last name, which may have indices."""
    at = max((i for i, part in enumerate(written) if part[0] not in "^_"), default=-1)
    if at < 0 or not written[at].lstrip("\\")[:1].isalpha():
        raise ValueError(f"a formula has a prime after no name: {' '.join(written)}")
    written[at] = rf"\{'d' * count}ot{{{written[at]}}}"


def _between(before: str, after: str) -> bool:
    """Whether an x with spaces around it stands between two factors, and is no factor itself."""
    spaced = before.endswith(" ") and after.startswith(" ") and not after.lstrip().startswith("(+)")
    return spaced and bool(re.search(r"[\w)\]'|]\s*$", before) and re.match(r"\s*[\w(\[|]", after))


def inside(text: str, at: int) -> str:
    """What stands in the bracket that opens before `at`, without brackets inside of it."""
    depth, own = 0, ""
    for letter in text[at:]:
        depth += (letter in "([") - (letter in ")]")
        if depth < 0:
            break
        own += letter if depth == 0 else ""
    return own


def name(word: str) -> str:
    if word in RATES:
        return RATES[word]
    if GREEK.fullmatch(word):
        return f"\\{word}"
    if len(word) > 1 and word[-1].isdigit() and not word.isdigit():
        letters = word.rstrip("0123456789")
        return f"{name(letters)}_{{{word[len(letters) :]}}}"
    return word if len(word) == 1 or word.isdigit() else rf"\mathrm{{{word}}}"
