"""Types of arrays with their shapes.

They are jaxtyping's if jaxtyping is already imported. To import it would take a third of the time of `import twistax`.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from jax import Array

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Float
else:

    class Float:
        """`Float[Array, "n"]` is an array; nothing reads its shape."""

        def __class_getitem__(cls, parts: tuple[Any, str]) -> Any:
            return parts[0]


__all__ = ["Array", "Float"]
