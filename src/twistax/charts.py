"""Charts, the coordinates of a step: `tx.charts.Exponential`, `SplitExponential`, `Ambient`; base class `Chart`."""

from .integrators.charts import *  # noqa: F403
from .integrators.charts import __all__ as _charts

__all__ = [*_charts]
