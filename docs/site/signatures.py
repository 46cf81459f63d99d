"""Signatures of public names with the types of their arguments, as the source writes them."""

from __future__ import annotations

import enum
import inspect
import re
from typing import Any, NamedTuple

from twistax.expr import Expr


class Signature(NamedTuple):
    """The text in the brackets of a call, and the type of what comes back; `untyped` are arguments without a type."""

    arguments: str
    returns: str | None
    untyped: tuple[str, ...]


def signature(value: Any, written: Callable[[str], str] = str) -> Signature | None:
    """The signature of a function or class, its types as `written` has them; None where there is none to write, as of
    an enumeration.
    """
    is_class = inspect.isclass(value)
    if is_class and (issubclass(value, enum.Enum) or getattr(value, "_is_protocol", False)):
        return None
    try:
        found = inspect.signature(value)
    except (TypeError, ValueError):
        return None
    types = _types_of_fields(value) if is_class else {}
    parameters = [p.replace(annotation=types.get(p.name, p.annotation)) for p in found.parameters.values()]
    parameters = [p for p in parameters if p.name != "self"]
    untyped = tuple(p.name for p in parameters if p.annotation is p.empty)
    returns = None if is_class or found.return_annotation is found.empty else written(_type(found.return_annotation))
    return Signature(f"({', '.join(_arguments(parameters, written))})", returns, untyped)


def _types_of_fields(value: type) -> dict[str, Any]:
    """Types by field of a node, whose `__init__` is written for it; an operand may be a number, too."""
    if not issubclass(value, Expr):
        return {}
    declared: dict[str, Any] = {}
    for base in reversed(value.__mro__):
        declared |= inspect.get_annotations(base)
    operands = {field.name: "ExprLike" for field in value._fields if field.operand or field.variadic}
    return {field.name: declared.get(field.name, "Any") for field in value._fields} | operands


def _arguments(parameters: list[inspect.Parameter], written: Callable[[str], str]) -> list[str]:
    texts: list[str] = []
    named = False
    for i, p in enumerate(parameters):
        if p.kind is p.KEYWORD_ONLY and not named:
            texts += ["*"]
        named |= p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
        star = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        text = star + p.name + ("" if p.annotation is p.empty else f": {written(_type(p.annotation))}")
        equals = "=" if p.annotation is p.empty else " = "
        texts.append(text + ("" if p.default is p.empty else equals + _default(p.default)))
        last = i + 1 == len(parameters) or parameters[i + 1].kind is not p.POSITIONAL_ONLY
        if p.kind is p.POSITIONAL_ONLY and last:
            texts.append("/")
    return texts


def _type(annotation: Any) -> str:
    """A type as it is written; strings within it, as in jaxtyping's `Float[Array, "3"]`, stay."""
    if isinstance(annotation, str):
        text = annotation
    elif hasattr(annotation, "__forward_arg__"):
        text = annotation.__forward_arg__
    elif inspect.isclass(annotation) and not getattr(annotation, "__args__", ()):
        text = annotation.__name__
    else:
        text = str(annotation)
    return re.sub(r"\b(?:typing|collections\.abc|twistax(?:\.\w+)*)\.(?=[A-Z])", "", text)


def _default(value: Any) -> str:
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}"
    if isinstance(value, (tuple, list)) and value and isinstance(value[0], enum.Enum):
        return "..."
    if inspect.isroutine(value) or inspect.isclass(value):
        return str(value.__name__)
    text = repr(value)
    return text if len(text) <= 40 and "<" not in text else "..."
