"""An XML file as elements with their line numbers. Entities and external files are refused."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from ...checks import short
from ...errors import ModelError

#: A start tag that contains a reference to an entity that XML does not predefine.
_TAG = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*""")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_ENTITY = re.compile(rb"&(?!amp;|lt;|gt;|quot;|apos;|#)([^;]*);")
#: Characters that some editors write around a file in UTF-8, and that XML does not allow before its declaration or
#: after its end.
_BEFORE = re.compile(rb"\A(?:\xef\xbb\xbf)?[ \t\r\n]+(?:\xef\xbb\xbf)?(?=<)")
_AFTER = re.compile(rb"\x00+\s*\Z")


@dataclasses.dataclass
class Element:
    """One element.

    Attributes:
        tag, attributes, children: as in the file; `read_xml` may remove the prefixes of tags.
        line: the line of its start.
        path: path of the file.
        parent: the enclosing element; None for the root.
        content: its text, with a space in place of each child.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    path: Path
    parent: Element | None = dataclasses.field(default=None, repr=False, compare=False)
    children: list[Element] = dataclasses.field(default_factory=list)
    content: str = ""

    @property
    def place(self) -> str:
        """File, line and element for messages; for an element without a name, also the enclosing
        element that has one.
        """
        around = self
        while "name" not in around.attributes and around.parent is not None and around.parent.parent is not None:
            around = around.parent
        inside = f", in {around.head}" if around is not self and "name" in around.attributes else ""
        return f"{self.path.name}{inside}, line {self.line}, {self.head}"

    @property
    def head(self) -> str:
        """The tag and the name, as in `<link name='arm'>`."""
        name = self.attributes.get("name")
        return f"<{self.tag}{'' if name is None else f' name={name!r}'}>"

    def wrong(self, what: str) -> ModelError:
        """A ModelError whose message names the location of the element."""
        return ModelError(f"{self.place}: {what}")

    def all(self, tag: str) -> list[Element]:
        """The children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        return next(iter(self.all(tag)), None)

    def text(self, name: str) -> str:
        """A required attribute. Raises ModelError if it is missing."""
        if name not in self.attributes:
            raise self.wrong(f"expected the attribute {name!r}")
        return self.attributes[name]

    def read(self, text: str, what: str = "a finite number") -> float:
        """The number in a text of the element, which `what` names in messages. Raises ModelError for other texts."""
        word = text.strip()
        if not (_NUMBER.fullmatch(word) and math.isfinite(float(word))):
            raise self.wrong(f"expected {what}, got {short(word)}")
        return float(word)

    def numbers(self, name: str, count: int, default: Any = None) -> np.ndarray:
        """An attribute as finite numbers (count,). Raises ModelError for other values."""
        if name not in self.attributes and default is not None:
            return np.asarray(default, dtype=np.float64)
        wanted, words = f"{count} finite numbers in {name}", self.text(name).split()
        if len(words) != count:
            raise self.wrong(f"expected {wanted}, got {self.text(name)!r}")
        return np.array([self.read(word, wanted) for word in words])

    def number(self, name: str, default: float | None = None) -> float:
        """An attribute as one finite number. Raises ModelError for other values."""
        if name not in self.attributes and default is not None:
            return default
        return self.read(self.text(name), f"a finite number in {name}")

    def limits(self, least: str, most: str) -> tuple[float | None, float | None]:
        """Two attributes that limit a value, None for a missing one. Raises ModelError if the first is higher."""
        lower, upper = (self.number(name) if name in self.attributes else None for name in (least, most))
        if lower is not None and upper is not None and lower > upper:
            raise self.wrong(f"{least} {lower:g} is above {most} {upper:g}")
        return lower, upper

    @property
    def values(self) -> np.ndarray:
        """The numbers in the content, separated by commas or white space. Raises ModelError for other content."""
        return np.array([self.read(word, "finite numbers") for word in self.content.replace(",", " ").split()])


def read_xml(path: Path, caller: str = "load", document_type: bool = False, notes: list[str] | None = None) -> Element:
    """The root element of a file.

    White space before the XML declaration and null characters after the end, which XML does not allow, are removed.

    Args:
        caller: the name of the calling function in messages.
        document_type: whether the file may declare a document type, which is not opened, and may use name space
            prefixes in tags, which are removed.
        notes: receives a note if something before the declaration or after the end was removed.
    Raises: ModelError for a file that cannot be read, is not XML, or declares a document type or entities.
    """
    if str(path).lstrip().startswith("<"):
        raise ModelError(f"{caller} expects the path of a file, got its text.\n  fix: write the text to a file")
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        why = getattr(error, "strerror", None) or error
        raise ModelError(f"{caller} expects a file, but cannot read {str(path)!r}: {why}") from None
    data, skipped = _trimmed(data, path, [] if notes is None else notes)
    parser, open_elements, roots = expat.ParserCreate(), list[Element](), list[Element]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        written = _TAG.match(data, parser.CurrentByteIndex) if document_type else None
        if written and (entity := _ENTITY.search(written[0])):
            unknown(entity[1].decode("utf-8", "replace"), None)
        name = tag.rpartition(":")[2] if document_type else tag
        parent = open_elements[-1] if open_elements else None
        element = Element(name, attributes, parser.CurrentLineNumber + skipped, path, parent)
        (parent.children if parent else roots).append(element)
        if open_elements:
            open_elements[-1].content += " "
        open_elements.append(element)

    def characters(text: str) -> None:
        open_elements[-1].content += text

    def doctype(_name: str, _system: Any, _public: Any, inside: int) -> None:
        if inside or not document_type:
            declared()

    def unknown(name: str, _parameter: Any) -> None:
        raise ModelError(f"{path.name}, line {parser.CurrentLineNumber + skipped}: unknown entity &{name};")

    def declared(*_: Any) -> None:
        line = parser.CurrentLineNumber + skipped
        raise ModelError(
            f"{path.name}, line {line}: a document type or entity is declared, which models do not need.\n"
            "  fix: remove <!DOCTYPE ...>; write out what its entities stand for"
        )

    parser.buffer_text, parser.buffer_size = (
        True,
        1 << 20,
    )  # otherwise each line of a table would be appended to the text separately
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: open_elements.pop()
    parser.CharacterDataHandler = characters
    parser.EntityDeclHandler, parser.StartDoctypeDeclHandler = declared, doctype
    # After a document type that is not opened, expat drops an unknown entity; in attributes it does so without a
    # callback, so `start` searches for them.
    parser.SkippedEntityHandler = unknown
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        line = error.lineno + skipped
        raise ModelError(f"{path.name}, line {line}: this is not XML: {expat.ErrorString(error.code)}") from None
    except ModelError:
        raise
    except (LookupError, ValueError) as error:  # the encoding that the file declares
        raise ModelError(f"{path.name}: this is not XML: {error}") from None
    return roots[0]


def _trimmed(data: bytes, path: Path, notes: list[str]) -> tuple[bytes, int]:
    """A file without invisible characters around its XML, and the number of lines removed from its beginning."""
    before, after = _BEFORE.match(data), _AFTER.search(data)
    if before and data.startswith(b"<?xml", before.end()):
        notes.append(f"white space before the XML declaration of {path.name!r}")
        skipped = before[0].count(b"\n") or before[0].count(b"\r")
    else:
        before, skipped = None, 0
    if after:
        notes.append(f"null characters after the end of {path.name!r}")
    return data[before.end() if before else 0 : after.start() if after else None], skipped
