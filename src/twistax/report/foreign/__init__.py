"""Published problems as their authors state them, solved by plain IPOPT in CasADi and by this package."""

import functools

from .page import ForeignReport
from .problems import FOREIGN

foreign = functools.partial(ForeignReport, FOREIGN)
